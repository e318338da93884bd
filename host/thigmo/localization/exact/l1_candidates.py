"""Candidates for the least 1-norm of one contact: every place where its minimum can lie.

For a given arc the objective is piecewise linear in f, so it is least on one of the curves
f = y_i / phi_i(a) on which a residual vanishes, at f = 0 or at a bound of f. Between the ends of
spans and the places where two such curves meet, the objective along a curve is
c + B(t) / phi_i(t) with a quadratic B whose t^2 part comes only from sensors in whose span the
contact lies: monotone without it, with it one stationary point in closed form. Called by
`one_contact_l1`, in the order in which the functions stand here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_part
from thigmo.localization.exact.l1_state import (
    Best,
    Setting,
    Work,
    first_open,
    offered,
    profile_l1,
)
from thigmo.localization.exact.response import INNER_END, Readings, objective_l1

Floats = NDArray[np.float64]


@compiled_part
def try_kinks(readings: Readings, setting: Setting, best: Best, work: Work) -> Best:
    """Arcs where the objective has a kink whatever the signs: 0, L and point sensors.

    The end of a span is none: phi is smooth there.
    """
    near, gain, slack = work.near, setting.gain, setting.slack
    y, low, span, _, _ = readings
    edges, start, idle = setting.edges, setting.start, setting.idle
    n = y.shape[0]
    n_edges = edges.shape[0]
    points = False
    for j in range(n):
        points = points or span[j] == 0.0
    # What sensors beyond the contact read is lost for every f.
    for e in range(n_edges - 1, start - 1, -1):
        arc = edges[e]
        kink = e == start or e == n_edges - 1
        if not (kink or points):
            continue
        if e == start and idle:
            arc += INNER_END * (edges[e + 1] - arc)
        lost = setting.floor
        for j in range(n):
            if low[j] >= arc:
                lost += gain[j]
                kink = kink or (span[j] == 0.0 and low[j] == arc)
        if lost > best.objective + slack:
            break
        if not kink:
            continue
        value, force = profile_l1(arc, readings, setting.forces, work.cuts, work.signed)
        best = offered(best, arc, force, value, slack, near)
    return best


@compiled_part
def remember(i: int, j: int, arc: float, work: Work) -> None:
    """Keep an arc where curves i and j meet, for both."""
    roots, others, n_roots = work.roots, work.others, work.n_roots
    roots[i, n_roots[i]] = arc
    others[i, n_roots[i]] = j
    n_roots[i] += 1
    roots[j, n_roots[j]] = arc
    others[j, n_roots[j]] = i
    n_roots[j] += 1


@compiled_part
def meeting_apart(
    m: int, q: int, length: float, readings: Readings, tip: Floats
) -> tuple[float, float]:
    """Where the curves of two readings of one sign meet, the span of m ending before that of q.

    y_m phi_q - y_q phi_m has the sign of -y where q begins to answer, and changes it at most once.

    Returns:
        the arc, NaN if it does not change by the tip, where the influences are `tip`; and the end
        of the span of q that the arc lies beyond, which rounding may not pass.
    """
    y, low, span, _, _ = readings
    none = np.nan
    sign = 1.0 if y[m] > 0.0 else -1.0
    q_end = low[q] + span[q]
    centre = low[m] + 0.5 * span[m]
    if sign * (y[m] * tip[q] - y[q] * tip[m]) < 0.0:
        return none, none
    if q_end < length and sign * (0.5 * y[m] * span[q] - y[q] * (q_end - centre)) < 0.0:
        return centre + y[m] * (q_end - centre - 0.5 * span[q]) / (y[m] - y[q]), q_end
    # y_m t^2 / (2 l) = y_q (t + d), t from low[q], d = low[q] - x[m] >= 0
    half = y[q] / y[m] * span[q]
    return low[q] + half + np.sqrt(half * (half + 2.0 * (low[q] - centre))), low[q]


@compiled_part
def try_pair_roots(readings: Readings, setting: Setting, best: Best, work: Work) -> Best:
    """Arcs where the curves of two readings meet; also remembered by curve.

    Form 0: the contact is beyond both spans; 1: beyond the first and inside the second; 2: inside
    both (q is the span that ends last).
    """
    near, slack = work.near, setting.slack
    y, low, span, inverse, w = readings
    tip = work.signed  # influences at the tip
    forces, plus, minus = setting.forces, setting.plus, setting.minus
    n = y.shape[0]
    edges = setting.edges
    length = edges[edges.shape[0] - 1]
    spanned = False
    for j in range(n):
        spanned = spanned or span[j] > 0.0
        work.n_roots[j] = 0
        tip[j] = max(length - low[j], 0.0)
        inside = min(tip[j], span[j])
        tip[j] = inside * inside * inverse[j] + (max(tip[j], span[j]) - span[j])
    cell = setting.start
    least = 0.0
    known = np.inf
    for i in range(n):
        bar = best.objective + slack
        if y[i] == 0.0 or w[i] == 0.0 or (minus if y[i] > 0.0 else plus) > bar:
            continue
        # Nothing before the first open cell is looked at any more.
        if bar < known:
            known = bar
            cell = first_open(cell, bar, readings, setting)
            least = max(edges[cell], 0.0)
        for j in range(i + 1, n):
            if y[i] * y[j] <= 0.0 or w[j] == 0.0:
                continue
            m = i
            q = j
            if low[i] + span[i] > low[j] + span[j]:
                m = j
                q = i
            if low[m] + span[m] <= low[q]:
                arc, begin = meeting_apart(m, q, length, readings, tip)
                if not arc >= least:
                    continue
                arc = min(max(arc, begin), length)
                if spanned:
                    remember(i, j, arc, work)
                inside = min(max(arc - low[i], 0.0), span[i])
                phi = inside * inside * inverse[i]
                phi += max(arc - low[i], span[i]) - span[i]
                force = y[i] / phi
                if phi > 0.0 and forces.low <= force <= forces.high:
                    value = objective_l1(arc, force, y, low, span, inverse, w)
                    best = offered(best, arc, force, value, slack, near)
                continue
            if low[m] == low[q] and span[m] == span[q]:
                continue  # they meet nowhere or everywhere
            m_end = low[m] + span[m]
            q_end = low[q] + span[q]
            for form in range(3):
                second = np.nan
                if form == 0:
                    begin = max(q_end, least)
                    end = length
                    if begin >= end or y[m] == y[q]:
                        continue
                    d = q_end - m_end + 0.5 * (span[m] - span[q])
                    first = m_end - 0.5 * span[m] + y[m] * d / (y[m] - y[q])
                elif form == 1:
                    begin = max(max(low[q], m_end), least)
                    end = min(q_end, length)
                    if begin >= end:
                        continue
                    # y_m t^2 / (2 l) = y_q (t + d), t from low[q], d = low[q] - x[m]
                    d = low[q] - m_end + 0.5 * span[m]
                    half = y[q] / y[m] * span[q]
                    square = half * (half + 2.0 * d)
                    if square < 0.0:
                        continue
                    far = half + np.sqrt(square)
                    first = low[q] + far
                    if d < 0.0:
                        second = low[q] - 2.0 * half * d / far
                else:
                    begin = max(max(low[q], low[m]), least)
                    end = min(m_end, length)
                    if begin >= end:
                        continue
                    ratio = np.sqrt(y[q] * span[q] / (y[m] * span[m]))
                    if ratio == 1.0:
                        continue
                    first = low[m] + (low[q] - low[m]) / (1.0 - ratio)
                for _ in range(2):
                    arc = first
                    first = second
                    if not begin <= arc <= end:
                        continue
                    if spanned:
                        remember(i, j, arc, work)
                    inside = min(max(arc - low[i], 0.0), span[i])
                    phi = inside * inside * inverse[i]
                    phi += max(arc - low[i], span[i]) - span[i]
                    force = y[i] / phi
                    if phi > 0.0 and forces.low <= force <= forces.high:
                        value = objective_l1(arc, force, y, low, span, inverse, w)
                        best = offered(best, arc, force, value, slack, near)
    return best


@compiled_part
def try_stationary(readings: Readings, setting: Setting, best: Best, work: Work) -> Best:
    """Stationary points along the curves, in the cells between edges that lie inside some span.

    Within a cell phi_j = c0 + c1 t + c2 t^2, t from the cell's near end (`forms`).
    """
    near, gain, slack = work.near, setting.gain, setting.slack
    y, low, span, inverse, w = readings
    roots, others, n_roots = work.roots, work.others, work.n_roots
    cuts, turns, forms, signed, place = work.cuts, work.turns, work.forms, work.signed, work.place
    edges, start, forces = setting.edges, setting.start, setting.forces
    plus, minus = setting.plus, setting.minus
    n = y.shape[0]
    n_edges = edges.shape[0]
    length = edges[n_edges - 1]
    for e in range(n_edges - 2, start - 1, -1):
        begin = edges[e]
        end = edges[e + 1]
        middle = 0.5 * (begin + end)
        lost = setting.floor
        curved = False
        m = 0
        for j in range(n):
            t = begin - low[j]
            if low[j] >= middle:
                lost += gain[j]
            else:
                if low[j] + span[j] > middle:
                    curved = True
                    forms[0, m] = t * t * inverse[j]
                    forms[1, m] = 2.0 * t * inverse[j]
                    forms[2, m] = inverse[j]
                else:
                    forms[0, m] = t - 0.5 * span[j]
                    forms[1, m] = 1.0
                    forms[2, m] = 0.0
                forms[3, m] = y[j]
                forms[4, m] = w[j]
                place[j] = m
                m += 1
        if lost > best.objective + slack:
            break
        if not curved:
            continue
        width = end - begin
        for i in range(n):
            if y[i] == 0.0 or w[i] == 0.0 or low[i] >= middle:
                continue
            if (minus if y[i] > 0.0 else plus) > best.objective + slack:
                continue
            i_inside = low[i] + span[i] > middle
            # Cuts of this curve within the cell, each with the sensor that changes sign there; the
            # meetings in it and beyond it are done with.
            cuts[0] = 0.0
            n_cuts = 1
            r = 0
            while r < n_roots[i]:
                t = roots[i, r] - begin
                if t <= 0.0:
                    r += 1
                    continue
                if t < width:
                    k = n_cuts
                    while k > 1 and cuts[k - 1] > t:
                        cuts[k] = cuts[k - 1]
                        turns[k] = turns[k - 1]
                        k -= 1
                    cuts[k] = t
                    turns[k] = place[others[i, r]]
                    n_cuts += 1
                n_roots[i] -= 1
                roots[i, r] = roots[i, n_roots[i]]
                others[i, r] = others[i, n_roots[i]]
            cuts[n_cuts] = width
            origin = (low[i] if i_inside else low[i] + 0.5 * span[i]) - begin
            known = False
            a0 = 0.0
            a1 = 0.0
            a2 = 0.0
            for k in range(n_cuts):
                left = cuts[k]
                right = cuts[k + 1]
                if right - left <= INNER_END * width:
                    known = False  # too near each other to trust their order
                    continue
                if known:
                    c = turns[k]
                    s = -2.0 * signed[c]
                    signed[c] = -signed[c]
                    a0 += s * forms[0, c]
                    a1 += s * forms[1, c]
                    a2 += s * forms[2, c]
                else:
                    known = True
                    mid = 0.5 * (left + right)
                    t = mid - origin
                    phi = t * t * inverse[i] if i_inside else t
                    force = y[i] / phi
                    a0 = 0.0
                    a1 = 0.0
                    a2 = 0.0
                    for c in range(m):
                        model = force * (forms[0, c] + mid * (forms[1, c] + mid * forms[2, c]))
                        s = forms[4, c] if forms[3, c] > model else -forms[4, c]
                        signed[c] = s
                        a0 += s * forms[0, c]
                        a1 += s * forms[1, c]
                        a2 += s * forms[2, c]
                # Sensor i itself adds a constant to B / phi_i. Shift to the curve's own origin.
                b0 = a0 + origin * (a1 + origin * a2)
                b1 = a1 + 2.0 * origin * a2
                b2 = a2
                if i_inside:
                    # B / t^2: stationary at t = -2 b0 / b1, a minimum of J if y b0 < 0.
                    if y[i] * b0 >= 0.0 or b0 * b1 >= 0.0:
                        continue
                    arc = origin - 2.0 * b0 / b1
                else:
                    # B / t: stationary at t^2 = b0 / b2.
                    if y[i] * b2 >= 0.0 or b0 * b2 <= 0.0:
                        continue
                    arc = origin + np.sqrt(b0 / b2)
                if not left - INNER_END * width <= arc <= right + INNER_END * width:
                    continue
                t = arc - origin
                arc += begin
                phi = t * t * inverse[i] if i_inside else t
                force = y[i] / phi
                if not forces.low <= force <= forces.high or arc > length:
                    continue
                value = objective_l1(arc, force, y, low, span, inverse, w)
                best = offered(best, arc, force, value, slack, near)
    return best


@compiled_part
def try_force_bounds(readings: Readings, setting: Setting, best: Best, work: Work) -> Best:
    """Along a finite bound of f the objective has its kinks where a residual vanishes."""
    near, slack = work.near, setting.slack
    y, low, span, inverse, w = readings
    edges, start, forces, cuts = setting.edges, setting.start, setting.forces, work.cuts
    n = y.shape[0]
    n_edges = edges.shape[0]
    length = edges[n_edges - 1]
    for side in range(2):
        force = forces.low if side == 0 else forces.high
        if not 0.0 < abs(force) < np.inf:
            continue
        n_cuts = 0
        for e in range(start, n_edges):
            cuts[n_cuts] = edges[e]
            n_cuts += 1
        for i in range(n):
            phi = y[i] / force
            if phi > 0.0:
                arc = low[i]
                if phi >= 0.5 * span[i]:
                    arc += 0.5 * span[i] + phi
                else:
                    arc += np.sqrt(2.0 * span[i] * phi)
                if edges[start] < arc < length:
                    m = n_cuts
                    while cuts[m - 1] > arc:
                        cuts[m] = cuts[m - 1]
                        m -= 1
                    cuts[m] = arc
                    n_cuts += 1
        for k in range(n_cuts):
            for inner in range(2):
                if inner == 0:
                    arc = cuts[k]
                else:
                    if k + 1 == n_cuts or not cuts[k + 1] > cuts[k]:
                        continue
                    middle = 0.5 * (cuts[k] + cuts[k + 1])
                    d0 = 0.0
                    d1 = 0.0
                    for j in range(n):
                        if low[j] >= middle:
                            continue
                        t = middle - low[j]
                        if t >= span[j]:
                            s = w[j] if y[j] > force * (t - 0.5 * span[j]) else -w[j]
                            d0 += s
                        else:
                            s = w[j] if y[j] > force * t * t * inverse[j] else -w[j]
                            d1 += 2.0 * s * inverse[j]
                            d0 -= 2.0 * s * inverse[j] * low[j]
                    if d1 == 0.0:
                        continue
                    arc = -d0 / d1
                    if not cuts[k] < arc < cuts[k + 1]:
                        continue
                value = objective_l1(arc, force, y, low, span, inverse, w)
                best = offered(best, arc, force, value, slack, near)
    return best
