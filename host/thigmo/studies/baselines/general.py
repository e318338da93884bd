"""What a user would reach for first: general optimisers on the thesis's objective, and a grid.

Variables are scaled as a competent user would (a / L, f L^2 over the readings' size); the joint
optimisers start where the problem says (by default where the thesis does, at the tip), with the
best force there.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from itertools import combinations
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from thigmo.studies.baselines.problem import (
    Array,
    Problem,
    best_forces,
    in_order,
    influence,
    single_forces,
    starting_arcs,
)
from thigmo.studies.baselines.problem import objective as misfit

if TYPE_CHECKING:
    from scipy.optimize import Bounds

_GRID_CM = 0.1
_PAIR_GRID_CM = 1.0

Optimiser = Callable[[Callable[[Array], float], Array, "Bounds"], Any]


def _jointly(optimise: Optimiser, problem: Problem) -> tuple[Array, Array]:
    """Arcs and forces together, by an optimiser of (cost, start, bounds)."""
    from scipy.optimize import Bounds

    # A force that explains the largest reading with a contact at the tip.
    unit = max(float(np.max(np.abs(problem.curvature))), 1e-12) / problem.length
    count = problem.contacts

    def cost(x: Array) -> float:
        return misfit(problem, x[:count] * problem.length, x[count:] * unit) / unit

    bounds = Bounds(np.repeat([0.0, -20.0], count), np.repeat([1.0, 20.0], count))
    arcs = starting_arcs(problem)
    start = np.concatenate([arcs / problem.length, best_forces(problem, arcs) / unit])
    with warnings.catch_warnings():
        # The objective has kinks; SciPy warns of the flat quasi-Newton updates that they cause.
        warnings.simplefilter("ignore", UserWarning)
        x = optimise(cost, np.clip(start, bounds.lb, bounds.ub), bounds).x
    return in_order(np.clip(x[:count], 0.0, 1.0) * problem.length, x[count:] * unit)


Method = Literal["SLSQP", "trust-constr", "Nelder-Mead"]


def minimiser(method: Method) -> Optimiser:
    """One of `scipy.optimize.minimize`'s methods."""

    def optimise(cost: Callable[[Array], float], start: Array, bounds: Bounds) -> Any:
        from scipy.optimize import minimize

        return minimize(cost, start, method=method, bounds=bounds)

    return optimise


def evolution(cost: Callable[[Array], float], _: Array, bounds: Bounds) -> Any:
    """SciPy's differential evolution (Storn and Price 1997), its defaults, a fixed seed."""
    from scipy.optimize import differential_evolution

    return differential_evolution(cost, bounds, rng=0)


def annealing(cost: Callable[[Array], float], start: Array, bounds: Bounds) -> Any:
    """SciPy's dual annealing (Xiang et al. 1997), 200 iterations, a fixed seed."""
    from scipy.optimize import dual_annealing

    return dual_annealing(cost, bounds, maxiter=200, rng=0, x0=start)


# Kraft 1988 (SLSQP), Byrd, Hribar and Nocedal 1999 (trust-constr), Nelder and Mead 1965.
OPTIMISERS: dict[str, Optimiser] = {
    "slsqp": minimiser("SLSQP"),
    "trust-constr": minimiser("trust-constr"),
    "nelder-mead": minimiser("Nelder-Mead"),
    "differential-evolution": evolution,
    "dual-annealing": annealing,
}


def optimised(name: str, problem: Problem) -> tuple[Array, Array]:
    """The thesis's objective in the hands of one of OPTIMISERS."""
    return _jointly(OPTIMISERS[name], problem)


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
