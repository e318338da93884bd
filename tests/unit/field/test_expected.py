"""What sweeps would tell of a peg before they are made."""

from __future__ import annotations

import pytest

from thigmo.config import RobotConfig
from thigmo.exploration.growth import stage_lengths
from thigmo.field import expected_sweeps
from thigmo.wiring import Wiring

NARROW = 3.0 / 53


@pytest.fixture(scope="module")
def lengths() -> list[float]:
    return stage_lengths(RobotConfig())


def test_more_sweeps_never_tell_less(lengths: list[float]) -> None:
    side = expected_sweeps(Wiring.laid_out(RobotConfig()), "left", lengths)
    assert side.felt_and_placed([0] * len(lengths), NARROW) == (0.0, 0.0)
    felt, placed = 0.0, 0.0
    for sweeps in ([0, 0, 0, 0, 0, 1], [0, 0, 0, 1, 0, 1], [0, 0, 0, 1, 1, 1], [1] * 6, [3] * 6):
        more_felt, more_placed = side.felt_and_placed(sweeps, NARROW)
        assert more_felt >= felt
        assert more_placed >= placed
        assert 0.0 < more_placed <= more_felt <= 1.0
        felt, placed = more_felt, more_placed


def test_a_longer_body_feels_more_of_what_it_reaches(lengths: list[float]) -> None:
    side = expected_sweeps(Wiring.laid_out(RobotConfig()), "left", lengths)
    single = [[int(n == s) for n in range(len(lengths))] for s in range(len(lengths))]
    felt = [side.felt_and_placed(sweeps, NARROW)[0] for sweeps in single]
    assert felt == sorted(felt)
    assert felt[0] < 0.1 < 0.9 < felt[-1]


def test_noise_and_unsure_places_of_sensors_cost_places_of_pegs(lengths: list[float]) -> None:
    good, noisy, unsure = RobotConfig(), RobotConfig(), RobotConfig()
    for sensor in noisy.sensors:
        sensor.noise *= 10
    for sensor in unsure.sensors:
        sensor.center_se_cm = 3.0
    sweeps = [0, 0, 0, 1, 1, 1]
    placed = [
        expected_sweeps(Wiring.laid_out(config), "left", lengths).felt_and_placed(sweeps, NARROW)[1]
        for config in (good, noisy, unsure)
    ]
    assert placed[1] < placed[0]
    assert placed[2] < placed[0]


def test_both_sides_of_a_symmetric_robot_tell_the_same(lengths: list[float]) -> None:
    left, right = (
        expected_sweeps(Wiring.laid_out(RobotConfig()), side, lengths) for side in ("left", "right")
    )
    assert left is right  # computed once
