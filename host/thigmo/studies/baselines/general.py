"""What a user would reach for first: general optimisers on the thesis's objective, and a grid.

Variables are scaled as a competent user would (a / L, f L^2 over the readings' size); the joint
optimisers start where the problem says (by default where the thesis does, at the tip), with the
best force there.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from scipy.optimize import Bounds, differential_evolution, dual_annealing, minimize

from thigmo.studies.baselines.problem import (
    Array,
    Problem,
    best_forces,
    in_order,
    influence,
    objective,
    single_forces,
    starting_arcs,
)

_GRID_CM = 0.1
_PAIR_GRID_CM = 1.0

Optimiser = Callable[..., Any]
"""Of a cost, bounds of its variables and `x0`; the result has the best in `x`."""

# Kraft 1988 (SLSQP); Byrd, Hribar and Nocedal 1999 (trust-constr); Nelder and Mead 1965; Storn and
# Price 1997, with SciPy's defaults; Xiang et al. 1997, of 200 iterations. Seeds are fixed.
OPTIMISERS: dict[str, Optimiser] = {
    "slsqp": partial(minimize, method="SLSQP"),
    "trust-constr": partial(minimize, method="trust-constr"),
    "nelder-mead": partial(minimize, method="Nelder-Mead"),
    "differential-evolution": lambda cost, x0, bounds: differential_evolution(cost, bounds, rng=0),
    "dual-annealing": partial(dual_annealing, maxiter=200, rng=0),
}


def optimised(name: str, problem: Problem) -> tuple[Array, Array]:
    """The thesis's objective, arcs and forces together, in the hands of one of OPTIMISERS."""
    # A force that explains the largest reading with a contact at the tip.
    unit = max(float(np.max(np.abs(problem.curvature))), 1e-12) / problem.length
    count = problem.contacts

    def cost(x: Array) -> float:
        return objective(problem, x[:count] * problem.length, x[count:] * unit) / unit

    bounds = Bounds(np.repeat([0.0, -20.0], count), np.repeat([1.0, 20.0], count))
    arcs = starting_arcs(problem)
    start = np.concatenate([arcs / problem.length, best_forces(problem, arcs) / unit])
    start = np.clip(start, bounds.lb, bounds.ub)
    with warnings.catch_warnings():
        # The objective has kinks; SciPy warns of the flat quasi-Newton updates that they cause.
        warnings.simplefilter("ignore", UserWarning)
        x = OPTIMISERS[name](cost, x0=start, bounds=bounds).x
    return in_order(np.clip(x[:count], 0.0, 1.0) * problem.length, x[count:] * unit)


def grid(problem: Problem) -> tuple[Array, Array]:
    """A 0.1 cm grid with exact inner force.

    Several contacts: 1 cm, all combinations, screened with least-squares forces, for exact ones
    would take minutes.
    """
    step = _GRID_CM if problem.contacts == 1 else _PAIR_GRID_CM
    nodes = np.linspace(0.0, problem.length, int(problem.length / step) + 1)[1:]
    levers = influence(problem, nodes)
    chosen = np.array(list(combinations(range(nodes.size), problem.contacts)))
    phi = levers.T[chosen]  # (K, contacts, N)
    if problem.contacts == 1:
        forces = single_forces(problem, nodes)[:, None]
    else:
        gram = phi @ phi.transpose(0, 2, 1) + 1e-9 * np.eye(problem.contacts)
        forces = np.linalg.solve(gram, (phi @ problem.curvature)[..., None])[..., 0]
    left = problem.curvature - (forces[:, None, :] @ phi)[:, 0, :]
    arcs = nodes[chosen[np.abs(left).sum(axis=1).argmin()]]
    return arcs, best_forces(problem, arcs)
