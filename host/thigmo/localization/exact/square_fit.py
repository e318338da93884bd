"""Least squares with signed coefficients: min over beta of |y - beta G|^2 for a handful of rows.

Lawson and Hanson's active set method (Solving Least Squares Problems, 1974, ch. 23) on the normal
equations, with free coefficients allowed: they are passive from the start. A coefficient that
depends on the others to rounding stays 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thigmo.localization.exact.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

DEPENDENT = 1e-13


@compiled
def solve_passive(
    h: Floats, b: Floats, passive: Ints, m: int, factor: Floats, beta: Floats
) -> None:
    """Solve the normal equations over the passive coefficients; the others become 0."""
    for r in range(m):
        beta[r] = 0.0
        factor[r, r] = 0.0
        if passive[r] == 0:
            continue
        for k in range(r):
            if factor[k, k] > 0.0:
                value = h[r, k]
                for i in range(k):
                    if factor[i, i] > 0.0:
                        value -= factor[r, i] * factor[k, i]
                factor[r, k] = value / factor[k, k]
        value = h[r, r]
        for k in range(r):
            if factor[k, k] > 0.0:
                value -= factor[r, k] * factor[r, k]
        if value > DEPENDENT * h[r, r]:
            factor[r, r] = np.sqrt(value)
            value = b[r]
            for k in range(r):
                if factor[k, k] > 0.0:
                    value -= factor[r, k] * beta[k]
            beta[r] = value / factor[r, r]
    for r in range(m - 1, -1, -1):
        if factor[r, r] > 0.0:
            value = beta[r]
            for k in range(r + 1, m):
                if factor[k, k] > 0.0:
                    value -= factor[k, r] * beta[k]
            beta[r] = value / factor[r, r]


@compiled
def square_fit(
    h: Floats,
    b: Floats,
    total: float,
    m: int,
    kind: Ints,
    beta: Floats,
    work: Floats,
    passive: Ints,
) -> float:
    """Fit from the normal equations; returns the least |y - beta G|^2.

    Args:
        h: (>= m, >= m) G G^T.
        b: (>= m,) G y.
        total: y y.
        m: coefficients.
        kind: (>= m,) 0 free, 1 beta >= 0, -1 beta <= 0.
        beta: (>= m,) written.
        work: (>= m + 1, >= m) work.
        passive: (>= m,) work.
    """
    factor = work[:m]
    last = work[m]
    # All passive first: right whenever the signs come out so.
    for r in range(m):
        passive[r] = 1
    solve_passive(h, b, passive, m, factor, beta)
    right = True
    for r in range(m):
        right = right and kind[r] * beta[r] >= 0.0
    if not right:
        for r in range(m):
            passive[r] = 1 if kind[r] == 0 else 0
        solve_passive(h, b, passive, m, factor, beta)
        for _ in range(6 * m):
            enter = -1
            steepest = 0.0
            for r in range(m):
                if passive[r] == 0 and h[r, r] > 0.0:
                    slope = b[r]
                    for k in range(m):
                        slope -= h[r, k] * beta[k]
                    slope *= kind[r] / np.sqrt(h[r, r])
                    if slope > steepest:
                        steepest = slope
                        enter = r
            if enter < 0 or steepest <= 1e-14 * np.sqrt(total):
                break
            passive[enter] = 1
            for r in range(m):
                last[r] = beta[r]
            while True:
                solve_passive(h, b, passive, m, factor, beta)
                step = 1.0
                leave = -1
                for r in range(m):
                    if passive[r] == 1 and kind[r] * beta[r] < 0.0:
                        share = last[r] / (last[r] - beta[r]) if last[r] != beta[r] else 0.0
                        if share < step or leave < 0:
                            step = share
                            leave = r
                if leave < 0:
                    break
                for r in range(m):
                    last[r] += step * (beta[r] - last[r])
                passive[leave] = 0
                last[leave] = 0.0
    value = total
    for r in range(m):
        value -= b[r] * beta[r]
    return value


@compiled
def charged_fit(
    h: Floats,
    b: Floats,
    total: float,
    m: int,
    kind: Ints,
    group: Ints,
    multiplier: Floats,
    limit: float,
    beta: Floats,
    work: Floats,
    passive: Ints,
) -> float:
    """Least |y - beta G|^2 + 2 sum over groups of multiplier (sum |beta| - limit)."""
    for r in range(m):
        b[r] -= kind[r] * multiplier[group[r]]
    value = square_fit(h, b, total, m, kind, beta, work, passive)
    for r in range(m):
        b[r] += kind[r] * multiplier[group[r]]
    for k in range(multiplier.shape[0]):
        value -= 2.0 * multiplier[k] * limit
    return value


@compiled
def square_fit_limited(
    h: Floats,
    b: Floats,
    total: float,
    m: int,
    kind: Ints,
    group: Ints,
    groups: int,
    limit: float,
    beta: Floats,
    multiplier: Floats,
    work: Floats,
    passive: Ints,
) -> float:
    """`square_fit` with the sum of each group's |beta| at most `limit`: a proven lower bound.

    Coefficients of a group must have one sign; the others (kind 0) are not limited. The value is
    the Lagrangian's minimum: a lower bound for any multipliers, the optimum for the right ones,
    which are found one group at a time (the sum falls as its multiplier rises).

    Args:
        h: as `square_fit`.
        b: as `square_fit`.
        total: as `square_fit`.
        m: coefficients.
        kind: as `square_fit`.
        group: (>= m,) group of each coefficient.
        groups: how many.
        limit: > 0.
        beta: (>= m,) written.
        multiplier: (>= groups,) work.
        work: as `square_fit`.
        passive: as `square_fit`.
    """
    best = square_fit(h, b, total, m, kind, beta, work, passive)
    for k in range(multiplier.shape[0]):
        multiplier[k] = 0.0
    for sweep in range(3):
        moved = False
        for k in range(groups):
            over = -limit
            size = 0.0
            for r in range(m):
                if group[r] == k:
                    over += kind[r] * beta[r]
                    size = max(size, h[r, r])
            if abs(over) <= 1e-9 * limit or (over < 0.0 and multiplier[k] == 0.0):
                continue
            moved = True
            low = 0.0
            high = np.inf
            at_low = 0.0
            at_high = 0.0
            if over > 0.0:
                low = multiplier[k]
                at_low = over
                step = max(low, 1e-6 * size * limit)
            else:
                high = multiplier[k]
                at_high = over
                step = 0.0
            last = 0
            for _ in range(60):
                if high == np.inf:
                    trial = low + step
                    step *= 8.0
                elif at_low == 0.0:
                    trial = low
                else:
                    trial = low + (high - low) * at_low / (at_low - at_high)
                multiplier[k] = trial
                value = charged_fit(
                    h, b, total, m, kind, group, multiplier, limit, beta, work, passive
                )
                best = max(best, value)
                over = -limit
                for r in range(m):
                    if group[r] == k:
                        over += kind[r] * beta[r]
                if abs(over) <= 1e-9 * limit:
                    break
                if over > 0.0:
                    low = trial
                    at_low = over
                    if last > 0:
                        at_high *= 0.5
                    last = 1
                else:
                    if trial == 0.0:
                        break
                    high = trial
                    at_high = over
                    if last < 0:
                        at_low *= 0.5
                    last = -1
                if high - low <= 1e-12 * high:
                    break
        if not moved:
            break
    return best
