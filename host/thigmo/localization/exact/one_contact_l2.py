"""Global least-squares fit of one contact.

For a given arc the best force is p / q with p = sum w^2 y phi and q = sum w^2 phi^2, and the
objective is sum (w y)^2 - p^2 / q. Between ends of spans p and q are polynomials of the arc, of
degree 1 and 2 where no span holds the contact and of degree 2 and 4 where one does; the stationary
points are the roots of 2 p' q - p q', of degree 1 and at most 4. Cells are swept from base to tip
with running sums over the sensors behind the contact, so that hundreds of gratings cost no more
than their number.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_inner, compiled_part, compiled_sums
from thigmo.localization.exact.polynomial import quartic_misses_unit, unit_roots
from thigmo.localization.exact.response import (
    INNER_END,
    PIECES,
    RANGES,
    ForceRange,
    Readings,
    find_edges,
    first_influence,
    objective_l2,
    usable,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CANDIDATES = 256


class Work(NamedTuple):
    """Room for one fit of N readings.

    Attributes:
        by_low: (N,) order of the sensors' near ends; not written by a fit.
        inside: (N,) sensors in whose span the contact lies.
        near: (2, CANDIDATES) arcs and objectives of near-best candidates.
        small: (9, 6) polynomials and roots.
    """

    by_low: Ints
    inside: Ints
    near: Floats
    small: Floats


@compiled_inner
def profile_l2(arc: float, readings: Readings, forces: ForceRange) -> tuple[float, float]:
    """Least objective over f at one arc, and that f."""
    y, low, span, inverse, w = readings
    p = 0.0
    q = 0.0
    for j in range(y.shape[0]):
        inside = min(max(arc - low[j], 0.0), span[j])
        phi = inside * inside * inverse[j] + (max(arc - low[j], span[j]) - span[j])
        p += w[j] * w[j] * y[j] * phi
        q += w[j] * w[j] * phi * phi
    force = min(max(p / q if q > 0.0 else 0.0, forces.low), forces.high)
    return objective_l2(arc, force, y, low, span, inverse, w), force


@compiled_part
def fit_l2(
    readings: Readings,
    edges: Floats,
    forces: ForceRange,
    tolerance: float,
    work: Work,
    ranges: Floats,
) -> tuple[float, float, float, int]:
    """One problem.

    Args:
        readings: N of them; weight 0 for a missing one.
        edges: from `find_edges`.
        forces: what f may be.
        tolerance: relative to the objective at f = 0.
        work: room for N.
        ranges: (PIECES, 2), written: the optimum set.

    Returns:
        objective, arc, force, number of ranges.
    """
    y, low, span, inverse, w = readings
    by_low, inside, near, small = work
    n_edges = edges.shape[0]
    n = y.shape[0]
    length = edges[n_edges - 1]
    rest = 0.0
    for j in range(n):
        rest += (w[j] * y[j]) ** 2
    f_zero = min(max(0.0, forces.low), forces.high)
    start = first_influence(low, edges)
    idle = low[by_low[0]] >= edges[start] if n > 0 else True
    best = rest
    best_arc = length
    best_force = f_zero
    n_near = 0
    if f_zero != 0.0:
        best, best_force = profile_l2(0.0, readings, forces)
        best_arc = 0.0
        near[0, 0] = 0.0
        near[1, 0] = best
        n_near = 1
        if start > 0:
            near[0, 1] = edges[start]
            near[1, 1] = best
            n_near = 2
    scale = max(rest, best)
    slack = tolerance * scale

    coefficients = small[0]
    roots = small[1]
    brackets = small[2]
    derivatives = small[3:8]
    tries = small[8]

    # Running sums over sensors wholly behind the contact.
    s0 = 0.0
    s1 = 0.0
    s2 = 0.0
    t0 = 0.0
    t1 = 0.0
    n_inside = 0
    entered = 0
    for e in range(start, n_edges - 1):
        begin = edges[e]
        width = edges[e + 1] - begin
        middle = begin + 0.5 * width
        kept = 0
        while entered < n and low[by_low[entered]] < middle:
            inside[n_inside] = by_low[entered]
            n_inside += 1
            entered += 1
        for k in range(n_inside):
            j = inside[k]
            if low[j] + span[j] > middle:
                inside[kept] = j
                kept += 1
            else:
                x = low[j] + 0.5 * span[j]
                v = w[j] * w[j]
                s0 += v
                s1 += v * x
                s2 += v * x * x
                t0 += v * y[j]
                t1 += v * y[j] * x
        n_inside = kept
        p0 = t0 * begin - t1
        p1 = t0 * width
        p2 = 0.0
        q0 = (s0 * begin - 2.0 * s1) * begin + s2
        q1 = 2.0 * width * (s0 * begin - s1)
        q2 = s0 * width * width
        q3 = 0.0
        q4 = 0.0
        for k in range(n_inside):
            j = inside[k]
            v = w[j] * w[j]
            t = begin - low[j]
            c0 = t * t * inverse[j]
            c1 = 2.0 * t * width * inverse[j]
            c2 = width * width * inverse[j]
            p0 += v * y[j] * c0
            p1 += v * y[j] * c1
            p2 += v * y[j] * c2
            q0 += v * c0 * c0
            q1 += 2.0 * v * c0 * c1
            q2 += v * (2.0 * c0 * c2 + c1 * c1)
            q3 += 2.0 * v * c1 * c2
            q4 += v * c2 * c2
        tries[0] = INNER_END if e == start and idle else 0.0
        tries[1] = 1.0
        n_tries = 2 if e == n_edges - 2 else 1
        coefficients[0] = 2.0 * p1 * q0 - p0 * q1
        coefficients[1] = p1 * q1 + 4.0 * p2 * q0 - 2.0 * p0 * q2
        if n_inside == 0:
            if coefficients[1] != 0.0:
                t = -coefficients[0] / coefficients[1]
                if 0.0 < t < 1.0:
                    tries[n_tries] = t
                    n_tries += 1
        else:
            coefficients[2] = 3.0 * (p2 * q1 - p0 * q3)
            coefficients[3] = 2.0 * p2 * q2 - p1 * q3 - 4.0 * p0 * q4
            coefficients[4] = p2 * q3 - 2.0 * p1 * q4
            if not quartic_misses_unit(coefficients):
                found = unit_roots(coefficients, 4, roots, derivatives, brackets)
                for k in range(found):
                    tries[n_tries] = roots[k]
                    n_tries += 1
        for k in range(n_tries):
            t = tries[k]
            p = p0 + t * (p1 + t * p2)
            q = q0 + t * (q1 + t * (q2 + t * (q3 + t * q4)))
            floor = 1e-7 * (s0 * (begin + t * width) ** 2)
            if q > floor:
                force = min(max(p / q, forces.low), forces.high)
                if rest - force * (2.0 * p - force * q) > best + slack + 1e-6 * scale:
                    continue
            arc = min(begin + t * width, length)
            value, force = profile_l2(arc, readings, forces)
            if value <= best + slack:
                if value < best:
                    best = value
                    best_arc = arc
                    best_force = force
                if n_near == CANDIDATES:
                    n_near = 0
                    for m in range(CANDIDATES):
                        if near[1, m] <= best + slack:
                            near[0, n_near] = near[0, m]
                            near[1, n_near] = near[1, m]
                            n_near += 1
                    n_near = min(n_near, CANDIDATES - 1)
                near[0, n_near] = arc
                near[1, n_near] = value
                n_near += 1
        # Along a finite bound of f: J = rest - 2 f p + f^2 q.
        for side in range(2):
            force = forces.low if side == 0 else forces.high
            if not 0.0 < abs(force) < np.inf:
                continue
            coefficients[0] = force * q1 - 2.0 * p1
            coefficients[1] = 2.0 * force * q2 - 4.0 * p2
            coefficients[2] = 3.0 * force * q3
            coefficients[3] = 4.0 * force * q4
            found = unit_roots(coefficients, 3, roots, derivatives, brackets)
            for k in range(found):
                arc = min(begin + roots[k] * width, length)
                value, clipped = profile_l2(arc, readings, forces)
                if value <= best + slack:
                    if value < best:
                        best = value
                        best_arc = arc
                        best_force = clipped
                    if n_near < CANDIDATES:
                        near[0, n_near] = arc
                        near[1, n_near] = value
                        n_near += 1

    if f_zero == 0.0 and rest <= best + slack:
        ranges[0, 0] = 0.0
        ranges[0, 1] = length
        return best, best_arc, best_force, 1
    count = 0
    for k in range(n_near):
        if near[1, k] <= best + slack:
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
                value, force = profile_l2(0.5 * (last + arc), readings, forces)
                joined = value <= best + slack or pieces == PIECES
        if joined:
            ranges[pieces - 1, 1] = max(ranges[pieces - 1, 1], arc)
        else:
            ranges[pieces, 0] = arc
            ranges[pieces, 1] = arc
            pieces += 1
    widest = 0
    for k in range(1, pieces):
        if ranges[k, 1] - ranges[k, 0] > ranges[widest, 1] - ranges[widest, 0]:
            widest = k
    if ranges[widest, 1] - ranges[widest, 0] > 1e-3 * length:
        arc = 0.5 * (ranges[widest, 0] + ranges[widest, 1])
        value, force = profile_l2(arc, readings, forces)
        if value <= best + slack:
            best_arc = arc
            best_force = force
    return best, best_arc, best_force, pieces


@compiled_sums
def fit_l2_rows(
    y: Floats,
    sensors: Floats,
    length: Floats,
    forces: tuple[float, float],
    tolerance: float,
    found: Floats,
) -> bool:
    """Every row of a batch; arguments as `one_contact_l1.fit_l1_rows`."""
    if not usable(y, sensors, length):
        return False
    rows, n = y.shape
    shared = sensors.shape[0] == 1 and length.shape[0] == 1
    r_y = np.empty(n)
    w = np.empty(n)
    low = np.empty(n)
    span = np.empty(n)
    inverse = np.empty(n)
    edges = np.empty(2 * n + 2)
    ranges = np.empty((PIECES, 2))
    by_low = np.empty(n, np.int64)
    inside = np.empty(n, np.int64)
    work = Work(by_low, inside, np.empty((2, CANDIDATES)), np.zeros((9, 6)))
    n_edges = 0
    for b in range(rows):
        s = b if sensors.shape[0] > 1 else 0
        if b == 0 or not shared:
            for j in range(n):
                span[j] = sensors[s, 1, j]
                low[j] = sensors[s, 0, j] - 0.5 * span[j]
                inverse[j] = 0.5 / span[j] if span[j] > 0.0 else 0.0
                k = j
                while k > 0 and low[by_low[k - 1]] > low[j]:
                    by_low[k] = by_low[k - 1]
                    k -= 1
                by_low[k] = j
            n_edges = find_edges(low, span, length[b if length.shape[0] > 1 else 0], edges)
        for j in range(n):
            known = y[b, j] == y[b, j]
            r_y[j] = y[b, j] if known else 0.0
            w[j] = sensors[s, 2, j] if known else 0.0
        row = Readings(r_y, low, span, inverse, w)
        allowed = ForceRange(forces[0], forces[1])
        value, arc, force, count = fit_l2(row, edges[:n_edges], allowed, tolerance, work, ranges)
        found[b, 0] = value
        found[b, 1] = arc
        found[b, 2] = force
        found[b, 3] = count
        for k in range(count):
            found[b, RANGES + 2 * k] = ranges[k, 0]
            found[b, RANGES + 2 * k + 1] = ranges[k, 1]
    return True
