"""The compiled heart of the large-deflection rod: shooting, Newton, active set, relaxation.

Why this form. A planar inextensible rod with EI = 1 and natural curvature g carries a contact
moment m(s) with theta' = g + m, m' = -(t x n), and n is constant between contacts. Frictionless
contacts push along the normal of the rod's own skin, so, seen from the tip, everything that acts
on the rod is known once each contact's force f and place q are: integrating from the tip down to
the base is an explicit initial-value problem. What remains is a Newton iteration in two unknowns a
contact (f, q) for the two coordinates of its peg's centre, plus the fold's angle when the base
folds. Forty to a hundred thousandths of a second per warm step, with machine-precision residuals.

Place of a contact, q: one coordinate around the skin, in cm travelled by the peg's centre: from
the base up the right side (q = arc length), round the right corner of the flat end (peg radius x
angle), across the face, round the left corner, and down the left side. It is continuous, so a peg
that slides from the side over the corner onto the face needs no case distinction in Newton.

Integration: Nystroem's three-stage fourth-order scheme for theta'' (positions and moment share its
Simpson weights, so that moment balance holds to rounding), on a fixed grid plus the contacts.

When Newton's branch ends (snap-through, slip over the tip), `relax` walks downhill in energy from
the last shape with stiff penalties, and Newton polishes what it finds.

Called by `elastica.py` only. See METHODS.md sections 5 and 6 in the project's notes for the model.
"""

from __future__ import annotations

from math import atan2, ceil, cos, fabs, hypot, pi, sin, sqrt

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

MAX_CONTACTS = 12  # simultaneously touching pegs
# Columns of the node table and of a load.
S, THETA, KAPPA, X, Y = 0, 1, 2, 3, 4
# Entries of the warm-start record.
COUNT, FOLD_ON, FOLD, SIGN, ALPHA, TIP_X, TIP_Y, VALID, JAC = 0, 1, 2, 3, 4, 5, 6, 7, 8
RECORD = 9
# Status codes of `equilibrium`.
CONVERGED, RELAXED, APPROXIMATE = 0, 1, 2

_TINY = 1e-9
_GAP_TOL = 1e-7  # cm
_RES_TOL = 1e-9  # cm


@compiled
def free_angle(s: float, length: float, g: Floats, cumulative: Floats) -> float:
    """Integral of the natural curvature from 0 to s; g holds one value, or nodes over 0..length."""
    n = g.size
    if n == 1:
        return float(g[0] * s)
    cell = length / (n - 1)
    i = min(max(int(s / cell), 0), n - 2)
    u = s - i * cell
    return float(cumulative[i] + u * (g[i] + 0.5 * u * (g[i + 1] - g[i]) / cell))


@compiled
def free_curvature(s: float, length: float, g: Floats) -> float:
    """Natural curvature at s."""
    n = g.size
    if n == 1:
        return float(g[0])
    cell = length / (n - 1)
    i = min(max(int(s / cell), 0), n - 2)
    return float(g[i] + (s / cell - i) * (g[i + 1] - g[i]))


@compiled
def skin(
    q: float, length: float, tube: float, peg: float
) -> tuple[float, float, float, float, int]:
    """Where on the skin: (arc, offset along the left normal, outward t, outward n, kind).

    Kind: 0 right side, 1 right corner, 2 face, 3 left corner, 4 left side.
    """
    if q <= length:
        return max(q, 0.0), -tube, 0.0, -1.0, 0
    u = q - length
    quarter = 0.5 * pi * peg
    if u < quarter:
        b = u / peg
        return length, -tube, sin(b), -cos(b), 1
    u -= quarter
    if u <= 2.0 * tube:
        return length, u - tube, 1.0, 0.0, 2
    u -= 2.0 * tube
    if u < quarter:
        b = u / peg
        return length, tube, cos(b), sin(b), 3
    return max(length - (u - quarter), 0.0), tube, 0.0, 1.0, 4


