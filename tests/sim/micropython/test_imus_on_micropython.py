"""A string of IMUs read over I2C by the firmware under MicroPython: readings, faults, recovery."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from command import Thigmo
from scipy.stats import norm

from thigmo.config import RAD_PER_OHM, HeadingSensor
from thigmo.design import draft
from thigmo.design.judge import IMU_BITS
from thigmo.emulator.imu_bus import BIT_US, Bno085, ImuBus, string_bus
from thigmo.emulator.micropython import MicroPythonBoard, open_micropython
from thigmo.emulator.micropython_build import missing
from thigmo.emulator.reach import room_for
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import CommandRefusedError, ConfigError, RobotFaultError
from thigmo.exploration import explore
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.framing import check_sequence
from thigmo.link.stored import StoredConfiguration
from thigmo.robot.robot import Robot
from thigmo.wiring import Wiring

Floats = npt.NDArray[np.float64]

LENGTH_CM = 100.0
# Of a sum of 16 conversions, at 34 kOhm of divider and sensor, and of two headings by quaternions
# of 14 bits: half a step of each.
_RAD_PER_COUNT = 34_000**2 / 22_000 / 1024 * RAD_PER_OHM
RESOLUTION_RAD = 0.5 * (_RAD_PER_COUNT / 16 + 2 * 2 / 2**14)
FAULTY = 6  # the seventh IMU from the base
WHERE = (FAULTY // 2, 0x4A + FAULTY % 2)


class String:
    """A robot with twelve IMUs, everted and ready; its bus can be harmed."""

    def __init__(self, path: Path) -> None:
        opened = open_micropython(f"micropython://{path}", seed=3)
        assert isinstance(opened, EmulatorTransport)
        self.transport = opened
        board = opened.lockstep.board
        assert isinstance(board, MicroPythonBoard)
        assert board.bus is not None
        self.board, self.bus = board, board.bus
        self.client = Client(opened)
        self.heard: list[wire.Telemetry] = []
        self.client.on_telemetry.append(lambda frame: self.heard.append(frame.message))
        self.robot = Robot(self.client)
        self.robot.configure(opened.config)
        self.robot.wait(0.5)
        self.robot.confirm_length(LENGTH_CM, settled=True)
        self.robot.select_body_pressure(2)

    @property
    def inputs(self) -> list[int]:
        """Inputs of the spans, base first."""
        (column,) = Wiring.laid_out(self.transport.config).columns
        return column.inputs

    @property
    def chip(self) -> Bno085:
        return self.bus.chips[WHERE]

    def bend(self) -> None:
        self.robot.wait(4.5)  # two windows of drift without an open circuit
        self.robot.arm()
        self.robot.zero()
        self.robot.press("left", 6.0)
        self.robot.wait(1.5)
        assert self.board.drive_enabled[0]

    def status(self) -> wire.StatusReport:
        return self.client.request(wire.GetStatus())

    def open_inputs(self) -> list[int]:
        """Inputs that are read as an open circuit, by their places from the base."""
        self.transport.pass_time(0.2)
        self.status()
        sums = self.heard[-1].flex_sum
        return [n for n, i in enumerate(self.inputs) if sums[i] == 0]


def scene_file(folder: Path, noise_deg: float | None = None) -> Path:
    """The whole robot in an empty room; `noise_deg` is of a report, if not as usual."""
    if reason := missing("unix-large"):
        pytest.skip(reason)
    scene = room_for(draft(100, 12, 2, kind="heading"), 0, peg=False)
    scene = scene.model_copy(update={"start_length_cm": LENGTH_CM, "start_settled": True})
    if noise_deg is not None:
        scene.imu.noise_deg = noise_deg
    path = folder / "scene.toml"
    scene.save(path)
    return path


@pytest.fixture
def scene_path(tmp_path: Path) -> Path:
    return scene_file(tmp_path)


@pytest.fixture
def string(scene_path: Path) -> String:
    return String(scene_path)


def turn_rad(count: Floats) -> Floats:
    """The turn that the count of a divider stands for."""
    ohm = 22_000 * (1024 - count) / count
    return (ohm - HeadingSensor.straight_ohm) * RAD_PER_OHM


@pytest.mark.parametrize("noise_deg", [0.05, 0.005])  # 0.05 is a BNO085's, and the emulator's
def test_readings_are_the_turns_between_neighbours(tmp_path: Path, noise_deg: float) -> None:
    string = String(scene_file(tmp_path, noise_deg))
    string.bend()
    string.robot.wait(4.0)
    plant = string.transport.lockstep.plant
    true_rad = turn_rad(plant.analog[string.bus.inputs, 1])
    sums = np.array([string.heard[-1].flex_sum[i] for i in string.bus.inputs])
    read_rad = turn_rad(sums / 16 + 0.5)
    # A reading has the reports of two IMUs, and the truth two later ones: four draws of the noise.
    # The largest of all spans is beyond this in one run of a thousand.
    sigma_rad = np.sqrt(4) * np.radians(noise_deg)
    most_rad = norm.isf(1e-3 / 2 / len(true_rad)) * sigma_rad
    assert read_rad == pytest.approx(true_rad, abs=most_rad + RESOLUTION_RAD)
    assert np.ptp(true_rad) > 0.02


def test_the_bus_carries_what_the_check_says_and_keeps_every_tick(string: String) -> None:
    before = string.bus.bits
    string.robot.wait(1.0)
    # An IMU is read in each tick: 1000 turns a second of IMU_BITS each.
    assert string.bus.bits - before == pytest.approx(1000 * IMU_BITS, rel=0.1)
    assert IMU_BITS * BIT_US < 1000
    assert string.status().faults == 0


def _unplugged(bus: ImuBus) -> Callable[[], None]:
    bus.chips[WHERE].answers = False
    return lambda: setattr(bus.chips[WHERE], "answers", True)


def _stale(bus: ImuBus) -> Callable[[], None]:
    bus.chips[WHERE].counts = False
    return lambda: setattr(bus.chips[WHERE], "counts", True)


def _stuck(bus: ImuBus) -> Callable[[], None]:
    bus.chips[WHERE].moves = False
    return lambda: setattr(bus.chips[WHERE], "moves", True)


def _held(bus: ImuBus) -> Callable[[], None]:
    bus.held_clocks = 10**6
    return lambda: setattr(bus, "held_clocks", 0)


def _no_multiplexer(bus: ImuBus) -> Callable[[], None]:
    bus.mux_answers = False
    return lambda: setattr(bus, "mux_answers", True)


def _deaf_multiplexer(bus: ImuBus) -> Callable[[], None]:
    bus.mux_stuck = True
    return lambda: setattr(bus, "mux_stuck", False)


@pytest.mark.parametrize(
    ("harm", "within_s"),
    [
        pytest.param(_unplugged, 0.15, id="not acknowledged"),
        pytest.param(_stale, 0.15, id="stale counter"),
        pytest.param(_held, 0.15, id="SDA held low"),
        pytest.param(_no_multiplexer, 0.15, id="multiplexer gone"),
        pytest.param(_deaf_multiplexer, 0.15, id="multiplexer keeps its channel"),
        pytest.param(_stuck, 3.0, id="stuck value while the body bends"),
    ],
)
def test_a_bus_or_imu_that_hangs_vents_and_stops(
    string: String, harm: Callable[[ImuBus], Callable[[], None]], within_s: float
) -> None:
    string.bend()
    repair = harm(string.bus)
    if within_s > 1:  # a body at rest does not show it, and does not need it
        string.robot.press("left", 12.0)
        with pytest.raises(RobotFaultError):
            string.robot.wait(within_s)
    else:
        string.transport.pass_time(within_s)
    assert string.status().faults == wire.Fault.FLEX_OPEN.mask
    assert not any(string.board.drive_enabled)
    assert string.board.braked
    string.transport.pass_time(0.1)
    assert not any(string.board.air)
    client = string.client
    client.request(wire.ClearFaults(0xFFFF))
    assert string.status().faults == wire.Fault.FLEX_OPEN.mask  # its cause is still there
    repair()
    string.transport.pass_time(0.5)
    client.request(wire.ClearFaults(0xFFFF))
    assert string.status().faults == 0
    string.bend()


def test_a_part_that_lets_go_after_nine_clocks_costs_no_stop(string: String) -> None:
    string.bend()
    string.bus.held_clocks = 9
    string.robot.wait(0.5)
    assert string.bus.held_clocks == 0
    assert string.status().faults == 0
    assert string.board.drive_enabled[0]


def test_only_the_two_spans_of_a_silent_imu_are_open(string: String) -> None:
    string.chip.answers = False
    assert string.open_inputs() == [FAULTY, FAULTY + 1]


def test_an_imu_that_began_again_needs_a_zero_before_the_next_bend(string: String) -> None:
    string.bend()
    string.robot.vent()
    string.robot.wait(2.0)
    before = string.status().zeroed_mask
    string.chip.restart(origin_rad=0.4)
    string.transport.pass_time(1.0)
    lost = string.inputs[FAULTY : FAULTY + 2]
    assert string.status().zeroed_mask == before & ~sum(1 << n for n in lost)
    string.client.request(wire.ClearFaults(0xFFFF))
    string.robot.wait(4.5)
    string.robot.arm()
    with pytest.raises(CommandRefusedError, match="zero"):
        string.robot.press("left", 6.0)
    string.robot.zero()
    string.robot.press("left", 6.0)


def test_an_imu_that_begins_again_in_a_bend_ends_it(string: String) -> None:
    """Without its zero the span at the base would guard nothing."""
    string.bend()
    string.chip.restart(origin_rad=0.4)
    with pytest.raises(RobotFaultError, match="flex_open: An IMU does not answer"):
        string.robot.wait(1.0)
    assert not any(string.board.drive_enabled)


def _without(store: bytes, ids: set[int]) -> bytes:
    """A store as a firmware without these parameters has written it."""
    made = bytearray(store)
    room = len(store) // 2 - 8
    for at in (16, 16 + room):
        if made[at] != 0xA7:
            continue
        (length,) = struct.unpack_from("<H", made, at + 5)
        entries, kept, place = made[at + 7 : at + 7 + length], b"", 0
        while place < length:
            size = 3 + entries[place + 1] * entries[place + 2]
            if entries[place] not in ids:
                kept += entries[place : place + size]
            place += size
        slot = made[at + 1 : at + 5] + struct.pack("<H", len(kept)) + kept
        slot += struct.pack("<H", check_sequence(bytes(slot)))
        made[at + 1 : at + 1 + len(slot)] = slot
    return bytes(made)


def test_an_old_store_refuses_to_arm_until_the_host_writes_the_addresses(string: String) -> None:
    string.client.request(wire.SaveConfig())
    addresses = {string.client.parameters[name].id for name in ("imu_from", "imu_to")}
    old = MicroPythonBoard(5, _without(string.board.eeprom, addresses), large=True)
    scene = string.transport.scene
    transport = EmulatorTransport(scene, old, seed=3)
    plant = transport.lockstep.plant
    old.bus = string_bus(plant.wiring, plant.imus)
    robot = Robot(client := Client(transport))
    transport.pass_time(0.5)
    report = client.request(wire.GetConfigReport())
    assert {*report.new_ids[: report.new_count]} == addresses
    assert client.request(wire.GetStatus()).faults & wire.Fault.FLEX_OPEN.mask
    with pytest.raises(CommandRefusedError):
        client.request(wire.Arm())
    robot.configure(string.transport.config)
    transport.pass_time(0.5)
    client.request(wire.ClearFaults(0xFFFF))
    assert client.request(wire.Arm()).status is wire.Status.OK


def test_an_imu_without_an_address_is_named(scene_path: Path) -> None:
    text = scene_path.read_text()
    scene_path.write_text(text.replace("i2c_address = 75", "i2c_address = 0", 1))
    with pytest.raises(ConfigError, match=r"the IMU at 14\.5 cm has no channel and address"):
        open_micropython(f"micropython://{scene_path}")


@pytest.mark.ci
def test_a_string_on_the_bus_explores_as_on_the_virtual_board(tmp_path: Path) -> None:
    if reason := missing("unix-large"):
        pytest.skip(reason)
    scene = room_for(draft(100, 12, 2, kind="heading"), 1, peg=True)
    scene.save(tmp_path / "room.toml")
    bus, virtual = (
        explore(f"{board}://{tmp_path / 'room.toml'}", seed=1, out=tmp_path, name=board).document
        for board in ("micropython", "emulator")
    )
    assert bus.outcome == virtual.outcome == "full length"
    assert len(bus.contacts) == len(virtual.contacts)
    for contact, virtual_contact in zip(bus.contacts, virtual.contacts, strict=True):
        assert contact.arc_cm == pytest.approx(virtual_contact.arc_cm, abs=3.0)


def test_parameters_of_imus_are_shown_and_set_by_name(scene_path: Path, thigmo: Thigmo) -> None:
    board = f"micropython://{scene_path}"
    ran = thigmo("params", "--robot", board, "imu_from", 74, "--save", "--json")
    assert json.loads(ran.out)["imu_from"]["value"] == [74] * 16
    ran = thigmo("params", "--robot", board, "imu_to", 1024)
    assert (ran.code, "imu_to must lie in 0..1023, not 1024" in ran.err) == (1, True)
    report = wire.ConfigReport(wire.Status.OK, 1, 60, 2, (61, 62, *(0,) * 6), 0, (0,) * 8)
    assert StoredConfiguration.of(report).new == ("imu_from", "imu_to")
