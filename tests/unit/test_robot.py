"""The robot object against a board that is a dictionary: configuration, faults, waiting."""

from __future__ import annotations

import json
from collections import deque
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from thigmo.cli.main import app
from thigmo.config import SIDES, FlexSensor, Muscle, RobotConfig
from thigmo.errors import (
    CommandRefusedError,
    CommandTimeoutError,
    ConfigError,
    DataError,
    RobotFaultError,
)
from thigmo.link import protocol as wire
from thigmo.robot import (
    Robot,
    SensorTable,
    SweepFrame,
    SweepWatcher,
    sweep_period_s,
)
from thigmo.robot.configuration import map_settings, parameter_settings
from thigmo.robot.curvature import resistance_ohm
from thigmo.wiring import Wiring

OK = wire.Status.OK


class DictionaryBoard:
    """Answers commands from memory; each poll takes as long as it may, then gives events."""

    def __init__(self) -> None:
        self.transport = SimpleNamespace(virtual=True)
        self.values = {
            entry.index + i: value
            for entry in wire.PARAMETERS.values()
            for i, value in enumerate(entry.defaults)
        }
        self.capacity = wire.Capacity(OK, 2, 10, 3, 0, 10, 1599, 800, 1000)
        self.parameters = wire.PARAMETERS
        self.maps: dict[tuple[int, int, int], tuple[int, ...]] = {}
        self.faults = 0
        self.lasting = 0  # faults whose cause is still there
        self.conditions = 0
        self.generation = 0
        self.sent: list[wire.Message] = []
        self.coming: list[wire.Event] = []
        self.events: deque[Any] = deque()
        self.on_telemetry: list[Any] = []
        self.on_event: list[Any] = []
        self.time = 0.0
        self.stubborn = -1
        self.latch_at_poll = 0
        self.closed = False

    def now(self) -> float:
        return self.time

    def device_s(self, t_us: int) -> float:
        return t_us / 1e6

    def close(self) -> None:
        self.closed = True

    def poll(self, timeout_s: float) -> None:
        self.time += timeout_s
        self.faults |= self.latch_at_poll
        if self.coming:
            event = self.coming.pop(0)
            self.events.append(SimpleNamespace(message=event, t_s=self.time, device_us=0))

    def request(self, command: wire.Message) -> wire.Message:
        self.sent.append(command)
        match command:
            case wire.GetParameter():
                return wire.ParameterValue(OK, command.index, self.values[command.index])
            case wire.SetParameter():
                if command.index != self.stubborn:
                    self.values[command.index] = command.value
                return wire.ParameterValue(OK, command.index, command.value)
            case wire.GetMap():
                key = (command.zone, command.muscle, command.branch)
                return wire.MapValues(OK, *key, self.maps.get(key, (0,) * 11))
            case wire.SetMap():
                self.maps[command.zone, command.muscle, command.branch] = command.curvature_e5
            case wire.SaveConfig():
                self.generation += 1
            case wire.ClearFaults():
                self.faults &= ~command.mask | self.lasting
                return wire.Ack(OK, wire.Reason.NONE, self.faults)
            case wire.GetStatus():
                return self._status()
            case wire.GrowTo() if self.faults:
                raise CommandRefusedError("refused", "clear", reason="fault_latched")
            case _:
                pass
        return wire.Ack(OK, wire.Reason.NONE, 0)

    def _status(self) -> wire.StatusReport:
        return wire.StatusReport(
            OK, wire.State.READY, wire.Activity.IDLE, 255, self.faults, self.conditions, 0,
            123_400, (0, 0), 0, 0, 0, 0, self.generation, 4980, 3, 0,
        )  # fmt: skip


def _robot() -> tuple[Robot, DictionaryBoard]:
    board = DictionaryBoard()
    return Robot(board), board  # type: ignore[arg-type]


def _event(code: wire.EventCode, arg: int, value: int = 0) -> wire.Event:
    return wire.Event(1, code, 0, arg, value)


