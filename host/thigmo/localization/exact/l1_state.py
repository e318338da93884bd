"""What one L1 fit of one contact carries along: its setting, the best so far, room, cheap bounds.

Called by `l1_candidates` and `one_contact_l1`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_inner, compiled_part, compiled_sums
from thigmo.localization.exact.response import ForceRange, Readings, objective_l1

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CANDIDATES = 256  # near-best candidates kept to find the optimum set


class Setting(NamedTuple):
    """What stays fixed during one fit.

    Attributes:
        edges: ends of spans, from `find_edges`.
        start: the last of them at which no sensor answers yet.
        idle: whether none answers there at all.
        forces: what f may be.
        plus: sum of w y over readings above 0: what any negative force leaves.
        minus: sum of w |y| over those below.
        floor: what every contact leaves: two sensors at the same place can never both be met.
        gain: (N,) how much more is left by one that a sensor does not feel.
        slack: what counts as equal to the best.
    """

    edges: Floats
    start: int
    idle: bool
    forces: ForceRange
    plus: float
    minus: float
    floor: float
    gain: Floats
    slack: float


class Best(NamedTuple):
    """The best candidate so far, and how many near ones are kept."""

    objective: float
    arc: float
    force: float
    kept: int


class Work(NamedTuple):
    """Room for one fit of N readings.

    Attributes:
        near: (2, CANDIDATES) arcs and objectives of near-best candidates.
        roots: (N, 4 N) for each curve the arcs where it meets others.
        others: (N, 4 N) the readings whose curves these are.
        n_roots: (N,) how many.
        cuts: (6 N + 8,) ends of pieces of a curve within a cell; keys of a median.
        turns: (6 N + 8,) reading that changes sign at each.
        forms: (5, N) influences in a cell, c0 + c1 t + c2 t^2, then y and w.
        signed: (N,) signed weights along a piece; amounts of a median.
        place: (N,) column of each reading in `forms`.
        gain: (N,) that of `Setting`.
    """

    near: Floats
    roots: Floats
    others: Ints
    n_roots: Ints
    cuts: Floats
    turns: Ints
    forms: Floats
    signed: Floats
    place: Ints
    gain: Floats


@compiled_sums
def empty_work(n: int) -> Work:
    """Room for fits of up to n readings."""
    return Work(
        np.empty((2, CANDIDATES)),
        np.empty((n, 4 * n)),
        np.empty((n, 4 * n), np.int64),
        np.empty(n, np.int64),
        np.empty(6 * n + 8),
        np.empty(6 * n + 8, np.int64),
        np.empty((5, n)),
        np.empty(n),
        np.empty(n, np.int64),
        np.empty(n),
    )


@compiled_part
def offered(best: Best, arc: float, force: float, value: float, slack: float, near: Floats) -> Best:
    """The best after one more candidate, which is kept in `near` if it is as good."""
    if not value <= best.objective + slack:
        return best
    kept = best.kept
    if kept < CANDIDATES:
        near[0, kept] = arc
        near[1, kept] = value
        kept += 1
    if value < best.objective:
        return Best(value, arc, force, kept)
    return Best(best.objective, best.arc, best.force, kept)


@compiled_inner
def profile_l1(
    arc: float, readings: Readings, forces: ForceRange, key: Floats, amount: Floats
) -> tuple[float, float]:
    """Least objective over f at one arc, and that f: the weighted median of y / phi.

    Args:
        arc: place of the contact.
        readings: N of them.
        forces: what f may be; the objective is convex in f, so the median is cut to it.
        key: (>= N,) work.
        amount: (>= N,) work.
    """
    y, low, span, inverse, w = readings
    n = y.shape[0]
    half = 0.0
    mean = 0.0
    for j in range(n):
        inside = min(max(arc - low[j], 0.0), span[j])
        phi = inside * inside * inverse[j] + (max(arc - low[j], span[j]) - span[j])
        amount[j] = w[j] * phi
        key[j] = y[j] / phi if amount[j] > 0.0 else np.inf
        half += 0.5 * amount[j]
        mean += w[j] * y[j] if phi > 0.0 else 0.0
    median = 0.0
    if half > 0.0:
        # From the mean of the ratios, which is seldom more than a few of them away.
        median = 0.5 * mean / half
        below = 0.0
        for j in range(n):
            below += amount[j] if key[j] < median else 0.0
        passed = below >= half
        while passed:
            lower = -np.inf
            for j in range(n):
                lower = key[j] if lower < key[j] < median else lower
            if lower == -np.inf:
                break
            median = lower
            for j in range(n):
                below -= amount[j] if key[j] == median else 0.0
            if below < half:
                break
        first = True
        while not passed:
            higher = np.inf
            for j in range(n):
                beyond = key[j] > median or (first and key[j] == median)
                higher = key[j] if beyond and key[j] < higher else higher
            if higher == np.inf:
                break
            first = False
            median = higher
            for j in range(n):
                below += amount[j] if key[j] == median else 0.0
            passed = below >= half
    force = min(max(median, forces.low), forces.high)
    return objective_l1(arc, force, y, low, span, inverse, w), force


@compiled_part
def least_left(readings: Readings, gain: Floats, paired: Ints) -> float:
    """`Setting.floor`; `gain` (N,) is written, `paired` (N,) is work."""
    y, low, span, _, w = readings
    floor = 0.0
    for j in range(y.shape[0]):
        gain[j] = w[j] * abs(y[j])
        paired[j] = 0
        for i in range(j):
            # Whatever both feel is the same, so the two leave at least their difference.
            if low[i] == low[j] and span[i] == span[j] and paired[i] == 0:
                least = min(w[i], w[j]) * abs(y[i] - y[j])
                floor += least
                gain[i] += gain[j] - least
                gain[j] = 0.0
                paired[i] = 1
                paired[j] = 1
                break
    return floor


@compiled_part
def first_open(cell: int, bar: float, readings: Readings, setting: Setting) -> int:
    """The first cell, from `cell` on, in which a contact may leave no more than `bar`."""
    low, edges, gain = readings.low, setting.edges, setting.gain
    while cell + 2 < edges.shape[0]:
        left = setting.floor
        for j in range(low.shape[0]):
            left += gain[j] if low[j] >= edges[cell + 1] else 0.0
        if left <= bar:
            break
        cell += 1
    return cell
