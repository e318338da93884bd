"""The exact point fits are minima: no other place fits better."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from scipy.optimize import linprog

from thigmo.errors import DataError
from thigmo.localization import thesis
from thigmo_bench.baselines.exact import exact


def frame(rng: np.random.Generator, count: int) -> thesis.ThesisProblem:
    """Noisy readings of one or two contacts, and one reading that is off."""
    x = np.sort(rng.uniform(3.0, 50.0, 9))
    empty = thesis.ThesisProblem(x, x, np.full(9, 3.0), 53.0, count)
    arcs = rng.uniform(10.0, 53.0, count)
    y = thesis.influence(empty, arcs) @ (0.01 / arcs * rng.choice([-1.0, 1.0], count))
    y += 6e-4 * rng.standard_normal(9)
    y[4] += 5e-3
    return replace(empty, curvature=y)


def least(problem: thesis.ThesisProblem, arcs: np.ndarray, norm: int) -> float:
    """The best that forces can do at given places, by SciPy."""
    phi, y = thesis.influence(problem, arcs), problem.curvature
    if norm == 2:
        return float(np.square(y - phi @ np.linalg.lstsq(phi, y, rcond=None)[0]).sum())
    rest = np.eye(y.size)
    optimum = linprog(
        np.r_[np.zeros(arcs.size), np.ones(2 * y.size)],
        A_eq=np.hstack([phi, rest, -rest]), b_eq=1e4 * y,
        bounds=[(None, None)] * arcs.size + [(0, None)] * 2 * y.size,
    )  # fmt: skip
    return 1e-4 * float(optimum.fun)  # its tolerance is absolute


@pytest.mark.parametrize("norm", [1, 2])
@pytest.mark.parametrize("count", [1, 2])
def test_no_place_fits_better_than_the_exact_one(count: int, norm: Literal[1, 2]) -> None:
    rng = np.random.default_rng([count, norm])
    for _ in range(4):
        problem = frame(rng, count)
        arcs, forces = exact(problem, norm)
        rest = problem.curvature - thesis.influence(problem, arcs) @ forces
        misfit = (np.abs(rest) ** norm).sum()
        assert misfit == pytest.approx(least(problem, arcs, norm), rel=1e-6)
        for tried in np.sort(rng.uniform(2.0, 53.0, (200, count))):
            if np.ptp(tried) > 4.0 or count == 1:  # nearer, forces without end would fit
                assert misfit <= 1.01 * least(problem, tried, norm)
    with pytest.raises(DataError, match="no exact fit of 3"):
        exact(replace(problem, contacts=3))


def test_of_places_that_fit_alike_the_middle_is_taken() -> None:
    # Of one reading that is not zero, every arc from there on fits.
    lone = thesis.ThesisProblem(np.array([0.002]), np.array([5.0]), np.zeros(1), 53.0)
    assert exact(lone)[0] == pytest.approx((5.0 + 53.0) / 2.0, abs=0.1)
