"""The air enables: held only while the firmware runs, armed; the body's only by its own command."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from firmware_bench import Bench

from thigmo.link import protocol as wire

HOLD_MS = 60  # what the charge pump stores, at most


def breathing() -> Bench:
    """Armed, with air in the body."""
    bench = Bench().prepare()
    bench.do(wire.BodyAir(1))
    bench.step(20)
    assert bench.board.air == (True, True)
    assert bench.status().conditions & wire.Condition.BODY_AIR.mask
    return bench


def test_no_air_before_the_robot_is_armed() -> None:
    bench = Bench()
    bench.hello()
    assert bench.board.air == (False, False)
    assert bench.refused(wire.BodyAir(1)) == wire.Reason.FAULT_LATCHED  # bad_config, as new
    bench.do(wire.LoadDefaults())
    bench.do(wire.ClearFaults(0xFFFF))
    assert bench.refused(wire.BodyAir(1)) == wire.Reason.WRONG_STATE
    bench.step(100)
    assert bench.board.air == (False, False)


def test_arming_lets_air_to_the_muscles_alone() -> None:
    bench = Bench().prepare()
    bench.step(20)
    assert bench.board.air == (True, False)


def press_stop(bench: Bench) -> None:
    bench.do(wire.Disarm())


def press_emergency_stop(bench: Bench) -> None:
    bench.board.set_estop(True)


def fall_silent(bench: Bench) -> None:
    bench.do(wire.ConfirmLength(100_000, 1))
    bench.do(wire.GrowTo(300_000, 0))
    bench.beating = False
    bench.step(600)


def hang(bench: Bench) -> None:
    bench.board.hang()


def reset(bench: Bench) -> None:
    bench.board.reset(wire.ResetCause.EXTERNAL)


@pytest.mark.parametrize("event", [press_stop, press_emergency_stop, fall_silent, hang, reset])
def test_air_goes_and_stays_away(event: Callable[[Bench], None]) -> None:
    bench = breathing()
    event(bench)
    bench.step(HOLD_MS + 10)
    assert bench.board.air == (False, False)
    bench.step(2000)
    assert bench.board.air == (False, False)


def test_air_comes_back_by_its_command_alone() -> None:
    bench = breathing()
    bench.board.set_estop(True)
    bench.step(100)
    bench.board.set_estop(False)
    bench.step(500)
    assert bench.board.air == (False, False)
    assert bench.do(wire.ClearFaults(0xFFFF)) == 0
    bench.do(wire.Arm())
    bench.step(500)
    assert bench.board.air == (True, False)
    bench.do(wire.BodyAir(1))
    bench.step(20)
    assert bench.board.air == (True, True)


def test_air_is_taken_by_command_in_any_state() -> None:
    bench = breathing()
    bench.do(wire.BodyAir(0))
    bench.step(HOLD_MS + 10)
    assert bench.board.air == (True, False)
    assert not bench.status().conditions & wire.Condition.BODY_AIR.mask
    bench.do(wire.Disarm())
    bench.do(wire.BodyAir(0))
    assert bench.refused(wire.BodyAir(2)) == wire.Reason.BAD_VALUE
