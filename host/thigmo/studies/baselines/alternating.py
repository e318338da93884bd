"""The thesis's own solver, as faithful as its text allows, and variants of it.

Source: M. Bryant, Tactile Perception for Growing Robots via Discrete Curvature Measurements, 2022,
section 2.5. Its model (equation 2.9) is taken at the centre of each sensor, whatever the span, its
objective is the 1-norm (2.10), its lengths are millimetres. `alternating` optimises f with a fixed,
then a in [0, L] with f fixed, from f = 0 and a at the tip (several contacts: at even fractions of
L), until no arc moves by more than 0.5 cm. MATLAB's interior point starts with a barrier of 0.1
while this objective is of order 0.01: the first barrier problems pull a towards the middle of
[0, L], and the path then follows the shrinking barrier. That is what lets it leave some local
minima, and what `coordinate` (exact coordinate descent: each step the global optimum of its
variable) lacks: it stalls in the ravine along which f and a trade, where neither alone can improve.
The step in f is exact here, which is the most that the interior point could reach. `clamped` and
`coupled` are the thesis's two remedies for a folded base (section 3.2).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from thigmo.compiled import compiled
from thigmo.studies.baselines.problem import (
    Array,
    Problem,
    best_forces,
    objective,
    residual,
    starting_arcs,
)

_TOLERANCE_CM = 0.5
_MOST_ROUNDS = 100
_MM = 10.0
_FIRST_BARRIER = 0.1
_BARRIER_STEP = 0.2
_BARRIERS = 12


@compiled
def _barrier_value(
    curvature: Array,
    position: Array,
    span: Array,
    arcs: Array,
    forces: Array,
    length: float,
    mu: float,
) -> float:
    value = residual(curvature, position, span, arcs, forces)
    for arc in arcs:
        if arc <= 0.0 or arc >= length:
            return np.inf
        value -= mu * (np.log(arc) + np.log(length - arc))
    return value


@compiled
def _follow(
    curvature: Array,
    position: Array,
    span: Array,
    arcs: Array,
    forces: Array,
    length: float,
    first: float,
    shrink: float,
    levels: int,
) -> None:
    """Follow the barrier path downhill from `arcs` (changed in place), forces fixed."""
    margin = 1e-6 * length
    for j in range(arcs.size):
        arcs[j] = min(max(arcs[j], margin), length - margin)
    mu = first
    for _ in range(levels):
        for _sweep in range(8):
            moved = 0.0
            for j in range(arcs.size):
                start = arcs[j]
                here = _barrier_value(curvature, position, span, arcs, forces, length, mu)
                step = 0.02 * length
                while step > 1e-5 * length:
                    better = False
                    for sign in (-1.0, 1.0):
                        old = arcs[j]
                        arcs[j] = old + sign * step
                        value = _barrier_value(curvature, position, span, arcs, forces, length, mu)
                        if value < here:
                            here = value
                            better = True
                            break
                        arcs[j] = old
                    if not better:
                        step *= 0.5
                moved = max(moved, abs(arcs[j] - start))
            if moved < 1e-4 * length:
                break
        mu *= shrink


def at_centres(problem: Problem) -> Problem:
    """The same readings as the thesis takes them: of the curvature at each sensor's centre."""
    return replace(problem, span=np.zeros_like(problem.span))


def alternating(problem: Problem) -> tuple[Array, Array]:
    """The thesis's solver: log-barrier interior point over a, in mm, alternated with exact f."""
    arcs = starting_arcs(problem) * _MM
    in_mm = replace(
        at_centres(problem),
        curvature=problem.curvature / _MM,
        position=problem.position * _MM,
        length=problem.length * _MM,
    )
    forces = np.zeros(arcs.size)
    for _ in range(_MOST_ROUNDS):
        forces = best_forces(in_mm, arcs)
        before = arcs.copy()
        _follow(
            in_mm.curvature,
            in_mm.position,
            in_mm.span,
            arcs,
            forces,
            in_mm.length,
            _FIRST_BARRIER,
            _BARRIER_STEP,
            _BARRIERS,
        )
        if np.max(np.abs(arcs - before)) <= _TOLERANCE_CM * _MM:
            break
    order = np.argsort(arcs)
    return arcs[order] / _MM, forces[order] * _MM**2


