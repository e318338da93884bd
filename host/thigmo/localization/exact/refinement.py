"""Local refinement of contacts: arcs and forces together, with the sensors' true spans.

The model is linear in the forces, and to first order in (f, f da), so a fit of twice as many
coefficients proposes a step of the arcs, which is kept only if it improves; arcs moved one at a
time cross the kinks at which that stops. The fits differ little from each other: each L1 fit starts
from the readings that the best one met (`absolute_descent`). Called by `solve` with places from
`knots`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_inner, compiled_sums
from thigmo.localization.exact.absolute_descent import Descent, descend
from thigmo.localization.exact.absolute_fit import SignedFit, Simplex, Size, absolute_fit
from thigmo.localization.exact.response import Readings, plain

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

GAIN = 1e-12  # of the objective; less is no improvement


class Room(NamedTuple):
    """Work of the fits."""

    simplex: Simplex
    descent: Descent


@compiled_inner
def columns(arcs: Floats, readings: Readings, slopes: bool, g: Floats) -> None:
    """Influence of each contact (row j) and, below them, its slope in the arc (row C + j).

    Args:
        arcs: (C,).
        readings: N of them.
        slopes: whether to fill the lower half.
        g: (>= 2 C, >= N), written.
    """
    _, low, span, inverse, _ = readings
    c = arcs.shape[0]
    for j in range(c):
        for i in range(low.shape[0]):
            t = arcs[j] - low[i]
            inside = min(max(t, 0.0), span[i])
            g[j, i] = inside * inside * inverse[i] + (max(t, span[i]) - span[i])
            if slopes:
                if span[i] > 0.0:
                    g[c + j, i] = inside / span[i]
                else:
                    g[c + j, i] = 1.0 if t > 0.0 else 0.0


@compiled_inner
def free_fit_l1(fit: SignedFit, m: int, basis: Ints, beta: Floats, room: Room) -> float:
    """Least sum of w |r| over free coefficients of the first m rows of g.

    Args:
        fit: data and coefficients.
        m: coefficients.
        basis: (>= m,) readings that a fit nearby met, or first a negative number; written.
        beta: (>= m,) written.
        room: work.
    """
    n = fit.y.shape[0]
    if basis[0] >= 0:
        value = descend(fit, m, basis, beta, room.descent)
        if value < np.inf:
            return value
    value, proven = absolute_fit(fit, Size(m, n, plain(0)), beta, room.simplex)
    for r in range(m):
        basis[r] = room.simplex.items[1, r]
        if basis[r] >= n:
            basis[0] = -1
            break
    return value if proven else np.inf


@compiled_inner
def free_fit_l2(fit: SignedFit, m: int, beta: Floats, simplex: Simplex) -> float:
    """Least sum of (w r)^2 over free coefficients of the first m rows of g; `beta` (m,) written."""
    g, y, w, _ = fit
    tableau, work, _ = simplex
    n = y.shape[0]
    # Orthogonal columns one after another; what is left of y is the residual.
    total = 0.0
    for i in range(n):
        work[0, i] = w[i] * y[i]
    for r in range(m):
        before = 0.0
        for i in range(n):
            tableau[r, i] = w[i] * g[r, i]
            before += tableau[r, i] * tableau[r, i]
        for p in range(r):
            dot = 0.0
            for i in range(n):
                dot += tableau[p, i] * tableau[r, i]
            for i in range(n):
                tableau[r, i] -= dot * tableau[p, i]
            work[1 + p, r] = dot
        after = 0.0
        for i in range(n):
            after += tableau[r, i] * tableau[r, i]
        size = np.sqrt(after)
        work[1 + r, r] = size if after > 1e-24 * before else 0.0
        scale = 1.0 / size if after > 1e-24 * before else 0.0
        dot = 0.0
        for i in range(n):
            tableau[r, i] *= scale
            dot += tableau[r, i] * work[0, i]
        for i in range(n):
            work[0, i] -= dot * tableau[r, i]
        beta[r] = dot
    for r in range(m - 1, -1, -1):
        value = beta[r]
        for p in range(r + 1, m):
            value -= work[1 + r, p] * beta[p]
        beta[r] = value / work[1 + r, r] if work[1 + r, r] > 0.0 else 0.0
    for i in range(n):
        total += work[0, i] * work[0, i]
    return total


@compiled_inner
def free_fit(fit: SignedFit, m: int, norm: int, basis: Ints, beta: Floats, room: Room) -> float:
    """`free_fit_l1` or, without a basis, `free_fit_l2`."""
    if norm == 1:
        return free_fit_l1(fit, m, basis, beta, room)
    return free_fit_l2(fit, m, beta, room.simplex)


@compiled_sums
def refine(
    readings: Readings,
    length: float,
    norm: int,
    steps: tuple[float, float],
    arcs: Floats,
    forces: Floats,
) -> float:
    """Improve arcs (C,) in place, forces free; returns the objective.

    Args:
        readings: N of them.
        length: everted length.
        norm: 1 or 2.
        steps: first step of the search, and the one at which it ends.
        arcs: (C,) start; written.
        forces: (C,) written.
    """
    step, stop = steps
    n = readings.y.shape[0]
    c = arcs.shape[0]
    g = np.empty((2 * c, n))
    room = Room(
        Simplex(
            np.empty((2 * c, n + 2 * c)),
            np.empty((2 * c + 6, n + 2 * c)),
            np.empty((4, n + 2 * c), np.int64),
        ),
        Descent(
            np.empty(n),
            np.empty(n),
            np.empty(n),
            np.empty(n),
            np.empty(n),
            np.empty(n, np.int64),
            np.empty((2 * c, 4 * c)),
            np.empty((2 * c, 2 * c)),
            np.empty(2 * c),
        ),
    )
    fit = SignedFit(g, readings.y, readings.w, np.zeros(2 * c, np.int64))
    beta = np.zeros(2 * c)
    push = np.zeros(2 * c)
    trial = np.empty(c)
    met = np.full(2 * c, -1)  # by the fit with slopes
    best_met = np.full(c, -1)
    trial_met = np.full(c, -1)
    columns(arcs, readings, False, g)
    best = free_fit(fit, c, norm, best_met, forces, room)
    least = GAIN * best
    while step > stop:
        start = best
        # Arcs and forces together: linear in (f, f da) while no sensor is passed.
        for _ in range(8):
            columns(arcs, readings, True, g)
            if free_fit(fit, 2 * c, norm, met, beta, room) >= best - least:
                break
            share = 1.0
            gained = False
            for _halving in range(4):
                for j in range(c):
                    move = beta[c + j] / beta[j] if beta[j] != 0.0 else 0.0
                    move = min(max(share * move, -8.0 * step), 8.0 * step)
                    trial[j] = min(max(arcs[j] + move, 0.0), length)
                columns(trial, readings, False, g)
                for j in range(c):
                    trial_met[j] = best_met[j]
                value = free_fit(fit, c, norm, trial_met, push, room)
                if value < best - least:
                    best = value
                    for j in range(c):
                        arcs[j] = trial[j]
                        forces[j] = push[j]
                        best_met[j] = trial_met[j]
                    gained = True
                    break
                share *= 0.4
            if not gained:
                break
        # One arc at a time: crosses the kinks that the steps above stop at.
        for j in range(c):
            for side in range(2):
                for k in range(c):
                    trial[k] = arcs[k]
                    trial_met[k] = best_met[k]
                trial[j] = min(max(arcs[j] + (1.0 - 2.0 * side) * step, 0.0), length)
                columns(trial, readings, False, g)
                value = free_fit(fit, c, norm, trial_met, push, room)
                if value < best - least:
                    best = value
                    arcs[j] = trial[j]
                    for k in range(c):
                        forces[k] = push[k]
                        best_met[k] = trial_met[k]
        if best >= start - least:
            step *= 0.35
    return best
