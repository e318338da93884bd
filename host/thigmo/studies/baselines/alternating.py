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


def at_centres(problem: Problem) -> Problem:
    """The same readings as the thesis takes them: of the curvature at each sensor's centre."""
    return replace(problem, span=np.zeros_like(problem.span))


def alternating(
    problem: Problem, norm: Literal[1, 2] = 1, barriers: tuple[float, ...] = _BARRIERS
) -> tuple[Array, Array]:
    """The thesis's solver: a log-barrier interior point over a, alternated with exact f.

    Its norm is the 1-norm. Barriers are followed one after the other; without any it is exact
    coordinate descent.
    """
    problem = at_centres(problem)
    nodes = problem.length * np.arange(1, _NODES) / _NODES
    barrier = np.log(nodes) + np.log(problem.length - nodes)
    levers = influence(problem, nodes)
    at = np.abs(nodes - starting_arcs(problem)[:, None]).argmin(axis=1)
    forces = np.zeros(at.size)
    for _ in range(_MOST_ROUNDS):
        if norm == 1:
            forces = best_forces(problem, nodes[at])
        else:
            forces = np.asarray(np.linalg.pinv(levers[:, at]) @ problem.curvature)
        before = nodes[at]
        if barriers:
            path = np.outer(barriers, barrier)
            _follow(problem.curvature, levers, forces, at, path, norm)
        else:
            for j in range(at.size):
                at[j] = _misfits(problem.curvature, levers, forces, at, j, norm).argmin()
        if np.max(np.abs(nodes[at] - before)) <= _TOLERANCE_CM:
            break
    return in_order(nodes[at], forces)


def _misfits(
    curvature: Array, levers: Array, forces: Array, at: Array, j: int, norm: Literal[1, 2]
) -> Array:
    """The objective for contact j at every node, the others where they are."""
    others = levers[:, at] @ forces - forces[j] * levers[:, at[j]]
    left = (curvature - others)[:, None] - forces[j] * levers
    return np.asarray(np.linalg.norm(left, norm, axis=0))


def _follow(
    curvature: Array, levers: Array, forces: Array, at: Array, barriers: Array, norm: Literal[1, 2]
) -> None:
    """Follow the barrier path downhill from the nodes `at` (changed in place), forces fixed."""
    alone = _misfits(curvature, levers, forces, at, 0, norm) if len(forces) == 1 else None
    for barrier in barriers:
        for _ in range(_SWEEPS):
            before = at.copy()
            for j in range(len(forces)):
                misfits = (
                    _misfits(curvature, levers, forces, at, j, norm) if alone is None else alone
                )
                at[j] = _downhill((misfits - barrier).tolist(), int(at[j]))
            if alone is not None or (at == before).all():
                break


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

    The same alternation as `alternating`, in a general solver's hands: the speed that users of the
    thesis's method see. In cm, where it takes half as long as in mm with the same error. Source:
    scipy.optimize, trust-constr (Byrd, Hribar and Nocedal, SIAM J. Optim. 9, 1999).
    """
    problem = at_centres(problem)
    arcs = starting_arcs(problem)
    forces = np.zeros(arcs.size)
    bounds = Bounds(np.zeros(arcs.size), np.full(arcs.size, problem.length))

    def cost(arcs: Array, forces: Array) -> float:
        return objective(problem, arcs, forces)

    for _ in range(_MOST_ROUNDS):
        forces = best_forces(problem, arcs)
        before = arcs.copy()
        with warnings.catch_warnings():
            # The objective has kinks; SciPy warns of the flat quasi-Newton updates they cause.
            warnings.simplefilter("ignore", UserWarning)
            found = minimize(cost, arcs, args=(forces,), method="trust-constr", bounds=bounds)
        arcs = np.clip(found.x, 0.0, problem.length)
        if np.max(np.abs(arcs - before)) <= _TOLERANCE_CM:
            break
    return in_order(arcs, forces)


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
    cut = at_centres(held)
    moment = np.sign(base) * problem.critical_curvature

    def cost(x: Array) -> float:
        arc = float(x[0])
        if not 0.0 < arc <= problem.length:
            return 1e3
        return objective(cut, np.array([arc]), np.array([moment / arc]))

    first = float(starting_arcs(problem)[0])
    simplex = [[0.999 * first], [0.9 * first]]
    found = minimize(cost, simplex[0], method="Nelder-Mead", options={"initial_simplex": simplex})
    arc = float(found.x[0])
    return np.array([arc]), np.array([moment / arc])
