"""Global fits of one to three contacts by branch and bound, with the proven gap.

A box holds each contact within one cell between neighbouring ends of spans. There every sensor's
influence is linear or quadratic in the arc, so the vector of influences runs within the convex hull
of two or three Bezier points, and a contact of known sign contributes a combination of those
points with coefficients of that sign: the least signed fit over them is a lower bound
(`relaxation`). It is exact where no span holds the contact, and elsewhere its error falls with the
square of the box. Signs are branched on only if the free fit mixes them; boxes are split where the
bound is loosest. Cells are combined from a table first (`cells`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_sums
from thigmo.localization.exact.absolute_fit import Size
from thigmo.localization.exact.cells import Search, combine_cells, describe_cells, line_table
from thigmo.localization.exact.heap import grown, heap_pop, heap_push
from thigmo.localization.exact.relaxation import (
    bezier_points,
    empty_relaxed,
    loosest,
    read_contacts,
    signed_fit,
)
from thigmo.localization.exact.response import Readings, plain

Floats = NDArray[np.float64]


@compiled_sums
def fit_several(
    readings: Readings,
    length: float,
    search: Search,
    places: Floats,
    arcs: Floats,
    forces: Floats,
) -> tuple[float, float, int]:
    """Branch and bound.

    Args:
        readings: N of them, sensors ordered by centre, weights > 0.
        length: everted length.
        search: what is sought.
        places: (contacts, 2) arcs between which each contact must lie.
        arcs: (contacts,), written.
        forces: (contacts,), written.

    Returns:
        objective (inf if nothing within the places gets below the ceiling), proven lower bound,
        number of bounds computed.
    """
    y, low, span, inverse, w = readings
    c, norm, sign, limit, slack, ceiling, _ = search
    n = y.shape[0]
    cells = describe_cells(readings, length)
    relaxed, room = empty_relaxed(n, c)
    g, data, weights, kind = relaxed.fit
    active, group, beta = relaxed.active, relaxed.group, relaxed.beta
    arc, force = relaxed.arc, relaxed.force
    inner = np.zeros(2 * c)
    # What sensors read if no contact reaches them.
    tail = np.zeros(n + 1)
    for j in range(n - 1, -1, -1):
        tail[j] = tail[j + 1] + (w[j] * abs(y[j]) if norm == 1 else (w[j] * y[j]) ** 2)

    best = tail[0] if tail[0] <= ceiling else np.inf
    for j in range(c):
        arcs[j] = min(max(length, places[j, 0]), places[j, 1])
        forces[j] = 0.0
    lower = min(best, ceiling)
    table = line_table(readings, norm, room.simplex)
    nodes, heap, used = combine_cells(cells, table, tail, search, places, lower - slack)
    size = used
    freed = -1  # nodes given back form a list through their first entry
    done = 0
    while size > 0:
        bound, item = heap_pop(heap, size)
        size -= 1
        if (
            bound > min(best, ceiling) - slack
            or done >= search.max_nodes
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
        m = bezier_points(node, cells.bent, readings, count, relaxed)
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
                relaxed,
                Size(m, count, extra),
                c if stage != 1 else plain(0),
                limit,
                norm,
                room,
            )
            if stage == 0:
                if proven:
                    bound = max(bound, value + constant - 1e-14 * tail[0])
                if bound > min(best, ceiling) - slack:
                    break
                mixed = read_contacts(node, limit, relaxed)
                if mixed < 0:
                    split = loosest(node, readings, count, relaxed, 1e-12 * length)
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
