"""What robot.toml says of errors reaches the localizer: of the right side and pressure."""

from __future__ import annotations

import pytest

from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.mechanics.closed_forms import critical_moment
from thigmo.reading_errors import reading_errors

SENSORS = [("right", 0), ("right", 3)]


def test_each_error_is_that_of_its_sensor_side_and_body_pressure() -> None:
    config = RobotConfig()
    config.column("right")[3].noise = 3e-4
    config.column("right")[3].zero_se = 4e-4
    config.column("right")[3].scale_se = 0.07
    config.muscle("left").offset_se = 7e-4
    config.muscle("left").maps[1].scale_se = 0.03
    config.body.critical_curvature_se = 0.05 * config.body.critical_curvature
    errors = reading_errors(config, "left", 1, SENSORS)
    arguments = errors.arguments()
    assert arguments["noise"] == pytest.approx([4.8e-4, 3e-4])
    assert arguments["zero_error"][1] == 4e-4
    assert arguments["gain_error"] == pytest.approx([0.15, 0.07])
    assert arguments["offset_error"] == 7e-4
    assert arguments["map_error"] == 0.03
    assert arguments["critical_curvature"] == pytest.approx(critical_moment(0.01108, 0.49, 1.01))
    assert 0.05 < arguments["critical_curvature_error"] < 0.1
    assert arguments["tube_radius"] == 1.75
    assert reading_errors(config, "left", 2, SENSORS).critical_curvature_error == pytest.approx(
        0.05
    )


def test_a_straight_body_has_no_error_of_a_map() -> None:
    errors = reading_errors(RobotConfig(), None, 2, SENSORS)
    assert (errors.map_error, errors.offset_error) == (0.0, 0.0)


def test_an_uncalibrated_robot_is_uncertain_in_everything() -> None:
    errors = reading_errors(RobotConfig(), "right", 0, [("left", 0)])
    assert min(errors.noise[0], errors.zero_error[0], errors.offset_error) > 0
    assert min(errors.gain_error[0], errors.map_error, errors.critical_curvature_error) >= 0.1


@pytest.mark.parametrize(
    ("body_pressure", "sensors", "named"),
    [(3, SENSORS, "pressure 3"), (-1, SENSORS, "pressure -1"), (0, [("left", 5)], "left 5")],
)
def test_what_robot_toml_does_not_have_is_named(body_pressure, sensors, named) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(DataError, match=named):
        reading_errors(RobotConfig(), "left", body_pressure, sensors)
