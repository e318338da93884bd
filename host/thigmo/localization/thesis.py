"""The thesis's own solver (`method="thesis"`).

Source: M. Bryant, Tactile Perception for Growing Robots via Discrete Curvature Measurements, 2022,
section 2.5. Its model (equation 2.9) is evaluated at the centre of each sensor, whatever the span.
Its objective is the 1-norm (2.10), and its lengths are in millimetres. `alternating` optimises the
forces f with the arcs a fixed, then a in [0, L] with f fixed. It starts from f = 0 and a at the tip
(several contacts: at even fractions of L), and ends when no arc moves by more than 0.5 cm. MATLAB's
interior point method starts with a barrier of 0.1, while this objective is of order 0.01: the first
barrier problems pull a towards the middle of [0, L], and the path then follows the shrinking
barrier. That is how it leaves some local minima. Exact coordinate descent (without barriers, the
best a in each step) stalls in the valley along which f and a compensate each other, where neither
alone can improve. The step in f is exact here, which is the best that the interior point method
could reach. `clamped` and `coupled` are the thesis's two remedies for a folded base (section 3.2).

Lengths are in cm and curvatures in 1/cm, because the solver's tolerance and barriers are lengths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from thigmo.mechanics.closed_forms import phi

Array = npt.NDArray[np.float64]
CRITICAL_PER_CM = 0.01108  # mean of five trials, section 3.2
_TOLERANCE_CM = 0.5
_MOST_ROUNDS = 100
# Barriers for an objective in 1/cm; the first is MATLAB's, 0.1 for an objective in 1/mm.
_BARRIERS = tuple(0.2**level for level in range(12))
_NODES = 1600  # intervals between the arcs tried; 0.03 cm each on the 53 cm body
_STEPS = (32, 16, 8, 4, 2, 1)  # steps of the descent, in nodes; the first is 2 % of the length
_SWEEPS = 8  # over all contacts, at most, for each barrier


@dataclass(frozen=True, slots=True)
class ThesisProblem:
    """Readings of one frame."""

    curvature: Array  # (N,) readings above free curvature, finite, 1/cm
    position: Array  # (N,) sensor centres, cm
    span: Array  # (N,) active lengths, cm
    length: float  # everted length, cm
    contacts: int = 1  # how many to find, 1 to 3
    # curvature at the base by the contacts at which the base folds, 1/cm
    critical_curvature: float = CRITICAL_PER_CM
    # (contacts,) starting arcs for the methods that need them, cm; if not given, the thesis's: even
    # fractions of the length, the last one at the tip
    start: Array | None = None


def influence(problem: ThesisProblem, arcs: Array) -> Array:
    """(N, K) readings for unit forces over EI at arcs (K,): mean lever arms over the spans, cm."""
    return phi(arcs, problem.position[:, None], problem.span[:, None])


def objective(problem: ThesisProblem, arcs: Array, forces: Array) -> float:
    """The 1-norm of readings minus model (thesis, equation 2.10)."""
    return float(np.abs(problem.curvature - influence(problem, arcs) @ forces).sum())


def weighted_median(ratio: Array, weight: Array) -> npt.NDArray[np.int64]:
    """(K,) row of the weighted median in each column of ratios and weights, (N, K) each."""
    order = np.argsort(np.where(weight > 0.0, ratio, np.inf), axis=0)
    summed = np.take_along_axis(weight, order, 0).cumsum(axis=0)
    middle = (summed < 0.5 * summed[-1]).sum(axis=0)
    return np.asarray(np.take_along_axis(order, middle[None, :], 0)[0])


def single_forces(problem: ThesisProblem, arcs: Array) -> Array:
    """(K,) best force over EI of a single contact at each of the arcs (K,): weighted medians."""
    levers = influence(problem, arcs)
    ratio = np.divide(
        problem.curvature[:, None], levers, out=np.zeros_like(levers), where=levers > 0.0
    )
    return np.asarray(ratio[weighted_median(ratio, levers), np.arange(levers.shape[1])])


def best_forces(problem: ThesisProblem, arcs: Array) -> Array:
    """Forces (K,) that minimise the 1-norm for contacts at given arcs (K,).

    For one contact it is a weighted median. For several, an optimum of the least absolute deviation
    fits as many readings exactly as there are forces, so all such subsets are tried.
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


def starting_arcs(problem: ThesisProblem) -> Array:
    """The problem's starting arcs, or the thesis's if it has none, (contacts,)."""
    if problem.start is not None:
        return np.array(problem.start, dtype=np.float64)
    return problem.length * np.arange(1, problem.contacts + 1) / problem.contacts


def in_order(arcs: Array, forces: Array) -> tuple[Array, Array]:
    """The contacts sorted from base to tip."""
    order = np.argsort(arcs)
    return arcs[order], forces[order]


