"""What a user would reach for first: general optimisers on the thesis's objective, and a grid.

Variables are scaled as a competent user would (a / L, f L^2 over the readings' size); the joint
optimisers start where the problem says (by default where the thesis does, at the tip), with the
best force there.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from thigmo.compiled import compiled
from thigmo.studies.baselines.problem import (
    Array,
    Problem,
    best_force,
    best_forces,
    influence,
    objective,
    residual,
    starting_arcs,
)

if TYPE_CHECKING:
    from scipy.optimize import Bounds

_GRID_CM = 0.1
_PAIR_GRID_CM = 1.0


def _scale(problem: Problem) -> float:
    """A force that explains the largest reading with a contact at the tip."""
    return max(float(np.max(np.abs(problem.curvature))), 1e-12) / problem.length


def _joint(problem: Problem) -> tuple[Callable[[Array], float], Array, float]:
    unit = _scale(problem)

    def cost(x: Array) -> float:
        half = x.size // 2
        return objective(problem, x[:half] * problem.length, x[half:] * unit) / unit

    arcs = starting_arcs(problem)
    bounds = _bounds(problem)
    start = np.concatenate([arcs / problem.length, best_forces(problem, arcs) / unit])
    return cost, np.clip(start, bounds.lb, bounds.ub), unit


def _answer(problem: Problem, x: Array, unit: float) -> tuple[Array, Array]:
    half = x.size // 2
    arcs = np.clip(x[:half], 0.0, 1.0) * problem.length
    order = np.argsort(arcs)
    return arcs[order], (x[half:] * unit)[order]


def _bounds(problem: Problem) -> Bounds:
    from scipy.optimize import Bounds

    low = np.repeat([0.0, -20.0], problem.contacts)
    return Bounds(low, np.repeat([1.0, 20.0], problem.contacts))


def slsqp(problem: Problem) -> tuple[Array, Array]:
    """Sequential least squares programming over arcs and forces together (SciPy; Kraft 1988)."""
    from scipy.optimize import minimize

    cost, start, unit = _joint(problem)
    found = minimize(cost, start, method="SLSQP", bounds=_bounds(problem))
    return _answer(problem, found.x, unit)


def trust_constr(problem: Problem) -> tuple[Array, Array]:
    """SciPy's trust-region interior point over both together (Byrd, Hribar and Nocedal 1999)."""
    import warnings

    from scipy.optimize import minimize

    cost, start, unit = _joint(problem)
    with warnings.catch_warnings():
        # The objective has kinks; SciPy warns of the flat quasi-Newton updates that they cause.
        warnings.simplefilter("ignore", UserWarning)
        found = minimize(cost, start, method="trust-constr", bounds=_bounds(problem))
    return _answer(problem, found.x, unit)


def nelder_mead(problem: Problem) -> tuple[Array, Array]:
    """Nelder and Mead's simplex (1965; SciPy) over arcs and forces together."""
    from scipy.optimize import minimize

    cost, start, unit = _joint(problem)
    found = minimize(cost, start, method="Nelder-Mead", bounds=_bounds(problem))
    return _answer(problem, found.x, unit)


def differential_evolution(problem: Problem) -> tuple[Array, Array]:
    """SciPy's differential evolution (Storn and Price 1997), its defaults, a fixed seed."""
    from scipy.optimize import differential_evolution as evolve

    cost, _, unit = _joint(problem)
    found = evolve(cost, _bounds(problem), rng=0)
    return _answer(problem, found.x, unit)


def dual_annealing(problem: Problem) -> tuple[Array, Array]:
    """SciPy's dual annealing (Xiang et al. 1997), 200 iterations, a fixed seed."""
    from scipy.optimize import dual_annealing as anneal

    cost, start, unit = _joint(problem)
    found = anneal(cost, _bounds(problem), maxiter=200, rng=0, x0=start)
    return _answer(problem, found.x, unit)


@compiled
def _scan(curvature: Array, position: Array, span: Array, length: float, step: float) -> float:
    cells = max(int(length / step), 1)
    best, least = length, np.inf
    arcs, forces = np.empty(1), np.empty(1)
    for k in range(1, cells + 1):
        arcs[0] = length * k / cells
        forces[0] = best_force(curvature, position, span, arcs[0])
        value = residual(curvature, position, span, arcs, forces)
        if value < least:
            best, least = arcs[0], value
    return best


def grid(problem: Problem) -> tuple[Array, Array]:
    """A 0.1 cm grid with exact inner force (several contacts: 1 cm, all combinations)."""
    if problem.contacts == 1:
        arc = _scan(problem.curvature, problem.position, problem.span, problem.length, _GRID_CM)
        arcs = np.array([arc])
        return arcs, best_forces(problem, arcs)
    nodes = np.linspace(0.0, problem.length, int(problem.length / _PAIR_GRID_CM) + 1)[1:]
    best: Array = starting_arcs(problem)
    least = np.inf
    for chosen in combinations(nodes, problem.contacts):
        arcs = np.array(chosen)
        value = objective(problem, arcs, _quick_forces(problem, arcs))
        if value < least:
            best, least = arcs, value
    return best, best_forces(problem, best)


def _quick_forces(problem: Problem, arcs: Array) -> Array:
    """Least-squares forces: the screen of the coarse grid, where exact ones would take minutes."""
    forces = np.linalg.lstsq(influence(problem, arcs), problem.curvature, rcond=None)[0]
    return np.asarray(forces, dtype=np.float64)
