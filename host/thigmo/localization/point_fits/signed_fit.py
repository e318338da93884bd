"""Least misfit of readings by three columns for each of two contacts, with non-negative weights.

The weights of a contact add up to at most a limit. Called by `two_contacts` for bounds over boxes
and for forces at given arcs. The 1-norm is a linear programme, solved by the simplex method with
exact line searches; the 2-norm is a quadratic one, solved as a linear complementarity problem by
Lemke's method (Cottle, Pang and Stone, The Linear Complementarity Problem, chapter 4). Both walk
one tableau by the same exchange.

What is returned as a bound is never the solver's word: it is the value of the dual at the
multipliers that the solver ended with, and any multipliers give a valid bound. Arguments: `g`
(6, >= n) columns, as rows; `y` (>= n,) readings; `limit` > 0; `beta` (6,) the weights, written.
"""

from __future__ import annotations

import numpy as np

from thigmo.compiled import compiled
from thigmo.localization.point_fits.response import Floats, crossing, integer

EACH, COLUMNS = 3, 6  # of one contact, of both
SMALL = 1e-12  # entries of a scaled tableau below this are zero
L2_ROWS = COLUMNS + 2
L2_STEPS = 60


@compiled
def exchange(table: Floats, p: int, q: int) -> None:
    """Swap row variable p and column variable q of row = table @ (columns, 1)."""
    rows, columns = table.shape
    inverse = 1.0 / table[p, q]
    for k in range(columns):
        table[p, k] *= -inverse
    table[p, q] = inverse
    for i in range(rows):
        factor = table[i, q]
        if i == p or factor == 0.0:
            continue
        table[i, q] = 0.0
        for k in range(columns):
            table[i, k] += factor * table[p, k]


@compiled
def dual_penalty(g: Floats, n: int, d: Floats) -> float:
    """What multipliers `d` (n,) of the residuals cost for each unit of the limit."""
    total = 0.0
    for c in range(2):
        worst = 0.0
        for r in range(EACH * c, EACH * c + EACH):
            pull = 0.0
            for i in range(n):
                pull += g[r, i] * d[i]
            worst = max(worst, pull)
        total += worst
    return total


@compiled
def column_scales(g: Floats, n: int, scale: Floats) -> None:
    """Factors (6,) that bring each column's largest entry to 1."""
    for r in range(COLUMNS):
        largest = 0.0
        for i in range(n):
            largest = max(largest, abs(g[r, i]))
        scale[r] = 1.0 / largest if largest > 0.0 else 1.0


