"""Candidates for the least 1-norm of one contact: every place where its minimum can lie.

For a given arc the objective is piecewise linear in f, so it is least on one of the curves
f = y_i / phi_i(a) on which a residual vanishes, at f = 0 or at a bound of f. Between the ends of
spans and the places where two such curves meet, the objective along a curve is
c + B(t) / phi_i(t) with a quadratic B whose t^2 part comes only from sensors in whose span the
contact lies: monotone without it, with it one stationary point in closed form. Called by
`one_contact_l1`, in the order in which the functions stand here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_inner, compiled_part, compiled_sums
from thigmo.localization.exact.response import INNER_END, ForceRange, Readings, objective_l1

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
        roots: (N, 4 N) for each curve the arcs where it meets others, ascending.
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
    count = 0
    half = 0.0
    for j in range(y.shape[0]):
        inside = min(max(arc - low[j], 0.0), span[j])
        phi = inside * inside * inverse[j] + (max(arc - low[j], span[j]) - span[j])
        if phi > 0.0 and w[j] > 0.0:
            ratio = y[j] / phi
            k = count
            while k > 0 and key[k - 1] > ratio:
                key[k] = key[k - 1]
                amount[k] = amount[k - 1]
                k -= 1
            key[k] = ratio
            amount[k] = w[j] * phi
            half += 0.5 * w[j] * phi
            count += 1
    median = 0.0
    for k in range(count):
        median = key[k]
        half -= amount[k]
        if half <= 0.0:
            break
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
    # What sensors beyond the contact read is lost for every f.
    for e in range(n_edges - 1, start - 1, -1):
        arc = edges[e]
        kink = e == start or e == n_edges - 1
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
def try_pair_roots(readings: Readings, setting: Setting, best: Best, work: Work) -> Best:
    """Arcs where the curves of two readings meet; also remembered by curve, in order.

    Form 0: the contact is beyond both spans; 1: beyond the first and inside the second; 2: inside
    both (q is the span that ends last).
    """
    near, slack = work.near, setting.slack
    y, low, span, inverse, w = readings
    roots, others, n_roots = work.roots, work.others, work.n_roots
    forces, plus, minus = setting.forces, setting.plus, setting.minus
    n = y.shape[0]
    edges = setting.edges
    length = edges[edges.shape[0] - 1]
    spanned = False
    for j in range(n):
        spanned = spanned or span[j] > 0.0
        n_roots[j] = 0
    cell = setting.start
    for i in range(n):
        bar = best.objective + slack
        if y[i] == 0.0 or w[i] == 0.0 or (minus if y[i] > 0.0 else plus) > bar:
            continue
        # Nothing before the first open cell is looked at any more.
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
                        for side in range(2):
                            own = i if side == 0 else j
                            k = n_roots[own]
                            while k > 0 and roots[own, k - 1] > arc:
                                roots[own, k] = roots[own, k - 1]
                                others[own, k] = others[own, k - 1]
                                k -= 1
                            roots[own, k] = arc
                            others[own, k] = j if side == 0 else i
                            n_roots[own] += 1
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
            # Cuts of this curve within the cell, each with the sensor that changes sign there;
            # its roots are sorted and those beyond the cell are done with.
            top = n_roots[i]
            while top > 0 and roots[i, top - 1] >= end:
                top -= 1
            n_roots[i] = top
            bottom = top
            while bottom > 0 and roots[i, bottom - 1] > begin:
                bottom -= 1
            cuts[0] = 0.0
            n_cuts = 1
            for k in range(bottom, top):
                cuts[n_cuts] = roots[i, k] - begin
                turns[n_cuts] = place[others[i, k]]
                n_cuts += 1
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
