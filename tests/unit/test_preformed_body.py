"""A body that is curved at rest: its entry in robot.toml, and what uses it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command import Thigmo

from thigmo.calibrate.steps import fit_csv, steps_of
from thigmo.config import FlexSensor, RestCurvature, RobotConfig
from thigmo.design import judge
from thigmo.errors import ConfigError, DataError
from thigmo.localization import localize
from thigmo.mechanics import Tube, push, rest_mean, rest_turn
from thigmo.robot.publishing import bent
from thigmo_bench.studies.gallery import gallery_robot

HOOK = ((10.0, 0.0), (35.0, 0.06))  # turns by 86 degrees
POSITION = np.array([5.0, 15.0, 25.0, 35.0, 45.0])


def robot_with(tmp_path: Path, *pieces: tuple[float, float]) -> RobotConfig:
    text = "".join(
        f"[[body.rest_curvature]]\nuntil_cm = {end}\ncurvature = {bend}\n" for end, bend in pieces
    )
    path = tmp_path / "robot.toml"
    path.write_text(text)
    return RobotConfig.load(path)


@pytest.mark.parametrize(
    ("pieces", "said"),
    [
        ([(20.0, 0.01), (20.0, 0.02)], "body.rest_curvature: until_cm must ascend"),
        ([(20.0, 0.01), (60.0, 0.02)], "until_cm = 60 lies beyond body.length_cm = 53"),
        ([(20.0, 1.2)], "a tube of 3.5 cm cannot be curved by 1.2 1/cm"),
    ],
)
def test_bends_that_no_body_has_are_refused(
    tmp_path: Path, pieces: list[tuple[float, float]], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        robot_with(tmp_path, *pieces)


def test_the_file_keeps_its_bends_and_a_straight_body_has_no_entry(tmp_path: Path) -> None:
    robot = gallery_robot("preformed")
    robot.save(tmp_path / "robot.toml")
    assert RobotConfig.load(tmp_path / "robot.toml").body.rest_pieces == robot.body.rest_pieces
    RobotConfig().save(tmp_path / "straight.toml")
    assert "rest_curvature" not in (tmp_path / "straight.toml").read_text()


def test_the_turn_of_the_rest_shape_is_the_sum_of_its_bends() -> None:
    assert rest_turn(HOOK, [0.0, 10.0, 20.0, 35.0, 53.0]) == pytest.approx([0, 0, 0.6, 1.5, 1.5])
    # Half of the third sensor's span lies in the bend, and a point sensor in it or not.
    assert rest_mean(HOOK, [5.0, 20.0, 35.0], [5.0, 5.0, 5.0]) == pytest.approx([0, 0.06, 0.03])
    assert rest_mean(HOOK, [9.0, 11.0], [0.0, 0.0]) == pytest.approx([0.0, 0.06])
    assert rest_mean((), [5.0], [5.5]) == [0.0]


def test_check_says_where_the_tip_lies_and_promises_no_exploration() -> None:
    robot = gallery_robot("preformed")
    findings = {finding.part: finding for finding in judge(robot)}
    assert "curved at rest" in findings["explore"].text
    body = push(0.0, 1.0, free_curvature=0.0, length=53.0,
                tube=Tube(3.5, rest_curvature=robot.body.rest_pieces))  # fmt: skip
    assert f"x = {body.tip[0]:.1f}, y = {body.tip[1]:.1f} cm" in findings["body"].text
    assert "localized" in findings["feel"].text
    assert not [part for part in findings if part.startswith("sweep")]


def test_check_asks_about_a_body_that_is_rolled_up(tmp_path: Path) -> None:
    robot = robot_with(tmp_path, (53.0, 0.2))
    (body,) = (finding for finding in judge(robot) if finding.part == "body")
    assert body.mark == "bad"
    assert "is rest_curvature in 1/cm?" in body.text


def test_the_camera_calibrates_only_what_does_not_hang_on_a_straight_body(tmp_path: Path) -> None:
    robot = gallery_robot("preformed")
    assert steps_of(robot) == ["pressure", "hysteresis", "noise", "check"]
    with pytest.raises(DataError, match="no straight shape at rest"):
        fit_csv("flex", tmp_path / "any.csv", robot)


@pytest.mark.parametrize("at_rest", [-0.02, 0.0, 0.015])
@pytest.mark.parametrize("bend", [-0.03, -0.01, 0.004, 0.025])
def test_a_flex_sensor_is_weak_where_the_whole_bend_is_against_it(
    at_rest: float, bend: float
) -> None:
    sensor = FlexSensor(center_cm=5.0, bend_sign=1)

    def answered(curvature: float) -> float:
        return curvature if curvature >= 0.0 else sensor.against_gain * curvature

    reading = answered(at_rest + bend) - answered(at_rest)
    known, curvature = sensor.straightened(reading, at_rest)
    assert curvature == pytest.approx(bend)
    assert (known.scale_se > sensor.scale_se) is (at_rest + bend < 0.0)


def test_the_published_shape_is_that_of_rest_and_readings_together() -> None:
    poses = bent(53.0, [(5.0, 0.01)], HOOK)
    body = push(0.0, 1.0, free_curvature=0.01, length=53.0, tube=Tube(3.5, rest_curvature=HOOK))
    assert poses[-1] == pytest.approx(body.tip, abs=0.05)


def test_localize_needs_the_rest_shape_for_its_levers(thigmo: Thigmo, tmp_path: Path) -> None:
    """A hook's levers are far shorter than those of the straight body that is assumed else."""
    body = push(6e-4, 48.0, free_curvature=0.0, length=53.0, tube=Tube(3.5, rest_curvature=HOOK))
    rest = rest_mean(HOOK, POSITION, np.full(5, 5.5))
    readings = body.averages(POSITION, 5.5) - rest
    common = {"length": 53.0, "span": 5.5, "noise": 1e-4, "free_curvature": 0.0}
    bent_contact = localize(readings, POSITION, body_curvature=rest, **common).contacts[0]  # type: ignore[arg-type]
    straight = localize(readings, POSITION, **common)  # type: ignore[arg-type]
    assert abs(bent_contact.arc - 48.0) < 0.5
    assert not straight.contacts or abs(straight.contacts[0].arc - 48.0) > 1.0

    config = RobotConfig()
    config.body.rest_curvature = [RestCurvature(until_cm=e, curvature=k) for e, k in HOOK]
    config.save(tmp_path / "robot.toml")
    rows = "".join(f"{x},{k}\n" for x, k in zip(POSITION, readings, strict=True))
    (tmp_path / "readings.csv").write_text("position,curvature\n" + rows)
    said = thigmo(
        "localize", str(tmp_path / "readings.csv"), "--length", "53", "--span", "5.5",
        "--config", str(tmp_path / "robot.toml"), "--free-curvature", "0", "--noise", "1e-4",
        "--json",
    )  # fmt: skip
    contact = json.loads(said.out)["contacts"][0]
    assert abs(contact["arc"] - 48.0) < 3.0
