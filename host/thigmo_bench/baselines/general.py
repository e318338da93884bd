"""Methods that a user would try first: general optimisers, a grid, kinks in a line, and trees.

Variables of the optimisers are scaled as a competent user would (a / L, f L^2 over the readings'
size); they start where the problem says (by default where the thesis does, at the tip), with the
best force there. `pwlf` and `ruptures` know neither the zero curvature beyond the last contact nor
the sensors' spans. The thesis suggests trees.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import combinations
from typing import Any

import numpy as np
from scipy.optimize import Bounds, differential_evolution, dual_annealing, minimize

from thigmo.errors import DataError
from thigmo.extras import require
from thigmo.localization import thesis
from thigmo.localization.thesis import (
    Array,
    alternate,
    at_centres,
    best_forces,
    in_order,
    influence,
    objective,
    single_forces,
    starting_arcs,
)

_GRID_CM = 0.1
_PAIR_GRID_CM = 1.0
_SEGMENT = 3  # the least that ruptures' continuous linear cost takes
_EXAMPLES = 6000


@dataclass(frozen=True, slots=True)
class BaselineProblem(thesis.ThesisProblem):
    """Readings of one frame above the free curvature, in cm and 1/cm, on the thesis's model.

    A baseline answers the arcs and forces of its contacts, base first. The model is averaged over
    each sensor's span; the thesis's own solvers take it at the sensors' centres.
    """

    noise: float = 6e-4  # standard deviation of a reading, 1/cm, for the trained baselines


# Kraft 1988 (SLSQP); Byrd, Hribar and Nocedal 1999 (trust-constr); Nelder and Mead 1965; Storn and
# Price 1997, with SciPy's defaults; Xiang et al. 1997, of 200 iterations. Seeds are fixed.
OPTIMISERS: dict[str, Callable[..., Any]] = {
    "slsqp": partial(minimize, method="SLSQP"),
    "trust-constr": partial(minimize, method="trust-constr"),
    "nelder-mead": partial(minimize, method="Nelder-Mead"),
    "differential-evolution": lambda cost, x0, bounds: differential_evolution(cost, bounds, rng=0),
    "dual-annealing": partial(dual_annealing, maxiter=200, rng=0),
}


def optimised(name: str, problem: BaselineProblem) -> tuple[Array, Array]:
    """Minimise the thesis's objective over arcs and forces together by one of OPTIMISERS."""
    # The force of a contact at the tip that explains the largest reading.
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


def alternating_trust_constr(problem: BaselineProblem) -> tuple[Array, Array]:
    """The thesis's solver as one would write it today: SciPy's interior point does each step in a.

    This is the speed that users of the thesis's method would see. It works in cm, which takes half
    as long as in mm with the same error. Source: scipy.optimize, trust-constr (Byrd, Hribar and
    Nocedal, SIAM J. Optim. 9, 1999).
    """
    cut = at_centres(problem)
    bounds = Bounds(np.zeros(cut.contacts), np.full(cut.contacts, cut.length))

    def cost(arcs: Array, forces: Array) -> float:
        return objective(cut, arcs, forces)

    def step_arcs(arcs: Array, forces: Array) -> Array:
        with warnings.catch_warnings():
            # The objective has kinks; SciPy warns of the flat quasi-Newton updates they cause.
            warnings.simplefilter("ignore", UserWarning)
            minimum = minimize(cost, arcs, args=(forces,), method="trust-constr", bounds=bounds)
        return np.asarray(np.clip(minimum.x, 0.0, cut.length))

    return alternate(starting_arcs(cut), lambda arcs: best_forces(cut, arcs), step_arcs)


def grid(problem: BaselineProblem) -> tuple[Array, Array]:
    """A 0.1 cm grid of arcs with exact forces.

    For several contacts, all combinations on a 1 cm grid, screened with least-squares forces,
    because exact ones would take minutes.
    """
    step = _GRID_CM if problem.contacts == 1 else _PAIR_GRID_CM
    nodes = np.linspace(0.0, problem.length, int(problem.length / step) + 1)[1:]
    levers = influence(problem, nodes)
    combinations_of_nodes = np.array(list(combinations(range(nodes.size), problem.contacts)))
    phi = levers.T[combinations_of_nodes]  # (K, contacts, N)
    if problem.contacts == 1:
        forces = single_forces(problem, nodes)[:, None]
    else:
        gram = phi @ phi.transpose(0, 2, 1) + 1e-9 * np.eye(problem.contacts)
        forces = np.linalg.solve(gram, (phi @ problem.curvature)[..., None])[..., 0]
    residual = problem.curvature - (forces[:, None, :] @ phi)[:, 0, :]
    arcs = nodes[combinations_of_nodes[np.abs(residual).sum(axis=1).argmin()]]
    return arcs, best_forces(problem, arcs)


