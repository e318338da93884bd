"""The problem that every baseline solves, and the pieces that they share.

A baseline gets curvature above the free curvature, in cm and 1/cm (their steps and tolerances are
lengths), and a number of contacts; it answers arcs and forces, base first. The model is the
thesis's (equation 2.9), averaged over each sensor's span; the thesis's own solvers take it at the
sensors' centres (`alternating.at_centres`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Problem:
    """Readings of one frame."""

    curvature: Array  # (N,) readings above free curvature, finite, 1/cm
    position: Array  # (N,) sensor centres, cm
    span: Array  # (N,) active lengths, cm
    length: float  # everted length, cm
    contacts: int = 1  # how many to find, 1 to 3
    # standard deviation of a reading, 1/cm; what the trained baselines are trained at
    noise: float = 6e-4
    critical_curvature: float = 0.01108  # contact curvature at which the base folds, 1/cm
    # (contacts,) arcs from which the methods that need it start, cm; the thesis's (even fractions
    # of the length, the last one at the tip) if not given
    start: Array | None = None


def influence(problem: Problem, arcs: Array) -> Array:
    """(N, K) readings for unit forces at K arcs: lever arms, averaged over each sensor's span."""
    reach = arcs - (problem.position - problem.span / 2)[:, None]
    span = problem.span[:, None]
    inside = 0.5 * reach**2 / np.maximum(span, 1e-12)
    beyond = arcs - problem.position[:, None]
    return np.asarray(np.where(reach <= 0, 0.0, np.where(reach >= span, beyond, inside)))


def objective(problem: Problem, arcs: Array, forces: Array) -> float:
    """The 1-norm of readings minus model (thesis, equation 2.10)."""
    return float(np.abs(problem.curvature - influence(problem, arcs) @ forces).sum())


def single_forces(problem: Problem, arcs: Array) -> Array:
    """For each of K arcs the force that a single contact there has: a weighted median, (K,)."""
    weight = influence(problem, arcs)
    ratio = problem.curvature[:, None] / np.where(weight > 0.0, weight, np.inf)
    order = np.argsort(ratio, axis=0)
    summed = np.take_along_axis(weight, order, 0).cumsum(axis=0)
    middle = (summed < 0.5 * summed[-1]).sum(axis=0)
    rank = np.take_along_axis(order, middle[None, :], 0)
    return np.asarray(np.take_along_axis(ratio, rank, 0)[0])


def best_forces(problem: Problem, arcs: Array) -> Array:
    """Forces that minimise the 1-norm for contacts at given arcs.

    One contact: the weighted median. Several: a least-absolute-deviation optimum passes through
    as many readings as there are forces, so all such subsets are tried.
    """
    if arcs.size == 1:
        return single_forces(problem, arcs)
    phi = influence(problem, arcs)
    subsets = np.array(list(combinations(range(problem.curvature.size), arcs.size)))
    regular = np.abs(np.linalg.det(phi[subsets])) >= 1e-9
    through = np.linalg.solve(phi[subsets[regular]], problem.curvature[subsets[regular]][..., None])
    tried = np.vstack([np.zeros((1, arcs.size)), through[..., 0]])
    misfit = np.abs(problem.curvature - tried @ phi.T).sum(axis=1)
    return np.asarray(tried[misfit.argmin()])


def starting_arcs(problem: Problem) -> Array:
    """A copy of the problem's start, or the thesis's."""
    if problem.start is not None:
        return np.array(problem.start, dtype=np.float64)
    return problem.length * np.arange(1, problem.contacts + 1) / problem.contacts


def in_order(arcs: Array, forces: Array) -> tuple[Array, Array]:
    """Contacts from the base on."""
    order = np.argsort(arcs)
    return arcs[order], forces[order]
