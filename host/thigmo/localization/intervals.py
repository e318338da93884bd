"""Credible intervals of a density given on sorted nodes, compiled.

The interval of a contact is the shortest one that holds 95 % of the posterior: it is closed at the
base and at the tip, where equal-tailed intervals would leave the end itself out. Beside it the
highest-density set, which may be several pieces: its pieces are the modes.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled, compiled_inner

Array = npt.NDArray[np.float64]


@compiled_inner
def cell_mass(width: float, step: float, left: float, right: float) -> float:
    """Integral over a cell of a density whose log is linear and changes by `step`.

    `left` and `right` are the densities at its ends.
    """
    if abs(step) < 1e-6:
        return width * 0.5 * (left + right)
    return width * (right - left) / step


@compiled_inner
def within(share: float, left: float, right: float) -> float:
    """Place 0..1 in a cell below which `share` of the cell's mass lies."""
    difference = right - left
    share = min(max(share, 1e-15), 1.0 - 1e-15)
    if abs(difference) < 1e-6:
        return share
    # Measured from the denser end, which keeps the numbers small.
    if difference > 0.0:
        return 1.0 + math.log(share + (1.0 - share) * math.exp(-difference)) / difference
    return math.log(1.0 - share + share * math.exp(difference)) / difference


@compiled_inner
def masses(arcs: Array, logp: Array, count: int, cumulative: Array) -> float:
    """Fill `cumulative` (count,) with the mass below each node, of a total of one.

    Returns:
        Log of the total mass.
    """
    top = -1e300
    for j in range(count):
        top = max(top, logp[j])
    cumulative[0] = 0.0
    left = math.exp(logp[0] - top)
    for j in range(count - 1):
        right = math.exp(logp[j + 1] - top)
        mass = cell_mass(arcs[j + 1] - arcs[j], logp[j + 1] - logp[j], left, right)
        cumulative[j + 1] = cumulative[j] + mass
        left = right
    total = cumulative[count - 1]
    for j in range(count):
        cumulative[j] /= total
    return top + math.log(total)


@compiled_inner
def shortest(
    arcs: Array, logp: Array, count: int, cumulative: Array, level: float
) -> tuple[float, float]:
    """Shortest interval that holds `level` of the mass (one end is tried at every node)."""
    low = arcs[0]
    high = arcs[count - 1]
    j = 0
    for i in range(count):
        goal = cumulative[i] + level
        if goal > 1.0 + 1e-12:
            break
        while j < count - 2 and cumulative[j + 1] < goal:
            j += 1
        if arcs[j] - arcs[i] >= high - low:
            continue
        cell = max(cumulative[j + 1] - cumulative[j], 1e-300)
        share = min(max((goal - cumulative[j]) / cell, 0.0), 1.0)
        end = arcs[j] + (arcs[j + 1] - arcs[j]) * within(share, logp[j], logp[j + 1])
        if end - arcs[i] < high - low:
            low = arcs[i]
            high = end
    j = count - 1
    for i in range(count - 1, -1, -1):
        goal = cumulative[i] - level
        if goal < -1e-12:
            break
        while j > 1 and cumulative[j - 1] > goal:
            j -= 1
        if arcs[i] - arcs[j] >= high - low:
            continue
        cell = max(cumulative[j] - cumulative[j - 1], 1e-300)
        share = min(max((goal - cumulative[j - 1]) / cell, 0.0), 1.0)
        start = arcs[j - 1] + (arcs[j] - arcs[j - 1]) * within(share, logp[j - 1], logp[j])
        if arcs[i] - start < high - low:
            low = start
            high = arcs[i]
    return low, high


@compiled
def modes(arcs: Array, logp: Array, count: int, cumulative: Array, level: float, out: Array) -> int:
    """Pieces of the highest-density set.

    Pieces with less than 1 % of the mass are left out, and pieces parted by a dip of less than
    half the density at their edge count as one.

    Args:
        out: (M, 3) written: low, high, mass of each piece, base to tip.

    Returns:
        Number of pieces.
    """
    cells = count - 1
    density = np.empty(cells)
    for j in range(cells):
        density[j] = (cumulative[j + 1] - cumulative[j]) / max(arcs[j + 1] - arcs[j], 1e-300)
    order = np.argsort(-density)
    inside = np.zeros(cells, dtype=np.bool_)
    held = 0.0
    edge = 0.0
    for r in range(cells):
        j = order[r]
        inside[j] = True
        edge = density[j]
        held += cumulative[j + 1] - cumulative[j]
        if held >= level:
            break
    # Shallow dips close.
    start = -1
    for j in range(cells):
        if inside[j]:
            if start >= 0 and j > start + 1:
                least = 1e300
                for m in range(start + 1, j):
                    least = min(least, density[m])
                if least > 0.5 * edge:
                    for m in range(start + 1, j):
                        inside[m] = True
            start = j
    pieces = 0
    j = 0
    while j < cells:
        if not inside[j]:
            j += 1
            continue
        first = j
        while j < cells and inside[j]:
            j += 1
        mass = cumulative[j] - cumulative[first]
        if mass >= 0.01 and pieces < out.shape[0]:
            out[pieces, 0] = arcs[first]
            out[pieces, 1] = arcs[j]
            out[pieces, 2] = mass
            pieces += 1
    return pieces


@compiled_inner
def median_between(
    arcs: Array, logp: Array, count: int, cumulative: Array, low: float, high: float
) -> float:
    """Median of the part of the density between two nodes."""
    first = 0
    while first < count - 2 and arcs[first + 1] <= low:
        first += 1
    last = count - 1
    while last > first + 1 and arcs[last - 1] >= high:
        last -= 1
    goal = 0.5 * (cumulative[first] + cumulative[last])
    j = first
    while j < last - 1 and cumulative[j + 1] < goal:
        j += 1
    share = (goal - cumulative[j]) / max(cumulative[j + 1] - cumulative[j], 1e-300)
    share = min(max(share, 0.0), 1.0)
    place: float = arcs[j] + (arcs[j + 1] - arcs[j]) * within(share, logp[j], logp[j + 1])
    return place


@compiled
def summary(
    arcs: Array, logp: Array, count: int, cumulative: Array, level: float
) -> tuple[float, float, float, Array]:
    """Median (of the heaviest mode), shortest interval and modes of a density on nodes.

    Returns:
        arc; interval low and high; (M, 3) modes.
    """
    start, end = shortest(arcs, logp, count, cumulative, level)
    pieces = np.empty((12, 3))
    found = modes(arcs, logp, count, cumulative, level, pieces)
    first = 0.0
    last = 1.0
    if found > 1:
        best = 0
        for m in range(found):
            if pieces[m, 2] > pieces[best, 2]:
                best = m
        first = pieces[best, 0]
        last = pieces[best, 1]
    arc = median_between(arcs, logp, count, cumulative, first, last)
    return arc, start, end, pieces[:found].copy()


@compiled
def mixed(arcs: Array, logp: Array, level: float) -> tuple[float, float, float, Array]:
    """Summary of any density on sorted nodes; `logp` is normalised in place."""
    cumulative = np.empty(arcs.shape[0])
    logp -= masses(arcs, logp, arcs.shape[0], cumulative)
    return summary(arcs, logp, arcs.shape[0], cumulative, level)


@compiled
def median(arcs: Array, logp: Array) -> float:
    """Median of any density on sorted nodes."""
    count = arcs.shape[0]
    cumulative = np.empty(count)
    masses(arcs, logp, count, cumulative)
    return median_between(arcs, logp, count, cumulative, 0.0, 1.0)
