"""Robots from their descriptions alone explore: three rooms of each, one of them empty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thigmo.config import RobotConfig
from thigmo.design import draft
from thigmo.emulator.board import virtual_board
from thigmo.emulator.reach import room_for
from thigmo.emulator.scene import FaultTable
from thigmo.emulator.serve import brought_up
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import ConfigError, RobotFaultError
from thigmo.link.client import Client
from thigmo.robot import Robot, connect
from thigmo.stream import Telemetry
from thigmo.studies.robots import ROBOTS, THESIS, visit
from thigmo.studies.rooms import explored
from thigmo.wiring import input_of

OTHERS = [name for name in ROBOTS if name != THESIS]


@pytest.mark.ci
@pytest.mark.parametrize("name", OTHERS)
def test_a_described_robot_finds_pegs_and_says_nothing_in_an_empty_room(name: str) -> None:
    found = [visit((name, seed, True)) for seed in (1, 2)]
    assert not any(one.status.startswith("aborted") for one in found)
    assert sum(one.missed for one in found) <= 1
    assert not any(one.wrong for one in found)
    # 12 and 28 cm where the inputs' order was taken for the sensors'.
    placed = [one for one in found if one.status == "localized"]
    assert not any(one.plane_cm > 0.06 * one.length_cm for one in placed)
    silent = visit((name, 3, False))
    assert silent.status == "silent"


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
    with pytest.raises(ConfigError, match="needs the board large"):
        connect(f"mega-sim://{tmp_path / 'large.toml'}")
    with connect(f"emulator://{tmp_path / 'large.toml'}") as robot:
        assert robot.read(0.2, despite_faults=True).curvature.shape == (16,)
        with pytest.raises(ConfigError, match=r"needs one for 2, 10 and 3 .mega"):
            robot.configure(RobotConfig())


def test_an_imu_that_hangs_is_a_fault_that_leaves_the_robot_safe(tmp_path: Path) -> None:
    scene = room_for(draft(100, 12, 1, kind="heading"), 0, peg=False)
    scene.faults = [FaultTable(kind="imu_hung", at_s=4.0, side="right", sensor=3)]
    scene.save(tmp_path / "hung.toml")
    with connect(f"emulator://{tmp_path / 'hung.toml'}") as robot:
        robot.configure(scene.robot)
        with pytest.raises(RobotFaultError, match="flex_open"):
            robot.wait(5.0)
        assert robot.status().state == "fault"
        read = robot.read(0.2, despite_faults=True).resistance
        inputs = input_of(scene.robot)
        open_ = {n for (_, n), number in inputs.items() if not np.isfinite(read[number])}
        assert open_ == {3, 4}


def test_a_large_board_on_a_port_is_read_once_its_robot_is_described() -> None:
    """Nothing but robot.toml says what hangs on a port."""
    scene = room_for(draft(200, 16, 1), 0, peg=False)
    board = virtual_board(scene.robot, 1, brought_up(scene.robot))
    port = EmulatorTransport(scene, board, seed=1)
    del port.config
    told: list[Telemetry] = []
    with Robot(Client(port)) as robot:
        robot.on_telemetry(told.append)
        with pytest.raises(ConfigError, match="16 sensors' inputs, and nobody has described"):
            robot.read(0.2)
        assert told == []
        robot.configure(scene.robot)
        assert robot.read(0.2).resistance.shape == (16,)
    assert {len(each.pressure_psi) for each in told} == {4}
