"""Global L1 fit of one contact by enumeration.

For a given arc the objective is piecewise linear in f, so it is least on one of the curves
f = y_i / phi_i(a) on which a residual vanishes, at f = 0 or at a bound of f. Between the ends of
spans and the places where two such curves meet, the objective along a curve is
c + B(t) / phi_i(t) with a quadratic B whose t^2 part comes only from sensors in whose span the
contact lies: monotone without it, with it one stationary point in closed form. The global minimum
is therefore at one of: f = 0; the ends of spans, 0 and L; pair roots; those stationary points; and
if f has a finite bound, the same along f = bound. All of them are tried.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_sums
from thigmo.localization.exact.response import (
    INNER_END,
    find_edges,
    first_influence,
    objective_l1,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CANDIDATES = 256  # near-best candidates kept to find the optimum set
PIECES = 4


@compiled_sums
def profile_l1(
    arc: float,
    y: Floats,
    low: Floats,
    span: Floats,
    inverse: Floats,
    w: Floats,
    f_low: float,
    f_high: float,
) -> tuple[float, float]:
    """Least objective over f at one arc, and that f (small N: every vanishing residual tried)."""
    f_best = min(max(0.0, f_low), f_high)
    best = objective_l1(arc, f_best, y, low, span, inverse, w)
    for i in range(y.shape[0] + 2):
        if i < y.shape[0]:
            inside = min(max(arc - low[i], 0.0), span[i])
            phi = inside * inside * inverse[i] + (max(arc - low[i], span[i]) - span[i])
            if phi <= 0.0 or y[i] == 0.0:
                continue
            f = y[i] / phi
            if not f_low <= f <= f_high:
                continue
        else:
            f = f_low if i == y.shape[0] else f_high
            if not abs(f) < np.inf:
                continue
        value = objective_l1(arc, f, y, low, span, inverse, w)
        if value < best:
            best = value
            f_best = f
    return best, f_best


@compiled_sums
def fit_l1(
    y: Floats,
    low: Floats,
    span: Floats,
    inverse: Floats,
    w: Floats,
    edges: Floats,
    n_edges: int,
    f_low: float,
    f_high: float,
    tolerance: float,
    roots: Floats,
    others: Ints,
    n_roots: Ints,
    near: Floats,
    cuts: Floats,
    forms: Floats,
    signed: Floats,
    turns: Ints,
    place: Ints,
    ranges: Floats,
) -> tuple[float, float, float, int]:
    """One problem.

    Work arrays: roots and others (N, 4 N), n_roots (N,), near (2, CANDIDATES), cuts and turns
    (6 N + 8,), forms (5, N), signed and place (N,).

    Args:
        y: (N,) readings above free curvature.
        low: (N,) near ends of the spans.
        span: (N,).
        inverse: (N,) 1 / (2 span), or 0.
        w: (N,) weights.
        edges: from `find_edges`.
        n_edges: how many.
        f_low: least f.
        f_high: largest f.
        tolerance: relative to the objective at f = 0.
        roots: work.
        others: work.
        n_roots: work.
        near: work.
        cuts: work.
        forms: work.
        signed: work.
        turns: work.
        place: work.
        ranges: (PIECES, 2), written: the optimum set.

    Returns:
        objective, arc, force, number of ranges.
    """
    n = y.shape[0]
    length = edges[n_edges - 1]
    # A force leaves at least the readings of the other sign.
    plus = 0.0
    minus = 0.0
    spanned = False
    for j in range(n):
        spanned = spanned or span[j] > 0.0
        plus += w[j] * max(y[j], 0.0)
        minus += w[j] * max(-y[j], 0.0)
        n_roots[j] = 0
    rest = plus + minus
    f_zero = min(max(0.0, f_low), f_high)
    start = first_influence(low, edges, n_edges)

    # f = 0 (or the bound next to it) is open to every arc; proximal to all sensors f is idle.
    best = rest
    best_arc = length
    best_force = f_zero
    n_near = 0
    idle = True  # no sensor answers at edges[start]
    for j in range(n):
        idle = idle and low[j] >= edges[start]
    if f_zero != 0.0:
        best = objective_l1(0.0, f_zero, y, low, span, inverse, w)
        best_arc = 0.0
        near[0, 0] = 0.0
        near[1, 0] = best
        n_near = 1
        if start > 0:
            near[0, 1] = edges[start]
            near[1, 1] = best
            n_near = 2

    slack = tolerance * max(rest, best)

    # Arcs where the objective has a kink whatever the signs: 0, L and point sensors. (The end of a
    # span is none: phi is smooth there.) What sensors beyond the contact read is lost for every f.
    for e in range(n_edges - 1, start - 1, -1):
        arc = edges[e]
        kink = e == start or e == n_edges - 1
        if e == start and idle:
            arc += INNER_END * (edges[e + 1] - arc)
        lost = 0.0
        for j in range(n):
            if low[j] >= arc:
                lost += w[j] * abs(y[j])
                kink = kink or (span[j] == 0.0 and low[j] == arc)
        if lost > best + slack:
            break
        if not kink:
            continue
        value, force = profile_l1(arc, y, low, span, inverse, w, f_low, f_high)
        if value <= best + slack:
            if value < best:
                best = value
                best_arc = arc
                best_force = force
            if n_near < CANDIDATES:
                near[0, n_near] = arc
                near[1, n_near] = value
                n_near += 1

    # Pair roots, remembered by curve. Form 0: the contact is beyond both spans; 1: beyond the first
    # and inside the second; 2: inside both (q is the span that ends last).
    for i in range(n):
        if y[i] == 0.0 or w[i] == 0.0 or (minus if y[i] > 0.0 else plus) > best + slack:
            continue
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
                    begin = max(q_end, 0.0)
                    end = length
                    if begin >= end or y[m] == y[q]:
                        continue
                    d = q_end - m_end + 0.5 * (span[m] - span[q])
                    first = m_end - 0.5 * span[m] + y[m] * d / (y[m] - y[q])
                elif form == 1:
                    begin = max(max(low[q], m_end), 0.0)
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
                    begin = max(max(low[q], low[m]), 0.0)
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
                    if phi > 0.0 and f_low <= force <= f_high:
                        value = objective_l1(arc, force, y, low, span, inverse, w)
                        if value <= best + slack:
                            if value < best:
                                best = value
                                best_arc = arc
                                best_force = force
                            if n_near < CANDIDATES:
                                near[0, n_near] = arc
                                near[1, n_near] = value
                                n_near += 1

    # Stationary points along the curves, in the cells that lie inside some span. Within a cell
    # phi_j = c0 + c1 t + c2 t^2, t from the cell's near end (`forms`).
    for e in range(n_edges - 2, start - 1, -1):
        begin = edges[e]
        end = edges[e + 1]
        middle = 0.5 * (begin + end)
        lost = 0.0
        curved = False
        m = 0
        for j in range(n):
            t = begin - low[j]
            if low[j] >= middle:
                lost += w[j] * abs(y[j])
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
        if lost > best + slack:
            break
        if not curved:
            continue
        width = end - begin
        for i in range(n):
            if y[i] == 0.0 or w[i] == 0.0 or low[i] >= middle:
                continue
            if (minus if y[i] > 0.0 else plus) > best + slack:
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
                if not f_low <= force <= f_high or arc > length:
                    continue
                value = objective_l1(arc, force, y, low, span, inverse, w)
                if value <= best + slack:
                    if value < best:
                        best = value
                        best_arc = arc
                        best_force = force
                    if n_near < CANDIDATES:
                        near[0, n_near] = arc
                        near[1, n_near] = value
                        n_near += 1

    # Along a finite bound of f the objective has its kinks where a residual vanishes.
    for side in range(2):
        force = f_low if side == 0 else f_high
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
                if value <= best + slack:
                    if value < best:
                        best = value
                        best_arc = arc
                        best_force = force
                    if n_near < CANDIDATES:
                        near[0, n_near] = arc
                        near[1, n_near] = value
                        n_near += 1

    if f_zero == 0.0 and rest <= best + slack:
        ranges[0, 0] = 0.0
        ranges[0, 1] = length
        return best, best_arc, best_force, 1

    # The optimum set: ends of its ranges are candidates; between two, the middle decides.
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
                value, force = profile_l1(
                    0.5 * (last + arc), y, low, span, inverse, w, f_low, f_high
                )
                joined = value <= best + slack or pieces == PIECES
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
                value, force = profile_l1(edges[e + 1], y, low, span, inverse, w, f_low, f_high)
                if value > best + slack:
                    break
                ranges[k, 1] = edges[e + 1]
        for e in range(n_edges - 1, start, -1):
            arc = edges[e - 1]
            if e - 1 == start and idle:
                arc += INNER_END * (edges[e] - arc)
            if arc < ranges[k, 0]:
                value, force = profile_l1(arc, y, low, span, inverse, w, f_low, f_high)
                if value > best + slack:
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
        value, force = profile_l1(arc, y, low, span, inverse, w, f_low, f_high)
        if value <= best + slack:
            best_arc = arc
            best_force = force
    return best, best_arc, best_force, pieces


@compiled_sums
def fit_l1_rows(
    y: Floats,
    low: Floats,
    span: Floats,
    w: Floats,
    length: Floats,
    f_low: float,
    f_high: float,
    tolerance: float,
    out: Floats,
    pieces: Ints,
    ranges: Floats,
) -> None:
    """Every row of a batch.

    Args:
        y: (B, N), NaN for a missing sensor.
        low: (B or 1, N).
        span: (B or 1, N).
        w: (B or 1, N).
        length: (B or 1,).
        f_low: least f.
        f_high: largest f.
        tolerance: relative.
        out: (B, 3) objective, arc, force; written.
        pieces: (B,) number of ranges; written.
        ranges: (B, PIECES, 2); written up to `pieces`.
    """
    rows, n = y.shape
    shared = low.shape[0] == 1 and span.shape[0] == 1 and length.shape[0] == 1
    r_y = np.empty(n)
    r_low = np.empty(n)
    r_span = np.empty(n)
    r_inverse = np.empty(n)
    r_w = np.empty(n)
    edges = np.empty(2 * n + 2)
    roots = np.empty((n, 4 * n))
    others = np.empty((n, 4 * n), np.int64)
    n_roots = np.empty(n, np.int64)
    near = np.empty((2, CANDIDATES))
    cuts = np.empty(6 * n + 8)
    forms = np.empty((5, n))
    signed = np.empty(n)
    turns = np.empty(6 * n + 8, np.int64)
    place = np.empty(n, np.int64)
    n_edges = 0
    if shared:
        n_edges = find_edges(low[0], span[0], length[0], edges)
    for b in range(rows):
        b_low = b if low.shape[0] > 1 else 0
        b_span = b if span.shape[0] > 1 else 0
        b_w = b if w.shape[0] > 1 else 0
        m = 0
        for j in range(n):
            if y[b, j] == y[b, j]:
                r_y[m] = y[b, j]
                r_low[m] = low[b_low, j]
                r_span[m] = span[b_span, j]
                r_inverse[m] = 0.5 / r_span[m] if r_span[m] > 0.0 else 0.0
                r_w[m] = w[b_w, j]
                m += 1
        if not shared:
            b_length = b if length.shape[0] > 1 else 0
            n_edges = find_edges(r_low[:m], r_span[:m], length[b_length], edges)
        value, arc, force, count = fit_l1(
            r_y[:m],
            r_low[:m],
            r_span[:m],
            r_inverse[:m],
            r_w[:m],
            edges,
            n_edges,
            f_low,
            f_high,
            tolerance,
            roots,
            others,
            n_roots,
            near,
            cuts,
            forms,
            signed,
            turns,
            place,
            ranges[b],
        )
        out[b, 0] = value
        out[b, 1] = arc
        out[b, 2] = force
        pieces[b] = count
