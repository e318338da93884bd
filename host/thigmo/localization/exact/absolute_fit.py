"""Least absolute deviations with signed coefficients: min over beta of sum w |y - beta G|.

The dual, max y s over |s| <= w with G s = 0 (<= 0 where beta >= 0, >= 0 where beta <= 0), is solved
by a bounded dual simplex on a dense tableau: it starts at beta = 0 and each step is an exact line
search (all residuals that change sign on the way are flipped at once). A handful of rows and few
pivots, so a fit costs about a microsecond; its value is a proven lower bound, which is what the
branch and bound over several contacts needs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_inner, compiled_sums
from thigmo.localization.exact.response import plain

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

PIVOTS = 400


class SignedFit(NamedTuple):
    """A fit of data by signed coefficients.

    Attributes:
        g: (>= m, >= n + extra) one row per coefficient.
        y: (>= n + extra,) data; then the right sides (>= 0) of the constraints beta g <= y.
        w: (>= n,) weights, > 0.
        kind: (>= m,) 0 free, 1 beta >= 0, -1 beta <= 0.
    """

    g: Floats
    y: Floats
    w: Floats
    kind: Ints


class Size(NamedTuple):
    """How much of a `SignedFit` is in use.

    Attributes:
        m: coefficients.
        n: data; 0 gives value 0.
        extra: constraints, in the columns after the data.
    """

    m: int
    n: int
    extra: int


class Simplex(NamedTuple):
    """Work of the simplex.

    Attributes:
        tableau: (>= m, >= n + extra + m).
        rows: (6, >= n + extra + m).
        items: (4, >= n + extra + m).
    """

    tableau: Floats
    rows: Floats
    items: Ints


@compiled_sums
def crossing(key: Floats, amount: Floats, order: Ints, count: int, need: float) -> int:
    """Place in `order` up to which the amounts, by ascending key, first add up to `need`.

    Weighted quickselect: on return, `order[:place]` holds the smaller keys. Returns `count` if the
    amounts do not suffice.

    Args:
        key: keys by item.
        amount: amounts by item, >= 0.
        order: items; reordered in its first `count` entries.
        count: how many items.
        need: > 0.
    """
    left = 0
    right = count
    while right - left > 12:
        a = key[order[left]]
        b = key[order[(left + right) >> 1]]
        c = key[order[right - 1]]
        pivot = max(min(a, b), min(max(a, b), c))
        low = left
        middle = left
        high = right
        below = 0.0
        equal = 0.0
        while middle < high:
            item = order[middle]
            value = key[item]
            if value < pivot:
                order[middle] = order[low]
                order[low] = item
                below += amount[item]
                low += 1
                middle += 1
            elif value > pivot:
                high -= 1
                order[middle] = order[high]
                order[high] = item
            else:
                equal += amount[item]
                middle += 1
        if below >= need:
            right = low
        elif below + equal >= need:
            need -= below
            left = low
            right = high
            break
        else:
            need -= below + equal
            left = high
            if left == count:
                return count
    if right - left <= 12:
        for k in range(left + 1, right):
            item = order[k]
            value = key[item]
            m = k
            while m > left and key[order[m - 1]] > value:
                order[m] = order[m - 1]
                m -= 1
            order[m] = item
    for k in range(left, right):
        need -= amount[order[k]]
        if need <= 0.0:
            return k
    return right if right < count else count


@compiled_inner
def absolute_fit(fit: SignedFit, size: Size, beta: Floats, simplex: Simplex) -> tuple[float, bool]:
    """Fit; returns the value and whether it is proven (the pivot limit was not met).

    Args:
        fit: data and coefficients.
        size: how much of them; no literal numbers (`plain`).
        beta: (>= m,) written.
        simplex: work.
    """
    g, y, w, kind = fit
    m, n, extra = size
    tableau, work, items = simplex
    ends = n + extra  # dual variables of the data, then of the constraints, then the slacks
    total = ends + m
    cost = work[0]
    side = work[1]  # the bound that a nonbasic variable stands at: +-1, 0 for a basic one
    key = work[2]
    amount = work[3]
    value_b = work[4]
    scale = work[5]
    order = items[0]
    basis = items[1]
    for j in range(n):
        cost[j] = y[j]
        side[j] = 1.0 if y[j] >= 0.0 else -1.0
    for j in range(n, ends):
        cost[j] = y[j]
        side[j] = 1.0  # these run from -inf to 0
    for r in range(m):
        largest = 0.0
        for j in range(n):
            largest = max(largest, abs(g[r, j]))
        scale[r] = 1.0 / largest if largest > 0.0 else 1.0
        x = 0.0
        reach = 0.0
        for j in range(n):
            tableau[r, j] = g[r, j] * scale[r]
            x -= tableau[r, j] * side[j] * w[j]
            reach += abs(tableau[r, j]) * w[j]
        for j in range(n, ends):
            tableau[r, j] = g[r, j] * scale[r]
        for k in range(m):
            tableau[r, ends + k] = 0.0
        tableau[r, ends + r] = 1.0
        basis[r] = ends + r
        value_b[r] = x
        key[r] = reach
        cost[ends + r] = 0.0
        side[ends + r] = 0.0
    tolerance = 0.0
    for r in range(m):
        tolerance = max(tolerance, key[r])
    tolerance *= 1e-13
    proven = False
    for _ in range(PIVOTS):
        # The basic variable that breaks its bounds most leaves.
        row = -1
        worst = tolerance
        direction = 0.0
        target = 0.0
        for r in range(m):
            b = basis[r]
            if b < n:
                lower = -w[b]
                upper = w[b]
            elif b < ends:
                lower = -np.inf
                upper = 0.0
            else:
                lower = -np.inf if kind[b - ends] < 0 else 0.0
                upper = np.inf if kind[b - ends] > 0 else 0.0
            if lower - value_b[r] > worst:
                worst = lower - value_b[r]
                row = r
                direction = 1.0
                target = lower
            elif value_b[r] - upper > worst:
                worst = value_b[r] - upper
                row = r
                direction = -1.0
                target = upper
        if row < 0:
            proven = True
            break
        count = plain(0)
        for j in range(n):
            push = direction * side[j] * tableau[row, j]
            if push > 1e-13:
                key[j] = abs(cost[j]) / push
                amount[j] = 2.0 * w[j] * push
                order[count] = j
                count += 1
        for j in range(n, ends):
            push = direction * side[j] * tableau[row, j]
            if push > 1e-13:
                key[j] = abs(cost[j]) / push
                amount[j] = np.inf
                order[count] = j
                count += 1
        for k in range(m):
            j = ends + k
            if side[j] != 0.0 and kind[k] != 0:
                push = -direction * kind[k] * tableau[row, j]
                if push > 1e-13:
                    key[j] = abs(cost[j]) / push
                    amount[j] = np.inf
                    order[count] = j
                    count += 1
        place = crossing(key, amount, order, count, worst)
        if place == count:
            # Rounding only: every residual turned and the row is still short by about nothing.
            proven = worst <= 1e3 * tolerance
            break
        for k in range(place):
            j = order[k]
            jump = 2.0 * w[j] * side[j]
            side[j] = -side[j]
            for r in range(m):
                value_b[r] += tableau[r, j] * jump
        enter = order[place]
        pivot = tableau[row, enter]
        move = (value_b[row] - target) / pivot
        start = side[enter] * w[enter] if enter < n else 0.0
        for r in range(m):
            value_b[r] -= tableau[r, enter] * move
        value_b[row] = start + move
        leave = basis[row]
        if leave < n:
            side[leave] = -direction
        else:
            side[leave] = 1.0  # nonbasic at 0
        side[enter] = 0.0
        basis[row] = enter
        inverse = 1.0 / pivot
        for j in range(total):
            tableau[row, j] *= inverse
        for r in range(m):
            if r != row:
                factor = tableau[r, enter]
                if factor != 0.0:
                    for j in range(total):
                        tableau[r, j] -= factor * tableau[row, j]
                    tableau[r, enter] = 0.0
        factor = cost[enter]
        if factor != 0.0:
            for j in range(total):
                cost[j] -= factor * tableau[row, j]
        cost[enter] = 0.0
    for r in range(m):
        beta[r] = -cost[ends + r] * scale[r]
    value = 0.0
    for j in range(n):
        value += w[j] * abs(cost[j])
    return value, proven