@compiled
def shoot(
    count: int,
    force: Floats,
    place: Floats,
    radius: Floats,
    loads: Floats,
    alpha: float,
    length: float,
    tube: float,
    g: Floats,
    cumulative: Floats,
    psi: float,
    fold: float,
    cells: int,
    record: bool,
    nodes: Floats,
    frames: Floats,
    base: Floats,
) -> int:
    """Integrate from the distal end to the base for given contact forces and places.

    loads: (n, 5) arc, following normal, following tangential, dead x, dead y. alpha: heading of
    the base as seen from the distal frame, needed by dead loads only. frames receives x, y, heading
    at each contact; base receives x, y, heading, moment at s = 0 (all in the distal frame).
    With record, nodes receives (s, theta, kappa, x, y) in the base frame, ascending; returns
    their number.
    """
    n_loads = loads.shape[0]
    total = count + n_loads
    arcs = np.empty(total)
    order = np.empty(total, np.int64)
    for j in range(total):
        if j < count:
            arcs[j] = skin(place[j], length, tube, radius[j])[0]
        else:
            arcs[j] = min(max(loads[j - count, 0], 0.0), length)
        k = j
        while k > 0 and arcs[order[k - 1]] < arcs[j]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = j
    s = length
    if not record and total > 0:
        s = arcs[order[0]]
    elif not record:
        s = 0.0
    h = length / cells
    x = 0.0
    y = 0.0
    th = 0.0
    m = 0.0
    nx = 0.0
    ny = 0.0
    ca = cos(alpha)
    sa = sin(alpha)
    k = ceil(s / h - _TINY) - 1
    e = 0
    n_nodes = 0
    while True:
        while e < total and arcs[order[e]] >= s - _TINY:
            j = order[e]
            c = cos(th)
            d = sin(th)
            if j < count:
                _, off, ot, on, kind = skin(place[j], length, tube, radius[j])
                frames[j, 0] = x
                frames[j, 1] = y
                frames[j, 2] = th
                ft = -force[j] * ot
                fn = -force[j] * on
                if kind != 0 and kind != 4:
                    m += -off * ft
                nx += ft * c - fn * d
                ny += ft * d + fn * c
            else:
                i = j - count
                fn = loads[i, 1]
                ft = loads[i, 2]
                nx += ft * c - fn * d + ca * loads[i, 3] - sa * loads[i, 4]
                ny += ft * d + fn * c + sa * loads[i, 3] + ca * loads[i, 4]
            e += 1
        if record:
            nodes[n_nodes, S] = s
            nodes[n_nodes, THETA] = th
            nodes[n_nodes, KAPPA] = free_curvature(s, length, g) + m
            nodes[n_nodes, X] = x
            nodes[n_nodes, Y] = y
            n_nodes += 1
        if s <= 0.0:
            break
        to = max(k * h, 0.0)
        at_grid = True
        if e < total and arcs[order[e]] > to + _TINY:
            to = arcs[order[e]]
            at_grid = False
        if psi != 0.0 and fold < s - _TINY and fold > to + _TINY:
            to = fold
            at_grid = False
        if at_grid:
            k -= 1
        step = s - to
        mid = s - 0.5 * step
        turn_s = free_angle(s, length, g, cumulative)
        half = turn_s - free_angle(mid, length, g, cumulative)
        full = turn_s - free_angle(to, length, g, cumulative)
        if psi != 0.0 and s <= fold + _TINY:
            half += 0.5 * step * psi / fold
            full += step * psi / fold
        c1 = cos(th)
        d1 = sin(th)
        q1 = c1 * ny - d1 * nx
        t2 = th - half - 0.5 * step * m - 0.125 * step * step * q1
        c2 = cos(t2)
        d2 = sin(t2)
        q2 = c2 * ny - d2 * nx
        t3 = th - full - step * m - 0.5 * step * step * q2
        c3 = cos(t3)
        d3 = sin(t3)
        q3 = c3 * ny - d3 * nx
        th = th - full - step * m - step * step / 6.0 * (q1 + 2.0 * q2)
        w = step / 6.0
        m += w * (q1 + 4.0 * q2 + q3)
        x -= w * (c1 + 4.0 * c2 + c3)
        y -= w * (d1 + 4.0 * d2 + d3)
        s = to
    base[0] = x
    base[1] = y
    base[2] = th
    base[3] = m
    if record:
        c = cos(th)
        d = sin(th)
        for i in range(n_nodes // 2):
            o = n_nodes - 1 - i
            for col in range(5):
                v = nodes[i, col]
                nodes[i, col] = nodes[o, col]
                nodes[o, col] = v
        for i in range(n_nodes):
            dx = nodes[i, X] - x
            dy = nodes[i, Y] - y
            nodes[i, X] = c * dx + d * dy
            nodes[i, Y] = c * dy - d * dx
            nodes[i, THETA] -= th
    return n_nodes


@compiled
def pose(
    s: float, nodes: Floats, n_nodes: int, psi: float, fold: float
) -> tuple[float, float, float]:
    """(x, y, theta) at arc s from the node table: Hermite in theta, Simpson in x and y."""
    lo = 0
    hi = n_nodes - 1
    while hi - lo > 1:
        mid = (lo + hi) // 2
        if nodes[mid, S] <= s:
            lo = mid
        else:
            hi = mid
    th = _heading(s, nodes, lo, psi, fold)
    a = nodes[lo, S]
    u = s - a
    t0 = nodes[lo, THETA]
    tm = _heading(a + 0.5 * u, nodes, lo, psi, fold)
    x = nodes[lo, X] + u / 6.0 * (cos(t0) + 4.0 * cos(tm) + cos(th))
    y = nodes[lo, Y] + u / 6.0 * (sin(t0) + 4.0 * sin(tm) + sin(th))
    return x, y, th


@compiled
def _heading(s: float, nodes: Floats, i: int, psi: float, fold: float) -> float:
    """Heading at s inside cell i. The fold's turn is linear and is added apart."""
    a = nodes[i, S]
    b = nodes[i + 1, S]
    width = b - a
    if width <= 0.0:
        return float(nodes[i, THETA])
    fa = 0.0
    fb = 0.0
    fs = 0.0
    if psi != 0.0:
        fa = psi * min(a, fold) / fold
        fb = psi * min(b, fold) / fold
        fs = psi * min(max(s, 0.0), fold) / fold
    ta = nodes[i, THETA] - fa
    tb = nodes[i + 1, THETA] - fb
    u = (s - a) / width
    v = 1.0 - u
    return float(
        fs
        + ta * (1.0 + 2.0 * u) * v * v
        + tb * (1.0 + 2.0 * v) * u * u
        + width * u * v * (nodes[i, KAPPA] * v - nodes[i + 1, KAPPA] * u)
    )


@compiled
def averages(
    centers: Floats,
    spans: Floats,
    nodes: Floats,
    n_nodes: int,
    psi: float,
    fold: float,
    out: Floats,
) -> None:
    """Mean curvature over each span, exactly: difference of heading over length.

    A span of 0 gives the value at the centre. Parts beyond the rod are cut off; a span wholly
    beyond it gives 0.
    """
    length = nodes[n_nodes - 1, S]
    for k in range(centers.size):
        a = max(centers[k] - 0.5 * spans[k], 0.0)
        b = min(centers[k] + 0.5 * spans[k], length)
        if spans[k] <= 0.0:
            a = max(min(centers[k] - 5e-4, length - 1e-3), 0.0)
            b = a + 1e-3
        if b - a < 1e-9:
            out[k] = 0.0
            continue
        out[k] = (pose(b, nodes, n_nodes, psi, fold)[2] - pose(a, nodes, n_nodes, psi, fold)[2]) / (
            b - a
        )


@compiled
def gap_to(
    px: float,
    py: float,
    peg: float,
    tube: float,
    nodes: Floats,
    n_nodes: int,
    psi: float,
    fold: float,
) -> tuple[float, float]:
    """(gap, place q) between a round peg and the flat-ended tube; negative gap = overlap."""
    length = nodes[n_nodes - 1, S]
    best = 1e30
    place = 0.0
    u_before = 0.0
    perimeter = 2.0 * length + pi * peg + 2.0 * tube
    for i in range(n_nodes):
        c = cos(nodes[i, THETA])
        d = sin(nodes[i, THETA])
        dx = px - nodes[i, X]
        dy = py - nodes[i, Y]
        u = dx * c + dy * d
        if i > 0 and u_before >= 0.0 and u < 0.0:
            # The foot of the perpendicular lies in this cell: Newton on (p - r) . t = 0.
            a = nodes[i - 1, S]
            b = nodes[i, S]
            s = a + (b - a) * u_before / (u_before - u)
            v = 0.0
            for _ in range(4):
                x, y, th = pose(s, nodes, n_nodes, psi, fold)
                ct = cos(th)
                st = sin(th)
                e = (px - x) * ct + (py - y) * st
                v = (py - y) * ct - (px - x) * st
                w = b - a
                kappa = nodes[i - 1, KAPPA] + (nodes[i, KAPPA] - nodes[i - 1, KAPPA]) * (s - a) / w
                if psi != 0.0 and s < fold:
                    kappa += psi / fold
                s = min(max(s + e / max(1.0 - kappa * v, 0.1), a), b)
                if fabs(e) < 1e-12:
                    break
            gap = fabs(v) - tube - peg
            if gap < best:
                best = gap
                place = s if v < 0.0 else perimeter - s
        if i == n_nodes - 1 and u >= 0.0:
            v = dy * c - dx * d
            over = fabs(v) - tube
            quarter = 0.5 * pi * peg
            if over <= 0.0:
                # Inside the end of the tube the nearer of face and side counts.
                gap = u - peg
                q = length + quarter + tube + v
            else:
                gap = hypot(u, over) - peg
                b = atan2(u, over)
                q = length + peg * b
                if v > 0.0:
                    q = perimeter - q
            if gap < best:
                best = gap
                place = q
        u_before = u
    return best, place


@compiled
def _solve_small(a: Floats, b: Floats, n: int) -> float:
    """Gauss elimination in place with row pivoting; b becomes the solution. Returns sign of det."""
    sign = 1.0
    for i in range(n):
        p = i
        for r in range(i + 1, n):
            if fabs(a[r, i]) > fabs(a[p, i]):
                p = r
        if fabs(a[p, i]) < 1e-300:
            return 0.0
        if p != i:
            sign = -sign
            for col in range(n):
                v = a[i, col]
                a[i, col] = a[p, col]
                a[p, col] = v
            v = b[i]
            b[i] = b[p]
            b[p] = v
        if a[i, i] < 0.0:
            sign = -sign
        for r in range(i + 1, n):
            f = a[r, i] / a[i, i]
            if f != 0.0:
                for col in range(i, n):
                    a[r, col] -= f * a[i, col]
                b[r] -= f * b[i]
    for i in range(n - 1, -1, -1):
        v = b[i]
        for col in range(i + 1, n):
            v -= a[i, col] * b[col]
        b[i] = v / a[i, i]
    return sign


@compiled
def _residual(
    z: Floats,
    count: int,
    who: Ints,
    radius: Floats,
    pegs: Floats,
    loads: Floats,
    dead: bool,
    fold_sign: float,
    critical: float,
    length: float,
    tube: float,
    g: Floats,
    cumulative: Floats,
    fold: float,
    cells: int,
    scratch: Floats,
    frames: Floats,
    base: Floats,
    out: Floats,
) -> None:
    """Peg centre minus the contact's locus (cm), fold and dead-load equations scaled to cm."""
    force = np.empty(count)
    place = np.empty(count)
    for j in range(count):
        force[j] = z[2 * j]
        place[j] = z[2 * j + 1]
    n = 2 * count
    psi = 0.0
    if fold_sign != 0.0:
        psi = z[n]
        n += 1
    alpha = 0.0
    if dead:
        alpha = z[n]
        n += 1
    shoot(
        count, force, place, radius, loads, alpha, length, tube, g, cumulative, psi, fold, cells,
        False, scratch, frames, base,
    )  # fmt: skip
    cb = cos(base[2])
    sb = sin(base[2])
    for j in range(count):
        _, off, ot, on, _ = skin(place[j], length, tube, radius[j])
        lt = radius[j] * ot
        ln = off + radius[j] * on
        c = cos(frames[j, 2])
        d = sin(frames[j, 2])
        dx = frames[j, 0] + lt * c - ln * d - base[0]
        dy = frames[j, 1] + lt * d + ln * c - base[1]
        out[2 * j] = pegs[who[j], 0] - (cb * dx + sb * dy)
        out[2 * j + 1] = pegs[who[j], 1] - (cb * dy - sb * dx)
    n = 2 * count
    if fold_sign != 0.0:
        out[n] = (fold_sign * base[3] - critical) * length * length
        n += 1
    if dead:
        out[n] = (base[2] - alpha) * length


@compiled
def _newton(
    z: Floats,
    count: int,
    who: Ints,
    radius: Floats,
    pegs: Floats,
    loads: Floats,
    dead: bool,
    fold_sign: float,
    critical: float,
    length: float,
    tube: float,
    g: Floats,
    cumulative: Floats,
    fold: float,
    cells: int,
    scratch: Floats,
    jac: Floats,
    warm: bool,
    info: Floats,
) -> tuple[bool, float]:
    """Solve for z = (f, q) of each contact, fold angle, base heading. Returns (ok, sign of det J).

    A change of that sign between start and end means that a limit point was passed: not ok.

    The Jacobian comes from differences, is kept from the previous step when `warm`, and follows by
    Broyden's update as long as that converges fast.
    """
    n = 2 * count
    if fold_sign != 0.0:
        n += 1
    if dead:
        n += 1
    frames = np.empty((count, 3))
    base = np.empty(4)
    res = np.zeros(n)
    trial = np.zeros(n)
    new = np.zeros(n)
    dz = np.zeros(n)
    lu = np.empty((n, n))
    perimeter = 2.0 * length + 2.0 * tube
    fresh = False
    have = warm
    sign = 0.0
    first = 0.0
    _residual(
        z, count, who, radius, pegs, loads, dead, fold_sign, critical, length, tube, g, cumulative,
        fold, cells, scratch, frames, base, res,
    )  # fmt: skip
    norm = 0.0
    for i in range(n):
        norm = max(norm, fabs(res[i]))
    for _ in range(40):
        info[0] += 1.0
        if not have:
            for i in range(n):
                if i < 2 * count:
                    if i % 2 == 0:
                        arc = max(skin(z[i + 1], length, tube, radius[i // 2])[0], 1.0)
                        step = 3e-5 / (arc * arc * arc)
                    else:
                        step = 1e-5
                else:
                    step = 1e-6
                keep = z[i]
                z[i] = keep + step
                _residual(
                    z, count, who, radius, pegs, loads, dead, fold_sign, critical, length, tube, g,
                    cumulative, fold, cells, scratch, frames, base, trial,
                )  # fmt: skip
                z[i] = keep
                for r in range(n):
                    jac[r, i] = (trial[r] - res[r]) / step
            have = True
            fresh = True
        for r in range(n):
            dz[r] = -res[r]
            for col in range(n):
                lu[r, col] = jac[r, col]
        sign = _solve_small(lu, dz, n)
        if sign == 0.0:
            return False, 0.0
        if first == 0.0:
            first = sign
        # Limit the step: 2 cm of sliding, half a radian of fold.
        shrink = 1.0
        for i in range(n):
            if not (fabs(dz[i]) < 1e200):
                return False, 0.0
            limit = 1e200
            if i < 2 * count:
                if i % 2 == 1:
                    limit = 2.0
            else:
                limit = 0.5
            if fabs(dz[i]) > limit:
                shrink = min(shrink, limit / fabs(dz[i]))
        ok = False
        norm_new = 0.0
        for _half in range(7):
            for i in range(n):
                new[i] = z[i] + shrink * dz[i]
                if i < 2 * count and i % 2 == 1:
                    top = perimeter + pi * radius[i // 2]
                    new[i] = min(max(new[i], 1e-3), top - 1e-3)
            _residual(
                new, count, who, radius, pegs, loads, dead, fold_sign, critical, length, tube, g,
                cumulative, fold, cells, scratch, frames, base, trial,
            )  # fmt: skip
            norm_new = 0.0
            for i in range(n):
                norm_new = max(norm_new, fabs(trial[i]))
            if norm_new < (1.0 - 0.1 * shrink) * norm or norm_new < _RES_TOL:
                ok = True
                break
            if not fresh:
                break
            shrink *= 0.5
        if not ok:
            if fresh:
                info[1] = norm
                return norm < 1e-7 and sign == first, sign
            have = False
            continue
        # Broyden's rank-one update.
        dd = 0.0
        for i in range(n):
            dz[i] = new[i] - z[i]
        # Scale the update to comparable units: forces weigh by their lever.
        for i in range(n):
            w = 1.0
            if i < 2 * count and i % 2 == 0:
                arc = max(skin(z[i + 1], length, tube, radius[i // 2])[0], 1.0)
                w = arc * arc * arc / 3.0
            dd += dz[i] * dz[i] * w * w
        if dd > 0.0:
            for r in range(n):
                v = trial[r] - res[r]
                for col in range(n):
                    v -= jac[r, col] * dz[col]
                for col in range(n):
                    w = 1.0
                    if col < 2 * count and col % 2 == 0:
                        arc = max(skin(z[col + 1], length, tube, radius[col // 2])[0], 1.0)
                        w = arc * arc * arc / 3.0
                    jac[r, col] += v * dz[col] * w * w / dd
        slow = norm_new > 0.2 * norm
        for i in range(n):
            z[i] = new[i]
            res[i] = trial[i]
        norm = norm_new
        if norm < _RES_TOL:
            info[1] = norm
            return sign == first, sign
        if slow:
            have = False
        fresh = False
    info[1] = norm
    return norm < 1e-7 and sign == first, sign


@compiled
def _active_set(
    length: float,
    tube: float,
    fold: float,
    critical: float,
    g: Floats,
    cumulative: Floats,
    pegs: Floats,
    loads: Floats,
    cells: int,
    who: Ints,
    force: Floats,
    place: Floats,
    warm: Floats,
    jac: Floats,
    nodes: Floats,
    info: Floats,
) -> int:
    """Newton inside, contacts and fold switched outside until all inequalities hold.

    Returns the number of nodes, or 0 when it fails. info: 0 iterations, 1 residual, 2 deepest
    overlap, 3 moment at the base.
    """
    n_pegs = pegs.shape[0]
    dead = False
    for i in range(loads.shape[0]):
        if loads[i, 3] != 0.0 or loads[i, 4] != 0.0:
            dead = True
    size = 2 * MAX_CONTACTS + 2
    z = np.zeros(size)
    radius = np.empty(MAX_CONTACTS)
    frames = np.empty((MAX_CONTACTS, 3))
    base = np.empty(4)
    touching = np.zeros(n_pegs, np.bool_)
    info[1] = 0.0
    use_jac = warm[JAC] > 0.0
    before = warm[SIGN]
    same = before != 0.0
    for _round in range(30):
        count = int(warm[COUNT])
        sign_fold = warm[FOLD_ON]
        info[1] = 0.0
        for j in range(count):
            radius[j] = pegs[who[j], 2]
            z[2 * j] = force[j]
            z[2 * j + 1] = place[j]
        n = 2 * count
        if sign_fold != 0.0:
            z[n] = warm[FOLD]
            n += 1
        if dead:
            z[n] = warm[ALPHA]
            n += 1
        sign = 0.0
        if n > 0:
            ok, sign = _newton(
                z, count, who, radius, pegs, loads, dead, sign_fold, critical, length, tube, g,
                cumulative, fold, cells, nodes, jac, use_jac, info,
            )  # fmt: skip
            if not ok:
                return 0
        if same and sign != before and n > 0:
            return 0  # passed a limit point: the branch is no longer stable
        for j in range(count):
            force[j] = z[2 * j]
            place[j] = z[2 * j + 1]
        n = 2 * count
        warm[FOLD] = 0.0
        if sign_fold != 0.0:
            warm[FOLD] = z[n]
            n += 1
        warm[ALPHA] = z[n] if dead else 0.0
        # Release a contact that pulls: the strongest pull first.
        worst = -1
        pull = -1e-12
        for j in range(count):
            if force[j] < pull:
                pull = force[j]
                worst = j
        if worst >= 0:
            for j in range(worst, count - 1):
                who[j] = who[j + 1]
                force[j] = force[j + 1]
                place[j] = place[j + 1]
            warm[COUNT] = count - 1
            use_jac = False
            same = False
            continue
        if sign_fold != 0.0 and warm[FOLD] * sign_fold < -1e-12:
            warm[FOLD_ON] = 0.0
            warm[FOLD] = 0.0
            use_jac = False
            same = False
            continue
        n_nodes = shoot(
            count, force, place, radius, loads, warm[ALPHA], length, tube, g, cumulative,
            warm[FOLD], fold, cells, True, nodes, frames, base,
        )  # fmt: skip
        if sign_fold == 0.0 and fabs(base[3]) > critical * (1.0 + 1e-12):
            warm[FOLD_ON] = 1.0 if base[3] > 0.0 else -1.0
            warm[FOLD] = 0.0
            use_jac = False
            same = False
            continue
        for i in range(n_pegs):
            touching[i] = False
        for j in range(count):
            touching[who[j]] = True
        deepest = 0.0
        which = -1
        at = 0.0
        for i in range(n_pegs):
            if not touching[i]:
                gap, q = gap_to(
                    pegs[i, 0], pegs[i, 1], pegs[i, 2], tube, nodes, n_nodes, warm[FOLD], fold
                )
                if gap < deepest:
                    deepest = gap
                    which = i
                    at = q
        if deepest < -_GAP_TOL:
            if count >= MAX_CONTACTS or deepest < -1.0:
                return 0
            who[count] = which
            force[count] = 0.0
            place[count] = at
            warm[COUNT] = count + 1
            use_jac = False
            same = False
            continue
        warm[SIGN] = sign
        warm[JAC] = 1.0 if n > 0 else 0.0
        info[2] = min(deepest, 0.0)
        info[3] = base[3]
        return n_nodes
    return 0


@compiled
def _place_cells(
    m: Floats,
    psi: float,
    length: float,
    fold: float,
    g: Floats,
    cumulative: Floats,
    cells: int,
    nodes: Floats,
) -> None:
    """Node table of a rod with piecewise-constant contact curvature m (midpoint rule)."""
    h = length / cells
    th = 0.0
    x = 0.0
    y = 0.0
    for i in range(cells + 1):
        s = i * h
        left = m[i - 1] if i > 0 else m[0]
        right = m[i] if i < cells else m[cells - 1]
        nodes[i, S] = s
        nodes[i, THETA] = th
        nodes[i, KAPPA] = free_curvature(s, length, g) + 0.5 * (left + right)
        nodes[i, X] = x
        nodes[i, Y] = y
        if i == cells:
            break
        a0 = free_angle(s, length, g, cumulative)
        am = free_angle(s + 0.5 * h, length, g, cumulative)
        a1 = free_angle(s + h, length, g, cumulative)
        f0 = psi * min(s, fold) / fold
        fm = psi * min(s + 0.5 * h, fold) / fold
        f1 = psi * min(s + h, fold) / fold
        mid = th + am - a0 + 0.5 * h * m[i] + fm - f0
        end = th + a1 - a0 + h * m[i] + f1 - f0
        x += h / 6.0 * (cos(th) + 4.0 * cos(mid) + cos(end))
        y += h / 6.0 * (sin(th) + 4.0 * sin(mid) + sin(end))
        th = end


@compiled
def _penalised(
    m: Floats,
    psi: float,
    length: float,
    tube: float,
    fold: float,
    critical: float,
    pegs: Floats,
    hold: Floats,
    stiff: float,
    cells: int,
    nodes: Floats,
    gaps: Floats,
    places: Floats,
) -> float:
    """Energy of bending, fold and augmented penalties; gaps and places are filled."""
    h = length / cells
    energy = 0.0
    for i in range(cells):
        energy += 0.5 * h * m[i] * m[i]
    if critical < 1e200:
        energy += critical * (sqrt(psi * psi + 1e-8) - 1e-4)
    for j in range(pegs.shape[0]):
        gap, q = gap_to(pegs[j, 0], pegs[j, 1], pegs[j, 2], tube, nodes, cells + 1, psi, fold)
        gaps[j] = gap
        places[j] = q
        f = hold[j] - stiff * gap
        if f > 0.0:
            energy += 0.5 * f * f / stiff
    return energy


@compiled
def relax(
    length: float,
    tube: float,
    fold: float,
    critical: float,
    g: Floats,
    cumulative: Floats,
    pegs: Floats,
    cells: int,
    m: Floats,
    psi: float,
    nodes: Floats,
    hold: Floats,
    places: Floats,
) -> float:
    """Walk downhill in energy from contact curvature m; penalties stand for the pegs.

    Gauss-Newton in the cells' curvature with a step limit of a centimetre, so that no peg is jumped
    over; augmented Lagrangian for exact forces. m, hold (forces), places are updated; the fold's
    angle is returned.
    """
    n_pegs = pegs.shape[0]
    h = length / cells
    stiff = 0.3
    gaps = np.empty(n_pegs)
    new = np.empty(cells)
    grad = np.empty(cells)
    v = np.zeros((n_pegs, cells))
    vp = np.zeros(n_pegs)
    dm = np.empty(cells)
    small = np.empty((n_pegs, n_pegs))
    rhs = np.empty(n_pegs)
    active = np.empty(n_pegs, np.int64)
    for i in range(cells):
        # Breaks the symmetry of a straight rod pushed head-on.
        m[i] += 1e-6 * (i + 1) / cells
    for j in range(n_pegs):
        hold[j] = 0.0
    _place_cells(m, psi, length, fold, g, cumulative, cells, nodes)
    for outer in range(8):
        energy = _penalised(
            m, psi, length, tube, fold, critical, pegs, hold, stiff, cells, nodes, gaps, places
        )
        damp = 0.0
        for _it in range(400 if outer == 0 else 60):
            n_act = 0
            gp = 0.0
            hp = 1.0
            if critical < 1e200:
                root = sqrt(psi * psi + 1e-8)
                gp = critical * psi / root
                hp = critical / root
            for i in range(cells):
                grad[i] = h * m[i]
            for j in range(n_pegs):
                f = hold[j] - stiff * gaps[j]
                if f <= 0.0:
                    continue
                a, off, ot, on, _ = skin(places[j], length, tube, pegs[j, 2])
                xa, ya, ta = pose(a, nodes, cells + 1, psi, fold)
                c = cos(ta)
                d = sin(ta)
                px = xa - off * d
                py = ya + off * c
                dx = ot * c - on * d
                dy = ot * d + on * c
                vp[j] = 0.0
                for i in range(cells):
                    s0 = i * h
                    if s0 >= a:
                        v[j, i] = 0.0
                        continue
                    width = min(h, a - s0)
                    u = 0.5 * width / h
                    mx = nodes[i, X] + u * (nodes[i + 1, X] - nodes[i, X])
                    my = nodes[i, Y] + u * (nodes[i + 1, Y] - nodes[i, Y])
                    lever = -(dy * (px - mx) - dx * (py - my))
                    v[j, i] = width * lever
                    over = min(s0 + width, fold) - s0
                    if over > 0.0:
                        vp[j] += over / fold * lever
                for i in range(cells):
                    grad[i] -= f * v[j, i]
                gp -= f * vp[j]
                active[n_act] = j
                n_act += 1
            dh = h * (1.0 + damp)
            hp *= 1.0 + damp
            free_psi = critical < 1e200
            for r in range(n_act):
                t = 0.0
                for i in range(cells):
                    t += v[active[r], i] * grad[i]
                t /= dh
                if free_psi:
                    t += vp[active[r]] * gp / hp
                rhs[r] = t
                for col in range(n_act):
                    t = 0.0
                    for i in range(cells):
                        t += v[active[r], i] * v[active[col], i]
                    t /= dh
                    if free_psi:
                        t += vp[active[r]] * vp[active[col]] / hp
                    small[r, col] = t
                small[r, r] += 1.0 / stiff
            if n_act > 0 and _solve_small(small, rhs, n_act) == 0.0:
                for r in range(n_act):
                    rhs[r] = 0.0
            slope = 0.0
            for i in range(cells):
                t = grad[i]
                for r in range(n_act):
                    t -= v[active[r], i] * rhs[r]
                dm[i] = -t / dh
                slope += dm[i] * grad[i]
            dpsi = 0.0
            if free_psi:
                t = gp
                for r in range(n_act):
                    t -= vp[active[r]] * rhs[r]
                dpsi = -t / hp
                slope += dpsi * gp
            turn = 0.0
            travel = fabs(dpsi) * length
            move = fabs(dpsi)
            for i in range(cells):
                turn += fabs(dm[i]) * h
                travel += fabs(dm[i]) * h * (length - i * h)
                move = max(move, turn)
            if travel < 1e-9 or slope >= 0.0:
                break
            scale = min(1.0, 1.0 / travel)
            done = False
            for _half in range(14):
                for i in range(cells):
                    new[i] = m[i] + scale * dm[i]
                _place_cells(new, psi + scale * dpsi, length, fold, g, cumulative, cells, nodes)
                e = _penalised(
                    new, psi + scale * dpsi, length, tube, fold, critical, pegs, hold, stiff,
                    cells, nodes, gaps, places,
                )  # fmt: skip
                if e <= energy + 1e-4 * scale * slope:
                    done = True
                    break
                scale *= 0.5
            if not done:
                _place_cells(m, psi, length, fold, g, cumulative, cells, nodes)
                energy = _penalised(
                    m, psi, length, tube, fold, critical, pegs, hold, stiff, cells, nodes, gaps,
                    places,
                )  # fmt: skip
                damp = max(4.0 * damp, 0.1)
                if damp > 1e6:
                    break
                continue
            damp *= 0.3
            for i in range(cells):
                m[i] = new[i]
            psi += scale * dpsi
            gain = energy - e
            energy = e
            if gain <= 1e-14 * fabs(energy) and scale * travel < 1e-6:
                break
        worst = 0.0
        for j in range(n_pegs):
            hold[j] = max(0.0, hold[j] - stiff * gaps[j])
            if hold[j] > 0.0:
                worst = max(worst, fabs(gaps[j]))
            else:
                worst = max(worst, -gaps[j])
        if worst < 1e-6:
            break
    return psi


@compiled
def equilibrium(
    length: float,
    tube: float,
    fold: float,
    critical: float,
    g: Floats,
    cumulative: Floats,
    pegs: Floats,
    loads: Floats,
    cells: int,
    travel: float,
    who: Ints,
    force: Floats,
    place: Floats,
    warm: Floats,
    jac: Floats,
    curvature: Floats,
    nodes: Floats,
    info: Floats,
) -> tuple[int, int]:
    """One quasi-static step from the warm state. Returns (status, number of nodes).

    travel: how far the tip may be expected to move (cm); a solution farther away than a few times
    that is checked by relaxation. curvature: contact curvature per cell of the last solution,
    updated. info: 0 iterations, 1 residual (cm), 2 deepest overlap (cm), 3 moment at the base.
    """
    who_0 = who.copy()
    force_0 = force.copy()
    place_0 = place.copy()
    warm_0 = warm.copy()
    info[0] = 0.0
    info[1] = 0.0
    n_nodes = _active_set(
        length, tube, fold, critical, g, cumulative, pegs, loads, cells, who, force, place, warm,
        jac, nodes, info,
    )  # fmt: skip
    status = CONVERGED
    if n_nodes > 0 and warm_0[VALID] > 0.0:
        far = hypot(nodes[n_nodes - 1, X] - warm_0[TIP_X], nodes[n_nodes - 1, Y] - warm_0[TIP_Y])
        if far > 5.0 * travel + 0.3:
            n_nodes = 0
    if n_nodes == 0 and loads.shape[0] == 0:
        status = RELAXED
        m = curvature.copy()
        hold = np.zeros(pegs.shape[0])
        places = np.zeros(pegs.shape[0])
        psi = relax(
            length, tube, fold, critical, g, cumulative, pegs, cells, m, warm_0[FOLD], nodes, hold,
            places,
        )  # fmt: skip
        tip_x = nodes[cells, X]
        tip_y = nodes[cells, Y]
        count = 0
        for j in range(pegs.shape[0]):
            if hold[j] > 1e-9 and count < MAX_CONTACTS:
                who[count] = j
                force[count] = hold[j]
                place[count] = places[j]
                count += 1
        warm[:] = 0.0
        warm[COUNT] = count
        if fabs(psi) > 1e-3:
            warm[FOLD_ON] = 1.0 if psi > 0.0 else -1.0
            warm[FOLD] = psi
        n_nodes = _active_set(
            length, tube, fold, critical, g, cumulative, pegs, loads, cells, who, force, place,
            warm, jac, nodes, info,
        )  # fmt: skip
        if n_nodes > 0:
            far = hypot(nodes[n_nodes - 1, X] - tip_x, nodes[n_nodes - 1, Y] - tip_y)
            if far > 1.0:
                n_nodes = 0
        if n_nodes == 0:
            # Keep the relaxed shape: an equilibrium to penalty accuracy.
            status = APPROXIMATE
            warm[:] = 0.0
            count = 0
            deepest = 0.0
            _place_cells(m, psi, length, fold, g, cumulative, cells, nodes)
            n_nodes = cells + 1
            for j in range(pegs.shape[0]):
                gap, q = gap_to(pegs[j, 0], pegs[j, 1], pegs[j, 2], tube, nodes, n_nodes, psi, fold)
                deepest = min(deepest, gap)
                if hold[j] > 1e-9 and count < MAX_CONTACTS:
                    who[count] = j
                    force[count] = hold[j]
                    place[count] = q
                    count += 1
            warm[COUNT] = count
            if fabs(psi) > 1e-3:
                warm[FOLD_ON] = 1.0 if psi > 0.0 else -1.0
                warm[FOLD] = psi
            info[1] = 1e-3
            info[2] = deepest
            info[3] = m[0]
    if n_nodes == 0:
        who[:] = who_0
        force[:] = force_0
        place[:] = place_0
        warm[:] = warm_0
        warm[JAC] = 0.0
        return APPROXIMATE, 0
    warm[TIP_X] = nodes[n_nodes - 1, X]
    warm[TIP_Y] = nodes[n_nodes - 1, Y]
    warm[VALID] = 1.0
    # Contact curvature at the cells' middles, for the next relaxation.
    h = length / cells
    k = 0
    for i in range(cells):
        s = (i + 0.5) * h
        while k < n_nodes - 2 and nodes[k + 1, S] <= s:
            k += 1
        width = nodes[k + 1, S] - nodes[k, S]
        u = (s - nodes[k, S]) / width if width > 0.0 else 0.0
        curvature[i] = (
            nodes[k, KAPPA] + u * (nodes[k + 1, KAPPA] - nodes[k, KAPPA])
            - free_curvature(s, length, g)
        )  # fmt: skip
    return status, n_nodes