def at_centres(problem: ThesisProblem) -> ThesisProblem:
    """The problem with readings of the curvature at each sensor's centre, as in the thesis."""
    return replace(problem, span=np.zeros_like(problem.span))


def alternate(
    arcs: Array, forces_at: Callable[[Array], Array], moved: Callable[[Array, Array], Array]
) -> tuple[Array, Array]:
    """Optimise forces with the arcs fixed, then arcs with the forces fixed, until the arcs stay."""
    for _ in range(_MOST_ROUNDS):
        forces = forces_at(arcs)
        before, arcs = arcs, moved(arcs, forces)
        if np.max(np.abs(arcs - before)) <= _TOLERANCE_CM:
            break
    return in_order(arcs, forces)


def alternating(
    problem: ThesisProblem, norm: Literal[1, 2] = 1, barriers: tuple[float, ...] = _BARRIERS
) -> tuple[Array, Array]:
    """The thesis's solver: a log-barrier interior point method for arcs, exact forces in between.

    The thesis uses the 1-norm. The barriers are applied one after the other; without any, this is
    exact coordinate descent. Returns arcs and forces, (contacts,) each.
    """
    problem = at_centres(problem)
    nodes = problem.length * np.arange(1, _NODES) / _NODES
    levers = influence(problem, nodes)
    walls = np.outer(barriers, np.log(nodes) + np.log(problem.length - nodes))

    def forces_at(arcs: Array) -> Array:
        if norm == 1:
            return best_forces(problem, arcs)
        return np.asarray(np.linalg.pinv(influence(problem, arcs)) @ problem.curvature)

    def moved(arcs: Array, forces: Array) -> Array:
        contact_nodes = np.searchsorted(nodes, arcs)

        def misfits(j: int) -> Array:
            """The objective with contact j at every node and the other contacts unchanged."""
            curvature_of_others = (
                levers[:, contact_nodes] @ forces - forces[j] * levers[:, contact_nodes[j]]
            )
            rest = (problem.curvature - curvature_of_others)[:, None] - forces[j] * levers
            return np.asarray(np.linalg.norm(rest, norm, axis=0))

        alone = misfits(0) if contact_nodes.size == 1 else None
        for wall in walls:
            for _ in range(_SWEEPS):
                before = contact_nodes.copy()
                for j in range(contact_nodes.size):
                    values = (misfits(j) if alone is None else alone) - wall
                    contact_nodes[j] = _downhill(values.tolist(), int(contact_nodes[j]))
                if alone is not None or (contact_nodes == before).all():
                    break
        for j in range(0 if barriers else contact_nodes.size):
            contact_nodes[j] = misfits(j).argmin()
        return np.asarray(nodes[contact_nodes])

    start = np.abs(nodes - starting_arcs(problem)[:, None]).argmin(axis=1)
    return alternate(nodes[start], forces_at, moved)


def _downhill(values: list[float], node: int) -> int:
    """The node that a descent from `at` reaches, from which no step leads lower."""
    for step in _STEPS:
        while True:
            for near in (node - step, node + step):
                if 0 <= near < len(values) and values[near] < values[node]:
                    node = near
                    break
            else:
                break
    return node


def _clamp_base(problem: ThesisProblem) -> tuple[ThesisProblem, float]:
    """The problem with base readings clipped to the critical curvature, and their mean before."""
    at_base = problem.position <= problem.position.min() + 1e-9
    limit = problem.critical_curvature
    held = np.where(at_base, np.clip(problem.curvature, -limit, limit), problem.curvature)
    return replace(problem, curvature=held), float(np.mean(problem.curvature[at_base]))


def clamped(problem: ThesisProblem) -> tuple[Array, Array]:
    """The thesis's solver with the base readings clamped to the critical curvature."""
    return alternating(_clamp_base(problem)[0])


def coupled(problem: ThesisProblem) -> tuple[Array, Array]:
    """A contact that folds the base: f = +-critical / a, with a found by Nelder-Mead (section 3.2).

    `clamped` answers instead if the base stays below the critical curvature, or for several
    contacts.
    """
    held, base = _clamp_base(problem)
    if problem.contacts != 1 or abs(base) <= problem.critical_curvature:
        return alternating(held)
    cut = at_centres(held)
    moment = np.sign(base) * problem.critical_curvature

    def cost(x: Array) -> float:
        inside = 0.0 < x[0] <= problem.length
        return objective(cut, x, moment / x) if inside else 1e3

    first = float(starting_arcs(problem)[0])
    simplex = [[0.999 * first], [0.9 * first]]
    arc = minimize(cost, simplex[0], method="Nelder-Mead", options={"initial_simplex": simplex}).x
    return arc, moment / arc
