"""Many frames: batches against single calls, and one obstacle over a sweep."""

from __future__ import annotations

import numpy as np
import pytest

import thigmo
from thigmo.errors import DataError
from thigmo.localization import (
    ArcFilter,
    identifiability,
    localize_batch,
    localize_rows,
    localize_sweep,
)
from thigmo.studies.rod import readings as true_readings

LENGTH, SPAN, SIGMA = 53.0, 5.5, 6e-4
COLUMN = np.array([5.0, 15.0, 25.0, 35.0, 45.0])
BOTH = np.tile(COLUMN, 2)


@pytest.fixture(scope="module")
def rows():
    rng = np.random.default_rng(41)
    out = []
    for _ in range(40):
        arc = rng.uniform(20.0, LENGTH)
        clean = true_readings(
            np.array([arc]), np.array([0.008 / arc]), BOTH, length=LENGTH, span=SPAN
        )
        out.append(clean + SIGMA * rng.standard_normal(10))
    out[3][2] = np.nan
    return np.array(out)


def test_batch_posterior_is_the_single_calls(rows):
    batch = localize_batch(
        rows, BOTH, length=LENGTH, span=SPAN, noise=SIGMA, method="exact", threads=0
    )
    for i, row in enumerate(rows):
        single = thigmo.localize(
            row, BOTH, length=LENGTH, span=SPAN, noise=SIGMA, contacts=1, mechanics="plain"
        )
        (contact,) = single.contacts
        assert batch.arc[i] == pytest.approx(contact.arc, abs=1e-6)
        assert batch.force[i] == pytest.approx(contact.force, rel=1e-6)
        assert (batch.low[i], batch.high[i]) == pytest.approx(contact.interval, abs=1e-6)


def test_batch_optimum_is_the_single_calls(rows):
    batch = localize_batch(rows, BOTH, length=LENGTH, span=SPAN, noise=SIGMA)
    for i, row in enumerate(rows):
        single = thigmo.localize(
            row, BOTH, length=LENGTH, span=SPAN, noise=SIGMA, contacts=1, method="l1"
        )
        assert batch.arc[i] == pytest.approx(single.contacts[0].arc, abs=1e-6)


def test_rows_over_processes_are_the_same(rows):
    options = {"length": LENGTH, "span": SPAN, "noise": SIGMA}
    serial = localize_rows(rows[:6], BOTH, **options)
    parallel = localize_rows(rows[:6], BOTH, jobs=2, **options)
    assert [r.contacts[0].arc for r in serial] == [r.contacts[0].arc for r in parallel]


@pytest.mark.parametrize(
    "change",
    [
        {"curvature": np.zeros(10)},
        {"curvature": np.full((2, 10), np.inf)},
        {"position": COLUMN},
        {"method": "guess"},
        {"free_curvature": np.zeros((3, 3))},
    ],
)
def test_batch_refuses_what_it_cannot_use(change):
    arguments = {"curvature": np.zeros((2, 10)), "position": BOTH, "noise": SIGMA} | change
    curvature, position = arguments.pop("curvature"), arguments.pop("position")
    with pytest.raises(DataError):
        localize_batch(curvature, position, length=LENGTH, span=SPAN, **arguments)


def sweep(rng, arc, frames=12):
    free = np.linspace(0.015, 0.03, frames)
    moment = -np.linspace(0.002, 0.006, frames)
    clean = [
        true_readings(
            np.array([arc]),
            np.array([m / arc]),
            COLUMN,
            length=LENGTH,
            span=SPAN,
            free_curvature=g,
        )
        for m, g in zip(moment, free, strict=True)
    ]
    return np.array(clean) + SIGMA * rng.standard_normal((frames, 5)), free


def test_a_sweep_is_sharper_than_its_best_frame_and_still_covers():
    rng = np.random.default_rng(42)
    joint, last, covered = [], [], 0
    for _ in range(25):
        arc = rng.uniform(28.0, 50.0)
        readings, free = sweep(rng, arc)
        options = {"length": LENGTH, "span": SPAN, "noise": SIGMA}
        (contact,) = localize_sweep(readings, COLUMN, free_curvature=free, **options).contacts
        joint.append(contact.arc - arc)
        covered += contact.interval[0] <= arc <= contact.interval[1]
        single = thigmo.localize(
            readings[-1], COLUMN, free_curvature=free[-1], contacts=1, **options
        )
        last.append(single.contacts[0].arc - arc)
    assert np.sqrt(np.mean(np.square(joint))) < 0.75 * np.sqrt(np.mean(np.square(last)))
    assert covered >= 20


def test_a_filter_follows_a_sliding_contact():
    rng = np.random.default_rng(43)
    chain = ArcFilter(LENGTH, slide_sigma=1.0)
    for arc in np.linspace(30.0, 42.0, 20):
        clean = true_readings(
            np.array([arc]), np.array([0.009 / arc]), BOTH, length=LENGTH, span=SPAN
        )
        result = chain.update(clean + SIGMA * rng.standard_normal(10), BOTH, noise=SIGMA, span=SPAN)
    (contact,) = result.contacts
    assert contact.arc == pytest.approx(42.0, abs=3.0)
    assert contact.interval[0] <= 42.0 <= contact.interval[1]


def test_an_empty_sweep_has_no_contact():
    rng = np.random.default_rng(44)
    found = sum(
        bool(
            localize_sweep(
                SIGMA * rng.standard_normal((10, 10)), BOTH, length=LENGTH, span=SPAN, noise=SIGMA
            ).contacts
        )
        for _ in range(30)
    )
    assert found <= 1


def test_bounds_of_the_layouts_are_those_of_the_information_matrix():
    arcs, moment = np.array([8.0, 20.0, 40.0, 53.0]), 0.01
    got = identifiability(BOTH, length=LENGTH, span=SPAN, noise=SIGMA, arcs=arcs, moments=[moment])
    for a, arc in enumerate(arcs):
        force = moment / arc

        def model(f, place):
            reach = np.clip(place - (BOTH - SPAN / 2), 0.0, None)
            return f * np.where(place >= BOTH + SPAN / 2, place - BOTH, reach**2 / (2 * SPAN))

        step = 1e-5
        jacobian = np.column_stack(
            [
                model(1.0, arc),
                (model(force, min(arc + step, LENGTH)) - model(force, arc - step))
                / (min(arc + step, LENGTH) - arc + step),
            ]
        )
        information = jacobian.T @ jacobian / SIGMA**2
        if np.linalg.cond(information) > 1e15:
            assert got.bound[0, a] == np.inf
        else:
            expected = np.sqrt(np.linalg.inv(information)[1, 1])
            assert got.bound[0, a] == pytest.approx(expected, rel=1e-2)
    assert len(got.table()) == len(arcs)


def test_bounds_of_two_contacts_depend_on_the_layout():
    def worst(base, separation):
        position = np.tile(base + 10.0 * np.arange(5), 2)
        got = identifiability(
            position,
            length=LENGTH,
            span=SPAN,
            noise=SIGMA,
            separations=[separation],
            moments=[0.025],
        )
        return got.pair_bound[0, 0].max()

    assert worst(5.0, 18.5) < 3.0
    assert worst(5.0, 13.0) == np.inf
    assert worst(1.0, 18.5) == np.inf