def test_the_board_ends_up_with_what_robot_toml_says() -> None:
    robot, board = _robot()
    config = RobotConfig()
    config.column("left")[2].healthy = False
    config.column("right")[1].center_cm = 14.5
    config.column("right")[1].center_se_cm = 0.25
    config.muscle("right").lag_s = 0.15
    assert robot.configure(config)
    for name, values in parameter_settings(Wiring.laid_out(config)).items():
        assert robot.parameter(name) == values, name
    assert robot.parameter("flex_enabled") == [1, 1, 0, 1, 1, 1, 1, 1, 1, 1]
    assert robot.parameter("flex_center_um")[6] == 145_000
    assert robot.parameter("flex_center_se_um")[5:8] == [1000, 2500, 1000]
    assert robot.parameter("lag_ms") == [200, 150]
    assert len(board.maps) == 12
    assert all(values[-1] < 0 for (_, side, _), values in board.maps.items() if side == 1)
    assert board.generation == 1


def test_a_board_that_holds_it_already_is_not_written_again() -> None:
    robot, board = _robot()
    robot.configure(RobotConfig())
    board.sent.clear()
    assert not robot.configure(RobotConfig())
    assert not any(
        isinstance(m, wire.SetParameter | wire.SetMap | wire.SaveConfig) for m in board.sent
    )


def test_a_value_that_the_board_does_not_give_back_is_an_error() -> None:
    robot, board = _robot()
    board.stubborn = wire.PARAMETERS["settle_ms"].index
    config = RobotConfig()
    config.board.settle_s = 20.0
    with pytest.raises(ConfigError, match=r"holds \[30000\] instead of \[20000\].*settle_ms"):
        robot.configure(config)


def test_a_missing_configuration_is_stored_and_its_fault_cleared_and_no_other() -> None:
    robot, board = _robot()
    board.faults = wire.Fault.BAD_CONFIG.mask | wire.Fault.WATCHDOG.mask
    robot.configure(RobotConfig())
    assert board.generation == 1
    assert robot.status().faults == ("watchdog",)
    with pytest.raises(RobotFaultError, match="watchdog: The firmware hung") as caught:
        robot.arm()
    assert caught.value.faults == ("watchdog",)


def test_a_fault_while_waiting_is_raised_in_the_schemas_words() -> None:
    robot, board = _robot()
    board.latch_at_poll = wire.Fault.SPOOL_STALL.mask
    board.coming = [
        _event(wire.EventCode.EVERTED, 0),
        _event(wire.EventCode.FAULT, wire.Fault.SPOOL_STALL),
    ]
    with pytest.raises(
        RobotFaultError,
        match=r"too little or too much motion \(The encoder stands still\); free the spool",
    ):
        robot.grow_to(10.0)


def test_a_wait_of_no_time_takes_what_has_come() -> None:
    robot, board = _robot()
    board.latch_at_poll = wire.Fault.SPOOL_STALL.mask
    board.coming = [_event(wire.EventCode.FAULT, wire.Fault.SPOOL_STALL)]
    with pytest.raises(RobotFaultError, match="spool_stall"):
        robot.wait(0)


@pytest.mark.parametrize(
    ("fault", "value", "said"),
    [
        (
            wire.Fault.INTERLOCK,
            wire.Reason.NOT_VENTED,
            r"ended it \(A muscle still holds pressure\)",
        ),
        (wire.Fault.BAD_CONFIG, wire.ConfigCause.BLANK, r"configuration \(Nothing was ever stored"),
        (wire.Fault.SPOOL_STALL, -1, r"too much motion \(before the board's last reset\); free"),
        (wire.Fault.PRESSURE_WIRE, -1, r"its supply \(before the board's last reset\); check"),
    ],
)
def test_a_fault_says_what_its_event_knows(fault: wire.Fault, value: int, said: str) -> None:
    robot, board = _robot()
    board.latch_at_poll = fault.mask
    board.coming = [_event(wire.EventCode.FAULT, fault, value)]
    with pytest.raises(RobotFaultError, match=said):
        robot.grow_to(10.0)


