"""Cells between ends of spans, and which combinations of them can hold the contacts.

Between two contacts the curvature is a straight line, so the sum of the independent line fits to
the sensors strictly between cells bounds a combination. Called by `branch_and_bound`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_sums
from thigmo.localization.exact.absolute_fit import SignedFit, Simplex, Size, absolute_fit
from thigmo.localization.exact.heap import grown, heap_push
from thigmo.localization.exact.response import Readings, find_edges, first_influence, plain

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Search(NamedTuple):
    """What is sought.

    Attributes:
        contacts: 1 to 3.
        norm: 1 or 2.
        sign: 0, or the sign that every force must have.
        limit: largest |force|.
        slack: absolute gap at which a box is given up.
        ceiling: boxes that cannot get below it are given up unsolved, and the search ends once it
            is `slack` below it (inf for none).
        max_nodes: the search is cut after as many bounds.
    """

    contacts: int
    norm: int
    sign: int
    limit: float
    slack: float
    ceiling: float
    max_nodes: int


class Cells(NamedTuple):
    """K cells between neighbouring ends of spans.

    Attributes:
        edges: (K + 1,) ascending.
        start: the first cell that matters: before it no sensor answers.
        before: (K,) sensors wholly before each (a prefix).
        beyond: (K,) the first of those wholly beyond it (a suffix).
        bent: (K,) whether it lies inside a span.
    """

    edges: Floats
    start: int
    before: Ints
    beyond: Ints
    bent: Ints


@compiled_sums
def describe_cells(readings: Readings, length: float) -> Cells:
    """The cells of a body of this length, sensors ordered by centre."""
    _, low, span, _, _ = readings
    n = low.shape[0]
    room = np.empty(2 * n + 2)
    cells = find_edges(low, span, length, room) - 1
    edges = room[: cells + 1]
    before = np.empty(cells, np.int64)
    beyond = np.empty(cells, np.int64)
    bent = np.empty(cells, np.int64)
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
    return Cells(edges, first_influence(low, edges), before, beyond, bent)


@compiled_sums
def line_table(readings: Readings, norm: int, simplex: Simplex) -> Floats:
    """(N + 1, N + 1): entry [i, j] is the least objective of one line through sensors i .. j - 1.

    A line sees every sensor wholly on one side of the contacts at its centre, whatever its span.
    """
    y, low, span, _, w = readings
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
                    SignedFit(g, y[i:], w[i:], kind), Size(plain(2), j - i, plain(0)), beta, simplex
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
def combine_cells(
    cells: Cells, table: Floats, tail: Floats, search: Search, places: Floats, bar: float
) -> tuple[Floats, Floats, int]:
    """All ordered combinations of cells whose table bound is at most `bar`.

    Args:
        cells: K of them.
        table: from `line_table`.
        tail: (N + 1,) objective of the sensors from each on, if no contact reaches them.
        search: what is sought.
        places: (contacts, 2) arcs between which each contact must lie.
        bar: bound above which a combination is dropped.

    Returns:
        nodes, heap and number of nodes. A node is a row: C near ends, C far ends, C signs, C cells.
    """
    edges, start, before, beyond, _ = cells
    c = search.contacts
    sign = search.sign
    nodes = np.empty((1024, 4 * c))
    heap = np.empty((1024, 2))
    size = plain(0)
    cell = np.zeros(3, np.int64)
    # From the tip inwards, so that what is lost beyond the last contact cuts first. Loops of
    # contacts that are not there run once.
    for ka in range(before.shape[0] - 1, start - 1, -1):
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
                    inside = inside and edges[cell[j]] <= places[j, 1]
                    inside = inside and edges[cell[j] + 1] >= places[j, 0]
                if not inside:
                    continue
                if size == nodes.shape[0]:
                    nodes = grown(nodes)
                    heap = grown(heap)
                for j in range(c):
                    nodes[size, j] = max(edges[cell[j]], places[j, 0])
                    nodes[size, c + j] = min(edges[cell[j] + 1], places[j, 1])
                    nodes[size, 2 * c + j] = sign
                    nodes[size, 3 * c + j] = cell[j]
                size = heap_push(heap, size, bound, size)
    return nodes, heap, size
