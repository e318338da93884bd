"""Global L1 fit of one contact to hundreds of sensors.

For a given arc the best force is a weighted median, so what is left is a profile J(a) over the
body (`dense_profile`). It is bounded from below over whole stretches of arc by duality
(`dense_bound`). That bound's loss is of second order in the length of the stretch, so stretches far
from the optimum are dismissed whole and few are left near it; beside a kink of J, or where J is
flat, nothing is lost at all and the search ends. Kinks are found as the places where tangents meet.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_sums
from thigmo.localization.exact.dense_bound import Ends, bounded
from thigmo.localization.exact.dense_profile import Dense, Room, dense_profile
from thigmo.localization.exact.response import (
    INNER_END,
    RANGES,
    ForceRange,
    Readings,
    plain,
    usable,
)

Floats = NDArray[np.float64]

STRETCHES = 8  # the body is cut into so many at first
NARROWEST = 1e-12  # of the length; rounding rules below
NEAR_BAR = 1e-3  # of the slack; so near to it is at the end of the optimum set


@compiled_sums
def next_place(stretch: Floats) -> float:
    """Where to look within a stretch: where the tangents at its ends meet, or its middle.

    Args:
        stretch: near end, J and its slope there, far end, the same there, > 0 for the middle.
    """
    left = float(stretch[0])
    right = float(stretch[3])
    if stretch[6] == 0.0 and stretch[2] < 0.0 < stretch[5]:
        drop = stretch[4] - stretch[1] - stretch[5] * (right - left)
        arc = left + float(drop / (stretch[2] - stretch[5]))
        if left < arc < right:
            return arc
    return 0.5 * (left + right)


@compiled_sums
def fit_dense_l1(
    readings: Readings, length: float, forces: ForceRange, tolerance: float
) -> tuple[float, float, float, float, float, int]:
    """One problem, sensors ordered by their near ends, forces of either sign or of one.

    Args:
        readings: N of them by ascending near ends, weights > 0.
        length: everted length.
        forces: (-inf or 0, inf or 0).
        tolerance: relative to the objective at f = 0.

    Returns:
        objective, arc, force, both ends of the optimum range around it, number of arcs looked at.
    """
    y, low, span, _, w = readings
    n = y.shape[0]
    tail = np.zeros(n + 1)
    for j in range(n - 1, -1, -1):
        tail[j] = tail[j + 1] + w[j] * abs(y[j])
    slack = tolerance * tail[0]
    best = tail[0]
    best_arc = length
    best_force = 0.0
    if n == 0 or low[0] >= length:
        return best, best_arc, best_force, 0.0, length, 0

    # Ends of spans by arc: two lists, the second nearly in order, merged.
    far = np.empty(n, np.int64)
    count = 0
    for j in range(n):
        if span[j] > 0.0:
            k = count
            while k > 0 and low[far[k - 1]] + span[far[k - 1]] > low[j] + span[j]:
                far[k] = far[k - 1]
                k -= 1
            far[k] = j
            count += 1
    ends = np.empty(n + count)
    owners = np.empty(n + count, np.int64)
    j = 0
    k = 0
    for e in range(n + count):
        if j < n and (k == count or low[j] <= low[far[k]] + span[far[k]]):
            ends[e] = low[j]
            owners[e] = j
            j += 1
        else:
            ends[e] = low[far[k]] + span[far[k]]
            owners[e] = ~far[k]
            k += 1

    dense = Dense(readings, tail, forces)
    room = Room(np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.int64))
    spans = Ends(ends, owners, np.empty((2, n)))

    # Nothing answers before the first near end; there the profile may be open.
    start = 0.0
    if low[0] >= 0.0:
        e = 0
        while e < ends.shape[0] and ends[e] <= low[0]:
            e += 1
        edge = min(ends[e], length) if e < ends.shape[0] else length
        start = low[0] + INNER_END * (edge - low[0])
    force = 0.0  # a guess for the next profile
    looked = 0
    # Stretches: near end, J and its slope there, far end, the same there, whether to halve it.
    stack = np.empty((STRETCHES + 100, 7))
    nearest = 0
    least = np.inf
    for k in range(STRETCHES + 1):
        arc = start + (length - start) * k / STRETCHES if k < STRETCHES else length
        found = dense_profile(arc, force, dense, room)
        force = found.force
        looked += 1
        if found.value < best:
            best = found.value
            best_arc = arc
            best_force = force
        if found.value < least:
            least = found.value
            nearest = k
        for row in range(max(k - 1, 0), min(k + 1, STRETCHES)):
            side = 3 if row < k else 0
            stack[row, side] = arc
            stack[row, side + 1] = found.value
            stack[row, side + 2] = -force * found.slope
            stack[row, 6] = 0.0
    waiting = plain(STRETCHES)

    # The bottom of the valley around the least of them.
    valley = np.empty(7)
    valley[:3] = stack[max(nearest - 1, 0), :3]
    valley[3:] = stack[min(nearest, STRETCHES - 1), 3:]
    for step in range(40):
        valley[6] = 1.0 if step % 3 == 2 else 0.0
        arc = next_place(valley)
        if (
            valley[2] < 0.0 < valley[5]
            and valley[1] + valley[2] * (arc - valley[0]) > best - 0.5 * slack
        ):
            break
        found = dense_profile(arc, force, dense, room)
        force = found.force
        looked += 1
        if found.value < best:
            best = found.value
            best_arc = arc
            best_force = force
        side = 0 if -force * found.slope < 0.0 else 3
        valley[side] = arc
        valley[side + 1] = found.value
        valley[side + 2] = -force * found.slope

    while waiting > 0:
        waiting -= 1
        left = stack[waiting, 0]
        right = stack[waiting, 3]
        if right - left <= NARROWEST * length:
            continue
        known = min(best_arc - left, right - best_arc) > NARROWEST * length
        arc = best_arc if known else next_place(stack[waiting])
        found = dense_profile(arc, force, dense, room)
        force = found.force
        looked += 1
        if found.value < best:
            best = found.value
            best_arc = arc
            best_force = force
        if not known and bounded((left, arc, right), best - slack, found, dense, spans):
            continue
        stack[waiting, 6] = 1.0 - stack[waiting, 6]
        stack[waiting + 1] = stack[waiting]
        for part in range(2):
            side = 3 * (1 - part)
            stack[waiting + part, side] = arc
            stack[waiting + part, side + 1] = found.value
            stack[waiting + part, side + 2] = -force * found.slope
        waiting += 2

    # Flat optimum: walk outwards over ends of spans, then along tangents within the last stretch.
    reach = np.empty(2)
    bar = best + slack
    for side in range(2):
        good = best_arc
        towards = 1.0 - 2.0 * side
        found = dense_profile(
            min(max(good + towards * 1e-7 * length, 0.0), length), force, dense, room
        )
        force = found.force
        if found.value <= bar:
            bad = np.nan
            for k in range(ends.shape[0] + 1):
                end = length if side == 0 else 0.0
                if k < ends.shape[0]:
                    end = float(ends[k] if side == 0 else ends[ends.shape[0] - 1 - k])
                    end = min(max(end, 0.0), length)
                if (end - good) * towards <= 0.0:
                    continue
                found = dense_profile(end, force, dense, room)
                force = found.force
                if found.value > bar:
                    bad = end
                    break
                good = end
            if bad == bad:
                for step in range(40):
                    slope = -found.force * found.slope
                    arc = bad - (found.value - bar) / slope if slope != 0.0 else good
                    if step % 4 == 3 or not (arc - good) * (bad - arc) > 0.0:
                        arc = 0.5 * (good + bad)
                    found_there = dense_profile(arc, force, dense, room)
                    force = found_there.force
                    if found_there.value <= bar:
                        good = arc
                        if found_there.value > bar - NEAR_BAR * slack:
                            break
                    else:
                        bad = arc
                        found = found_there
                        if found.value < bar + NEAR_BAR * slack:
                            good = arc
                            break
        reach[side] = good
    return best, best_arc, best_force, reach[1], reach[0], looked


@compiled_sums
def fit_dense_rows(
    y: Floats,
    sensors: Floats,
    length: Floats,
    forces: tuple[float, float],
    tolerance: float,
    found: Floats,
) -> bool:
    """Every row of a batch; arguments as `one_contact_l1.fit_l1_rows`, forces as `fit_dense_l1`."""
    if not usable(y, sensors, length):
        return False
    rows, n = y.shape
    near = np.empty(n)
    kept = np.empty((5, n))
    order = np.empty(n, np.int64)
    for b in range(rows):
        s = b if sensors.shape[0] > 1 else 0
        ascending = True
        for j in range(n):
            near[j] = sensors[s, 0, j] - 0.5 * sensors[s, 1, j]
            ascending = ascending and (j == 0 or near[j - 1] <= near[j])
            order[j] = j
        if not ascending:
            order[:] = np.argsort(near, kind="mergesort")
        m = 0
        for k in range(n):
            j = order[k]
            if y[b, j] == y[b, j] and sensors[s, 2, j] > 0.0:
                span = sensors[s, 1, j]
                kept[0, m] = y[b, j]
                kept[1, m] = near[j]
                kept[2, m] = span
                kept[3, m] = 0.5 / span if span > 0.0 else 0.0
                kept[4, m] = sensors[s, 2, j]
                m += 1
        end = float(length[b if length.shape[0] > 1 else 0])
        best, arc, force, low, high, _ = fit_dense_l1(
            Readings(kept[0, :m], kept[1, :m], kept[2, :m], kept[3, :m], kept[4, :m]),
            end,
            ForceRange(forces[0], forces[1]),
            tolerance,
        )
        found[b, 0] = best
        found[b, 1] = arc
        found[b, 2] = force
        found[b, 3] = 1.0
        found[b, RANGES] = low if force != 0.0 else 0.0
        found[b, RANGES + 1] = high if force != 0.0 else end
    return True
