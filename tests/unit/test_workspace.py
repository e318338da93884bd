"""From arc to room: shapes against closed forms, contacts on the right side of the skin."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin

import numpy as np
import pytest
from contacts import CONTACT
from hypothesis import given
from hypothesis import strategies as st

from thigmo.exploration.map import best_contact, errors, peg_ahead
from thigmo.exploration.workspace import (
    Bend,
    centreline,
    common_error,
    measured_bend,
    place_contact,
    ramp_knots,
    skin_point,
)
from thigmo.record import MapContact, TrueContact


@given(st.floats(5, 60), st.floats(-0.08, 0.08))
def test_a_free_body_is_a_circular_arc(length: float, curvature: float) -> None:
    x, y, heading = centreline(Bend(length, curvature)).pose(length)
    assert heading == pytest.approx(curvature * length)
    if abs(curvature) > 1e-6:
        assert x == pytest.approx(sin(heading) / curvature, abs=2e-3)
        assert y == pytest.approx((1 - cos(heading)) / curvature, abs=2e-3)


def test_excess_curvature_turns_the_body_and_a_fold_turns_all_of_it() -> None:
    # Heading beyond the contact: g s + the integral of a ramp that falls to zero at 40 cm.
    ramp = ramp_knots([(40.0, -2e-4)])
    assert ramp == pytest.approx(np.array([(0.0, -2e-4 * 40), (40.0, 0.0)]))
    curve = centreline(Bend(50.0, 0.01, ramp, fold_rad=0.1))
    assert curve.pose(0.0)[2] == pytest.approx(0.1)
    assert curve.pose(40.0)[2] == pytest.approx(0.1 + 0.4 - 2e-4 * 800)
    assert curve.pose(50.0)[2] == pytest.approx(0.1 + 0.5 - 2e-4 * 800)


@pytest.mark.parametrize("apart", [0.0, 0.1])
def test_the_difference_of_two_sensors_at_one_place_bends_no_base(apart: float) -> None:
    centers, noise = np.array([5.0, 5.0 + apart, 15.0, 25.0]), 6e-4 * np.array([1.0, -1.0, 0, 0])
    first_pair = centers[1:] - [apart / 2, 0.0, 0.0]
    ramp, plain = (-2e-4 * np.maximum(27.0 - at, 0) for at in (centers, first_pair))
    base = measured_bend(40.0, centers, ramp + noise).excess[0]
    assert base == pytest.approx(measured_bend(40.0, first_pair, plain).excess[0])


def test_the_shape_is_the_same_in_whichever_order_the_inputs_have_the_sensors() -> None:
    centers, readings = np.array([5.0, 15.0, 25.0, 35.0]), np.array([4e-3, 6e-3, 9e-3, 13e-3])
    other = np.array([2, 0, 3, 1])
    assert measured_bend(40.0, centers[other], readings[other]) == measured_bend(
        40.0, centers, readings
    )
    covariance = np.diag([1.0, 2.0, 3.0, 4.0])
    assert common_error(40.0, centers[other], covariance[np.ix_(other, other)]) == pytest.approx(
        common_error(40.0, centers, covariance)
    )


def test_a_body_as_its_sensors_see_it_is_the_body() -> None:
    bend = Bend(50.0, 0.02, ramp_knots([(38.0, -2e-4)]))
    centers = np.array([5.0, 15.0, 25.0, 35.0, 45.0])
    readings = 0.02 - 2e-4 * np.maximum(38.0 - centers, 0)
    seen, true = centreline(measured_bend(50.0, centers, readings)), centreline(bend)
    for arc in (10.0, 30.0, 50.0):
        assert seen.pose(arc) == pytest.approx(true.pose(arc), abs=0.05)


def test_a_common_error_puts_the_tip_as_far_off_as_the_sensors_own() -> None:
    rng = np.random.default_rng(7)
    centers, error = np.array([5.0, 15.0, 25.0, 35.0]), np.array([4e-4, 3e-4, 6e-4, 3e-4])
    tips = [
        centreline(measured_bend(40.0, centers, error * rng.standard_normal(4))).pose(40.0)[1]
        for _ in range(800)
    ]
    stated = common_error(40.0, centers, np.diag(error**2)) * 40.0**2 / 2
    assert np.std(tips) == pytest.approx(stated, rel=0.25)


def test_the_point_is_on_the_side_that_the_force_comes_from() -> None:
    straight = centreline(Bend(50.0, 0.0))
    assert skin_point(straight, 30.0, +1e-4, 1.75)[:2] == pytest.approx((30.0, -1.75))
    assert skin_point(straight, 30.0, -1e-4, 1.75)[:2] == pytest.approx((30.0, 1.75))
    assert skin_point(straight, 30.0, -1e-4, 1.75)[2] == pytest.approx(pi / 2)


def test_the_covariance_is_the_interval_along_and_the_shapes_error_across() -> None:
    placed = place_contact(
        Bend(53.0, 0.0, curvature_se=5e-4), 40.0, -1e-4, (36.0, 44.0), radius_cm=1.75
    )
    (xx, xy), (_, yy) = placed.covariance_cm2
    assert xx**0.5 == pytest.approx(8 / 3.92, rel=2e-3)
    # The integral of the heading's error, and the bend between the sensors.
    assert yy**0.5 == pytest.approx(np.hypot(5e-4 * 40**2 / 2, 0.5), rel=2e-3)
    assert placed.track[0] == pytest.approx((36.0, 1.75), abs=1e-3)
    assert placed.track[-1] == pytest.approx((44.0, 1.75), abs=1e-3)
    assert abs(xy) < 0.2


def _contact(x: float, y: float, width: float, length: float) -> MapContact:
    return replace(
        CONTACT,
        arc_cm=45.0,
        x_cm=x,
        y_cm=y,
        interval_cm=(45.0 - width / 2, 45.0 + width / 2),
        everted_length_cm=length,
        covariance_cm2=(((width / 3.92) ** 2, 0.0), (0.0, 0.2)),
    )


def test_the_error_is_taken_at_the_best_contacts_own_stage() -> None:
    contacts = [_contact(37, 28, 6, 50), _contact(10, 28, 2, 53)]
    truth = [TrueContact(38, 28, 45, 50, 0), TrueContact(13, 32, 45, 53, 0)]
    assert best_contact(contacts) is contacts[1]
    assert errors(contacts, truth) == pytest.approx((3.0, 5.0))
    assert errors([], truth) == (None, None)
    assert errors(contacts, truth[:1]) == (None, None)


def test_growth_stops_before_a_peg_on_its_path_only() -> None:
    assert peg_ahead([_contact(38, 1.0, 3, 40)], 39.0, 1.75)
    assert not peg_ahead([_contact(38, 12.0, 3, 40)], 39.0, 1.75)
    assert not peg_ahead([_contact(20, 1.0, 3, 40)], 39.0, 1.75)


def test_poses_are_evenly_spaced_and_end_at_the_tip() -> None:
    poses = np.asarray(centreline(Bend(53.0, 0.02)).poses(1.0))
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    assert len(poses) == 54
    assert np.ptp(steps) < 1e-3
