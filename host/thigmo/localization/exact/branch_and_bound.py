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
from thigmo.localization.exact.response import find_edges, first_influence, plain
from thigmo.localization.exact.square_fit import square_fit, triangle

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@compiled_sums
def heap_push(heap: Floats, size: int, key: float, item: int) -> int:
    """Add to a binary heap of rows (key, item), least key first; returns the new size."""
    k = size
    while k > 0:
        parent = (k - 1) >> 1
        if heap[parent, 0] <= key:
            break
        heap[k, 0] = heap[parent, 0]
        heap[k, 1] = heap[parent, 1]
        k = parent
    heap[k, 0] = key
    heap[k, 1] = item
    return size + 1


@compiled_sums
def heap_pop(heap: Floats, size: int) -> tuple[float, int]:
    """Take the least of `size` entries."""
    top = heap[0, 0]
    item = int(heap[0, 1])
    key = heap[size - 1, 0]
    last = heap[size - 1, 1]
    n = size - 1
    k = 0
    while True:
        child = 2 * k + 1
        if child >= n:
            break
        if child + 1 < n and heap[child + 1, 0] < heap[child, 0]:
            child += 1
        if heap[child, 0] >= key:
            break
        heap[k, 0] = heap[child, 0]
        heap[k, 1] = heap[child, 1]
        k = child
    heap[k, 0] = key
    heap[k, 1] = last
    return top, item


@compiled_sums
def grown(array: Floats) -> Floats:
    """A copy with twice the rows."""
    rows, columns = array.shape
    out = np.empty((2 * rows, columns))
    for r in range(rows):
        for k in range(columns):
            out[r, k] = array[r, k]
    return out


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
                    g, y[i:], w[i:], plain(2), j - i, plain(0), kind, beta, tableau, work, items
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
def describe_cells(
    low: Floats, span: Floats, edges: Floats, cells: int, before: Ints, beyond: Ints, bent: Ints
) -> None:
    """Per cell between edges: sensors wholly before it (a prefix), the first of those wholly
    beyond it (a suffix), and whether it lies inside a span.

    Args:
        low: (N,).
        span: (N,).
        edges: (cells + 1,).
        cells: how many.
        before: (cells,) written.
        beyond: (cells,) written.
        bent: (cells,) written.
    """
    n = low.shape[0]
    for k in range(cells):
        before[k] = 0
        while before[k] < n and low[before[k]] + span[before[k]] <= edges[k]:
            before[k] += 1
        beyond[k] = n
        while beyond[k] > 0 and low[beyond[k] - 1] >= edges[k + 1]:
            beyond[k] -= 1
        bent[k] = 0
        for j in range(before[k], beyond[k]):
            if low[j] < 0.5 * (edges[k] + edges[k + 1]) < low[j] + span[j]:
                bent[k] = 1


@compiled_sums
def combine_cells(
    edges: Floats,
    start: int,
    cells: int,
    before: Ints,
    beyond: Ints,
    table: Floats,
    tail: Floats,
    contacts: int,
    sign: int,
    limits: Floats,
    bar: float,
) -> tuple[Floats, Floats, int]:
    """All ordered combinations of cells whose table bound is at most `bar`.

    Returns:
        nodes, heap and number of nodes. A node is a row: C near ends, C far ends, C signs, C cells.
    """
    c = contacts
    nodes = np.empty((1024, 4 * c))
    heap = np.empty((1024, 2))
    size = plain(0)
    cell = np.zeros(3, np.int64)
    # From the tip inwards, so that what is lost beyond the last contact cuts first. Loops of
    # contacts that are not there run once.
    for ka in range(cells - 1, start - 1, -1):
        bound_a = tail[beyond[ka]]
        if bound_a > bar:
            continue
        for kb in range(ka if c > 1 else start, start - 1, -1):
            bound_b = bound_a
            if c > 1 and before[ka] > beyond[kb]:
                bound_b += table[beyond[kb], before[ka]]
            if bound_b > bar:
                continue
            for kc in range(kb if c > 2 else start, start - 1, -1):
                bound = bound_b
                if c > 2 and before[kb] > beyond[kc]:
                    bound += table[beyond[kc], before[kb]]
                cell[c - 1] = ka
                if c > 1:
                    cell[c - 2] = kb
                if c > 2:
                    cell[0] = kc
                bound += table[0, before[cell[0]]]
                inside = bound <= bar
                for j in range(c):
                    inside = inside and edges[cell[j]] <= limits[j, 1]
                    inside = inside and edges[cell[j] + 1] >= limits[j, 0]
                if not inside:
                    continue
                if size == nodes.shape[0]:
                    nodes = grown(nodes)
                    heap = grown(heap)
                for j in range(c):
                    nodes[size, j] = max(edges[cell[j]], limits[j, 0])
                    nodes[size, c + j] = min(edges[cell[j] + 1], limits[j, 1])
                    nodes[size, 2 * c + j] = sign
                    nodes[size, 3 * c + j] = cell[j]
                size = heap_push(heap, size, bound, size)
    return nodes, heap, size


