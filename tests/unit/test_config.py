"""robot.toml: what is written is read back, and what is wrong is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from thigmo.config import Body, Muscle, RobotConfig, TanhMap
from thigmo.errors import ConfigError


def test_default_survives_a_round_trip(tmp_path: Path) -> None:
    config = RobotConfig(name="round trip")
    assert config.save(tmp_path / "robot.toml") is None
    assert RobotConfig.load(tmp_path / "robot.toml") == config


def test_an_existing_file_is_kept_aside_each_time(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    RobotConfig(name="first").save(path)
    backups = [RobotConfig(name=name).save(path) for name in ("second", "third")]
    assert [RobotConfig.load(str(backup)).name for backup in backups] == ["first", "second"]
    assert RobotConfig.load(path).name == "third"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("version = 1", "version must be 2, not 1"),
        ("[[sensors.left]]\ncenter_cm = 12", "sensors must be a list"),
        ("nmae = 'typo'", "nmae is no entry that is known here"),
        ("[body]\nlength_cm = -1", "body.length_cm must be above 0, not -1"),
        ("[body]\nlength_cm = nan", "body.length_cm must be a finite number, not nan"),
        ("[body]\nlength_cm = 'long'", "body.length_cm must be a number, not 'long'"),
        ("sensor = []", "[[sensor]] is empty: give at least 1"),
        ("body = 3", "body must be a table, not 3"),
        ("[body]\nlength_cm = 40\npressure = [{until_cm = 40, pressure_psi = 1}]", "beyond"),
        ("[[sensor]]\ncenter_cm = 51", "sensor[0]"),
        (
            "body = {pressure = [{until_cm = 53, pressure_psi = 1}]}\n[[muscle]]\nname = 'left'",
            "one for each of body.pressure",
        ),
        ("= nonsense", "not valid TOML"),
        ("sensor = ['flex', 5]", "sensor.0: a sensor is a table"),
        ("[[sensor]]\ncenter_cm = 2", "sensor[0] begins before the base"),
        ("[[sensor]]\ncenter_cm = 15\n[[sensor]]\ncenter_cm = 5", "sensor[1] lies before"),
        ("[[sensor]]\ncenter_cm = 5\nscale_per_ohm = 0", "every reading 0"),
        ("[[sensor]]\ncenter_cm = 5\nnoise = 0", "noise must be above 0, not 0"),
        ("[[muscle]]\nname = 'a=b'", "muscle.0.name: give a name on one line"),
        ('[[muscle]]\nname = "a\\nb"', "muscle.0.name: give a name on one line"),
        ("[[muscle]]\nname = 'right'\nangle_deg = 90", "named right, which is 270 degrees"),
    ],
)
def test_a_wrong_entry_is_named_in_one_line(tmp_path: Path, text: str, named: str) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        RobotConfig.load(path)
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_and_unwritable_files_say_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="check the path"):
        RobotConfig.load(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="you may write to"):
        RobotConfig().save(tmp_path / "no-such-folder" / "robot.toml")


@pytest.mark.parametrize(
    ("length_cm", "body_pressure"), [(0.0, 0), (26.5, 0), (26.6, 1), (35.3, 1), (53.0, 2)]
)
def test_a_boundary_belongs_to_the_body_pressure_below(
    length_cm: float, body_pressure: int
) -> None:
    assert Body().pressure_number(length_cm) == body_pressure


def test_a_robot_of_one_muscle_has_one_side() -> None:
    config = RobotConfig(muscles=[Muscle(name="bender", angle_deg=270)])
    assert config.sides == ("right",)
    with pytest.raises(ConfigError, match="use bender"):
        config.muscle("left")


def test_a_muscle_has_the_number_of_its_place_in_the_file() -> None:
    config = RobotConfig()
    config.muscles.reverse()
    assert [config.muscle_number(side) for side in ("left", "right")] == [1, 0]
    assert [config.muscle_number(degrees) for degrees in (90.0, 270)] == [1, 0]
    config.muscles.pop()
    with pytest.raises(ConfigError, match=r"no muscle left; use right \(270\)"):
        config.muscle_number("left")


def test_actuator_map_is_zero_at_zero_pressure() -> None:
    assert TanhMap(offset_psi=3.0).curvature(0.0) == pytest.approx(0.0, abs=1e-15)