def test_the_event_of_a_fault_that_was_cleared_since_stops_nothing() -> None:
    robot, board = _robot()
    board.coming = [
        _event(wire.EventCode.FAULT, wire.Fault.BAD_CONFIG),
        _event(wire.EventCode.ACTIVITY_DONE, wire.Activity.GROWING, 100_000),
    ]
    assert robot.grow_to(10.0) == pytest.approx(10.0)


def test_a_refusal_because_of_a_fault_names_the_fault() -> None:
    robot, board = _robot()
    board.faults = wire.Fault.OVER_PRESSURE.mask
    with pytest.raises(RobotFaultError, match="over_pressure"):
        robot.grow_to(10.0)


def test_a_pressure_fault_names_its_muscle_as_often_as_it_is_told_and_how_to_clear_it() -> None:
    board = DictionaryBoard()
    board.transport.virtual = False
    robot = Robot(board, url="/dev/ttyACM0")  # type: ignore[arg-type]
    board.latch_at_poll = wire.Fault.PRESSURE_WIRE.mask
    board.coming = [_event(wire.EventCode.FAULT, wire.Fault.PRESSURE_WIRE, SIDES.index("right"))]
    said = (
        r"of its supply \(right muscle\); check its wire, then clear "
        r"\(`thigmo clear --robot /dev/ttyACM0`\)$"
    )
    for command in (lambda: robot.grow_to(10.0), robot.arm):
        with pytest.raises(RobotFaultError, match=said):
            command()


def test_the_command_clears_what_it_can_and_tells_the_fault_that_lasts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, board = _robot()
    board.faults = wire.Fault.ESTOP.mask | wire.Fault.WATCHDOG.mask
    board.lasting = wire.Fault.ESTOP.mask
    monkeypatch.setattr("thigmo.robot.connect", lambda url: Robot(board))  # type: ignore[arg-type]
    first = CliRunner().invoke(app, ["clear", "--robot", "/dev/ttyACM0"])
    assert first.output == "Cleared: watchdog.\n"
    assert isinstance(first.exception, RobotFaultError)
    assert "estop: The emergency stop was pressed; release it" in str(first.exception)
    board.lasting = 0
    cleared = CliRunner().invoke(app, ["clear", "--robot", "/dev/ttyACM0", "--json"])
    assert json.loads(cleared.output) == {"cleared": ["estop"], "remaining": []}
    assert cleared.exit_code == 0
    assert CliRunner().invoke(app, ["clear", "--robot", "x"]).output == "No fault is latched.\n"


def test_growth_ends_with_the_boards_length_and_only_with_its_own_event() -> None:
    robot, board = _robot()
    board.coming = [
        _event(wire.EventCode.ACTIVITY_DONE, wire.Activity.SWEEPING, 1),
        _event(wire.EventCode.ACTIVITY_DONE, wire.Activity.GROWING, 100_400),
    ]
    assert robot.grow_to(10.0) == pytest.approx(10.04)


def test_events_from_before_a_command_do_not_end_it() -> None:
    robot, board = _robot()
    board.coming = [_event(wire.EventCode.ACTIVITY_DONE, wire.Activity.GROWING, 50_000)]
    board.poll(0.1)
    with pytest.raises(CommandTimeoutError, match="growing has not ended"):
        robot.grow_to(10.0)


def test_an_aborted_activity_says_why() -> None:
    robot, board = _robot()
    everted = wire.StatusReport(
        OK, wire.State.READY, wire.Activity.IDLE, 0, 0, 0, 0, 0, (0, 0), 0x21, 0x21, 0, 0, 1, 5000,
        0, 0,
    )  # fmt: skip
    board._status = lambda: everted  # type: ignore[method-assign]
    board.coming = [
        _event(wire.EventCode.ACTIVITY_ABORTED, wire.Activity.ZEROING, wire.Reason.DRIFTING)
    ]
    with pytest.raises(CommandRefusedError, match="Readings still drift") as caught:
        robot.zero()
    assert caught.value.reason == "drifting"
    assert next(m for m in board.sent if isinstance(m, wire.ZeroSensors)).mask == 0x21


