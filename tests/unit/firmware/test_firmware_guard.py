"""The sensors that guard a bend are missing or wrong: what the contact trigger and the board do.

While a muscle bends the body, the trigger works on the base sensors that this muscle leaves at rest
(`trigger_when`). What is shown here:

- No such sensor: a sweep is refused. A press is accepted, and its answer says that no contact is
  felt.
- Its circuit breaks during the bend: a fault, outputs off. The same of an IMU that begins again and
  so loses its zero (tests/sim/micropython/test_imus_on_micropython.py).
- It is frozen at rest, or reads too little: the trigger reports a contact that is none.
- It reads too much: the trigger is deaf, and nothing on the board notices. `thigmo calibrate check`
  compares the sensor with the map.
- A former muscle seems to hold pressure, so its sensors seem wrinkled and the trigger waits: a
  fault, or for less than the fault's threshold a body that is not vented, which no sweep starts
  with.
- A muscle that is not fitted seems to hold pressure: nothing.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from firmware_bench import Bench, bend, flex_count, pressure_count

from thigmo.link import protocol as wire

GUARD = 5  # input of the base sensor that the first muscle leaves at rest
SWEEP = wire.Sweep((1500, 0), 8000, 1, 0)


def held(first: float, second: float) -> float:
    """Against obstacles on both sides, which take 0.008 1/cm at the peak."""
    return bend(first, second) - 0.001 * (max(0.0, first - 7.0) - max(0.0, second - 7.0))


def ready(body: Callable[[float, float], float] = bend) -> Bench:
    return Bench(body=body).zeroed()


def read_by_guard(bench: Bench, gain: float) -> None:
    """Let the guard read a bend with a wrong gain."""
    inner = bench.inputs

    def inputs() -> np.ndarray:
        counts = inner()
        counts[GUARD] = flex_count(gain * bench.body(*bench.air.psi))
        return counts

    bench.inputs = inputs  # type: ignore[method-assign]


def contacts(bench: Bench) -> list[int]:
    return [event.arg for event in bench.event(wire.EventCode.CONTACT)]


@pytest.mark.parametrize(
    ("name", "value"), [("trigger_when", 0x80), ("flex_enabled", 0)], ids=["not named", "unhealthy"]
)
def test_without_a_guard_a_sweep_is_refused_and_a_press_is_answered_so(
    name: str, value: int
) -> None:
    bench = ready()
    bench.set(name, value, element=GUARD)
    for tops in ((1500, 0), (1500, 1500)):
        answer = bench.get(wire.Sweep(tops, 8000, 1, 0), wire.Ack)
        assert (answer.reason, answer.detail) == (wire.Reason.NO_BASE_SENSOR, 0)
    assert bench.do(wire.SetPressure((800, 0), 0)) == 1
    assert bench.do(wire.SetPressure((0, 800), 0)) == 0
    bench.do(wire.Vent())
    bench.step(2000)
    bench.do(wire.Sweep((0, 1500), 8000, 1, 0))


def test_a_guard_whose_zero_is_unknown_lets_no_muscle_bend_the_body() -> None:
    bench = ready()
    bench.do(wire.ConfirmLength(100_000, 0))
    assert bench.refused(SWEEP) == wire.Reason.NOT_ZEROED
    assert bench.refused(wire.SetPressure((800, 0), 0)) == wire.Reason.NOT_ZEROED


@pytest.mark.parametrize(
    ("count", "fault"), [(0.0, wire.Fault.FLEX_OPEN), (1023.0, wire.Fault.FLEX_SHORT)]
)
def test_a_guard_whose_circuit_breaks_in_a_bend_ends_it(count: float, fault: wire.Fault) -> None:
    bench = ready()
    bench.do(SWEEP)
    bench.step(1500)
    bench.override[GUARD] = count
    bench.step(300)
    assert fault in bench.faults()
    assert bench.safe()


@pytest.mark.parametrize("gain", [0.0, 0.7])
def test_a_guard_that_is_frozen_or_reads_too_little_says_contact_where_there_is_none(
    gain: float,
) -> None:
    bench = ready()
    read_by_guard(bench, gain)
    bench.do(SWEEP)
    bench.step(8000)
    assert contacts(bench) == [0]


@pytest.mark.parametrize(("gain", "felt"), [(1.0, [0]), (1.5, [])])
def test_a_guard_that_reads_too_much_is_deaf_and_the_board_does_not_notice(
    gain: float, felt: list[int]
) -> None:
    bench = ready(held)
    read_by_guard(bench, gain)
    bench.do(SWEEP)
    bench.step(8000)
    assert contacts(bench) == felt
    assert bench.faults() == ()


@pytest.mark.parametrize(
    ("lies", "fault"),
    [(False, wire.Fault.PRESSURE_STUCK), (True, wire.Fault.PRESSURE_MISMATCH)],
    ids=["a valve that sticks", "a sensor that lies"],
)
def test_a_former_muscle_that_keeps_pressure_is_a_fault_before_the_next_one_bends_far(
    lies: bool, fault: wire.Fault
) -> None:
    bench = ready(held)
    bench.do(wire.Sweep((1500, 1500), 8000, 1, 0))
    bench.until(lambda: bool(bench.event(wire.EventCode.PEAK, 0)))
    if lies:
        bench.override[10] = pressure_count(9.0)
    else:
        bench.air.stuck[0] = True
    bench.until(lambda: bool(bench.faults()), 6000)
    assert fault in bench.faults()
    assert bench.safe()
    assert bench.air.psi[1] < 5.0
    assert contacts(bench) == [0]


def test_a_former_muscle_that_seems_to_keep_a_little_pressure_mutes_one_half_and_is_told() -> None:
    bench = ready(held)
    bench.do(wire.Sweep((1500, 1500), 8000, 1, 0))
    bench.until(lambda: bool(bench.event(wire.EventCode.PEAK, 0)))
    bench.step(1800)
    bench.override[10] = pressure_count(1.0)
    bench.until(lambda: bench.ended(wire.Activity.SWEEPING))
    assert contacts(bench) == [0]
    bench.step(2000)
    assert not bench.status().conditions & wire.Condition.VENTED.mask
    assert bench.refused(SWEEP) == wire.Reason.NOT_VENTED
