"""`test_output`: one output as it is, for a moment, within limits that no parameter moves."""

from __future__ import annotations

import pytest
from firmware_bench import Bench

from thigmo.link import protocol as wire

O = wire.Output  # noqa: E741
R = wire.Reason


@pytest.mark.parametrize("side", [0, 1])
def test_a_valve_carries_the_current_asked_for_and_then_none(side: int) -> None:
    bench = Bench().prepare()
    bench.do(wire.TestOutput(O.TRANSDUCER, side, 336, 300))
    bench.step(20)
    assert bench.board.drive[side] == 336
    assert bench.board.drive_enabled == (side == 0, side == 1)
    bench.step(250)
    assert bench.board.drive[side] == 336
    bench.step(60)
    assert bench.board.drive_enabled == (False, False)
    assert bench.event(wire.EventCode.ACTIVITY_DONE, wire.Activity.TESTING)
    assert bench.status().state == wire.State.READY


@pytest.mark.parametrize("duty", [150, -150])
def test_the_motor_turns_with_the_length_unknown(duty: int) -> None:
    bench = Bench().prepare()
    bench.do(wire.TestOutput(O.MOTOR, 0, duty, 200))
    bench.step(100)
    assert bench.board.motor == duty
    bench.step(150)
    assert bench.board.braked
    assert not bench.status().conditions & wire.Condition.LENGTH_KNOWN.mask


def test_repeated_in_time_it_goes_on() -> None:
    bench = Bench().prepare()
    for _ in range(5):
        bench.do(wire.TestOutput(O.TRANSDUCER, 0, 336, 500))
        bench.step(400)
        assert bench.board.drive == (336, 0)
    assert bench.do(wire.Vent()) == 0
    assert bench.safe()
    bench.step(100)
    assert bench.safe()


def test_a_minute_of_it_is_no_fault() -> None:
    bench = Bench().prepare()
    for _ in range(150):
        bench.do(wire.TestOutput(O.TRANSDUCER, 0, 400, 500))
        bench.step(400)
    assert bench.air.psi[0] == pytest.approx(5.6, abs=0.1)
    assert bench.faults() == ()


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (wire.TestOutput(O.TRANSDUCER, 0, 401, 100), R.OVER_LIMIT),
        (wire.TestOutput(O.TRANSDUCER, 0, -1, 100), R.BAD_VALUE),
        (wire.TestOutput(O.MOTOR, 0, 201, 100), R.OVER_LIMIT),
        (wire.TestOutput(O.MOTOR, 0, -201, 100), R.OVER_LIMIT),
        (wire.TestOutput(O.MOTOR, 0, -32768, 100), R.OVER_LIMIT),
        (wire.TestOutput(O.MOTOR, 0, 100, 501), R.OVER_LIMIT),
        (wire.TestOutput(O.MOTOR, 0, 100, 0), R.BAD_VALUE),
    ],
)
def test_what_is_too_much_is_refused(command: wire.TestOutput, reason: wire.Reason) -> None:
    bench = Bench().prepare()
    assert bench.refused(command) == reason
    bench.step(50)
    assert bench.safe()


def test_interlocks() -> None:
    bench = Bench().prepare()
    bench.do(wire.TestOutput(O.TRANSDUCER, 0, 400, 500))
    bench.step(300)
    assert bench.refused(wire.TestOutput(O.MOTOR, 0, 100, 100)) == R.NOT_VENTED
    assert bench.refused(wire.TestOutput(O.TRANSDUCER, 1, 400, 100)) == R.BUSY
    assert bench.refused(wire.Home()) == R.BUSY
    bench.do(wire.Disarm())
    assert bench.safe()
    assert bench.refused(wire.TestOutput(O.TRANSDUCER, 0, 400, 100)) == R.WRONG_STATE


def test_a_silent_host_ends_it() -> None:
    bench = Bench().prepare()
    bench.do(wire.TestOutput(O.MOTOR, 0, 100, 500))
    bench.beating = False
    bench.step(505)
    assert bench.safe()
