"""Robots from their descriptions alone explore: three rooms of each, one of them empty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command import Thigmo
from emulated import armed, room_file

from thigmo.config import RobotConfig
from thigmo.design import draft, judge
from thigmo.emulator.board import virtual_board
from thigmo.emulator.reach import room_for, sweep_once
from thigmo.emulator.scene import FaultTable, PegTable
from thigmo.emulator.serve import brought_up
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import ConfigError, RobotFaultError
from thigmo.exploration import explore
from thigmo.link.client import Client
from thigmo.mechanics import Peg
from thigmo.robot import Robot, connect
from thigmo.stream import Telemetry
from thigmo.wiring import Wiring
from thigmo_bench.studies.robots import (
    MIXED,
    ROBOTS,
    THESIS,
    THICK_7,
    THICK_10,
    robot_named,
    visit,
)
from thigmo_bench.studies.rooms import explored

LONG = "200 cm, 1 muscle, 16 sensors"  # five minutes
OTHERS = [
    pytest.param(name, marks=pytest.mark.nightly if name == LONG else ())
    for name in ROBOTS
    if name != THESIS
]


def _prepare(driven: Robot, robot: RobotConfig) -> None:
    """Configure it at its full length, arm and zero it."""
    driven.configure(robot)
    driven.confirm_length(robot.body.length_cm, settled=True)
    driven.select_body_pressure(2)
    driven.arm()
    driven.wait(2.0)
    driven.zero()


@pytest.mark.ci
@pytest.mark.parametrize("name", OTHERS)
def test_a_described_robot_finds_pegs_and_says_nothing_in_an_empty_room(name: str) -> None:
    visits = [visit((name, seed, True)) for seed in (1, 2)]
    assert not any(room.status.startswith("aborted") for room in visits)
    assert sum(room.missed for room in visits) <= 1
    assert not any(room.wrong for room in visits)
    # 12 and 28 cm where the inputs' order was taken for the sensors'.
    placed = [room for room in visits if room.status == "localized"]
    assert not any(room.plane_cm > 0.06 * room.length_cm for room in placed)
    silent = visit((name, 3, False))
    assert silent.status == "silent"


@pytest.mark.ci
@pytest.mark.parametrize("name", [THICK_7, THICK_10, MIXED])
def test_a_thick_or_mixed_robot_is_sound(name: str) -> None:
    visits = [visit((name, 1, True)), visit((name, 3, False))]
    assert not [room.status for room in visits if room.status.startswith("aborted")]


@pytest.mark.parametrize("name", [THICK_7, THICK_10])
def test_a_thick_body_stands_where_it_stopped(name: str) -> None:
    """The contacts opened before the brake had closed: 8.4 mm in 50 ms, and spool_slip."""
    scene = room_for(robot_named(name), 1, peg=False)
    robot, transport = armed(scene)
    plant = transport.lockstep.plant
    for length_cm in (10.0, 20.0, 30.0):
        robot.grow_to(length_cm)
        stopped_cm = plant.length_cm
        robot.wait(0.5)
        assert plant.length_cm == pytest.approx(stopped_cm, abs=0.01)
        assert plant.length_cm == pytest.approx(length_cm, abs=0.3)
    robot.retract_to(5.0)
    assert plant.length_cm == pytest.approx(5.0, abs=0.3)


def test_a_check_says_how_far_a_thick_body_runs_on_until_its_brake_holds() -> None:
    config = robot_named(THICK_10)
    said = [finding for finding in judge(config) if "its brake holds" in finding.text]
    assert [finding.mark for finding in said] == ["ok"] * 3
    assert "runs on by 2.0 mm until its brake holds, 70 ms later; 3 mm are allowed" in said[0].text
    config.spool.brake_closes_s = 0.15
    slow = [finding for finding in judge(config) if "a faster brake" in finding.text]
    assert [finding.mark for finding in slow] == ["bad", "bad"]


def test_a_thick_body_that_the_spool_cannot_hold_is_told_what_to_change(tmp_path: Path) -> None:
    scene = room_for(draft(53, 5, 2, diameter_cm=6.0), 0, peg=False)
    scene.save(tmp_path / "thick.toml")
    with pytest.raises(RobotFaultError, match=r"1.47 psi pull 14.3 N .* fit a brake or lower"):
        explored(f"emulator://{tmp_path / 'thick.toml'}", tmp_path, 1)


def test_a_robot_of_many_sensors_is_refused_by_the_usual_board(tmp_path: Path) -> None:
    large = draft(200, 16, 1)
    with (
        connect("emulator://empty") as robot,
        pytest.raises(
            ConfigError,
            match=r"built for 2 muscles, 10 sensors .* needs one for 4, 16 and 8 \(large",
        ),
    ):
        robot.configure(large)
    room_for(large, 0, peg=False).save(tmp_path / "large.toml")
    with pytest.raises(ConfigError, match=r"needs another board \(large"):
        connect(f"mega-sim://{tmp_path / 'large.toml'}")
    with connect(f"emulator://{tmp_path / 'large.toml'}") as robot:
        assert robot.read(0.2, despite_faults=True).curvature.shape == (16,)
        with pytest.raises(ConfigError, match=r"needs one for 2, 10 and 3 .mega"):
            robot.configure(RobotConfig())


def test_muscles_out_of_the_plane_are_driven_and_not_explored_with(
    tmp_path: Path, thigmo: Thigmo
) -> None:
    robot = draft(53, 3, 1)
    (muscle,), column = robot.muscles, robot.sensors
    turned = {name: 90.0 + 120.0 * n for n, name in enumerate(("one", "two", "three"))}
    robot.muscles = [
        muscle.model_copy(deep=True, update={"name": name, "angle_deg": lies})
        for name, lies in turned.items()
    ]
    robot.sensors = [
        sensor.model_copy(update={"angle_deg": (lies + 180.0) % 360.0})
        for lies in turned.values()
        for sensor in column
    ]
    assert [sensor.center_cm for sensor in Wiring.laid_out(robot).sensors if sensor].count(
        column[0].center_cm
    ) == 3
    assert Wiring.laid_out(robot).base_inputs == (0, 8)
    scene = room_for(robot, 0, peg=False)
    scene.start_length_cm, scene.start_settled = robot.body.length_cm, True
    scene.save(tmp_path / "space.toml")
    robot.save(tmp_path / "robot.toml")
    ran = thigmo("robot", "check", tmp_path / "robot.toml")
    apart = " and ".join(f"muscle {m.name} ({m.angle_deg:g} degrees)" for m in robot.muscles[1:])
    assert f"{apart} and 6 sensors out of the plane" in " ".join(ran.out.split())
    url = f"emulator://{tmp_path / 'space.toml'}"
    ran = thigmo("explore", "--robot", url, "--out", tmp_path / "runs")
    assert ran.code == 1
    (line,) = ran.err.splitlines()
    assert line.startswith(
        f"thigmo: an exploration is in the plane, by sensors on the board: {apart} and"
    )
    assert not list((tmp_path / "runs").glob("*"))
    with connect(url) as driven:
        _prepare(driven, robot)
        for name, number in (("two", 1), (330.0, 2)):
            driven.press(name, 9.0)
            driven.wait(4.0)
            psi = driven.read(0.5).pressure_psi
            assert psi[number] == pytest.approx(9.0, abs=0.3)
            assert sum(psi) == pytest.approx(9.0, abs=1.0)
        with pytest.raises(ConfigError, match=r"no muscle four; use one \(90\)"):
            driven.press("four", 9.0)


def test_a_muscle_that_no_base_sensor_guards_is_pressed_with_a_warning_and_not_swept(
    tmp_path: Path,
) -> None:
    robot = draft(53, None, 4)
    scene = room_for(robot, 0, peg=False)
    scene.start_length_cm, scene.start_settled = robot.body.length_cm, True
    warned: list[str] = []
    with connect(room_file(tmp_path, scene)) as driven:
        _prepare(driven, robot)
        driven.operator.warn = warned.append  # type: ignore[method-assign]
        for name in ("left", "180deg", "180deg"):
            driven.press(name, 5.0)
        driven.vent()
        assert warned == [
            "no base sensor guards muscle 180deg: no contact is felt while it bends the body"
        ]
        with pytest.raises(ConfigError, match=r"no healthy sensor .* to muscle 180deg"):
            driven.sweep({"180deg": 5.0}, period_s=10.0)


def test_a_base_sensor_that_reads_half_of_a_bend_does_not_take_it_for_a_contact(
    tmp_path: Path,
) -> None:
    robot = draft(53, 3, 1)
    for sensor in robot.sensors:
        sensor.angle_deg = 210.0
    scene = room_for(robot, 0, peg=False)
    scene.start_length_cm, scene.start_settled = robot.body.length_cm, True
    with connect(room_file(tmp_path, scene)) as driven:
        _prepare(driven, robot)
        driven.press("left", 15.0, ramp_psi_s=2.0)
        driven.wait(10.0)
        assert driven.read(0.5).pressure_psi[0] == pytest.approx(15.0, abs=0.3)
        assert "contact" not in driven.status().conditions


def test_a_side_without_a_base_sensor_is_not_swept_and_the_run_says_so(tmp_path: Path) -> None:
    """Swept all the same, a peg there was missed for a reason that was not so."""
    robot = draft(40, 3, 2)
    robot.column("left")[0].healthy = False
    robot.muscles[1].name = "lower"
    scene = room_for(robot, 0, peg=False)
    scene.pegs = [PegTable(x=28.0, y=-6.0, radius=0.8)]
    scene.save(tmp_path / "blind.toml")
    document = explore(f"emulator://{tmp_path / 'blind.toml'}", seed=1, out=tmp_path).document
    assert "no sweeps towards lower, because no healthy sensor at the base" in document.skips
    assert {shape.side for stage in document.stages for shape in stage.shapes} == {"left"}
    assert (document.contacts, document.missed) == ([], [])
    assert [(muscle.side, muscle.name) for muscle in document.muscles] == [
        ("left", "left"),
        ("right", "lower"),
    ]
    robot.column("right")[0].healthy = False
    beyond = Wiring.laid_out(robot).unexplorable
    assert beyond is not None
    assert "so no sweep feels a contact" in beyond.problem


def test_either_base_sensor_of_two_kinds_is_enough_for_a_sweep() -> None:
    """A flex sensor and a string of IMUs on opposite sides: both read bends to the right."""
    robot = draft(120, 8, 2, kind="heading")
    robot.sensors += draft(120, 5, 2).column("left")
    assert len(Wiring.laid_out(robot).trigger_sensors(robot.muscle("right"))) == 2
    robot.column("left")[0].healthy = False
    assert Wiring.laid_out(robot).unguarded_muscles == ()
    swept = [finding for finding in judge(robot) if finding.part == "sweep of right"]
    assert [sweep.mark for sweep in swept] == ["ok", "ok"]


def test_a_sweep_that_nothing_at_the_base_can_feel_is_refused() -> None:
    with connect("emulator://empty") as robot:
        config = robot.config
        for base in Wiring.laid_out(config).trigger_sensors(config.muscle("left")):
            base.sensor.healthy = False
        robot.configure(config)
        with pytest.raises(ConfigError, match=r"no healthy sensor .* to muscle left"):
            robot.sweep({"right": 5.0, "left": 5.0}, period_s=10.0)


def test_a_muscle_whose_bends_no_sensor_reads_feels_no_peg() -> None:
    robot = draft(53, 5, 2)
    robot.sensors = [sensor for sensor in robot.sensors if sensor.side == "left"]
    assert robot.sensors_for("left") == []
    assert sweep_once(robot, [Peg(30.0, 6.0, 0.5)], 53.0, "left") is None


def test_an_imu_that_hangs_is_a_fault_that_leaves_the_robot_safe(tmp_path: Path) -> None:
    scene = room_for(draft(100, 12, 1, kind="heading"), 0, peg=False)
    scene.faults = [FaultTable(kind="imu_hung", at_s=4.0, side="right", sensor=3)]
    scene.save(tmp_path / "hung.toml")
    with connect(f"emulator://{tmp_path / 'hung.toml'}") as robot:
        robot.configure(scene.robot)
        with pytest.raises(RobotFaultError, match="flex_open: An IMU does not answer"):
            robot.wait(5.0)
        assert robot.status().state == "fault"
        read = robot.read(0.2, despite_faults=True).resistance
        inputs = Wiring.laid_out(scene.robot).inputs
        open_ = {n for (_, n), number in inputs.items() if not np.isfinite(read[number])}
        assert open_ == {3, 4}


def test_a_large_board_on_a_port_is_read_once_its_robot_is_described() -> None:
    """Nothing but robot.toml says what hangs on a port."""
    scene = room_for(draft(200, 16, 1), 0, peg=False)
    board = virtual_board(scene.robot, 1, brought_up(scene.robot))
    port = EmulatorTransport(scene, board, seed=1)
    del port.config
    said: list[Telemetry] = []
    with Robot(Client(port)) as robot:
        robot.on_telemetry(said.append)
        with pytest.raises(ConfigError, match="16 sensor inputs is not known"):
            robot.read(0.2)
        assert said == []
        robot.configure(scene.robot)
        assert robot.read(0.2).resistance.shape == (16,)
    assert {len(telemetry.pressure_psi) for telemetry in said} == {4}