def test_leaving_the_robot_stops_it_and_closes_the_link_once() -> None:
    robot, board = _robot()
    with pytest.raises(ZeroDivisionError), robot:
        _ = 1 / 0
    assert isinstance(board.sent[-1], wire.Disarm)
    assert board.closed
    count = len(board.sent)
    robot.close()
    assert len(board.sent) == count


def test_a_muscle_that_does_not_empty_is_an_error_in_time() -> None:
    robot, board = _robot()
    with pytest.raises(CommandTimeoutError, match="still holds pressure"):
        robot.vent()
    board.conditions = wire.Condition.VENTED.mask
    robot.vent()


def test_nobody_answers_for_a_program_that_named_nobody() -> None:
    robot, _ = _robot()
    with pytest.raises(DataError, match=r"0\.49 psi"):
        robot.operator.set_body_pressure(0.49)
    with pytest.raises(DataError, match="length is unknown"):
        robot.operator.everted_length_cm()


def test_parameters_are_checked_before_they_are_sent() -> None:
    robot, board = _robot()
    with pytest.raises(ConfigError, match="no parameter 'nonsense'"):
        robot.parameter("nonsense")
    with pytest.raises(ConfigError, match="this board has no parameter imu_from"):
        robot.parameter("imu_from")
    with pytest.raises(ConfigError, match=r"must lie in 0\.\.600000 ms, not -1"):
        robot.set_parameter("settle_ms", [-1])
    with pytest.raises(ConfigError, match="holds 10 values, and 2"):
        robot.set_parameter("flex_scale", [1, 2])
    robot.set_parameter("flex_scale", [34_000])
    assert robot.parameter("flex_scale") == [34_000] * 10
    assert sum(isinstance(m, wire.SetParameter) for m in board.sent) == 10


def test_too_many_sensors_for_the_board_are_named() -> None:
    left = [FlexSensor(center_cm=5.0 + 2.5 * n) for n in range(17)]
    with pytest.raises(ConfigError, match="17 sensors"):
        parameter_settings(Wiring.laid_out(RobotConfig(sensors=left)))


def test_fewer_sensors_leave_the_rest_disabled() -> None:
    config = RobotConfig(sensors=[FlexSensor(center_cm=5.0)])
    assert parameter_settings(Wiring.laid_out(config))["flex_enabled"] == [1] + [0] * 9
    assert SensorTable.laid_out(Wiring.laid_out(config)).healthy.tolist() == [True] + [False] * 9


def test_all_settings_fit_the_schemas_ranges() -> None:
    config = RobotConfig()
    for name, values in parameter_settings(Wiring.laid_out(config)).items():
        entry = wire.PARAMETERS[name]
        assert len(values) == entry.count
        assert all(entry.low <= value <= entry.high for value in values), name
    assert all(
        len(m.curvature_e5) == wire.MAP_POINTS for m in map_settings(Wiring.laid_out(config))
    )


def test_the_boards_maps_are_what_the_base_sensors_that_guard_a_muscle_read() -> None:
    """A sensor at 30 degrees reads all of a bend towards 210, half of which is in the plane."""
    config = RobotConfig(
        muscles=[Muscle(name=f"{lies:g}deg", angle_deg=lies) for lies in (90.0, 210.0, 0.0)],
        sensors=[FlexSensor(angle_deg=lies, center_cm=5.0) for lies in (270.0, 30.0)],
    )
    top_psi = config.board.pressure_range_psi
    full = round(config.muscles[0].maps[0].inflate.curvature(top_psi) * 1e5)

    def sent() -> list[int]:
        return [
            setting.curvature_e5[-1]
            for setting in map_settings(Wiring.laid_out(config))
            if (setting.zone, setting.branch) == (0, wire.Branch.INFLATE)
        ]

    assert sent() == [full, -full, 0]
    bits = parameter_settings(Wiring.laid_out(config))["trigger_when"]
    assert (bits[0], bits[8]) == (0x80 | 1 << 1, 0x80 | 1 << 0)
    # Of a bend towards 0 degrees one sensor reads nothing, and the other wrinkles.
    assert [muscle.name for muscle in Wiring.laid_out(config).unguarded_muscles] == ["0deg"]
    # One that reads half of a bend guards it in place of a dead one that would read all.
    config.sensors[0].healthy, config.sensors[0].angle_deg = False, 30.0
    config.sensors[1].angle_deg = 330.0
    assert sent()[1] == pytest.approx(full / 2, abs=1)


