"""The problem that every baseline solves, and the pieces that they share.

A baseline gets curvature above the free curvature, in cm and 1/cm (their steps and tolerances are
lengths, so the caller converts), and a number of contacts; it answers arcs and forces. The model
is the thesis's (equation 2.9), averaged over each sensor's span; the thesis's own solvers take it
at the sensors' centres (`alternating.at_centres`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Problem:
    """Readings of one frame.

    Attributes:
        curvature: (N,) readings above free curvature, finite, 1/cm.
        position: (N,) sensor centres, cm.
        span: (N,) active lengths, cm.
        length: everted length, cm.
        contacts: how many to find, 1 to 3.
        noise: standard deviation of a reading, 1/cm; what the trained baselines are trained at.
        critical_curvature: contact curvature at which the base folds, 1/cm.
        start: (contacts,) arcs from which the methods that need it start, cm; the thesis's (even
            fractions of the length, the last one at the tip) if not given.
    """

    curvature: Array
    position: Array
    span: Array
    length: float
    contacts: int = 1
    noise: float = 6e-4
    critical_curvature: float = 0.01108
    start: Array | None = None


@compiled
def lever(arc: float, position: float, span: float) -> float:
    """Reading of a unit force at `arc`: its lever arm, averaged over the sensor's span."""
    near = position - 0.5 * span
    if arc <= near:
        return 0.0
    if arc >= position + 0.5 * span:
        return arc - position
    return 0.5 * (arc - near) * (arc - near) / span


@compiled
def residual(curvature: Array, position: Array, span: Array, arcs: Array, forces: Array) -> float:
    """1-norm of readings minus model (thesis, equation 2.10)."""
    total = 0.0
    for i in range(curvature.size):
        value = curvature[i]
        for j in range(arcs.size):
            value -= forces[j] * lever(arcs[j], position[i], span[i])
        total += abs(value)
    return total


@compiled
def best_force(curvature: Array, position: Array, span: Array, arc: float) -> float:
    """The force that minimises the 1-norm for one contact at `arc`: a weighted median."""
    n = curvature.size
    ratio = np.empty(n)
    weight = np.empty(n)
    count = 0
    for i in range(n):
        phi = lever(arc, position[i], span[i])
        if phi > 0.0:
            ratio[count] = curvature[i] / phi
            weight[count] = phi
            count += 1
    if count == 0:
        return 0.0
    order = np.argsort(ratio[:count])
    half = 0.5 * weight[:count].sum()
    total = 0.0
    for k in order:
        total += weight[k]
        if total >= half:
            return float(ratio[k])
    return float(ratio[order[count - 1]])


def best_forces(problem: Problem, arcs: Array) -> Array:
    """Forces that minimise the 1-norm for contacts at given arcs.

    One contact: the weighted median. Several: a least-absolute-deviation optimum passes through
    as many readings as there are forces, so all such subsets are tried.
    """
    if arcs.size == 1:
        force = best_force(problem.curvature, problem.position, problem.span, float(arcs[0]))
        return np.array([force])
    phi = influence(problem, arcs)
    best, least = np.zeros(arcs.size), float(np.abs(problem.curvature).sum())
    for rows in combinations(range(problem.curvature.size), arcs.size):
        chosen = phi[list(rows)]
        if abs(np.linalg.det(chosen)) < 1e-9:
            continue
        forces = np.linalg.solve(chosen, problem.curvature[list(rows)])
        value = float(np.abs(problem.curvature - phi @ forces).sum())
        if value < least:
            best[:], least = forces, value
    return best


def influence(problem: Problem, arcs: Array) -> Array:
    """(N, C) readings for unit forces at the arcs."""
    near = problem.position - problem.span / 2
    reach = arcs[None, :] - near[:, None]
    inside = 0.5 * reach**2 / np.maximum(problem.span, 1e-12)[:, None]
    beyond = arcs[None, :] - problem.position[:, None]
    result: Array = np.where(
        reach <= 0, 0.0, np.where(reach >= problem.span[:, None], beyond, inside)
    )
    return result


def objective(problem: Problem, arcs: Array, forces: Array) -> float:
    """The 1-norm of readings minus model."""
    return float(residual(problem.curvature, problem.position, problem.span, arcs, forces))


def starting_arcs(problem: Problem) -> Array:
    """A copy of the problem's start, or the thesis's."""
    if problem.start is not None:
        return np.array(problem.start, dtype=np.float64)
    return problem.length * np.arange(1, problem.contacts + 1) / problem.contacts