@compiled_sums
def bezier_points(
    node: Floats,
    contacts: int,
    bent: Ints,
    low: Floats,
    span: Floats,
    inverse: Floats,
    active: Ints,
    count: int,
    g: Floats,
    kind: Ints,
    group: Ints,
    offset: Ints,
) -> int:
    """Rows of g: influences at both ends of each contact's box and, in a span, their middle point.

    Args:
        node: one row of nodes.
        contacts: C.
        bent: (cells,) whether a cell lies in a span.
        low: (N,).
        span: (N,).
        inverse: (N,).
        active: sensors that take part.
        count: how many.
        g: written.
        kind: written: sign of each row.
        group: written: contact of each row.
        offset: (C + 1,) written: first row of each contact.

    Returns:
        Number of rows.
    """
    c = contacts
    m = 0
    for j in range(c):
        offset[j] = m
        left = node[j]
        right = node[c + j]
        three = bent[int(node[3 * c + j])] == 1 and right > left
        for q in range(count):
            i = active[q]
            a = left - low[i]
            b = right - low[i]
            t = 0.5 * (a + b)
            if t <= 0.0:
                at_left = 0.0
                at_right = 0.0
                middle = 0.0
            elif t >= span[i]:
                at_left = a - 0.5 * span[i]
                at_right = b - 0.5 * span[i]
                middle = t - 0.5 * span[i]
            else:
                at_left = a * a * inverse[i]
                at_right = b * b * inverse[i]
                middle = a * b * inverse[i]
            g[m, q] = at_left
            g[m + 1, q] = at_right
            if three:
                g[m + 2, q] = middle
        rows = 3 if three else 2
        for r in range(m, m + rows):
            kind[r] = int(node[2 * c + j])
            group[r] = j
        m += rows
    offset[c] = m
    return m


@compiled_sums
def read_contacts(
    node: Floats,
    contacts: int,
    beta: Floats,
    offset: Ints,
    limit: float,
    arc: Floats,
    force: Floats,
) -> int:
    """Arcs and forces that a relaxed fit stands for.

    Returns:
        The contact whose signs are mixed worst (by the base moment that this is worth) or whose
        force passes the limit, sign not yet known; -1 if there is none.
    """
    c = contacts
    mixed = -1
    mixed_by = 0.0
    for j in range(c):
        total = 0.0
        plus = 0.0
        minus = 0.0
        moment = 0.0
        for r in range(offset[j], offset[j + 1]):
            total += beta[r]
            plus += max(beta[r], 0.0)
            minus += max(-beta[r], 0.0)
            place = 0.0 if r == offset[j] else (1.0 if r == offset[j] + 1 else 0.5)
            moment += beta[r] * place
        left = node[j]
        right = node[c + j]
        mixture = max(min(plus, minus) * (right - left), (abs(total) - limit) * right)
        if node[2 * c + j] == 0.0 and mixture > max(mixed_by, 1e-9 * max(plus, minus) * left):
            mixed_by = mixture
            mixed = j
        share = moment / total if total != 0.0 else 0.5
        arc[j] = left + min(max(share, 0.0), 1.0) * (right - left)
        force[j] = total
    return mixed