@compiled
def fit_l1(g: Floats, y: Floats, n: int, limit: float, beta: Floats) -> float:
    """Weights of least sum |y - beta g|; returns a proven lower bound of that sum."""
    rows = n + 2
    table = np.empty((rows, COLUMNS + 1))
    side, key, amount = np.empty(rows), np.empty(rows), np.empty(rows)
    slope, scale = np.empty(COLUMNS), np.empty(COLUMNS)
    order = np.empty(rows, np.int64)
    # What stands in rows, then columns: readings from 0, room up to the limits, weights from n + 2.
    names = np.arange(rows + COLUMNS)
    column_scales(g, n, scale)
    for i in range(rows):
        for r in range(COLUMNS):
            own = -g[r, i] if i < n else (-1.0 if r // EACH == i - n else 0.0)
            table[i, r] = own * scale[r]
        table[i, COLUMNS] = y[i] if i < n else limit
        side[i] = 1.0 if table[i, COLUMNS] >= 0.0 else -1.0
    for _ in range(20 * rows):
        # The column along which the sum falls fastest.
        q, need = integer(0), SMALL
        for r in range(COLUMNS):
            slope[r] = 0.0
            for i in range(rows):
                if names[i] < n:
                    slope[r] += side[i] * table[i, r]
            # A residual that leaves 0 adds to the sum; a weight can only grow.
            fall = abs(slope[r]) - 1.0 if names[rows + r] < n else -slope[r]
            if fall > need:
                need, q = fall, r
        if need == SMALL:
            break
        way = -1.0 if slope[q] > 0.0 else 1.0
        count = integer(0)
        for i in range(rows):
            rate = way * table[i, q] * (side[i] if names[i] < n else 1.0)
            if rate < -SMALL:
                amount[i] = -2.0 * rate if names[i] < n else np.inf
                key[i] = abs(table[i, COLUMNS]) / -rate
                order[count] = i
                count += 1
        last = crossing(key, amount, order, count, need)
        if last == count:
            break
        for k in range(last):
            side[order[k]] *= -1.0
        p = order[last]
        exchange(table, p, q)
        side[p] = way
        names[p], names[rows + q] = names[rows + q], names[p]
    # Multipliers of the residuals, by reading; `key` is free by now.
    beta[:] = 0.0
    for r in range(COLUMNS):
        if names[rows + r] < n:
            key[names[rows + r]] = min(max(-slope[r], -1.0), 1.0)
    for i in range(rows):
        if names[i] < n:
            key[names[i]] = side[i]
        elif names[i] >= rows:
            beta[names[i] - rows] = max(table[i, COLUMNS], 0.0) * scale[names[i] - rows]
    bound = -limit * dual_penalty(g, n, key)
    for i in range(n):
        bound += key[i] * y[i]
    return bound


@compiled
def complementarity(g: Floats, y: Floats, n: int, limit: float, scale: Floats) -> Floats:
    """Gradients and room up to the limits, against weights, multipliers, the covering variable."""
    table = np.zeros((L2_ROWS, L2_ROWS + 2))
    for r in range(L2_ROWS):
        table[r, L2_ROWS] = 1.0
        table[r, L2_ROWS + 1] = limit if r >= COLUMNS else 0.0
    for r in range(COLUMNS):
        c = COLUMNS + r // EACH
        table[r, c], table[c, r] = scale[r], -scale[r]
        for i in range(n):
            scaled = g[r, i] * scale[r]
            table[r, L2_ROWS + 1] -= scaled * y[i]
            for k in range(COLUMNS):
                table[r, k] += scaled * g[k, i] * scale[k]
    return table


@compiled
def fit_l2(g: Floats, y: Floats, n: int, limit: float, beta: Floats) -> float:
    """Weights of least sum (y - beta g)^2; returns a proven lower bound of that sum."""
    scale = np.empty(COLUMNS)
    column_scales(g, n, scale)
    table = complementarity(g, y, n, limit, scale)
    covering = last = L2_ROWS
    # In rows, then columns: weights and multipliers from 0, the covering variable, their partners.
    names = np.arange(2 * L2_ROWS + 1)
    p = integer(0)
    for r in range(2 * L2_ROWS + 1):
        names[r] = covering + 1 + r if r < L2_ROWS else r - L2_ROWS
        if r < L2_ROWS and table[r, last + 1] < table[p, last + 1]:
            p = r
    q = integer(covering)
    for _ in range(L2_STEPS if table[p, last + 1] < 0.0 else 0):
        exchange(table, p, q)
        left = names[p]
        names[p], names[L2_ROWS + q] = names[L2_ROWS + q], left
        if left == covering:
            break
        partner = left - covering - 1 if left > covering else left + covering + 1
        q = integer(0)
        while names[L2_ROWS + q] != partner:
            q += 1
        p, least = integer(-1), np.inf
        for r in range(L2_ROWS):
            if table[r, q] < -SMALL:
                ratio = -table[r, last + 1] / table[r, q]
                if ratio < least or (ratio == least and names[r] == covering):
                    least, p = ratio, r
        if p < 0:
            break
    beta[:] = 0.0
    for r in range(L2_ROWS):
        if names[r] < COLUMNS:
            beta[names[r]] = max(table[r, last + 1], 0.0) * scale[names[r]]
    d, bound = np.empty(n), 0.0
    for i in range(n):
        d[i] = y[i]
        for r in range(COLUMNS):
            d[i] -= beta[r] * g[r, i]
        bound += d[i] * (2.0 * y[i] - d[i])
    return bound - 2.0 * limit * dual_penalty(g, n, d)
