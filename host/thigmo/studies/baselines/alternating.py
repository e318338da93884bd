"""The thesis's own solver, as faithful as its text allows, and variants of it.

Source: M. Bryant, Tactile Perception for Growing Robots via Discrete Curvature Measurements, 2022,
section 2.5. Its model (equation 2.9) is taken at the centre of each sensor, whatever the span, its
objective is the 1-norm (2.10), its lengths are millimetres. `alternating` optimises f with a fixed,
then a in [0, L] with f fixed, from f = 0 and a at the tip (several contacts: at even fractions of
L), until no arc moves by more than 0.5 cm. MATLAB's interior point starts with a barrier of 0.1
while this objective is of order 0.01: the first barrier problems pull a towards the middle of
[0, L], and the path then follows the shrinking barrier. That is what lets it leave some local
minima; exact coordinate descent (no barriers: each step the best a of all) stalls in the ravine
along which f and a trade, where neither alone can improve. The step in f is exact here, which is
the most that the interior point could reach. `clamped` and `coupled` are the thesis's two remedies
for a folded base (section 3.2).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.optimize import Bounds, minimize

from thigmo.studies.baselines.problem import (
    Array,
    Problem,
    best_forces,
    in_order,
    influence,
    objective,
    starting_arcs,
)

_TOLERANCE_CM = 0.5
_MOST_ROUNDS = 100
# MATLAB's first barrier of 0.1 on an objective in 1/mm, as one in 1/cm.
_BARRIERS = tuple(0.2**level for level in range(12))
_NODES = 1600  # of the arcs that are tried; 0.03 cm apart on the 53 cm body
_STEPS = (32, 16, 8, 4, 2, 1)  # nodes; the first is 2 % of the length
_SWEEPS = 8


def _at_centres(problem: Problem) -> Problem:
    """The same readings as the thesis takes them: of the curvature at each sensor's centre."""
    return replace(problem, span=np.zeros_like(problem.span))


def _alternate(
    arcs: Array, forces_at: Callable[[Array], Array], moved: Callable[[Array, Array], Array]
) -> tuple[Array, Array]:
    """Forces with the arcs fixed, then arcs with the forces fixed, until these stay."""
    for _ in range(_MOST_ROUNDS):
        forces = forces_at(arcs)
        before, arcs = arcs, moved(arcs, forces)
        if np.max(np.abs(arcs - before)) <= _TOLERANCE_CM:
            break
    return in_order(arcs, forces)


def alternating(
    problem: Problem, norm: Literal[1, 2] = 1, barriers: tuple[float, ...] = _BARRIERS
) -> tuple[Array, Array]:
    """The thesis's solver: a log-barrier interior point over a, alternated with exact f.

    Its norm is the 1-norm. Barriers are followed one after the other; without any it is exact
    coordinate descent.
    """
    problem = _at_centres(problem)
    nodes = problem.length * np.arange(1, _NODES) / _NODES
    levers = influence(problem, nodes)
    walls = np.outer(barriers, np.log(nodes) + np.log(problem.length - nodes))

    def forces_at(arcs: Array) -> Array:
        if norm == 1:
            return best_forces(problem, arcs)
        return np.asarray(np.linalg.pinv(influence(problem, arcs)) @ problem.curvature)

    def moved(arcs: Array, forces: Array) -> Array:
        at = np.searchsorted(nodes, arcs)

        def misfits(j: int) -> Array:
            """The objective for contact j at every node, the others where they are."""
            others = levers[:, at] @ forces - forces[j] * levers[:, at[j]]
            left = (problem.curvature - others)[:, None] - forces[j] * levers
            return np.asarray(np.linalg.norm(left, norm, axis=0))

        alone = misfits(0) if at.size == 1 else None
        for wall in walls:
            for _ in range(_SWEEPS):
                before = at.copy()
                for j in range(at.size):
                    values = (misfits(j) if alone is None else alone) - wall
                    at[j] = _downhill(values.tolist(), int(at[j]))
                if alone is not None or (at == before).all():
                    break
        for j in range(0 if barriers else at.size):
            at[j] = misfits(j).argmin()
        return np.asarray(nodes[at])

    start = np.abs(nodes - starting_arcs(problem)[:, None]).argmin(axis=1)
    return _alternate(nodes[start], forces_at, moved)


def _downhill(values: list[float], at: int) -> int:
    """From a node down to where steps of no size lead lower."""
    for step in _STEPS:
        while True:
            for near in (at - step, at + step):
                if 0 <= near < len(values) and values[near] < values[at]:
                    at = near
                    break
            else:
                break
    return at


def alternating_trust_constr(problem: Problem) -> tuple[Array, Array]:
    """The thesis's solver as one would write it today: SciPy's interior point does each step in a.

    The speed that users of the thesis's method see. In cm, where it takes half as long as in mm
    with the same error. Source: scipy.optimize, trust-constr (Byrd, Hribar and Nocedal, SIAM J.
    Optim. 9, 1999).
    """
    cut = _at_centres(problem)
    bounds = Bounds(np.zeros(cut.contacts), np.full(cut.contacts, cut.length))

    def cost(arcs: Array, forces: Array) -> float:
        return objective(cut, arcs, forces)

    def moved(arcs: Array, forces: Array) -> Array:
        with warnings.catch_warnings():
            # The objective has kinks; SciPy warns of the flat quasi-Newton updates they cause.
            warnings.simplefilter("ignore", UserWarning)
            found = minimize(cost, arcs, args=(forces,), method="trust-constr", bounds=bounds)
        return np.asarray(np.clip(found.x, 0.0, cut.length))

    return _alternate(starting_arcs(cut), lambda arcs: best_forces(cut, arcs), moved)


def _clamp_base(problem: Problem) -> tuple[Problem, float]:
    """Readings of the base sensors kept from passing the critical curvature, and their mean."""
    at_base = problem.position <= problem.position.min() + 1e-9
    limit = problem.critical_curvature
    held = np.where(at_base, np.clip(problem.curvature, -limit, limit), problem.curvature)
    return replace(problem, curvature=held), float(np.mean(problem.curvature[at_base]))


def clamped(problem: Problem) -> tuple[Array, Array]:
    """The thesis's solver on readings whose base is clamped at the critical curvature."""
    return alternating(_clamp_base(problem)[0])


def coupled(problem: Problem) -> tuple[Array, Array]:
    """One folded contact: f = +-critical / a, so a alone is sought, by Nelder-Mead (section 3.2).

    Readings whose base does not pass the critical curvature are not folded and go to `clamped`, as
    do several contacts.
    """
    held, base = _clamp_base(problem)
    if problem.contacts != 1 or abs(base) <= problem.critical_curvature:
        return alternating(held)
    cut = _at_centres(held)
    moment = np.sign(base) * problem.critical_curvature

    def cost(x: Array) -> float:
        inside = 0.0 < x[0] <= problem.length
        return objective(cut, x, moment / x) if inside else 1e3

    first = float(starting_arcs(problem)[0])
    simplex = [[0.999 * first], [0.9 * first]]
    arc = minimize(cost, simplex[0], method="Nelder-Mead", options={"initial_simplex": simplex}).x
    return arc, moment / arc