@compiled_sums
def loosest(
    node: Floats,
    contacts: int,
    low: Floats,
    span: Floats,
    inverse: Floats,
    active: Ints,
    count: int,
    weights: Floats,
    arc: Floats,
    force: Floats,
    beta: Floats,
    offset: Ints,
    least: float,
) -> int:
    """The contact whose hull is furthest from its curve of influences; -1 if all touch."""
    c = contacts
    widest = 0.0
    split = -1
    for j in range(c):
        left = node[j]
        right = node[c + j]
        if offset[j + 1] - offset[j] < 3 or right - left <= least:
            continue
        spread = 0.0
        for q in range(count):
            i = active[q]
            a = left - low[i]
            b = right - low[i]
            if 0.0 < 0.5 * (a + b) < span[i]:
                t = arc[j] - low[i]
                hull = beta[offset[j]] * a * a + beta[offset[j] + 1] * b * b
                hull += beta[offset[j] + 2] * a * b
                spread += weights[q] * abs(hull - force[j] * t * t) * inverse[i]
        if spread > widest:
            widest = spread
            split = j
    return split


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
        ceiling: boxes that cannot get below it are given up unsolved, and the search ends once it
            is `slack` below it (inf for none).
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
    cells = find_edges(low, span, length, edges) - 1
    start = first_influence(low, edges, cells + 1)
    before = np.empty(cells, np.int64)
    beyond = np.empty(cells, np.int64)
    bent = np.empty(cells, np.int64)
    describe_cells(low, span, edges, cells, before, beyond, bent)
    rows = 3 * c
    tableau = np.empty((rows + 1, n + c + rows))
    work = np.empty((6, n + c + rows))
    items = np.empty((4, n + 2 * c + rows), np.int64)
    square = np.empty((5, rows + c + 1, rows + c + 1))
    g = np.empty((rows, n + c))
    group = np.zeros(rows, np.int64)
    kind = np.empty(rows + c, np.int64)
    beta = np.zeros(rows + c)
    inner = np.zeros(2 * c)
    active = np.empty(max(n, 1), np.int64)
    data = np.empty(n + c)
    weights = np.empty(n)
    arc = np.empty(c)
    force = np.empty(c)
    offset = np.zeros(c + 1, np.int64)
    # What sensors read if no contact reaches them.
    tail = np.zeros(n + 1)
    for j in range(n - 1, -1, -1):
        tail[j] = tail[j + 1] + (w[j] * abs(y[j]) if norm == 1 else (w[j] * y[j]) ** 2)

    best = tail[0] if tail[0] <= ceiling else np.inf
    for j in range(c):
        arcs[j] = min(max(length, limits[j, 0]), limits[j, 1])
        forces[j] = 0.0
    lower = min(best, ceiling)
    table = line_table(low, span, y, w, norm, tableau, work, items)
    nodes, heap, used = combine_cells(
        edges, start, cells, before, beyond, table, tail, c, sign, limits, lower - slack
    )
    size = used
    freed = -1  # nodes given back form a list through their first entry
    done = 0
    while size > 0:
        bound, item = heap_pop(heap, size)
        size -= 1
        if (
            bound > min(best, ceiling) - slack
            or done >= max_nodes
            or (ceiling < np.inf and best <= ceiling - slack)
        ):
            lower = min(lower, bound)
            break
        done += 1
        node = nodes[item]
        # Sensors up to the last contact take part, the others read what they read.
        furthest = node[c]
        for j in range(1, c):
            furthest = max(furthest, node[c + j])
        constant = 0.0
        count = plain(0)
        for i in range(n):
            if low[i] < furthest:
                active[count] = i
                data[count] = y[i]
                weights[count] = w[i]
                count += 1
            else:
                constant += tail[i] - tail[i + 1]
        m = bezier_points(node, c, bent, low, span, inverse, active, count, g, kind, group, offset)
        split = -1
        mixed = -1
        # First the relaxed fit over the hulls, a lower bound; then the best forces at the arcs
        # that it stands for, an upper bound; if those pass the limit, the best within it.
        for stage in range(3):
            extra = plain(0)
            if stage == 0:
                for j in range(c):
                    if node[2 * c + j] != 0.0:
                        for r in range(m):
                            g[r, count + extra] = node[2 * c + j] if group[r] == j else 0.0
                        data[count + extra] = limit
                        extra += 1
            else:
                m = c
                for j in range(c):
                    kind[j] = sign
                    group[j] = j
                    if stage == 2:
                        kind[j] = 1 if force[j] >= 0.0 else -1
                        for r in range(c):
                            g[r, count + j] = kind[j] if r == j else 0.0
                        data[count + j] = limit
                        extra = c
                    for q in range(count):
                        t = arc[j] - low[active[q]]
                        inside = min(max(t, 0.0), span[active[q]])
                        reach = max(t, span[active[q]]) - span[active[q]]
                        g[j, q] = inside * inside * inverse[active[q]] + reach
            value, proven = signed_fit(
                g,
                data,
                weights,
                m,
                count,
                extra,
                limit,
                group,
                c if stage != 1 else plain(0),
                norm,
                kind,
                beta,
                tableau,
                work,
                items,
                square,
            )
            if stage == 0:
                if proven:
                    bound = max(bound, value + constant - 1e-14 * tail[0])
                if bound > min(best, ceiling) - slack:
                    break
                mixed = read_contacts(node, c, beta, offset, limit, arc, force)
                if mixed < 0:
                    split = loosest(
                        node,
                        c,
                        low,
                        span,
                        inverse,
                        active,
                        count,
                        weights,
                        arc,
                        force,
                        beta,
                        offset,
                        1e-12 * length,
                    )
                if mixed >= 0 and done > 4:
                    break  # arcs read off mixed signs are poor upper bounds
                continue
            within = True
            for j in range(c):
                within = within and abs(beta[j]) <= limit
                inner[j] = min(max(beta[j], -limit), limit)
            if not within and stage == 1:
                continue
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
            break
        if bound > min(best, ceiling) - slack or (mixed < 0 and split < 0):
            # Given up; or the relaxed solution is a true one and nothing here is below it.
            lower = min(lower, bound)
            node[0] = freed
            freed = item
            continue
        if freed >= 0:
            other = freed
            freed = int(nodes[other, 0])
        else:
            if used == nodes.shape[0]:
                nodes = grown(nodes)
            other = used
            used += 1
        if size + 2 > heap.shape[0]:
            heap = grown(heap)
        for k in range(4 * c):
            nodes[other, k] = nodes[item, k]
        if mixed >= 0:
            nodes[item, 2 * c + mixed] = 1.0
            nodes[other, 2 * c + mixed] = -1.0
        else:
            left = nodes[item, split]
            right = nodes[item, c + split]
            cut = arc[split]
            if min(cut - left, right - cut) < 0.1 * (right - left):
                cut = 0.5 * (left + right)
            nodes[item, c + split] = cut
            nodes[other, split] = cut
        size = heap_push(heap, size, bound, item)
        size = heap_push(heap, size, bound, other)
    return best, min(lower, min(best, ceiling)), done
