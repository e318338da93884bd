"""From the board's integers to messages in units."""

from __future__ import annotations

from math import isnan, nan, pi
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thigmo.config import RobotConfig
from thigmo.link import protocol as wire
from thigmo.link.inbox import ReceivedEvent, TelemetryFrame
from thigmo.record import LogWriter
from thigmo.robot import SensorTable
from thigmo.robot.publishing import Publisher, bent
from thigmo.stream import BodyShape, Telemetry, read_messages, recording
from thigmo.wiring import Wiring

WIRING = Wiring.laid_out(RobotConfig())
TABLE = SensorTable.laid_out(WIRING).zeroed(dict.fromkeys(range(10), 16 * 660.0))


def _frame(
    flex: list[int],
    left_cpsi: int = 0,
    right_cpsi: int = 0,
    length_um: int = 530_000,
    motor: int = -400,
) -> TelemetryFrame:
    message = wire.Telemetry(
        5_000_000, tuple(flex), (left_cpsi, right_cpsi), (1000, 0), (1599, 0), length_um, motor,
        1234, 1200, wire.State.MOVING << 4 | wire.Activity.SWEEPING, wire.Fault.STOPPED.mask,
    )  # fmt: skip
    return TelemetryFrame(1, 6.0, 5_000_000, message.pack())


def _publisher(table: SensorTable, epoch_s: float) -> Publisher:
    link: Any = SimpleNamespace(now=lambda: 0.0, on_telemetry=[], on_event=[])
    publisher = Publisher(link, WIRING, table)
    publisher.epoch_s = epoch_s
    return publisher


def _decoded(
    frame: TelemetryFrame, table: SensorTable = TABLE, epoch_s: float = 0.0, supply_v: float = nan
) -> Telemetry:
    publisher = _publisher(table, epoch_s)
    publisher.supply_v = supply_v
    return publisher.decoded(frame)


@given(st.lists(st.integers(0, 16 * 1023), min_size=10, max_size=10))
def test_curvature_is_that_of_the_sensor_table(flex: list[int]) -> None:
    said = _decoded(_frame(flex))
    by_table = TABLE.curvature(np.array(flex, dtype=np.float64))
    assert said.curvature_per_cm == pytest.approx(by_table.tolist(), rel=1e-12, nan_ok=True)


def test_units_and_names() -> None:
    said = _decoded(_frame([10_000] * 10, 950, 3), epoch_s=1.7e9, supply_v=11.9)
    assert (said.t_s, said.epoch_s, said.device_s) == (6.0, 1.7e9 + 6.0, 5.0)
    assert (said.pressure_psi, said.demand_psi) == ((9.5, 0.03), (10.0, 0.0))
    assert said.drive_ma == (20.0, 0.0)
    assert (said.length_cm, said.motor, said.supply_v) == (53.0, -0.5, 11.9)
    assert (said.base_per_cm, said.free_per_cm) == (0.01234, 0.012)
    assert (said.state, said.activity, said.faults) == ("moving", "sweeping", ("stopped",))


def _frames(count: int, *, moves: bool = True) -> list[TelemetryFrame]:
    """Readings 5 ms apart, of a robot under pressure or of one at rest."""
    payload = _frame([10_000] * 10, 900 if moves else 0, motor=0).payload
    times_us = range(10_000_000, 10_000_000 + 5000 * count, 5000)
    return [TelemetryFrame(0, t_us * 1e-6, t_us, payload) for t_us in times_us]


def _fed(publisher: Publisher, frames: list[TelemetryFrame]) -> None:
    for frame in frames:
        publisher.take(frame)


def test_readings_are_recorded_and_shown_at_once(tmp_path: Path) -> None:
    publisher = _publisher(TABLE, 0.0)
    with LogWriter(tmp_path / "run.mcap", {}) as log, recording(publisher.hub, log):
        _fed(publisher, _frames(200))
        with publisher.hub.subscribe({"telemetry"}) as heard:
            _fed(publisher, _frames(100))
            assert len(heard.take()) == 100
    kept = list(read_messages(tmp_path / "run.mcap"))
    assert len([message for message in kept if isinstance(message, Telemetry)]) == 300


@pytest.mark.parametrize(("moves", "shapes"), [(True, 100), (False, 10)])
def test_a_robot_at_rest_tells_its_shape_once_a_second(
    tmp_path: Path, *, moves: bool, shapes: int
) -> None:
    publisher = _publisher(TABLE, 0.0)
    with LogWriter(tmp_path / "run.mcap", {}) as log, recording(publisher.hub, log):
        _fed(publisher, _frames(2000, moves=moves))
    kept = list(read_messages(tmp_path / "run.mcap"))
    assert sum(isinstance(message, BodyShape) for message in kept) == pytest.approx(
        shapes, rel=0.06
    )


def test_only_sensors_that_are_out_and_zeroed_tell_something() -> None:
    said = _decoded(_frame([10_000] * 10, length_um=200_000), TABLE.zeroed({0: nan}))
    known = [not isnan(value) for value in said.curvature_per_cm]
    assert known == [False, True, False, False, False, True, True, False, False, False]


@pytest.mark.parametrize(("pressures", "free"), [((900, 0), "right"), ((0, 900), "left")])
def test_the_inflated_side_wrinkles_and_is_not_compared(
    pressures: tuple[int, int], free: str
) -> None:
    said = _decoded(_frame([10_000] * 10, *pressures))
    expected = {"left": said.expected_per_cm[:5], "right": said.expected_per_cm[5:]}
    assert expected.pop(free) == (0.012,) * 5
    assert all(isnan(value) for value in expected.popitem()[1])


@pytest.mark.parametrize("fault", list(wire.Fault))
def test_a_fault_says_what_happened_and_what_to_do(fault: wire.Fault) -> None:
    received = ReceivedEvent(wire.Event(1, wire.EventCode.FAULT, 0, fault, 0), 2.0, 0)
    said = _publisher(TABLE, 10.0).event(received)
    assert (said.name, said.severity, said.epoch_s) == (fault.key, "fault", 12.0)
    assert said.message
    assert said.next


@pytest.mark.parametrize("code", [c for c in wire.EventCode if c is not wire.EventCode.FAULT])
def test_every_event_has_words(code: wire.EventCode) -> None:
    received = ReceivedEvent(wire.Event(1, code, 0, 1, 7), 2.0, 0)
    said = _publisher(TABLE, 0.0).event(received)
    assert said.name == code.key
    assert said.message


def test_a_quarter_circle_ends_beside_its_start() -> None:
    length_cm = 40.0
    poses = bent(length_cm, [(0.0, pi / 2 / length_cm)])
    radius_cm = length_cm / (pi / 2)
    assert poses[-1] == pytest.approx((radius_cm, radius_cm, pi / 2), rel=1e-3)


def test_between_two_sensors_the_bend_goes_over_from_one_to_the_other() -> None:
    heading = [pose[2] for pose in bent(20.0, [(5.0, 0.0), (15.0, 0.02)])]
    assert heading[2] == 0.0  # at 4 cm
    assert heading[-1] == pytest.approx(0.2, abs=0.002)  # a tenth over the ramp, and as much after
