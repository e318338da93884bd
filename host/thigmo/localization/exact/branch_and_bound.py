"""Global fits of one to three contacts by branch and bound, with the proven gap.

A box holds each contact within one cell between neighbouring ends of spans. There every sensor's
influence is linear or quadratic in the arc, so the vector of influences runs within the convex hull
of two or three Bezier points, and a contact of known sign contributes a combination of those
points with coefficients of that sign: the least signed fit over them is a lower bound. It is exact
where no span holds the contact, and elsewhere its error falls with the square of the box. Signs are
branched on only if the free fit mixes them; boxes are split where the bound is loosest.

Cells are combined from a table first: between two contacts the curvature is a straight line, so
the sum of the independent line fits to the sensors strictly between cells bounds a combination.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_sums
from thigmo.localization.exact.absolute_fit import absolute_fit
from thigmo.localization.exact.response import find_edges, first_influence
from thigmo.localization.exact.square_fit import square_fit, triangle

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@compiled_sums
def heap_push(keys: Floats, items: Ints, size: int, key: float, item: int) -> int:
    """Add to a binary heap (least key first); returns the new size."""
    k = size
    while k > 0:
        parent = (k - 1) >> 1
        if keys[parent] <= key:
            break
        keys[k] = keys[parent]
        items[k] = items[parent]
        k = parent
    keys[k] = key
    items[k] = item
    return size + 1


@compiled_sums
def heap_pop(keys: Floats, items: Ints, size: int) -> tuple[float, int]:
    """Take the least from a heap of `size` entries."""
    top = keys[0]
    item = items[0]
    key = keys[size - 1]
    last = items[size - 1]
    n = size - 1
    k = 0
    while True:
        child = 2 * k + 1
        if child >= n:
            break
        if child + 1 < n and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[k] = keys[child]
        items[k] = items[child]
        k = child
    keys[k] = key
    items[k] = last
    return top, item


@compiled_sums
def signed_fit(
    g: Floats,
    y: Floats,
    w: Floats,
    m: int,
    n: int,
    extra: int,
    limit: float,
    group: Ints,
    groups: int,
    norm: int,
    kind: Ints,
    beta: Floats,
    tableau: Floats,
    work: Floats,
    items: Ints,
    square: Floats,
) -> tuple[float, bool]:
    """Least sum of |w r| or (w r)^2 over signed coefficients.

    Arguments as `absolute_fit`; and the limit on the sum of |beta| over each `group` of one sign,
    which the constraint columns say to the L1 fit; and `square` (5, m + 4, m + 4) work.
    """
    if norm == 1:
        return absolute_fit(g, y, w, m, n, extra, kind, beta, tableau, work, items)
    triangle(g, y, w, m, n, tableau, square[0], square[1, 0])
    value = square_fit(
        square[0],
        square[1, 0],
        m,
        kind,
        group,
        groups,
        limit,
        beta,
        items[0],
        square[2],
        square[3],
        square[4],
    )
    return value, True


@compiled_sums
def line_table(
    low: Floats,
    span: Floats,
    y: Floats,
    w: Floats,
    norm: int,
    tableau: Floats,
    work: Floats,
    items: Ints,
) -> Floats:
    """(N + 1, N + 1): entry [i, j] is the least objective of one line through sensors i .. j - 1.

    A line sees every sensor wholly on one side of the contacts at its centre, whatever its span.
    """
    n = y.shape[0]
    table = np.zeros((n + 1, n + 1))
    g = np.ones((2, n))
    kind = np.zeros(2, np.int64)
    beta = np.zeros(2)
    if norm == 1:
        for i in range(n):
            for j in range(i + 2, n + 1):
                for k in range(i, j):
                    g[1, k - i] = low[k] + 0.5 * span[k] - low[i]
                value, proven = absolute_fit(
                    g, y[i:], w[i:], 2, j - i, 0, kind, beta, tableau, work, items
                )
                table[i, j] = max(value if proven else 0.0, table[i, j - 1])
        return table
    for i in range(n):
        s0 = 0.0
        s1 = 0.0
        s2 = 0.0
        t0 = 0.0
        t1 = 0.0
        total = 0.0
        origin = low[i] + 0.5 * span[i]
        for j in range(i, n):
            v = w[j] * w[j]
            x = low[j] + 0.5 * span[j] - origin
            s0 += v
            s1 += v * x
            s2 += v * x * x
            t0 += v * y[j]
            t1 += v * y[j] * x
            total += v * y[j] * y[j]
            spread = s2 - s1 * s1 / s0 if s0 > 0.0 else 0.0
            value = total - t0 * t0 / s0 if s0 > 0.0 else 0.0
            if spread > 1e-13 * s2:
                slope = t1 - t0 * s1 / s0
                value -= slope * slope / spread
            # Rounding must not lift a bound.
            table[i, j + 1] = max(value - 1e-13 * total, table[i, j])
    return table


@compiled_sums
def fit_several(
    y: Floats,
    low: Floats,
    span: Floats,
    w: Floats,
    length: float,
    contacts: int,
    norm: int,
    sign: int,
    limit: float,
    slack: float,
    ceiling: float,
    limits: Floats,
    max_nodes: int,
    arcs: Floats,
    forces: Floats,
) -> tuple[float, float, int]:
    """Branch and bound.

    Args:
        y: (N,) readings above free curvature, sensors ordered by centre.
        low: (N,) near ends.
        span: (N,).
        w: (N,) weights, > 0.
        length: everted length.
        contacts: 1 to 3.
        norm: 1 or 2.
        sign: 0, or the sign that every force must have.
        limit: largest |force|.
        slack: absolute gap at which a box is given up.
        ceiling: boxes that cannot get below it are given up unsolved (inf for none).
        limits: (contacts, 2) arcs between which each contact must lie.
        max_nodes: the search is cut after as many bounds.
        arcs: (contacts,), written.
        forces: (contacts,), written.

    Returns:
        objective (inf if nothing within the limits gets below the ceiling), proven lower bound,
        number of bounds computed.
    """
    n = y.shape[0]
    c = contacts
    inverse = np.zeros(n)
    for j in range(n):
        if span[j] > 0.0:
            inverse[j] = 0.5 / span[j]
    edges = np.empty(2 * n + 2)
    n_edges = find_edges(low, span, length, edges)
    start = first_influence(low, edges, n_edges)
    cells = n_edges - 1
    rows = 3 * c
    tableau = np.empty((rows + 1, n + c + rows))
    work = np.empty((6, n + c + rows))
    items = np.empty((4, n + 2 * c + rows), np.int64)
    g = np.empty((rows, n + c))
    group = np.zeros(rows, np.int64)
    kind = np.empty(rows + c, np.int64)
    beta = np.zeros(rows + c)
    inner = np.zeros(2 * c)
    square = np.empty((5, rows + c + 1, rows + c + 1))

    table = line_table(low, span, y, w, norm, tableau, work, items)
    tail = np.zeros(n + 1)
    for j in range(n - 1, -1, -1):
        tail[j] = tail[j + 1] + (w[j] * abs(y[j]) if norm == 1 else (w[j] * y[j]) ** 2)
    # Per cell: sensors wholly before it form a prefix, wholly beyond it a suffix.
    before = np.zeros(cells, np.int64)
    beyond = np.zeros(cells, np.int64)
    curved = np.zeros(cells, np.bool_)
    for k in range(cells):
        while before[k] < n and low[before[k]] + span[before[k]] <= edges[k]:
            before[k] += 1
        beyond[k] = n
        while beyond[k] > 0 and low[beyond[k] - 1] >= edges[k + 1]:
            beyond[k] -= 1
        for j in range(n):
            if low[j] < 0.5 * (edges[k] + edges[k + 1]) < low[j] + span[j]:
                curved[k] = True

    best = tail[0]
    for j in range(c):
        arcs[j] = min(max(length, limits[j, 0]), limits[j, 1])
        forces[j] = 0.0
    if best > ceiling:
        best = np.inf

    capacity = 1024
    boxes = np.empty((capacity, 2 * c))
    signs = np.empty((capacity, c), np.int64)
    where = np.empty((capacity, c), np.int64)
    keys = np.empty(capacity)
    heap = np.empty(capacity, np.int64)
    free = np.empty(capacity, np.int64)
    n_free = 0
    used = 0
    size = 0
    cell = np.empty(3, np.int64)
    # Combinations from the tip inwards, so that what is lost beyond the last contact cuts first.
    for ka in range(cells - 1, start - 1, -1):
        bound_a = tail[beyond[ka]]
        if bound_a > min(best, ceiling) - slack:
            continue
        for kb in range(ka if c > 1 else 0, (start if c > 1 else 0) - 1, -1):
            bound_b = bound_a
            if c > 1 and before[ka] > beyond[kb]:
                bound_b += table[beyond[kb], before[ka]]
            if bound_b > min(best, ceiling) - slack:
                continue
            for kc in range(kb if c > 2 else 0, (start if c > 2 else 0) - 1, -1):
                bound = bound_b
                if c > 2 and before[kb] > beyond[kc]:
                    bound += table[beyond[kc], before[kb]]
                if c == 1:
                    cell[0] = ka
                elif c == 2:
                    cell[0] = kb
                    cell[1] = ka
                else:
                    cell[0] = kc
                    cell[1] = kb
                    cell[2] = ka
                bound += table[0, before[cell[0]]]
                if bound > min(best, ceiling) - slack:
                    continue
                outside = False
                for j in range(c):
                    outside = outside or edges[cell[j]] > limits[j, 1]
                    outside = outside or edges[cell[j] + 1] < limits[j, 0]
                if outside:
                    continue
                if used == capacity:
                    boxes = grown(boxes)
                    signs = grown_ints(signs)
                    where = grown_ints(where)
                    more = np.empty(2 * capacity)
                    more[:capacity] = keys
                    keys = more
                    wider = np.empty(2 * capacity, np.int64)
                    wider[:capacity] = heap
                    heap = wider
                    free = np.empty(2 * capacity, np.int64)
                    capacity *= 2
                for j in range(c):
                    boxes[used, 2 * j] = max(edges[cell[j]], limits[j, 0])
                    boxes[used, 2 * j + 1] = min(edges[cell[j] + 1], limits[j, 1])
                    signs[used, j] = sign
                    where[used, j] = cell[j]
                size = heap_push(keys, heap, size, bound, used)
                used += 1

    active = np.empty(max(n, 1), np.int64)
    data = np.empty(n + c)
    weights = np.empty(n)
    arc = np.empty(c)
    force = np.empty(c)
    spread = np.empty(c)
    offset = np.zeros(c + 1, np.int64)
    nodes = 0
    lower = min(best, ceiling)
    while size > 0:
        bound, node = heap_pop(keys, heap, size)
        size -= 1
        if bound > min(best, ceiling) - slack:
            lower = min(lower, bound)
            break
        if nodes >= max_nodes:
            lower = min(lower, bound)
            break
        nodes += 1
        # Sensors up to the last contact take part, the others read what they read.
        furthest = 0.0
        for j in range(c):
            furthest = max(furthest, boxes[node, 2 * j + 1])
        constant = 0.0
        count = 0
        for i in range(n):
            if low[i] < furthest:
                active[count] = i
                data[count] = y[i]
                weights[count] = w[i]
                count += 1
            else:
                constant += w[i] * abs(y[i]) if norm == 1 else (w[i] * y[i]) ** 2
        m = 0
        for j in range(c):
            offset[j] = m
            left = boxes[node, 2 * j]
            right = boxes[node, 2 * j + 1]
            bent = curved[where[node, j]] and right > left
            for q in range(count):
                i = active[q]
                a = left - low[i]
                b = right - low[i]
                t = 0.5 * (a + b)
                if t <= 0.0:
                    g[m, q] = 0.0
                    g[m + 1, q] = 0.0
                    middle = 0.0
                elif t >= span[i]:
                    g[m, q] = a - 0.5 * span[i]
                    g[m + 1, q] = b - 0.5 * span[i]
                    middle = t - 0.5 * span[i]
                else:
                    g[m, q] = a * a * inverse[i]
                    g[m + 1, q] = b * b * inverse[i]
                    middle = a * b * inverse[i]
                if bent:
                    g[m + 2, q] = middle
            width = 3 if bent else 2
            for r in range(m, m + width):
                kind[r] = signs[node, j]
                group[r] = j
            m += width
        offset[c] = m
        extra = 0
        for j in range(c):
            if signs[node, j] != 0:
                for r in range(m):
                    g[r, count + extra] = signs[node, j] if group[r] == j else 0.0
                data[count + extra] = limit
                extra += 1
        value, proven = signed_fit(
            g,
            data,
            weights,
            m,
            count,
            extra,
            limit,
            group,
            c,
            norm,
            kind,
            beta,
            tableau,
            work,
            items,
            square,
        )
        value += constant
        if proven:
            bound = max(bound, value - 1e-14 * tail[0])
        if bound > min(best, ceiling) - slack:
            lower = min(lower, bound)
            free[n_free] = node
            n_free += 1
            continue
        # Read contacts off the relaxed solution.
        mixed = -1
        mixed_by = 0.0
        for j in range(c):
            total = 0.0
            plus = 0.0
            minus = 0.0
            moment = 0.0
            left = boxes[node, 2 * j]
            right = boxes[node, 2 * j + 1]
            for r in range(offset[j], offset[j + 1]):
                b = beta[r]
                total += b
                if b > 0.0:
                    plus += b
                else:
                    minus -= b
                place = 0.0 if r == offset[j] else (1.0 if r == offset[j] + 1 else 0.5)
                moment += b * place
            # How much a mixture of signs matters: the change of base moment that it stands for.
            mixture = min(plus, minus) * (right - left)
            mixture = max(mixture, (abs(total) - limit) * right)
            if signs[node, j] == 0 and mixture > max(mixed_by, 1e-9 * max(plus, minus) * left):
                mixed_by = mixture
                mixed = j
            share = moment / total if total != 0.0 else 0.5
            share = min(max(share, 0.0), 1.0)
            arc[j] = left + share * (right - left)
            force[j] = total
        # An upper bound: the best forces at these arcs. And how far the hull is from the curve.
        for j in range(c):
            kind[j] = sign
            for q in range(count):
                i = active[q]
                inside = min(max(arc[j] - low[i], 0.0), span[i])
                g[j, q] = inside * inside * inverse[i] + (max(arc[j] - low[i], span[i]) - span[i])
            spread[j] = 0.0
            left = boxes[node, 2 * j]
            right = boxes[node, 2 * j + 1]
            if offset[j + 1] - offset[j] < 3 or right - left <= 1e-12 * length:
                continue
            for q in range(count):
                i = active[q]
                a = left - low[i]
                b = right - low[i]
                if 0.0 < 0.5 * (a + b) < span[i]:
                    hull = beta[offset[j]] * a * a + beta[offset[j] + 1] * b * b
                    hull = (hull + beta[offset[j] + 2] * a * b) * inverse[i]
                    spread[j] += weights[q] * abs(hull - force[j] * g[j, q])
        for attempt in range(2):
            # The best forces at these arcs; if they pass the limit, the best of these signs within.
            extra = 0
            if attempt == 1:
                for j in range(c):
                    kind[j] = 1 if force[j] >= 0.0 else -1
                    group[j] = j
                    for other in range(c):
                        g[other, count + j] = kind[j] if other == j else 0.0
                    data[count + j] = limit
                extra = c
            value, proven = signed_fit(
                g,
                data,
                weights,
                c,
                count,
                extra,
                limit,
                group,
                extra,
                norm,
                kind,
                inner,
                tableau,
                work,
                items,
                square,
            )
            within = True
            for j in range(c):
                within = within and abs(inner[j]) <= limit
            if within:
                break
        for j in range(c):
            inner[j] = min(max(inner[j], -limit), limit)
        value = constant
        for q in range(count):
            r = data[q]
            for j in range(c):
                r -= inner[j] * g[j, q]
            value += weights[q] * abs(r) if norm == 1 else (weights[q] * r) ** 2
        if value < best:
            best = value
            for j in range(c):
                arcs[j] = arc[j]
                forces[j] = inner[j]
        split = -1
        if mixed < 0:
            widest = 0.0
            for j in range(c):
                if spread[j] > widest:
                    widest = spread[j]
                    split = j
        if bound > min(best, ceiling) - slack or (mixed < 0 and split < 0):
            # Given up, or the relaxed solution is a true one and nothing here is below it.
            lower = min(lower, bound)
            free[n_free] = node
            n_free += 1
            continue
        cut = 0.0
        end = 0.0
        if mixed < 0:
            left = boxes[node, 2 * split]
            end = boxes[node, 2 * split + 1]
            cut = arc[split]
            if min(cut - left, end - cut) < 0.1 * (end - left):
                cut = 0.5 * (left + end)
        for child in range(2):
            if child == 0:
                target = node
            elif n_free > 0:
                n_free -= 1
                target = free[n_free]
            else:
                if used == capacity:
                    boxes = grown(boxes)
                    signs = grown_ints(signs)
                    where = grown_ints(where)
                    more = np.empty(2 * capacity)
                    more[:capacity] = keys
                    keys = more
                    wider = np.empty(2 * capacity, np.int64)
                    wider[:capacity] = heap
                    heap = wider
                    free = np.empty(2 * capacity, np.int64)
                    capacity *= 2
                target = used
                used += 1
            if child == 1:
                for j in range(c):
                    boxes[target, 2 * j] = boxes[node, 2 * j]
                    boxes[target, 2 * j + 1] = boxes[node, 2 * j + 1]
                    signs[target, j] = signs[node, j]
                    where[target, j] = where[node, j]
            if mixed >= 0:
                signs[target, mixed] = 1 if child == 0 else -1
            else:
                boxes[target, 2 * split] = boxes[node, 2 * split] if child == 0 else cut
                boxes[target, 2 * split + 1] = cut if child == 0 else end
            size = heap_push(keys, heap, size, bound, target)
    if size == 0:
        lower = min(lower, min(best, ceiling))
    return best, lower, nodes


@compiled_sums
def grown(array: Floats) -> Floats:
    """A copy with twice the rows."""
    out = np.empty((2 * array.shape[0], array.shape[1]))
    out[: array.shape[0]] = array
    return out


@compiled_sums
def grown_ints(array: Ints) -> Ints:
    """A copy with twice the rows."""
    out = np.empty((2 * array.shape[0], array.shape[1]), np.int64)
    out[: array.shape[0]] = array
    return out
