"""The thesis's fit as a method of `localize`: its numbers, and that nobody takes them for sure."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from scipy.optimize import linprog

import thigmo
from thigmo.errors import DataError
from thigmo.localization import thesis

X = np.tile([5.0, 15.0, 25.0, 35.0, 45.0], 2)


def pressed(arc: float, moment: float = 0.009) -> np.ndarray:
    return np.asarray(moment / arc * np.clip(arc - X, 0.0, None))


@pytest.mark.parametrize("arc", [39.75, 45.0])
def test_it_finds_a_clean_contact_and_claims_nothing(arc: float) -> None:
    found = thigmo.localize(pressed(arc), X, length=53, span=5.5, method="thesis")
    (contact,) = found.contacts
    assert contact.arc == pytest.approx(arc, abs=1.5)
    assert contact.force == pytest.approx(0.009 / arc, rel=0.1)
    assert found.status == contact.status == "point estimate"
    assert contact.interval == (0.0, 53.0)
    assert math.isnan(contact.probability)
    assert "no interval" in repr(found)
    assert "no interval" in found._repr_html_()
    assert found.bend[0, 1] == pytest.approx(contact.force * contact.arc)
    found.plot()


def test_several_contacts_are_those_of_the_solver() -> None:
    y = pressed(53.0, 0.012) - pressed(20.0, 0.008)
    found = thigmo.localize(y, X, length=53, span=5.5, contacts=2, method="thesis")
    arcs, forces = thesis.alternating(thesis.Problem(y, X, np.full(10, 5.5), 53.0, 2))
    assert [contact.arc for contact in found.contacts] == arcs.tolist()
    assert [contact.force for contact in found.contacts] == forces.tolist()


def test_a_folded_base_is_coupled_where_the_critical_curvature_is_given() -> None:
    y = pressed(30.0, 0.01108) + 0.02 * (X < 6)  # the fold lies under the base sensors
    plain = thigmo.localize(y, X, length=53, method="thesis").contacts[0]
    coupled = thigmo.localize(
        y, X, length=53, method="thesis", critical_curvature=0.01108
    ).contacts[0]
    assert abs(coupled.arc - 30.0) < 0.5 * abs(plain.arc - 30.0)
    assert coupled.force * coupled.arc == pytest.approx(0.01108)


def test_missing_readings_are_left_out() -> None:
    y = pressed(39.75)
    y[3] = math.nan
    rest = np.isfinite(y)
    found = thigmo.localize(y, X, length=53, span=5.5, method="thesis")
    without = thigmo.localize(y[rest], X[rest], length=53, span=5.5, method="thesis")
    assert found.contacts[0].arc == without.contacts[0].arc


def test_what_it_cannot_do_is_said() -> None:
    with pytest.raises(DataError, match="0 contacts"):
        thigmo.localize(pressed(30.0), X, length=53, contacts=0, method="thesis")
    with pytest.raises(DataError, match="thesis takes no rows"):
        thigmo.localize_batch(pressed(30.0)[None], X, length=53, method="thesis")  # type: ignore[arg-type]
    with pytest.raises(DataError, match="a reading is infinite"):
        thigmo.localize(np.full(10, np.inf), X, length=53, method="thesis")

    with pytest.raises(DataError, match="l2 has been removed") as gone:
        thigmo.localize(pressed(30.0), X, length=53, method="l2")
    assert "posterior" in gone.value.next_step


def frame(rng: np.random.Generator, count: int) -> thesis.Problem:
    """Noisy readings of one or two contacts, and one reading that is off."""
    x = np.sort(rng.uniform(3.0, 50.0, 9))
    empty = thesis.Problem(x, x, np.full(9, 3.0), 53.0, count)
    arcs = rng.uniform(10.0, 53.0, count)
    y = thesis.influence(empty, arcs) @ (0.01 / arcs * rng.choice([-1.0, 1.0], count))
    y += 6e-4 * rng.standard_normal(9)
    y[4] += 5e-3
    return replace(empty, curvature=y)


def least(problem: thesis.Problem, arcs: np.ndarray, norm: int) -> float:
    """The best that forces can do at given places, by SciPy."""
    phi, y = thesis.influence(problem, arcs), problem.curvature
    if norm == 2:
        return float(np.square(y - phi @ np.linalg.lstsq(phi, y, rcond=None)[0]).sum())
    rest = np.eye(y.size)
    found = linprog(
        np.r_[np.zeros(arcs.size), np.ones(2 * y.size)],
        A_eq=np.hstack([phi, rest, -rest]), b_eq=1e4 * y,
        bounds=[(None, None)] * arcs.size + [(0, None)] * 2 * y.size,
    )  # fmt: skip
    return 1e-4 * float(found.fun)  # its tolerance is absolute


@pytest.mark.parametrize("norm", [1, 2])
@pytest.mark.parametrize("count", [1, 2])
def test_no_place_fits_better_than_the_exact_one(count: int, norm: Literal[1, 2]) -> None:
    rng = np.random.default_rng([count, norm])
    for _ in range(4):
        problem = frame(rng, count)
        arcs, forces = thesis.exact(problem, norm)
        rest = problem.curvature - thesis.influence(problem, arcs) @ forces
        misfit = (np.abs(rest) ** norm).sum()
        assert misfit == pytest.approx(least(problem, arcs, norm), rel=1e-6)
        for tried in np.sort(rng.uniform(2.0, 53.0, (200, count))):
            if np.ptp(tried) > 4.0 or count == 1:  # nearer, forces without end would fit
                assert misfit <= 1.01 * least(problem, tried, norm)
    with pytest.raises(DataError, match="no exact fit of 3"):
        thesis.exact(replace(problem, contacts=3))


def test_a_point_fit_claims_nothing_and_takes_the_middle_of_what_fits_alike() -> None:
    found = thigmo.localize(pressed(30.0), X, length=53, span=5.5, method="l1")
    assert found.status == "point estimate"
    assert found.contacts[0].interval == (0.0, 53.0)
    assert found.objective is not None
    with pytest.raises(DataError, match="l1 fits no 3 contacts"):
        thigmo.localize(pressed(30.0), X, length=53, contacts=3, method="l1")
    # Of one reading that is not zero, every arc from there on fits.
    lone = np.where(X == 5.0, 0.002, np.nan)
    arc = thigmo.localize(lone, X, length=53, method="l1").contacts[0].arc
    assert arc == pytest.approx((5.0 + 53.0) / 2.0, abs=0.1)
