"""Muscles out of the plane, from the command line: mapped by sensors or named as unmeasured."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command import Thigmo

from thigmo.config import FlexSensor, Muscle, RobotConfig
from thigmo.design import draft
from thigmo.emulator.reach import room_for

pytestmark = pytest.mark.ci


def calibrate(thigmo: Thigmo, folder: Path, robot: RobotConfig, step: str = "actuator"):
    """A step of a robot out to its tip, on the last body pressure only."""
    scene = room_for(robot, 0, peg=False)
    scene.start_length_cm, scene.start_settled = robot.body.length_cm, True
    scene.save(folder / "scene.toml")
    robot.save(folder / "robot.toml")
    return thigmo(
        "calibrate", step, "--robot", f"emulator://{folder / 'scene.toml'}", "--config",
        folder / "robot.toml", "--folder", folder / "made", "--trials", 1, "--step-psi", 4.5,
        "--body-pressure", 2,
    )  # fmt: skip


def test_a_muscle_that_no_sensor_reads_is_named_and_keeps_its_default(
    thigmo: Thigmo, tmp_path: Path
) -> None:
    robot = draft(53, 5, 2)
    robot.muscles.append(Muscle(name="up", angle_deg=0.0))
    ran = calibrate(thigmo, tmp_path, robot)
    assert ran.code == 0, ran.out + ran.err
    assert "muscle up is not calibrated: no healthy sensor reads a bend towards 0" in ran.out
    left, right, up = RobotConfig.load(tmp_path / "made" / "robot.toml").muscles
    assert left.maps[2].calibrated
    assert right.maps[2].calibrated
    assert up == robot.muscles[2]
    status = thigmo("calibrate", "status", "--folder", tmp_path / "made").out
    assert "not calibrated: up" in status
    said = json.loads((tmp_path / "made" / "actuator.json").read_text())
    assert said["not_calibrated"] == ["up"]
    checked = " ".join(thigmo("robot", "check", tmp_path / "made" / "robot.toml").out.split())
    assert "cannot be calibrated: no healthy sensor reads a bend towards 0 degrees" in checked
    ran = calibrate(thigmo, tmp_path, robot, "check")
    assert "up muscle: is not calibrated: no healthy sensor reads its bend" in ran.out


def test_a_robot_of_which_nothing_can_be_measured_is_refused_in_one_line(
    thigmo: Thigmo, tmp_path: Path
) -> None:
    robot = draft(53, 5, 1)
    robot.muscles[0].angle_deg = 0.0
    ran = calibrate(thigmo, tmp_path, robot)
    assert ran.code == 1
    (line,) = ran.err.splitlines()
    assert line.startswith("thigmo: muscle left is not calibrated: no healthy sensor reads")


def test_sensors_opposite_map_a_muscle_and_time_its_lag(thigmo: Thigmo, tmp_path: Path) -> None:
    robot = draft(53, 4, 1)
    lower = robot.muscles[0].model_copy(deep=True)
    lower.name, lower.angle_deg = "lower", 210.0
    robot.muscles.append(lower)
    scale = robot.sensors[0].scale_per_ohm
    robot.sensors += [
        FlexSensor(
            angle_deg=30.0, center_cm=sensor.center_cm, span_cm=sensor.span_cm,
            scale_per_ohm=-scale, bend_sign=-1,
        )
        for sensor in robot.sensors
    ]  # fmt: skip
    ran = calibrate(thigmo, tmp_path, robot)
    assert ran.code == 0, ran.out + ran.err
    assert "not calibrated" not in ran.out
    made = RobotConfig.load(tmp_path / "made" / "robot.toml").muscles[1]
    for branch in ("inflate", "deflate"):
        goal = getattr(lower.maps[2], branch).curvature(18.0)
        assert getattr(made.maps[2], branch).curvature(18.0) == pytest.approx(goal, rel=0.06)
    assert made.maps[2].scale_se == pytest.approx(0.15 / 2, rel=0.2)
    assert made.lag_s != lower.lag_s
    assert not made.maps[0].calibrated
    ran = calibrate(thigmo, tmp_path, robot, "check")
    assert ran.code == 0, ran.out
    looked = json.loads((tmp_path / "made" / "check.json").read_text())["findings"]
    (lower_bend,) = (finding for finding in looked if finding["part"] == "lower muscle")
    assert lower_bend["mark"] == "ok"
    assert "as mapped" in lower_bend["text"]


@pytest.mark.parametrize("muscles", [3, 4])
def test_each_muscle_of_a_drafted_robot_around_the_body_is_mapped(
    thigmo: Thigmo, tmp_path: Path, muscles: int
) -> None:
    robot = draft(53, None, muscles)
    ran = calibrate(thigmo, tmp_path, robot)
    assert ran.code == 0, ran.out + ran.err
    for made, true in zip(
        RobotConfig.load(tmp_path / "made" / "robot.toml").muscles, robot.muscles, strict=True
    ):
        assert made.maps[2].calibrated
        goal = true.maps[2].inflate.curvature(18.0)
        assert made.maps[2].inflate.curvature(18.0) == pytest.approx(goal, rel=0.06)
