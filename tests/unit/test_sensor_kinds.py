"""Every kind of sensor answers what the robot, the localizer's callers and the board ask of one."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo.config import RobotConfig
from thigmo.reading_errors import shared_errors
from thigmo.sensors import KINDS, AnySensor, FlexSensor, HeadingSensor


def made(kind: str) -> AnySensor:
    return KINDS[kind](kind=kind, center_cm=12.0, span_cm=4.0, angle_deg=270.0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_reading_counts_from_the_straight_body_and_follows_the_scale(kind: str) -> None:
    sensor = made(kind)
    assert sensor.reading(sensor.raw_zero) == 0.0
    before = sensor.reading(sensor.raw_zero + 50.0)
    sensor.rescale(2.0)
    assert sensor.reading(sensor.raw_zero + 50.0) == pytest.approx(2 * before)
    assert sensor.reading_se >= sensor.noise


@pytest.mark.parametrize("kind", KINDS)
def test_before_its_calibration_a_sensor_is_at_its_place_with_default_constants(kind: str) -> None:
    sensor = made(kind)
    sensor.rescale(3.0)
    sensor.healthy = False
    blank = sensor.uncalibrated()
    assert blank == made(kind)


def test_a_flex_sensor_keeps_the_sign_of_its_scale_before_its_calibration() -> None:
    sensor = FlexSensor(center_cm=5.0, scale_per_ohm=-9e-5)
    assert sensor.uncalibrated().scale_per_ohm == -FlexSensor(center_cm=5.0).scale_per_ohm


def test_what_sensors_share_is_of_their_own_kind_only() -> None:
    imus = [HeadingSensor(kind="heading", center_cm=center, span_cm=10.0) for center in (5.0, 15.0)]
    alone = shared_errors(imus)
    beside = shared_errors([imus[0], made("flex"), imus[1], None, made("fibre")])
    assert beside[[0, 2]][:, : alone.shape[1]] == pytest.approx(alone)
    assert not beside[[1, 3]].any()
    assert np.count_nonzero(beside[4]) == 1


def test_every_kind_passes_the_tip_within_the_body() -> None:
    body_cm = RobotConfig().body.length_cm
    for kind in KINDS:
        passage = made(kind).passes_at
        reach_cm = passage.span_cm / 2
        assert 0.0 < passage.center_cm - reach_cm < passage.center_cm + reach_cm < body_cm
        assert passage.center_se_cm > 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_a_quieter_sensor_reads_with_smaller_errors_and_is_a_copy(kind: str) -> None:
    sensor = made(kind)
    quieter = sensor.quieter(4.0)
    assert quieter.noise == sensor.noise / 4.0
    assert quieter.zero_error == sensor.zero_error / 4.0
    assert sensor == made(kind)


@pytest.mark.parametrize("kind", ["heading", "fibre"])
def test_a_kind_without_a_preferred_sign_reads_alike_in_bends_of_both(kind: str) -> None:
    sensor = made(kind)
    assert sensor.straightened(-0.01, 0.02) == (sensor, -0.01)
    assert sensor.response_against == (1.0, 0.0)


def test_a_flex_sensor_states_its_weak_answer_only_if_it_prefers_a_sign() -> None:
    both, left = (FlexSensor(center_cm=5.0, bend_sign=sign) for sign in (0, 1))
    assert both.response_against == (1.0, 0.0)
    assert left.response_against == (left.against_gain, left.against_gain_se)


def test_a_count_is_worth_the_bend_that_changes_the_divider_by_one_count() -> None:
    sensor = FlexSensor(center_cm=5.0)
    divider_ohm, count = 10_000.0, 1024 * 10_000.0 / (10_000.0 + sensor.zero_ohm)
    bent_ohm = divider_ohm * (1024 / (count - 1e-3) - 1)
    per_count = sensor.reading(bent_ohm) / 1e-3
    assert sensor.count_curvature(divider_ohm, 1024) == pytest.approx(per_count, rel=1e-3)
    assert made("heading").count_curvature(divider_ohm, 1024) == 0.0
