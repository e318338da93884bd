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
    return max(value, 0.0)
