"""Bodies in space against an independent rod: places, forces, weight, ends, what is refused."""

from __future__ import annotations

import math
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

import thigmo
from thigmo.errors import DataError
from thigmo.localization import Localizer, priors
from thigmo.mechanics.closed_forms import phi
from thigmo_bench.studies import rod
from thigmo_bench.studies.rod_in_space import solve
from thigmo_bench.studies.scenes import STATED
from thigmo_bench.studies.space import ANGLE, AXIS, POSITION, SIGMA, SPAN, TWIST

READ = {
    "position": POSITION, "angle": ANGLE, "length": 1.0, "span": SPAN, "noise": SIGMA,
    **STATED,
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
    single = thigmo.localize(curvature[0], **READ)
    options = READ | {"position": 530 * POSITION, "span": 530 * SPAN, "length": 530.0}
    localizer = Localizer.of(**(options | {"noise": SIGMA / 530}))
    scaled = localizer.localize(curvature[0] / 530)
    assert scaled.contacts[0].arc == pytest.approx(530 * single.contacts[0].arc)
    assert np.multiply(scaled.contacts[0].vector, 530**2) == pytest.approx(
        single.contacts[0].vector
    )
    rows = localizer.localize_batch(curvature / 530)
    assert rows.arc[0, 0] == scaled.contacts[0].arc


def test_turned_about_its_axis_with_everything_places_stay():
    rods = pressed(0.55, 3.0, -1.0, weight=np.array([[0.3, -0.8, 0.4]]), twist=TWIST)
    curvature = noisy(rods.readings(POSITION, AXIS, SPAN)[0], 3)
    single = thigmo.localize(curvature, **READ, twist=TWIST, weight=rods.weight[0])
    c, s = np.cos(1.0), np.sin(1.0)
    about = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    turned = thigmo.localize(
        curvature, **(READ | {"angle": ANGLE + 1.0}), twist=TWIST,
        weight=about @ rods.weight[0],
    )  # fmt: skip
    assert abs(turned.contacts[0].arc - single.contacts[0].arc) < 1e-6
    assert turned.contacts[0].vector == pytest.approx(about @ single.contacts[0].vector, abs=1e-6)


def test_turned_about_its_axis_two_contacts_stay():
    # Frame 74 moves by 5e-6 where shapes are compared component by component.
    arcs = np.tile([0.35, 0.8], (80, 1))
    sizes = np.array([[0.0, 12.0, 12.0], [0.0, 6.0, 6.0]])
    forces = sizes * np.random.default_rng(5).uniform(-1.0, 1.0, (80, 2, 3))
    curvature = noisy(solve(arcs, forces).readings(POSITION, AXIS, SPAN), 5)
    turned = READ | {"angle": ANGLE + 1.234}
    pairs = 0
    for frame in curvature:
        contacts, turned_contacts = (
            thigmo.localize(frame, **options).contacts for options in (READ, turned)
        )
        assert [c.arc for c in turned_contacts] == pytest.approx(
            [c.arc for c in contacts], abs=1e-6
        )
        pairs += len(contacts) == 2
    assert pairs > 40


def test_on_a_body_bent_by_150_degrees_exact_readings_give_the_place():
    for arc, force in ((0.5, 3.0), (0.9, -2.0)):
        rods = pressed(arc, force, force, free=np.array([[0.0, 0.4, 2.6]]))
        free = np.where(ANGLE == 0.0, 2.6, -0.4)
        (contact,) = thigmo.localize(
            rods.readings(POSITION, AXIS, SPAN)[0], **(READ | {"noise": 1e-4}), contacts=1,
            free_curvature=free,
        ).contacts  # fmt: skip
        assert contact.arc == pytest.approx(arc, abs=1e-3)
        assert contact.vector == pytest.approx(rods.forces[0, 0], abs=5e-3)


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
        noisy(rods.readings(x, axis, SPAN)[0], 8),
        **(READ | {"position": x, "axis": axis, "angle": None}), twist=TWIST,
    )  # fmt: skip
    assert result.hypothesis == "end wrench"
    assert result.status == "localized"


@cache
def responses(free, arc):
    """(6, N) of readings of a circle to unit forces and couples at an arc, in the frame there."""

    def frames(at):
        c, s = np.cos(free * at), np.sin(free * at)
        zero = 0.0 * at
        columns = [[c, s, zero], [-s, c, zero], [zero, zero, zero + 1.0]]
        return np.moveaxis(np.array(columns), (0, 1), (-2, -1))

    def places(at):
        x = np.sinc(free * at / np.pi) * at
        return np.stack(
            [x, at * np.sin(free * at / 2) * np.sinc(free * at / 2 / np.pi), 0 * at], -1
        )

    across = (np.arange(100) + 0.5) / 100 - 0.5  # of a sensor
    at = POSITION[:, None] + SPAN * across
    axes, lever = frames(np.array(arc)), places(np.array(arc)) - places(at)
    moments = [np.cross(lever, axis) for axis in axes] + [0.0 * lever + axis for axis in axes]
    read = np.einsum("dsni,snki,sk->dsn", np.array(moments), frames(at), AXIS)
    return (read * (at < arc)).mean(axis=2)


