"""Global L1 fit of one contact by enumeration.

The global minimum is at f = 0, at 0 or L, at a point sensor, where the curves of two readings meet,
at a stationary point along such a curve, or along a bound of f (`l1_candidates`). All of them are
tried; the optimum set is found from those that are as good as the best.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_part, compiled_sums
from thigmo.localization.exact.l1_candidates import (
    try_force_bounds,
    try_kinks,
    try_pair_roots,
    try_stationary,
)
from thigmo.localization.exact.l1_state import (
    Best,
    Setting,
    Work,
    empty_work,
    least_left,
    profile_l1,
)
from thigmo.localization.exact.response import (
    INNER_END,
    PIECES,
    RANGES,
    ForceRange,
    Readings,
    find_edges,
    first_influence,
    objective_l1,
    plain,
    usable,
)

Floats = NDArray[np.float64]


@compiled_part
def optimum_set(
    readings: Readings, setting: Setting, best: Best, work: Work, ranges: Floats
) -> tuple[float, float, int]:
    """Ranges of arc as good as the best, from the candidates kept in `work.near`.

    Args:
        readings: N of them.
        setting: of the fit.
        best: the global minimum.
        work: its candidates are reordered.
        ranges: (PIECES, 2), written.

    Returns:
        arc and force in the middle of the widest range, and how many ranges there are.
    """
    edges, start, idle = setting.edges, setting.start, setting.idle
    n_edges = edges.shape[0]
    length = edges[n_edges - 1]
    near, key, amount = work.near, work.cuts, work.signed
    best_arc = best.arc
    best_force = best.force
    # Ends of ranges are candidates; between two, the middle decides.
    count = 0
    for k in range(best.kept):
        if near[1, k] <= best.objective + setting.slack:
            arc = near[0, k]
            m = count
            while m > 0 and near[0, m - 1] > arc:
                near[0, m] = near[0, m - 1]
                m -= 1
            near[0, m] = arc
            count += 1
    pieces = 0
    for k in range(count):
        arc = near[0, k]
        joined = False
        if pieces > 0:
            last = ranges[pieces - 1, 1]
            if arc - last <= 1e-12 * length:
                joined = True
            else:
                value, force = profile_l1(0.5 * (last + arc), readings, setting.forces, key, amount)
                joined = value <= best.objective + setting.slack or pieces == PIECES
        if joined:
            ranges[pieces - 1, 1] = max(ranges[pieces - 1, 1], arc)
        else:
            ranges[pieces, 0] = arc
            ranges[pieces, 1] = arc
            pieces += 1
    # A flat stretch may also end where a span does.
    for k in range(pieces):
        for e in range(start, n_edges - 1):
            if edges[e + 1] > ranges[k, 1]:
                value, force = profile_l1(edges[e + 1], readings, setting.forces, key, amount)
                if value > best.objective + setting.slack:
                    break
                ranges[k, 1] = edges[e + 1]
        for e in range(n_edges - 1, start, -1):
            arc = edges[e - 1]
            if e - 1 == start and idle:
                arc += INNER_END * (edges[e] - arc)
            if arc < ranges[k, 0]:
                value, force = profile_l1(arc, readings, setting.forces, key, amount)
                if value > best.objective + setting.slack:
                    break
                ranges[k, 0] = arc
    merged = 0
    for k in range(1, pieces):
        if ranges[k, 0] <= ranges[merged, 1]:
            ranges[merged, 1] = max(ranges[merged, 1], ranges[k, 1])
        else:
            merged += 1
            ranges[merged, 0] = ranges[k, 0]
            ranges[merged, 1] = ranges[k, 1]
    pieces = merged + 1
    widest = 0
    for k in range(1, pieces):
        if ranges[k, 1] - ranges[k, 0] > ranges[widest, 1] - ranges[widest, 0]:
            widest = k
    if ranges[widest, 1] > ranges[widest, 0]:
        arc = 0.5 * (ranges[widest, 0] + ranges[widest, 1])
        value, force = profile_l1(arc, readings, setting.forces, key, amount)
        if value <= best.objective + setting.slack:
            best_arc = arc
            best_force = force
    return best_arc, best_force, pieces


@compiled_part
def fit_l1(
    readings: Readings,
    edges: Floats,
    forces: ForceRange,
    tolerance: float,
    work: Work,
    ranges: Floats,
) -> tuple[float, float, float, int]:
    """One problem.

    Args:
        readings: N of them.
        edges: from `find_edges`.
        forces: what f may be.
        tolerance: relative to the objective at f = 0.
        work: room for N.
        ranges: (PIECES, 2), written: the optimum set.

    Returns:
        objective, arc, force, number of ranges.
    """
    y, low, span, inverse, w = readings
    n_edges = edges.shape[0]
    length = edges[n_edges - 1]
    # A force leaves at least the readings of the other sign.
    plus = 0.0
    minus = 0.0
    start = first_influence(low, edges)
    idle = True  # no sensor answers at edges[start]
    for j in range(y.shape[0]):
        plus += w[j] * max(y[j], 0.0)
        minus += w[j] * max(-y[j], 0.0)
        idle = idle and low[j] >= edges[start]
    rest = plus + minus
    f_zero = min(max(0.0, forces.low), forces.high)

    # f = 0 (or the bound next to it) is open to every arc; proximal to all sensors f is idle.
    best = Best(rest, length, f_zero, plain(0))
    if f_zero != 0.0:
        value = objective_l1(0.0, f_zero, y, low, span, inverse, w)
        near = work.near
        near[0, 0] = 0.0
        near[1, 0] = value
        near[0, 1] = edges[start]
        near[1, 1] = value
        best = Best(value, 0.0, f_zero, plain(2 if start > 0 else 1))
    slack = tolerance * max(rest, best.objective)
    floor = least_left(readings, work.gain, work.place)
    setting = Setting(edges, start, idle, forces, plus, minus, floor, work.gain, slack)
    best = try_kinks(readings, setting, best, work)
    best = try_pair_roots(readings, setting, best, work)
    best = try_stationary(readings, setting, best, work)
    best = try_force_bounds(readings, setting, best, work)
    if f_zero == 0.0 and rest <= best.objective + slack:
        ranges[0, 0] = 0.0
        ranges[0, 1] = length
        return best.objective, best.arc, best.force, 1
    arc, force, pieces = optimum_set(readings, setting, best, work, ranges)
    return best.objective, arc, force, pieces


@compiled_sums
def fit_l1_rows(
    y: Floats,
    sensors: Floats,
    length: Floats,
    forces: tuple[float, float],
    tolerance: float,
    found: Floats,
) -> bool:
    """Every row of a batch; false, with nothing written, if a number is not `usable`.

    Plain arrays, because numba takes microseconds to unpack a tuple of them.

    Args:
        y: (B, N), NaN for a missing sensor.
        sensors: (1 or B, 3, N) centres, spans and weights.
        length: (1 or B,) everted lengths.
        forces: least and largest f.
        tolerance: relative.
        found: (B, WRITTEN), written.
    """
    if not usable(y, sensors, length):
        return False
    rows, n = y.shape
    shared = sensors.shape[0] == 1 and length.shape[0] == 1
    span = np.empty(n)
    inverse = np.empty(n)
    low = np.empty(n)
    r_y = np.empty(n)
    w = np.empty(n)
    common = np.empty(2 * n + 2)
    own = np.empty(2 * n + 2)
    ranges = np.empty((PIECES, 2))
    work = empty_work(n)
    n_common = 0
    if shared:
        for j in range(n):
            low[j] = sensors[0, 0, j] - 0.5 * sensors[0, 1, j]
        n_common = find_edges(low, sensors[0, 1], length[0], common)
    for b in range(rows):
        s = b if sensors.shape[0] > 1 else 0
        m = 0
        for j in range(n):
            if y[b, j] == y[b, j]:
                r_y[m] = y[b, j]
                span[m] = sensors[s, 1, j]
                low[m] = sensors[s, 0, j] - 0.5 * span[m]
                inverse[m] = 0.5 / span[m] if span[m] > 0.0 else 0.0
                w[m] = sensors[s, 2, j]
                m += 1
        # Ends of missing sensors' spans are not edges, or a row would not be what it is alone.
        if shared and m == n:
            edges = common[:n_common]
        else:
            end = length[b if length.shape[0] > 1 else 0]
            edges = own[: find_edges(low[:m], span[:m], end, own)]
        row = Readings(r_y[:m], low[:m], span[:m], inverse[:m], w[:m])
        allowed = ForceRange(forces[0], forces[1])
        value, arc, force, count = fit_l1(row, edges, allowed, tolerance, work, ranges)
        found[b, 0] = value
        found[b, 1] = arc
        found[b, 2] = force
        found[b, 3] = count
        for k in range(count):
            found[b, RANGES + 2 * k] = ranges[k, 0]
            found[b, RANGES + 2 * k + 1] = ranges[k, 1]
    return True