def _cost(problem: Problem, forces: Array, arcs: Array) -> float:
    return objective(problem, arcs, forces)


def alternating_trust_constr(problem: Problem) -> tuple[Array, Array]:
    """The thesis's solver as one would write it today: SciPy's interior point does each step in a.

    The same alternation as `alternating`, in a general solver's hands instead of compiled code:
    the speed that users of the thesis's method see. In cm, where it takes half as long as in mm
    with the same error. Source: scipy.optimize, trust-constr (Byrd, Hribar and Nocedal, SIAM J.
    Optim. 9, 1999).
    """
    import warnings

    from scipy.optimize import Bounds, minimize

    problem = at_centres(problem)
    arcs = starting_arcs(problem)
    forces = np.zeros(arcs.size)
    bounds = Bounds(np.zeros(arcs.size), np.full(arcs.size, problem.length))
    for _ in range(_MOST_ROUNDS):
        forces = best_forces(problem, arcs)
        before = arcs.copy()
        with warnings.catch_warnings():
            # The objective has kinks; SciPy warns of the flat quasi-Newton updates they cause.
            warnings.simplefilter("ignore", UserWarning)
            found = minimize(
                partial(_cost, problem, forces), arcs, method="trust-constr", bounds=bounds
            )
        arcs = np.clip(found.x, 0.0, problem.length)
        if np.max(np.abs(arcs - before)) <= _TOLERANCE_CM:
            break
    order = np.argsort(arcs)
    return arcs[order], forces[order]


@compiled
def _best_arc(
    curvature: Array,
    position: Array,
    span: Array,
    arcs: Array,
    forces: Array,
    length: float,
    j: int,
) -> float:
    """The best place for contact j over all of [0, length], everything else fixed."""
    best, least = arcs[j], np.inf
    trial = arcs.copy()
    cells = 1060
    for k in range(cells + 1):
        trial[j] = length * k / cells
        value = residual(curvature, position, span, trial, forces)
        if value < least:
            best, least = trial[j], value
    return float(best)


def coordinate(problem: Problem) -> tuple[Array, Array]:
    """Exact coordinate descent: the best f, then the globally best a, until nothing moves.

    Not the thesis's solver, though its text can be read as this: see the top of this file.
    """
    problem = at_centres(problem)
    arcs = starting_arcs(problem)
    forces = np.zeros(arcs.size)
    for _ in range(_MOST_ROUNDS):
        forces = best_forces(problem, arcs)
        before = arcs.copy()
        for j in range(arcs.size):
            arcs[j] = _best_arc(
                problem.curvature, problem.position, problem.span, arcs, forces, problem.length, j
            )
        if np.max(np.abs(arcs - before)) <= _TOLERANCE_CM:
            break
    order = np.argsort(arcs)
    return arcs[order], forces[order]


def clamp_base(problem: Problem) -> Problem:
    """Readings of the base sensors kept from passing the critical curvature (section 3.2)."""
    at_base = problem.position <= problem.position.min() + 1e-9
    limit = problem.critical_curvature
    clamped = np.where(at_base, np.clip(problem.curvature, -limit, limit), problem.curvature)
    return replace(problem, curvature=clamped)


def clamped(problem: Problem) -> tuple[Array, Array]:
    """The thesis's solver on readings whose base is clamped at the critical curvature."""
    return alternating(clamp_base(problem))


def coupled(problem: Problem) -> tuple[Array, Array]:
    """One folded contact: f = +-critical / a, so a alone is sought, by Nelder-Mead (section 3.2).

    Readings whose base does not pass the critical curvature are not folded and go to `clamped`, as
    do several contacts.
    """
    from scipy.optimize import minimize

    at_base = problem.position <= problem.position.min() + 1e-9
    base = float(np.mean(problem.curvature[at_base]))
    if problem.contacts != 1 or abs(base) <= problem.critical_curvature:
        return clamped(problem)
    cut = at_centres(clamp_base(problem))
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