def test_the_boards_trigger_does_not_count_a_base_sensor_that_does_not_answer_to_a_bend() -> None:
    """It reads nothing of the bend, so the trigger would take every bend for a contact."""
    config = RobotConfig()
    config.column("left")[0].bend_sign = 1  # bends to the right are negative
    bits = parameter_settings(Wiring.laid_out(config))["trigger_when"]
    assert (bits[0], bits[5]) == (0x80, 0x80 | 1 << 0)
    assert [muscle.name for muscle in Wiring.laid_out(config).unguarded_muscles] == ["right"]


@given(ohm=st.floats(3_000, 60_000))
def test_resistance_is_the_dividers_inverse(ohm: float) -> None:
    fraction = 22_000 / (22_000 + ohm)
    assert resistance_ohm(np.array([1024 * fraction]), 22_000) == pytest.approx([ohm], rel=1e-9)


def test_an_open_circuit_gives_no_number() -> None:
    table = SensorTable.laid_out(Wiring.laid_out(RobotConfig())).zeroed(
        dict.fromkeys(range(10), 16 * 640.0)
    )
    sums = np.full(10, 16 * 600.0)
    sums[3] = 0
    curvature = table.curvature(sums)
    assert np.isnan(curvature[3])
    assert np.isfinite(np.delete(curvature, 3)).all()
    # More resistance than at the zero, and a positive scale: bent to the left.
    assert curvature[0] > 0


def test_only_the_inactive_sides_sensors_that_answer_are_usable() -> None:
    config = RobotConfig()
    config.column("right")[0].healthy = False
    config.column("right")[1].bend_sign = -1
    table = SensorTable.laid_out(Wiring.laid_out(config))
    assert np.flatnonzero(table.usable("left", 0x3FF)).tolist() == [7, 8, 9]
    assert np.flatnonzero(table.usable("left", 0x17F)).tolist() == [8]
    assert np.flatnonzero(table.usable("right", 0x3FF)).tolist() == [0, 1, 2, 3, 4]


def test_a_peak_is_the_mean_of_its_readings() -> None:
    table = SensorTable.laid_out(Wiring.laid_out(RobotConfig())).zeroed(
        dict.fromkeys(range(10), 16 * 640.0)
    )
    shots = [
        SweepFrame("left", float(n), 17.0 + n, 0.03 + n * 1e-5, -0.01, (16 * 600 + n,) * 10)
        for n in range(10)
    ]
    peak = SweepWatcher(table, sensors=0x3FF, length_cm=53.0).average(shots)
    assert (peak.count, peak.t_s, peak.pressure_psi) == (10, 4.5, 21.5)
    assert peak.free_curvature == pytest.approx(0.030045)
    assert peak.curvature == pytest.approx(table.curvature(np.full(10, 16 * 600 + 4.5)))


def test_the_sweeps_period_keeps_the_lags_error_within_its_share_of_the_threshold() -> None:
    config = RobotConfig()
    period = sweep_period_s(config, 0)
    g_max = config.muscle("left").maps[0].inflate.curvature(18.0)
    assert 2 * np.pi / period * g_max * 0.5 * 0.2 <= 0.25 * 0.005 + 1e-12
    config.muscle("left").lag_s = config.muscle("right").lag_s = 0.4
    assert sweep_period_s(config, 0) == pytest.approx(2 * period, rel=0.2)
    assert sweep_period_s(config, 0, trigger_per_cm=0.01) < sweep_period_s(config, 0)
