"""Least squares with signed and limited coefficients, for a handful of them: a proven lower bound.

The data are first rotated into a triangle (orthogonal, so nothing is lost). Signs are settled by
Lawson and Hanson's active set method (Solving Least Squares Problems, 1974, ch. 23), free
coefficients being passive throughout; limits on sums of coefficients by the augmented Lagrangian,
whose minimum is a lower bound for any multipliers and the optimum for the right ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_inner, compiled_sums
from thigmo.localization.exact.absolute_fit import SignedFit, Size

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

DEPENDENT = 1e-12  # a column this close to the span of those before it adds nothing
STIFFNESS = 100.0  # of the springs on limits, relative to the largest coefficient's column


class Triangle(NamedTuple):
    """Rotated data: one row of `a` per coefficient.

    Attributes:
        a: (>= m + groups, >= m + 1 + groups); beyond the first m rows and m + 1 columns for limits.
        t: (>= m + 1 + groups,).
    """

    a: Floats
    t: Floats


class Limits(NamedTuple):
    """Limits on sums of |coefficients|.

    Attributes:
        group: (>= m,) group of each coefficient; those of a group have one sign, or no limit.
        groups: how many.
        limit: of each group's sum, > 0.
    """

    group: Ints
    groups: int
    limit: float


class ActiveSet(NamedTuple):
    """Work of the active set method, for m + groups coefficients.

    Attributes:
        passive: (>= m + groups,) which coefficients are not held at 0.
        q: (>= m + groups, >= m + 1 + groups).
        upper: (>= m + groups, >= m + groups).
        small: (3, >= m + 1 + groups).
    """

    passive: Ints
    q: Floats
    upper: Floats
    small: Floats


@compiled_inner
def triangle(fit: SignedFit, size: Size, q: Floats, out: Triangle) -> None:
    """Rotate weighted data: |t - beta a| = |w (y - beta g)| for every beta.

    Args:
        fit: data and coefficients.
        size: how much of them.
        q: (>= m + 1, >= n) work.
        out: written.
    """
    g, y, w, _ = fit
    m, n, _ = size
    a, t = out
    for r in range(m + 1):
        before = 0.0
        for k in range(n):
            q[r, k] = w[k] * (g[r, k] if r < m else y[k])
            before += q[r, k] * q[r, k]
        for p in range(r):
            dot = 0.0
            for k in range(n):
                dot += q[p, k] * q[r, k]
            for k in range(n):
                q[r, k] -= dot * q[p, k]
            if r < m:
                a[r, p] = dot
            else:
                t[p] = dot
        after = 0.0
        for k in range(n):
            after += q[r, k] * q[r, k]
        norm = np.sqrt(after)
        if r < m:
            a[r, r] = norm
            for p in range(r + 1, m + 1):
                a[r, p] = 0.0
        else:
            t[r] = norm
        scale = 1.0 / norm if after > 0.0 else 0.0
        if after <= DEPENDENT * DEPENDENT * before:
            scale = 0.0
            if r < m:
                a[r, r] = 0.0
        for k in range(n):
            q[r, k] *= scale


@compiled_sums
def solve_passive(data: Triangle, m: int, rows: int, beta: Floats, work: ActiveSet) -> float:
    """Least squares over the passive coefficients, the others 0; returns the squared residual."""
    a, t = data
    passive, q, upper, small = work
    rest = small[0]
    for k in range(rows):
        rest[k] = t[k]
    for r in range(m):
        beta[r] = 0.0
        upper[r, r] = 0.0
        if passive[r] <= 0:
            continue
        before = 0.0
        for k in range(rows):
            q[r, k] = a[r, k]
            before += a[r, k] * a[r, k]
        for p in range(r):
            if upper[p, p] > 0.0:
                dot = 0.0
                for k in range(rows):
                    dot += q[p, k] * q[r, k]
                for k in range(rows):
                    q[r, k] -= dot * q[p, k]
                upper[p, r] = dot
        after = 0.0
        for k in range(rows):
            after += q[r, k] * q[r, k]
        if after > DEPENDENT * DEPENDENT * before:
            size = np.sqrt(after)
            upper[r, r] = size
            dot = 0.0
            for k in range(rows):
                q[r, k] /= size
                dot += q[r, k] * rest[k]
            for k in range(rows):
                rest[k] -= dot * q[r, k]
            beta[r] = dot
    for r in range(m - 1, -1, -1):
        if upper[r, r] > 0.0:
            value = beta[r]
            for p in range(r + 1, m):
                if upper[p, p] > 0.0:
                    value -= upper[r, p] * beta[p]
            beta[r] = value / upper[r, r]
    left = 0.0
    for k in range(rows):
        left += rest[k] * rest[k]
    return left


@compiled_sums
def signed_square_fit(
    data: Triangle, m: int, rows: int, kind: Ints, beta: Floats, work: ActiveSet
) -> float:
    """Least |t - beta a|^2 with beta >= 0 where kind is 1, <= 0 where -1, free where 0.

    Args:
        data: from `triangle`, with or without limits.
        m: coefficients.
        rows: data.
        kind: (>= m,).
        beta: (>= m,) written.
        work: the rest of it.
    """
    a, t = data
    passive = work.passive
    rest = work.small[0]
    last = work.small[1]
    total = 0.0
    for k in range(rows):
        total += t[k] * t[k]
    for r in range(m):
        passive[r] = 1
        last[r] = 0.0
    value = total
    enter = -1
    phase = 0  # 0: all passive at once, right whenever the signs come out so; then one by one
    for _ in range(20 * m):
        value = solve_passive(data, m, rows, beta, work)
        wrong = -1
        step = 1.0
        for r in range(m):
            if kind[r] * beta[r] < 0.0:
                share = last[r] / (last[r] - beta[r]) if last[r] != beta[r] else 0.0
                if wrong < 0 or share < step:
                    step = share
                    wrong = r
        if phase == 0 and wrong >= 0:
            phase = 1
            for r in range(m):
                passive[r] = 1 if kind[r] == 0 else 0
            continue
        if wrong >= 0 and wrong == enter and last[wrong] == 0.0:
            passive[wrong] = -1  # its slope was rounding: not again before the point has moved
            enter = -1
            continue
        if wrong >= 0:
            for r in range(m):
                last[r] += step * (beta[r] - last[r])
            passive[wrong] = 0
            last[wrong] = 0.0
            continue
        if phase == 0:
            return value
        if enter >= 0:
            for r in range(m):
                passive[r] = max(passive[r], 0)
        enter = -1
        steepest = 1e-14 * np.sqrt(total)
        for r in range(m):
            last[r] = beta[r]
            if passive[r] == 0:
                slope = 0.0
                size = 0.0
                for k in range(rows):
                    slope += a[r, k] * rest[k]
                    size += a[r, k] * a[r, k]
                if size > 0.0 and kind[r] * slope > steepest * np.sqrt(size):
                    steepest = kind[r] * slope / np.sqrt(size)
                    enter = r
        if enter < 0:
            return value
        passive[enter] = 1
    return 0.0


@compiled_sums
def square_fit(
    data: Triangle, m: int, kind: Ints, limits: Limits, beta: Floats, work: ActiveSet
) -> float:
    """`signed_square_fit` with the sum of each group's |beta| at most a limit: a lower bound.

    Args:
        data: from `triangle`; its further rows and columns are written.
        m: coefficients.
        kind: (>= m + groups,).
        limits: on groups of them.
        beta: (>= m + groups,) written.
        work: the rest of it.
    """
    a, t = data
    group, groups, limit = limits
    multiplier = work.small[2]
    best = 0.0
    stiff = 0.0
    root = 0.0
    count = m
    rows = m + 1
    for _ in range(12):
        value = signed_square_fit(data, count, rows, kind, beta, work)
        settled = True
        for k in range(groups):
            over = -limit
            for r in range(m):
                if group[r] == k:
                    over += kind[r] * beta[r]
            if count == m:
                settled = settled and over <= 1e-12 * limit
            else:
                value -= multiplier[k] * multiplier[k] / stiff
                over += beta[m + k]
                multiplier[k] = max(multiplier[k] + stiff * over, 0.0)
                settled = settled and abs(over) <= 1e-11 * limit
        best = max(best, value)
        if settled:
            break
        if count == m:
            # Each limit becomes a spring on sum |beta| + slack - limit.
            size = 0.0
            for r in range(m):
                value = 0.0
                for k in range(m + 1):
                    value += a[r, k] * a[r, k]
                size = max(size, value)
            stiff = STIFFNESS * size
            root = np.sqrt(stiff)
            count = m + groups
            rows = m + 1 + groups
            for k in range(groups):
                multiplier[k] = 0.0
                kind[m + k] = 1
                for c in range(rows):
                    a[m + k, c] = 0.0
                a[m + k, m + 1 + k] = root
                for r in range(m):
                    a[r, m + 1 + k] = root * kind[r] if group[r] == k else 0.0
        for k in range(groups):
            t[m + 1 + k] = root * limit - multiplier[k] / root
    return best
