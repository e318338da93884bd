"""Global L1 fit of one contact to hundreds of sensors.

Branch and bound along the body. Behind the contact the curvature is a straight line, so the best
line through the sensors wholly behind a stretch, plus what the sensors wholly beyond it read,
bounds every contact within it; both terms are monotone, so few stretches are looked at. A stretch
of one cell is settled by a fit to the Bezier points of its influences, which is exact where no span
holds the contact and converges with the square of the stretch where one does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_sums
from thigmo.localization.exact.absolute_fit import absolute_fit, crossing
from thigmo.localization.exact.branch_and_bound import heap_pop, heap_push
from thigmo.localization.exact.one_contact_l2 import fit_l2
from thigmo.localization.exact.response import (
    INNER_END,
    find_edges,
    first_influence,
    objective_l1,
    plain,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@compiled_sums
def dense_profile(
    arc: float,
    y: Floats,
    low: Floats,
    span: Floats,
    inverse: Floats,
    w: Floats,
    f_low: float,
    f_high: float,
    key: Floats,
    amount: Floats,
    order: Ints,
) -> tuple[float, float]:
    """Least objective over f at one arc, and that f: a weighted median by selection.

    Args:
        arc: place of the contact.
        y: (N,).
        low: (N,).
        span: (N,).
        inverse: (N,).
        w: (N,).
        f_low: least f.
        f_high: largest f.
        key: (N,) work.
        amount: (N,) work.
        order: (N,) work.
    """
    count = plain(0)
    half = 0.0
    for j in range(y.shape[0]):
        inside = min(max(arc - low[j], 0.0), span[j])
        phi = inside * inside * inverse[j] + (max(arc - low[j], span[j]) - span[j])
        if phi > 0.0:
            key[j] = y[j] / phi
            amount[j] = w[j] * phi
            half += 0.5 * amount[j]
            order[count] = j
            count += 1
    force = min(max(0.0, f_low), f_high)
    if count > 0:
        place = min(crossing(key, amount, order, count, half), count - 1)
        force = min(max(key[order[place]], f_low), f_high)
    return objective_l1(arc, force, y, low, span, inverse, w), force


@compiled_sums
def fit_dense_l1(
    y: Floats,
    low: Floats,
    span: Floats,
    w: Floats,
    length: float,
    f_low: float,
    f_high: float,
    tolerance: float,
) -> tuple[float, float, float, float, float, int]:
    """One problem, sensors ordered by their centres, forces of either sign or of one.

    Args:
        y: (N,) readings above free curvature.
        low: (N,) near ends.
        span: (N,).
        w: (N,) weights, > 0.
        length: everted length.
        f_low: least f, -inf or 0.
        f_high: largest f, inf or 0.
        tolerance: relative to the objective at f = 0.

    Returns:
        objective, arc, force, both ends of the optimum range around it, number of fits.
    """
    n = y.shape[0]
    inverse = np.zeros(n)
    for j in range(n):
        if span[j] > 0.0:
            inverse[j] = 0.5 / span[j]
    edges = np.empty(2 * n + 2)
    n_edges = find_edges(low, span, length, edges)
    start = first_influence(low, edges, n_edges)
    cells = n_edges - 1
    key = np.empty(n)
    amount = np.empty(n)
    order = np.empty(max(n, 1), np.int64)
    tableau = np.empty((3, n + 3))
    work = np.empty((6, n + 3))
    items = np.empty((4, n + 3), np.int64)
    g = np.empty((3, max(n, 1)))
    kind = np.zeros(3, np.int64)
    beta = np.zeros(3)

    tail = np.zeros(n + 1)
    for j in range(n - 1, -1, -1):
        tail[j] = tail[j + 1] + w[j] * abs(y[j])
    slack = tolerance * tail[0]
    before = np.zeros(cells, np.int64)
    beyond = np.zeros(cells, np.int64)
    j = 0
    for k in range(cells):
        while j < n and low[j] + span[j] <= edges[k]:
            j += 1
        before[k] = j
    j = n
    for k in range(cells - 1, -1, -1):
        while j > 0 and low[j - 1] >= edges[k + 1]:
            j -= 1
        beyond[k] = j
    line = np.full(n + 1, -1.0)

    # A first upper bound from least squares, then from the profile near it.
    by_low = np.empty(max(n, 1), np.int64)
    for j in range(n):
        k = j
        while k > 0 and low[by_low[k - 1]] > low[j]:
            by_low[k] = by_low[k - 1]
            k -= 1
        by_low[k] = j
    near = np.empty((2, 256))
    small = np.zeros((9, 6))
    ranges = np.empty((4, 2))
    value, guess, force, _pieces = fit_l2(
        y,
        low,
        span,
        inverse,
        w,
        by_low,
        edges,
        n_edges,
        f_low,
        f_high,
        1e-9,
        order,
        near,
        small,
        ranges,
    )
    best = tail[0]
    best_arc = length
    best_force = 0.0
    value, force = dense_profile(guess, y, low, span, inverse, w, f_low, f_high, key, amount, order)
    if value < best:
        best = value
        best_arc = guess
        best_force = force

    capacity = 4 * cells + 64
    heap = np.empty((capacity, 2))
    first = np.empty(capacity, np.int64)
    last = np.empty(capacity, np.int64)
    first[0] = start
    last[0] = cells
    size = heap_push(heap, plain(0), 0.0, plain(0))
    used = 1
    fits = 0
    boxes = np.empty((128, 2))
    signs = np.empty(128, np.int64)
    while size > 0:
        bound, item = heap_pop(heap, size)
        size -= 1
        if bound > best - slack:
            break
        a = first[item]
        b = last[item]
        if b - a > 1:
            middle = (a + b) >> 1
            for side in range(2):
                k0 = a if side == 0 else middle
                k1 = middle if side == 0 else b
                rest = tail[beyond[k1 - 1]]
                m = before[k0]
                if rest > best - slack:
                    continue
                if m >= 3 and line[m] < 0.0:
                    for k in range(m):
                        g[0, k] = 1.0
                        g[1, k] = low[k] + 0.5 * span[k] - low[0]
                    kind[0] = 0
                    kind[1] = 0
                    value, proven = absolute_fit(
                        g, y, w, plain(2), m, plain(0), kind, beta, tableau, work, items
                    )
                    fits += 1
                    line[m] = value * (1.0 - 1e-13) if proven else 0.0
                child = rest + (line[m] if m >= 3 else 0.0)
                if child > best - slack:
                    continue
                first[used] = k0
                last[used] = k1
                size = heap_push(heap, size, max(child, bound), used)
                used += 1
            continue
        # One cell.
        middle_arc = 0.5 * (edges[a] + edges[b])
        count = beyond[a]
        curved = False
        for j in range(before[a], count):
            curved = curved or (low[j] < middle_arc < low[j] + span[j])
        boxes[0, 0] = edges[a]
        boxes[0, 1] = edges[b]
        signs[0] = int(f_low == 0.0) - int(f_high == 0.0)
        waiting = 1
        while waiting > 0:
            waiting -= 1
            left = boxes[waiting, 0]
            right = boxes[waiting, 1]
            sign = signs[waiting]
            m = plain(3) if curved else plain(2)
            for j in range(count):
                t0 = left - low[j]
                t1 = right - low[j]
                t = 0.5 * (t0 + t1)
                if t <= 0.0:
                    g[0, j] = 0.0
                    g[1, j] = 0.0
                    g[2, j] = 0.0
                elif t >= span[j]:
                    g[0, j] = t0 - 0.5 * span[j]
                    g[1, j] = t1 - 0.5 * span[j]
                    g[2, j] = t - 0.5 * span[j]
                else:
                    g[0, j] = t0 * t0 * inverse[j]
                    g[1, j] = t1 * t1 * inverse[j]
                    g[2, j] = t0 * t1 * inverse[j]
            for r in range(m):
                kind[r] = sign
            value, proven = absolute_fit(
                g, y, w, m, count, plain(0), kind, beta, tableau, work, items
            )
            fits += 1
            value += tail[count]
            if proven and value > best - slack:
                continue
            total = 0.0
            plus = 0.0
            minus = 0.0
            for r in range(m):
                total += beta[r]
                plus += max(beta[r], 0.0)
                minus += max(-beta[r], 0.0)
            if sign == 0 and min(plus, minus) > 1e-12 * max(plus, minus):
                for s in range(2):
                    boxes[waiting, 0] = left
                    boxes[waiting, 1] = right
                    signs[waiting] = 1 - 2 * s
                    waiting += 1
                continue
            share = 0.5
            if total != 0.0:
                share = (beta[1] + (0.5 * beta[2] if m == 3 else 0.0)) / total
            share = min(max(share, 0.0), 1.0)
            arc = left + share * (right - left)
            if a == start and arc <= edges[start]:
                arc += INNER_END * (right - left)
            value, force = dense_profile(
                arc, y, low, span, inverse, w, f_low, f_high, key, amount, order
            )
            if value < best:
                best = value
                best_arc = arc
                best_force = force
            if curved and right - left > 1e-12 * length and waiting < 126:
                if min(share, 1.0 - share) < 0.1:
                    arc = 0.5 * (left + right)
                for s in range(2):
                    boxes[waiting, 0] = left if s == 0 else arc
                    boxes[waiting, 1] = arc if s == 0 else right
                    signs[waiting] = sign
                    waiting += 1

    # Flat optimum: walk outwards over ends of cells, then halve the last cell.
    reach = np.empty(2)
    for side in range(2):
        good = best_arc
        step = 1.0 - 2.0 * side
        value, force = dense_profile(
            min(max(good + step * 1e-7 * length, 0.0), length),
            y,
            low,
            span,
            inverse,
            w,
            f_low,
            f_high,
            key,
            amount,
            order,
        )
        if value <= best + slack:
            bad = np.nan
            for k in range(n_edges):
                e = edges[k] if side == 0 else edges[n_edges - 1 - k]
                if (e - good) * step <= 0.0:
                    continue
                value, force = dense_profile(
                    e, y, low, span, inverse, w, f_low, f_high, key, amount, order
                )
                if value > best + slack:
                    bad = e
                    break
                good = e
            if bad == bad:
                for _ in range(40):
                    middle_arc = 0.5 * (good + bad)
                    value, force = dense_profile(
                        middle_arc, y, low, span, inverse, w, f_low, f_high, key, amount, order
                    )
                    if value <= best + slack:
                        good = middle_arc
                    else:
                        bad = middle_arc
        reach[side] = good
    return best, best_arc, best_force, reach[1], reach[0], fits