def largest_lever(free, arc):
    """Of forces across a circle, over all of it before an arc."""
    before = np.linspace(0.0, arc, 200)
    return np.abs(np.sin(free * (arc - before)) / free if free else arc - before).max()


def log_densities(curvature, column_sets, *, bad=None, pushes=None):
    """Log densities of readings under sets of columns (K, N).

    `pushes`: index of a column whose number is never negative. Beside a bad reading one contact
    leaves a misfit, so that the noise is doubted; the likelier level of it is all that matters.
    """
    out, doubt = [], 0.0 if bad is None else np.log1p(-sum(priors.NOISE_ODDS))
    for columns in column_sets:
        white = (SIGMA**2 + (priors.TRUST * np.abs(curvature).max()) ** 2) * np.eye(POSITION.size)
        if bad is not None:
            white[bad, bad] += priors.BAD_DEVIATION**2
        total = white + columns.T @ columns
        log_density = multivariate_normal(np.zeros(POSITION.size), total).logpdf(curvature)
        if pushes is not None:
            gain = np.linalg.solve(total, columns[pushes])
            mean, variance = gain @ curvature, 1.0 - gain @ columns[pushes]
            log_density += np.log(2.0) + norm.logcdf(mean / np.sqrt(variance))
        out.append(log_density)
    return np.array(out) + doubt


def columns_of(free, scale, arcs=(), end=""):
    """Columns of one prior deviation of contacts at arcs, and of a face or a grip of the end."""
    sets = []
    for arc in arcs:
        deviation = scale / max(
            largest_lever(free, arc), priors.LEAST_LEVER * largest_lever(free, 1)
        )
        sets.append(deviation * responses(free, arc)[1:3])
    if end:
        force, unit = responses(free, 1.0), scale / largest_lever(free, 1.0)
        couple = scale if end == "grip" else unit * priors.TUBE_RADIUS
        sets += [unit * force[1:3], unit * force[:1], couple * force[4:6]]
    return np.concatenate(sets)


@pytest.mark.parametrize(
    ("name", "count", "cells", "end", "bad", "free", "odds", "options"),
    [
        ("one contact", 1, 60, "", None, 0.0, 0.0, {"contacts": 1}),
        ("one contact", 1, 60, "", 5, 0.0, np.log(priors.BAD_READING), {"contacts": 1}),
        ("two contacts", 2, 24, "", None, 0.0, priors.ANOTHER, {"contacts": 2}),
        ("three contacts", 3, 12, "", None, 0.0, 2.0 * priors.ANOTHER, {"contacts": 3}),
        ("end wrench", 0, 0, "grip", None, 0.0, 0.0, {"held_end": True}),
        ("one contact, end wrench", 1, 24, "grip", None, 0.0, priors.ANOTHER, {"held_end": True}),
        ("end wrench", 0, 0, "face", None, 0.6, priors.END, {}),
        ("one contact", 1, 60, "", None, 0.6, 0.0, {"contacts": 1}),
    ],
)
def test_explanations_are_weighed_as_dense_normal_densities(
    name, count, cells, end, bad, free, odds, options
):
    clean = 0.05 * phi(0.6, POSITION, SPAN)
    excess = clean + 0.3 * noisy(0.0 * clean, 9)
    if bad is not None:
        excess[bad] += 0.1
    rest = free * (ANGLE == 0.0)
    localizer = Localizer.of(**(READ | {"held_end": False} | options))._compiled
    weighed = localizer.localize(excess + rest, rest, rest).weighed
    bad_row = -1 if bad is None else bad
    log_weight = next(weight for load, at, weight in weighed if (load, at) == (name, bad_row))
    middles = (np.arange(cells) + 0.5) / cells if cells else ()
    logs = [
        log_densities(
            excess,
            [columns_of(free, scale, arcs, end) for arcs in combinations(middles, count)],
            bad=bad,
            pushes=2 * count + 2 if end == "face" else None,
        )
        for scale in priors.MOMENTS
    ]
    weight = logsumexp(logs) - np.log(np.size(logs)) + priors.CONTACT + odds
    assert log_weight == pytest.approx(weight, abs=0.02)


@pytest.mark.parametrize("weight", [None, (0.2, -1.0, 0.5)])
def test_readings_of_zero_without_a_noise_have_a_finite_answer(weight):
    options = READ | {"noise": None, "weight": weight}
    result = thigmo.localize(np.zeros(POSITION.size), **options)
    assert np.isfinite(result.log_odds)
    assert sum(result.hypotheses.values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"angle": 90.0 * ANGLE}, "rad"),
        ({"angle": ANGLE[:-1]}, "angle has shape"),
        ({"axis": 2.0 * AXIS, "angle": None}, "unit vector"),
        ({"axis": AXIS}, "angle and axis are both given"),
        ({"axis": AXIS[:-1], "angle": None}, "axis has shape"),
        ({"weight": (0.0, 1.0)}, "weight"),
        ({"critical_curvature": 1.0}, "no fold is weighed in space"),
        ({"method": "thesis"}, "knows no angles"),
        ({"angle": None, "twist": 1.0}, "twist"),
    ],
)
def test_what_is_not_possible_in_space_is_refused(given, says):
    with pytest.raises(DataError, match=says):
        Localizer.of(**(READ | given))