def pwlf(problem: BaselineProblem) -> tuple[Array, Array]:
    """pwlf's continuous piecewise-linear fit; its inner breaks are the contacts.

    Readings at one place are averaged first, for a line has one value there. Source: Jekel and
    Venter, pwlf: A Python Library for Fitting 1D Continuous Piecewise Linear Functions, 2019.

    Raises:
        NotInstalledError: the package is missing.
        DataError: there are too few places for its free parameters.
    """
    require("bench", "this baseline")
    from pwlf import PiecewiseLinFit

    places = np.unique(problem.position)
    fewest_places = 2 * problem.contacts + 2
    if places.size < fewest_places:
        raise DataError(
            f"pwlf needs readings at {fewest_places} places, not {places.size}", "use the localizer"
        )
    means = np.array([problem.curvature[problem.position == x].mean() for x in places])
    fit = PiecewiseLinFit(places, means, seed=0)
    breaks = np.asarray(fit.fit(problem.contacts + 1), dtype=np.float64)
    arcs = np.clip(np.sort(breaks[1:-1]), 0.0, problem.length)
    return arcs, best_forces(problem, arcs)


def ruptures(problem: BaselineProblem) -> tuple[Array, Array]:
    """ruptures' exact dynamic programme with the continuous linear cost.

    It sees a series of samples, not their places, and needs three in a segment: readings at one
    place follow each other in it, because averaged there would be too few. A change at a sample is
    a contact at its place. Source: Truong, Oudre and Vayatis, Selective review of offline change
    point detection methods, Signal Processing 167, 2020.

    Raises:
        NotInstalledError: the package is missing.
        DataError: there are too few places for its segments.
    """
    require("bench", "this baseline")
    from ruptures import Dynp

    order = np.argsort(problem.position, kind="stable")
    fewest_readings = _SEGMENT * (problem.contacts + 1)
    if order.size < fewest_readings:
        raise DataError(
            f"ruptures needs {fewest_readings} readings, not {order.size}", "use the localizer"
        )
    fit = Dynp(model="clinear", min_size=_SEGMENT, jump=1)
    fit.fit(problem.curvature[order][:, None])
    ends = np.asarray(fit.predict(n_bkps=problem.contacts)[:-1], dtype=int)
    arcs = problem.position[order][ends]
    return arcs, best_forces(problem, arcs)


def trees(problem: BaselineProblem, mechanics: bool = False) -> tuple[Array, Array]:
    """Extremely randomised trees on the readings, alone or with the fit of `grid` beside them.

    Source: Geurts, Ernst and Wehenkel, Extremely randomized trees, Machine Learning 63, 2006.
    """
    forest = _ensemble(
        tuple(problem.position.tolist()), tuple(problem.span.tolist()), problem.length,
        problem.contacts, problem.noise, mechanics,
    )  # fmt: skip
    arcs = np.sort(np.atleast_1d(forest.predict(_features(problem, mechanics)[None, :])[0]))
    return arcs, best_forces(problem, arcs)


@lru_cache(maxsize=16)
def _ensemble(
    position: tuple[float, ...],
    span: tuple[float, ...],
    length: float,
    contacts: int,
    noise: float,
    mechanics: bool,
) -> Any:
    """Trees trained on the beam model with random contacts, and kept for the process."""
    require("bench", "this baseline")
    from sklearn.ensemble import ExtraTreesRegressor

    layout = BaselineProblem(
        np.zeros(len(position)), np.array(position), np.array(span), length, contacts,
        noise=noise,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    examples = [_example(layout, rng) for _ in range(_EXAMPLES)]
    inputs = np.array([_features(problem, mechanics) for problem, _ in examples])
    arcs = np.array([target for _, target in examples])
    forest = ExtraTreesRegressor(n_estimators=100, min_samples_leaf=3, random_state=0)
    return forest.fit(inputs, arcs if contacts > 1 else arcs[:, 0])


def _example(layout: BaselineProblem, rng: np.random.Generator) -> tuple[BaselineProblem, Array]:
    arcs = np.sort(rng.uniform(0.2, 1.0, layout.contacts)) * layout.length
    moments = rng.uniform(0.1, 1.2, layout.contacts) * layout.critical_curvature
    forces = moments * rng.choice([-1.0, 1.0], layout.contacts) / arcs
    clean = influence(layout, arcs) @ forces
    return replace(layout, curvature=clean + layout.noise * rng.standard_normal(clean.size)), arcs


def _features(problem: BaselineProblem, mechanics: bool) -> Array:
    """The readings; with mechanics also the fit of `grid` and its residuals."""
    plain = problem.curvature * problem.length
    if not mechanics:
        return plain
    arcs, forces = grid(problem)
    residual = problem.curvature - influence(problem, arcs) @ forces
    return np.concatenate([plain, arcs, forces * problem.length**2, residual * problem.length])
