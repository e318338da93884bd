"""Robots that do not grow, have no muscles, or hold more than 20 psi."""

from __future__ import annotations

from math import inf
from pathlib import Path

import pytest

from thigmo.config import RobotConfig
from thigmo.errors import ConfigError
from thigmo.exploration.growth import stage_lengths
from thigmo.link import protocol as wire
from thigmo.robot.configuration import map_settings, parameter_settings
from thigmo.wiring import Wiring

FINGER = """
name = "finger"
[body]
grows = false
length_cm = 12.0
diameter_cm = 1.5
[[sensor]]
angle_deg = 270.0
center_cm = 4.0
"""
WHISKER = "muscle = []\n"


def _robot(text: str, folder: Path) -> RobotConfig:
    file = folder / "robot.toml"
    file.write_text(text)
    return RobotConfig.load(file)


def test_a_finger_has_no_spool_no_pouches_and_no_fold(tmp_path: Path) -> None:
    finger = _robot(FINGER, tmp_path)
    finger.write(tmp_path / "written.toml")
    written = (tmp_path / "written.toml").read_text()
    for entry in ("spool", "pitch_cm", "growth_psi"):
        assert entry not in written
    assert RobotConfig.load(tmp_path / "written.toml") == finger
    assert finger.body.critical_curvature == inf
    assert stage_lengths(finger) == [12.0]
    sent = parameter_settings(Wiring.laid_out(finger))
    assert (sent["grows"], sent["brake_fitted"]) == ([0], [0])


@pytest.mark.parametrize(
    ("added", "named"),
    [
        ("[spool]\nbrake = true\n", "leave [spool] out"),
        ("[body]\ngrows = false\npitch_cm = 5.0\n", "body.pitch_cm is of a body that grows"),
    ],
)
def test_what_a_body_of_fixed_length_lacks_is_refused(
    added: str, named: str, tmp_path: Path
) -> None:
    text = FINGER + added if "spool" in added else added + "[[sensor]]\ncenter_cm = 4.0\n"
    with pytest.raises(ConfigError) as caught:
        _robot(text, tmp_path)
    assert named in str(caught.value)


def test_a_body_that_grows_needs_air(tmp_path: Path) -> None:
    text = "[[body.pressure]]\nuntil_cm = 53.0\npressure_psi = 0.0\n"
    with pytest.raises(ConfigError, match="no body grows at 0 psi"):
        _robot(text, tmp_path)


def test_a_robot_without_muscles_is_described_and_explore_says_why_not(tmp_path: Path) -> None:
    wiring = Wiring.laid_out(_robot(WHISKER, tmp_path))
    sent = parameter_settings(wiring)
    assert sent["muscle_fitted"] == []  # those that are not stated are sent as 0
    assert map_settings(wiring) == []
    refused = wiring.unexplorable
    assert refused is not None
    assert "no muscles" in refused.problem
    assert "thigmo feel" in refused.cure


def test_a_file_without_a_pressure_range_keeps_20_psi(tmp_path: Path) -> None:
    robot = _robot("", tmp_path)
    sent = parameter_settings(Wiring.laid_out(robot))
    for name in ("map_top_cpsi", "over_pressure_cpsi", "pressure_full_cpsi", "drive_20ma_cpsi"):
        assert sent[name] == wire.PARAMETERS[name].defaults
    with pytest.raises(ConfigError) as caught:
        _robot('[[muscle]]\nname = "left"\nmax_pressure_psi = 30.0\n', tmp_path)
    assert "muscle[0].max_pressure_psi = 30 is above board.pressure_range_psi = 20" in str(
        caught.value
    )


def test_maps_and_limits_follow_the_pressure_range(tmp_path: Path) -> None:
    text = (
        "board.pressure_range_psi = 30.0\n"
        '[[muscle]]\nname = "left"\nmax_pressure_psi = 30.0\n' + "[[muscle.map]]\n" * 3
    )
    robot = _robot(text, tmp_path)
    sent = parameter_settings(Wiring.laid_out(robot))
    assert (sent["map_top_cpsi"], sent["max_pressure_cpsi"]) == ([3000], [3000])
    assert sent["over_pressure_cpsi"] == [3300]
    inflate = robot.muscles[0].maps[0].inflate
    first = map_settings(Wiring.laid_out(robot))[0]
    assert first.curvature_e5[-1] == round(inflate.curvature(30.0) * 1e5)
    assert first.curvature_e5[5] == round(inflate.curvature(15.0) * 1e5)


def test_a_range_that_the_sensors_cannot_show_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"shows no 63 psi, where over_pressure vents"):
        _robot("board.pressure_range_psi = 60.0\n", tmp_path)
    wide = "board.pressure_range_psi = 60.0\nboard.pressure_sensor_psi = 100.0\n"
    assert _robot(wide, tmp_path).board.over_pressure_psi == 63.0
