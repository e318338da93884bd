"""Bodies in space against an independent rod: places, forces, weight, ends, what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

import thigmo
from thigmo.errors import DataError
from thigmo.localization import Localizer, priors
from thigmo.mechanics.closed_forms import phi
from thigmo.studies import rod
from thigmo.studies.rod_in_space import solve
from thigmo.studies.space import AXIS, DIRECTION, POSITION, SIGMA, SPAN, TWIST

READ = {
    "position": POSITION, "direction": DIRECTION, "length": 1.0, "span": SPAN, "noise": SIGMA,
}  # fmt: skip


def pressed(arc, normal, binormal, **options):
    """(1) rod with one force across it."""
    return solve(np.array([[arc]]), np.array([[[0.0, normal, binormal]]]), **options)


def noisy(clean, seed):
    return clean + SIGMA * np.random.default_rng(seed).standard_normal(clean.shape)


def test_the_rod_in_space_is_that_in_the_plane():
    arcs, normal, x = np.array([[0.4, 0.8]]), np.array([[2.0, -3.0]]), np.linspace(0.05, 0.95, 10)
    rods = solve(
        arcs, np.stack([0.0 * normal, normal, 0.0 * normal], 2), free=np.array([[0.0, 0.0, 1.0]])
    )
    plane = rod.readings(arcs[0], normal[0], x, 0.1, length=1.0, free_curvature=1.0)
    axis = np.tile([0.0, 0.0, 1.0], (10, 1))
    assert rods.readings(x, axis, 0.1)[0] == pytest.approx(plane, abs=1e-7)


def test_a_contact_is_found_with_its_force_in_the_frame_of_the_base():
    rods = pressed(0.7, 2.0, 1.0, twist=TWIST)
    clean = rods.readings(POSITION, AXIS, SPAN)[0]
    result = thigmo.localize(noisy(clean, 1), **READ, twist=TWIST, stiffness=(2.0, 0.0))
    (contact,) = result.contacts
    assert contact.status == "localized"
    assert contact.interval[0] < 0.7 < contact.interval[1]
    assert contact.vector == pytest.approx(rods.forces[0, 0], abs=0.15)
    assert (
        contact.newtons.across.interval[0] < 2 * math.sqrt(5) < contact.newtons.across.interval[1]
    )
    arc, toward_0, toward_90 = result.bend.T
    free = np.interp(POSITION[::2], arc, toward_0), np.interp(POSITION[::2], arc, toward_90)
    assert np.ravel(free, "F") == pytest.approx(clean, abs=0.1)


def test_units_and_rows_are_those_of_the_plane():
    curvature = noisy(pressed(0.6, 2.0, 1.0).readings(POSITION, AXIS, SPAN), 2)
    one = thigmo.localize(curvature[0], **READ)
    options = READ | {"position": 530 * POSITION, "span": 530 * SPAN, "length": 530.0}
    localizer = Localizer.of(**(options | {"noise": SIGMA / 530}))
    other = localizer.localize(curvature[0] / 530)
    assert other.contacts[0].arc == pytest.approx(530 * one.contacts[0].arc)
    assert np.multiply(other.contacts[0].vector, 530**2) == pytest.approx(one.contacts[0].vector)
    rows = localizer.localize_batch(curvature / 530)
    assert rows.arc[0, 0] == other.contacts[0].arc


def test_turned_about_its_axis_with_everything_places_stay():
    rods = pressed(0.55, 3.0, -1.0, weight=np.array([[0.3, -0.8, 0.4]]), twist=TWIST)
    curvature = noisy(rods.readings(POSITION, AXIS, SPAN)[0], 3)
    one = thigmo.localize(curvature, **READ, twist=TWIST, weight=rods.weight[0])
    c, s = np.cos(1.0), np.sin(1.0)
    about = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    other = thigmo.localize(
        curvature, **(READ | {"direction": DIRECTION + 1.0}), twist=TWIST,
        weight=about @ rods.weight[0],
    )  # fmt: skip
    assert abs(other.contacts[0].arc - one.contacts[0].arc) < 1e-6
    assert other.contacts[0].vector == pytest.approx(about @ one.contacts[0].vector, abs=1e-6)


def test_weight_that_is_stated_is_no_contact():
    rods = solve(np.ones((1, 1)), np.zeros((1, 1, 3)), weight=np.array([[0.4, -1.5, 0.3]]))
    curvature = noisy(rods.readings(POSITION, AXIS, SPAN)[0], 4)
    assert thigmo.localize(curvature, **READ).contacts  # unstated it looks like one
    assert thigmo.localize(curvature, **READ, weight=rods.weight[0]).status == "no contact"


def test_a_loaded_end_is_not_localized_elsewhere():
    rng = np.random.default_rng(6)
    force, couple = rng.standard_normal((2, 20, 1, 3)) * [1.0, 1.0, 1.0]
    couple[..., 0] = 0.0
    rods = solve(np.ones((20, 1)), force, couple=0.7 * couple, twist=TWIST)
    for curvature in noisy(rods.readings(POSITION, AXIS, SPAN), 7):
        result = thigmo.localize(curvature, **READ, twist=TWIST)
        assert result.contacts[-1].interval[1] == 1.0
        assert not any(c.status == "localized" for c in result.contacts[:-1])


def test_sensors_that_measure_twist_show_what_twists_the_end():
    rods = solve(
        np.ones((1, 1)), np.array([[[0.0, 1.0, 0.5]]]), couple=np.array([[[0.8, 0.3, 0.0]]]),
        twist=TWIST,
    )  # fmt: skip
    axis = np.concatenate([AXIS, np.tile([1.0, 0.0, 0.0], (12, 1))])
    x = np.r_[POSITION, POSITION[::2]]
    result = thigmo.localize(
        noisy(rods.readings(x, axis, SPAN)[0], 8), **(READ | {"position": x, "direction": axis}),
        twist=TWIST,
    )  # fmt: skip
    assert result.hypothesis == "end wrench"
    assert result.status == "localized"


def test_one_contact_is_weighed_as_dense_normal_densities():
    clean = 0.05 * phi(0.6, POSITION, SPAN)
    curvature = clean + 0.3 * noisy(0.0 * clean, 9)
    localizer = Localizer.of(**READ, contacts=1, held_end=False)._compiled
    nothing = np.zeros(1)
    weighed = localizer.localize(curvature, nothing, nothing).weighed
    found = next(weight for load, bad, weight in weighed if (load, bad) == ("one contact", -1))
    white = (SIGMA**2 + (priors.TRUST * np.abs(curvature).max()) ** 2) * np.eye(POSITION.size)
    logs = []
    for arc in (np.arange(60) + 0.5) / 60:
        lever = phi(arc, POSITION, SPAN)
        for scale in priors.MOMENTS:
            deviation = scale / max(arc, priors.LEAST_LEVER)
            both = (deviation**2) * sum(
                np.outer(column, column)
                for column in (lever * (DIRECTION == 0.0), lever * (DIRECTION > 0.0))
            )
            logs.append(
                multivariate_normal(np.zeros(POSITION.size), white + both).logpdf(curvature)
            )
    weight = logsumexp(logs) - np.log(len(logs)) + priors.CONTACT
    assert found == pytest.approx(weight, abs=0.02)


@pytest.mark.parametrize("weight", [None, (0.2, -1.0, 0.5)])
def test_readings_of_zero_without_a_noise_have_a_finite_answer(weight):
    options = READ | {"noise": None, "weight": weight}
    result = thigmo.localize(np.zeros(POSITION.size), **options)
    assert np.isfinite(result.log_odds)
    assert sum(result.hypotheses.values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"direction": 90.0 * DIRECTION}, "rad"),
        ({"direction": DIRECTION[:-1]}, "direction has shape"),
        ({"direction": 2.0 * AXIS}, "unit vector"),
        ({"weight": (0.0, 1.0)}, "weight"),
        ({"critical_curvature": 1.0}, "no fold is weighed in space"),
        ({"method": "l1"}, "knows no direction"),
        ({"direction": None, "twist": 1.0}, "twist"),
    ],
)
def test_what_is_not_possible_in_space_is_refused(given, says):
    with pytest.raises(DataError, match=says):
        Localizer.of(**(READ | given))
