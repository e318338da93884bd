"""The exact point fits against oracles, against themselves, and on readings that are hard."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
import pytest
from point_fit_oracles import (
    LIMIT,
    Floats,
    PointFit,
    fit,
    grid_minimum,
    influence,
    misfit,
    objective,
    profile,
    programme_minimum,
    random_frame,
)

import thigmo
from thigmo.errors import DataError

Norm = Literal["l1", "l2"]
Many = Callable[[int], int]
BOTH: tuple[Norm, ...] = ("l1", "l2")
ROBOT = np.tile(np.arange(5.0, 46.0, 10.0), 2) / 53.0  # the thesis's five sensors on both sides
ROBOT_LOW, ROBOT_HIGH = ROBOT - 2.75 / 53.0, ROBOT + 2.75 / 53.0


def check(y: Floats, low: Floats, high: Floats, norm: Norm, found: PointFit) -> float:
    """The answer is one, attains its objective, and is proven; returns its tolerance."""
    slack = 1e-9 * float(misfit(y, norm)) + 1e-300
    attained = objective(y, low, high, found.arcs, found.forces, norm)
    assert attained == pytest.approx(found.objective, abs=2.0 * slack)
    assert np.all((found.arcs >= 0.0) & (found.arcs <= 1.0))
    assert np.all(np.diff(found.arcs) >= 0.0)
    assert found.gap <= 1.01 * slack
    if len(found.arcs) == 2:
        assert np.all(np.abs(found.forces) <= LIMIT * np.abs(y).max() * (1.0 + 1e-12))
    return slack


@pytest.mark.sim
@pytest.mark.parametrize("norm", BOTH)
@pytest.mark.parametrize(("contacts", "frames", "most"), [(1, 25, 10), (2, 10, 6)])
def test_no_grid_does_better(norm: Norm, contacts: int, frames: int, most: int, many: Many) -> None:
    rng = np.random.default_rng(20 + contacts)
    for _ in range(many(frames)):
        y, low, high = random_frame(rng, most, contacts)
        found = fit(y, low, high, contacts, norm)
        slack = check(y, low, high, norm, found)
        best = grid_minimum(y, low, high, contacts, norm, None)
        assert found.objective <= best + slack
        # The grid comes close, so that the comparison means something.
        assert best <= found.objective + 0.05 * misfit(y, norm)


@pytest.mark.parametrize(("contacts", "frames", "most"), [(1, 12, 8), (2, 4, 4)])
def test_linear_programmes_agree(contacts: int, frames: int, most: int, many: Many) -> None:
    rng = np.random.default_rng(40 + contacts)
    for _ in range(many(frames)):
        y, places, _ = random_frame(rng, most, contacts, points=True)
        found = fit(y, places, places, contacts, "l1")
        best = programme_minimum(y, places, contacts)
        # HiGHS has absolute tolerances of 1e-7.
        assert found.objective == pytest.approx(best, abs=1e-5 * max(1.0, float(np.abs(y).sum())))


def test_the_optimum_set_of_one_contact_is_where_the_profile_is_least(many: Many) -> None:
    rng = np.random.default_rng(60)
    flat = 0
    for _ in range(many(50)):
        y, low, high = random_frame(rng, 10, 1)
        found = fit(y, low, high, 1, "l1")
        (ranges,) = found.optimum_set
        slack = 1e-9 * float(np.abs(y).sum())
        ends = np.array(ranges)
        flat += bool((ends[:, 1] - ends[:, 0] > 0.005).any())
        inside = np.concatenate([np.linspace(near, far, 7) for near, far in ranges])
        arcs = np.concatenate(
            [np.linspace(0.0, 1.0, 200), (ends + np.array([-1e-3, 1e-3])).ravel()]
        )
        arcs = arcs[(arcs >= 0.0) & (arcs <= 1.0)]
        near, far = ends[:, 0] - 1e-4, ends[:, 1] + 1e-4
        outside = arcs[~((near < arcs[:, None]) & (arcs[:, None] < far)).any(-1)]
        level = found.objective + 3.0 * slack + 1e-300
        assert np.all(profile(y, low, high, inside) <= level)
        assert np.all(profile(y, low, high, outside) > level)
    assert flat > 10


@pytest.mark.sim
def test_the_optimum_sets_of_two_contacts_attain_the_minimum_at_their_ends(many: Many) -> None:
    rng = np.random.default_rng(80)
    flat = 0
    for _ in range(many(2)):
        y = 0.03 * rng.standard_normal(10)
        for _ in range(2):
            y += rng.choice([-1, 1]) * influence(rng.uniform(0.2, 1.0), ROBOT_LOW, ROBOT_HIGH)
        found = fit(y, ROBOT_LOW, ROBOT_HIGH, 2, "l1")
        scale = float(np.abs(y).sum())
        for contact, ((near, far),) in enumerate(found.optimum_set):
            assert near <= found.arcs[contact] <= far
            flat += far - near > 0.01
            for arc, least in (
                (near, True),
                (far, True),
                (near - 0.01, False),
                (far + 0.01, False),
            ):
                if 0.0 <= arc <= 1.0:
                    held = {contact: arc}
                    value = grid_minimum(y, ROBOT_LOW, ROBOT_HIGH, 2, "l1", held)
                    assert (value <= found.objective + 1e-5 * scale) == least
    assert flat > 1


@pytest.mark.parametrize("norm", BOTH)
@pytest.mark.parametrize("contacts", [1, 2])
def test_rows_are_fitted_as_if_alone(contacts: int, norm: Norm) -> None:
    rng = np.random.default_rng(3)
    rows = 0.1 * rng.standard_normal((8, 10)) + influence(0.7, ROBOT_LOW, ROBOT_HIGH)
    rows[5] = 0.0
    rows[6, [0, 7]] = np.nan
    given = {"position": ROBOT * 53.0, "length": 53.0, "span": 5.5, "method": norm}
    together = thigmo.localize_batch(rows / 53.0, contacts=contacts, jobs=3, **given)
    assert len(together) == len(rows)
    for m, row in enumerate(rows / 53.0):
        alone = thigmo.localize(row, contacts=contacts, **given)
        assert together.status[m] == alone.status == "point estimate"
        assert together.contacts[m] == len(alone.contacts) == contacts
        assert together.objective[m] == alone.objective
        assert np.isnan(together.probability[m])
        for c, contact in enumerate(alone.contacts):
            assert together.arc[m, c] == contact.arc
            assert together.force[m, c] == contact.force
            assert (together.low[m, c], together.high[m, c]) == contact.interval


@pytest.mark.parametrize("norm", BOTH)
@pytest.mark.parametrize("contacts", [1, 2])
def test_sign_scale_and_order_do_not_matter(contacts: int, norm: Norm, many: Many) -> None:
    rng = np.random.default_rng(4)
    power = 1 if norm == "l1" else 2
    for _ in range(many(20)):
        y, low, high = random_frame(rng, 10, contacts)
        found = fit(y, low, high, contacts, norm).objective
        slack = 3e-9 * float(misfit(y, norm)) + 1e-300
        order = rng.permutation(len(y))
        assert fit(-y, low, high, contacts, norm).objective == pytest.approx(found, abs=slack)
        assert fit(y[order], low[order], high[order], contacts, norm).objective == pytest.approx(
            found, abs=slack
        )
        scaled = fit(1e-4 * y, low, high, contacts, norm).objective
        assert scaled == pytest.approx(1e-4**power * found, abs=1e-4**power * slack)


@pytest.mark.parametrize("norm", BOTH)
def test_contacts_are_recovered_from_clean_readings(norm: Norm) -> None:
    rng = np.random.default_rng(5)
    position = np.linspace(0.06, 0.94, 20)
    for span in (0.0, 0.1):
        low, high = position - span / 2, position + span / 2
        arcs = np.sort(rng.uniform(0.35, 0.95, 2))
        arcs[1] = max(arcs[1], arcs[0] + 0.3)
        forces = np.array([0.8, -1.5])
        one = fit(forces[0] * influence(arcs[0], low, high), low, high, 1, norm)
        assert one.arcs == pytest.approx(arcs[:1], abs=1e-4)
        assert one.forces == pytest.approx(forces[:1], abs=1e-3)
        arcs = np.clip(arcs, 0.0, 0.98)
        two = fit(forces @ influence(arcs, low, high), low, high, 2, norm)
        assert two.arcs == pytest.approx(arcs, abs=1e-3)
        assert two.forces == pytest.approx(forces, abs=1e-2)


def test_a_gross_error_does_not_move_the_l1_fit() -> None:
    y = influence(0.7, ROBOT_LOW, ROBOT_HIGH)
    y[2] += 5.0
    assert fit(y, ROBOT_LOW, ROBOT_HIGH, 1, "l1").arcs == pytest.approx([0.7], abs=1e-4)
    assert abs(fit(y, ROBOT_LOW, ROBOT_HIGH, 1, "l2").arcs[0] - 0.7) > 0.05


@pytest.mark.parametrize("norm", BOTH)
def test_hundreds_of_gratings_are_fitted_and_proven_too(norm: Norm) -> None:
    rng = np.random.default_rng(6)
    low = np.linspace(0.0, 0.995, 200)
    high = low + 0.005
    arcs, forces = np.array([0.45, 0.8]), np.array([-2.0, 1.5])
    y = forces @ influence(arcs, low, high) + 0.02 * rng.standard_normal(200)
    for contacts in (1, 2):
        found = fit(y, low, high, contacts, norm)
        check(y, low, high, norm, found)
    assert found.objective <= objective(y, low, high, arcs, forces, norm)
    assert found.arcs == pytest.approx(arcs, abs=0.02)


@pytest.mark.parametrize("norm", BOTH)
@pytest.mark.parametrize("contacts", [1, 2])
def test_where_no_contact_fits_better_every_arc_is_as_good(contacts: int, norm: Norm) -> None:
    found = fit(np.zeros(10), ROBOT_LOW, ROBOT_HIGH, contacts, norm)
    assert found.objective == found.gap == 0.0
    assert np.all(found.forces == 0.0)
    if norm == "l1" or contacts == 2:
        assert found.optimum_set == (((0.0, 1.0),),) * contacts


@pytest.mark.parametrize("norm", BOTH)
def test_the_end_of_the_body_cuts_a_span(norm: Norm) -> None:
    position = np.array([0.0, 0.5, 1.0])
    low, high = np.array([0.0, 0.4, 0.9]), np.array([0.1, 0.6, 1.0])
    y = 0.5 * influence(0.95, low, high)
    found = thigmo.localize(y, position, length=1.0, span=0.2, contacts=1, method=norm)
    assert found.contacts[0].arc == pytest.approx(0.95, abs=1e-6)
    assert found.objective == pytest.approx(0.0, abs=1e-9)


def test_where_any_arc_explains_one_reading_the_force_is_not_endless() -> None:
    for place in (0.0, 0.3):
        found = fit(np.array([0.4]), np.array([place]), np.array([place + 0.2]), 1, "l2")
        assert found.objective == pytest.approx(0.0, abs=1e-15)
        assert found.arcs[0] > place + 0.1
        assert found.forces[0] < 10.0


@pytest.mark.parametrize("norm", BOTH)
def test_what_cannot_be_fitted_is_said(norm: Norm) -> None:
    given = {"position": ROBOT, "length": 1.0, "method": norm}
    y = 0.1 * ROBOT
    with pytest.raises(DataError, match="3 contacts"):
        thigmo.localize(y, contacts=3, **given)
    with pytest.raises(DataError, match="row 1: a reading is infinite"):
        thigmo.localize_batch([y, np.full(10, np.inf)], **given)
    with pytest.raises(DataError, match="tighter than the tube"):
        thigmo.localize(1e3 * y, **given)
    with pytest.raises(DataError, match="no reading is finite"):
        thigmo.localize(np.full(10, np.nan), **given)
