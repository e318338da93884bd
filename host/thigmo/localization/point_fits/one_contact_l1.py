"""Global 1-norm fit of one contact, by enumeration of the pieces of its profile.

For a fixed arc the best force is a weighted median of reading / response, so the profile J(a), the
misfit with the best force, is made of pieces: along one of them the median stays with one sensor
and no residual changes sign. There J is a quotient of two quadratics, so its minimum and the arcs
where it stays below a level are closed forms. A piece is found from an arc inside it. It ends where
another residual vanishes together with the median's, or where the weights of the others pull the
median away: roots of quadratics. That the pieces hold their median is checked in their middle.
"""

from __future__ import annotations

import numpy as np

from thigmo.compiled import compiled
from thigmo.localization.point_fits.response import (
    Floats,
    Ints,
    crossing,
    expand,
    integer,
    response,
)

NARROW = 1e-13  # pieces narrower than this are left out; J is continuous
INNER_END = 1e-9  # the first cell is open at its near end: so far inside it, as a share of it
ROUNDING = 1e-13  # residuals below this share of their terms are zero
PIECE = 12  # numbers that describe a piece
TOUCHING = 1e-11  # ranges no further apart are one


@compiled
def real_roots(c0: float, c1: float, c2: float) -> tuple[float, float]:
    """Both roots of c0 + c1 t + c2 t^2; NaN or infinite for one that is not there or not real."""
    q = -0.5 * (c1 + np.copysign(np.sqrt(c1 * c1 - 4.0 * c0 * c2), c1))
    return q / c2, c0 / q


@compiled
def quotient(t: float, piece: Floats) -> float:
    """J at t on a piece."""
    top = piece[3] + t * (piece[4] + t * piece[5])
    return float(top / (piece[6] + t * (piece[7] + t * piece[8])))


@compiled
def median_sensor(y: Floats, phi: Floats, count: int, key: Floats, order: Ints) -> int:
    """The sensor whose residual vanishes for the best force, given `count` responses `phi`."""
    total = 0.0
    for j in range(count):
        key[j] = y[j] / phi[j] if phi[j] > 0.0 else 0.0
        order[j] = j
        total += phi[j]
    return int(order[min(crossing(key, phi, order, count, 0.5 * total), count - 1)])


@compiled
def narrow(c0: float, c1: float, c2: float, middle: float, piece: Floats) -> None:
    """Cut a piece at the real roots of c0 + c1 t + c2 t^2 that are next to its middle."""
    for t in real_roots(c0, c1, c2):
        if piece[0] < t <= middle:
            piece[0] = t
        elif middle < t < piece[1]:
            piece[1] = t


@compiled
def describe_piece(
    y: Floats, poly: Floats, active: int, work: Floats, order: Ints, piece: Floats
) -> bool:
    """Write the piece around the middle of an interval; false if its median does not hold there.

    `y` and `poly` (N, 3) are the readings of the `active` sensors that answer and their responses,
    `work` (2, N + 3) and `order` (N,) are room. `piece` (PIECE,) holds the interval's ends and the
    misfit of the other sensors; the piece's ends and J's numerator and denominator are written.
    """
    middle = 0.5 * (piece[0] + piece[1])
    for j in range(active):
        work[0, j] = poly[j, 0] + middle * (poly[j, 1] + middle * poly[j, 2])
    i = median_sensor(y, work[0], active, work[1], order)
    for j in range(active):
        if j != i:
            c0 = y[i] * poly[j, 0] - y[j] * poly[i, 0]
            c1 = y[i] * poly[j, 1] - y[j] * poly[i, 1]
            narrow(c0, c1, y[i] * poly[j, 2] - y[j] * poly[i, 2], middle, piece)
    middle = 0.5 * (piece[0] + piece[1])
    own = poly[i, 0] + middle * (poly[i, 1] + middle * poly[i, 2])
    # The others pull at the force; the median's sensor, and ties with it, can hold it.
    pull, give = work[0], work[1]
    for c in range(3):
        pull[c] = 0.0
        give[c] = piece[6 + c] = poly[i, c]
        piece[3 + c] = piece[2] * poly[i, c]
    for j in range(active):
        if j == i:
            continue
        phi = poly[j, 0] + middle * (poly[j, 1] + middle * poly[j, 2])
        left = y[j] * own - y[i] * phi
        tie = abs(left) <= ROUNDING * (abs(y[j]) * own + abs(y[i]) * phi)
        sign = 1.0 if left > 0.0 else -1.0
        for c in range(3):
            if tie:
                give[c] += poly[j, c]
            else:
                pull[c] += sign * poly[j, c]
                piece[3 + c] += sign * (y[j] * poly[i, c] - y[i] * poly[j, c])
    held = True
    for way in (-1.0, 1.0):
        c0 = give[0] + way * pull[0]
        c1 = give[1] + way * pull[1]
        c2 = give[2] + way * pull[2]
        total = give[0] + middle * (give[1] + middle * give[2])
        held = held and c0 + middle * (c1 + middle * c2) >= -1e-9 * total
        narrow(c0, c1, c2, middle, piece)
    return held


@compiled
def find_lowest(piece: Floats) -> None:
    """Write where J is least on a piece, an end or a place without slope, and how low it is."""
    a0, a1, a2, b0, b1, b2 = piece[3], piece[4], piece[5], piece[6], piece[7], piece[8]
    piece[10], piece[11] = piece[0], quotient(piece[0], piece)
    first, last = real_roots(a1 * b0 - a0 * b1, 2.0 * (a2 * b0 - a0 * b2), a2 * b1 - a1 * b2)
    for t in (first, last, piece[1]):
        if piece[0] < t <= piece[1] and quotient(t, piece) < piece[11]:
            piece[10], piece[11] = t, quotient(t, piece)


@compiled
def join_range(near: float, far: float, ranges: Floats, count: int) -> int:
    """Add a range to `count` ascending ones, or to the last if they touch or there is no room."""
    if count > 0 and (near <= ranges[count - 1, 1] + TOUCHING or count == ranges.shape[0]):
        ranges[count - 1, 1] = max(far, ranges[count - 1, 1])
        return count
    ranges[count, 0], ranges[count, 1] = near, far
    return count + 1


@compiled
def add_low_parts(level: float, piece: Floats, ranges: Floats, count: int) -> int:
    """Add the parts of a piece where J is at most `level` to `count` ranges; returns how many."""
    near, end = piece[0], piece[1]
    a = piece[3] - level * piece[6]
    b = piece[4] - level * piece[7]
    first, last = real_roots(a, b, piece[5] - level * piece[8])
    first = first if near < first < end else end
    last = last if near < last < end else end
    found = False
    for far in (min(first, last), max(first, last), end):
        if far > near and quotient(0.5 * (near + far), piece) <= level:
            count = join_range(piece[9] + near, piece[9] + far, ranges, count)
            found = True
        near = far
    # Too narrow to tell: the lowest point alone.
    return count if found else join_range(piece[9] + piece[10], piece[9] + piece[10], ranges, count)


@compiled
def enumerate_pieces(y: Floats, low: Floats, high: Floats, edges: Floats, pieces: Floats) -> int:
    """Write all pieces, ascending; returns how many, or -1 if (P, PIECE) is no room for them."""
    n = y.shape[0]
    used = 0
    own, order = np.empty(n), np.empty(n, np.int64)
    poly, work = np.empty((n, 3)), np.empty((2, n + 3))
    for e in range(edges.shape[0] - 1):
        start, width = edges[e], edges[e + 1] - edges[e]
        active, beyond, answered = integer(0), 0.0, False
        for j in range(n):
            if low[j] < start + 0.5 * width:
                expand(start, start + 0.5 * width, low[j], high[j], poly[active])
                answered = answered or poly[active, 0] > 0.0
                own[active] = y[j]
                active += 1
            else:
                beyond += abs(y[j])
        if active == 0:
            continue
        # From the far end of the room: intervals still to be looked at (their start is negative),
        # and pieces found that wait for the intervals before them.
        top = pieces.shape[0] - 1
        pieces[top, 0] = 0.0 if answered else INNER_END * width
        pieces[top, 1], pieces[top, 9] = width, -1.0
        while top < pieces.shape[0]:
            if pieces[top, 9] >= 0.0:
                for c in range(PIECE):
                    pieces[used, c] = pieces[top, c]
                used += 1
                top += 1
                continue
            near, far = pieces[top, 0], pieces[top, 1]
            if far - near <= NARROW:
                top += 1
                continue
            if used + 4 > top:
                return -1
            first = second = 0.5 * (near + far)
            piece = pieces[top - 1]
            piece[0], piece[1], piece[2] = near, far, beyond
            verified = describe_piece(own, poly, active, work, order, piece)
            if verified:
                first, second = piece[0], piece[1]
                find_lowest(piece)
            pieces[top, 0] = second
            piece[9] = start
            top -= 2 if verified else 1
            pieces[top, 0], pieces[top, 1], pieces[top, 9] = near, first, -1.0
    return used


@compiled
def fit_one_l1(
    rows: Floats, low: Floats, high: Floats, edges: Floats, tolerance: float, found: Floats
) -> None:
    """Global fit of every row (M, N) into `found` (M, 3 + 2 R): objective, arc, force, optimum set.

    What is within `tolerance` of the objective without contact counts as equal. The set is up to R
    ranges, both ends of each; the last takes what is too many.
    """
    n = rows.shape[1]
    pieces = np.empty((64 + 8 * n, PIECE))
    ranges = np.empty(((found.shape[1] - 3) // 2, 2))
    work, order = np.empty((2, n)), np.empty(n, np.int64)
    for row in range(rows.shape[0]):
        y = rows[row]
        rest = 0.0
        for j in range(n):
            rest += abs(y[j])
        used = enumerate_pieces(y, low, high, edges, pieces)
        while used < 0:
            pieces = np.empty((2 * pieces.shape[0], PIECE))
            used = enumerate_pieces(y, low, high, edges, pieces)
        best = rest
        for k in range(used):
            best = min(best, pieces[k, 11])
        level = best + tolerance * rest
        count = integer(0)
        if rest <= level:
            used, count = 0, join_range(0.0, 1.0, ranges, count)
        for k in range(used):
            if pieces[k, 11] <= level:
                count = add_low_parts(level, pieces[k], ranges, count)
        found[row, 0] = best
        widest = -1.0
        for k in range(count):
            found[row, 3 + 2 * k] = ranges[k, 0]
            found[row, 4 + 2 * k] = ranges[k, 1]
            if ranges[k, 1] - ranges[k, 0] > widest:
                widest = ranges[k, 1] - ranges[k, 0]
                found[row, 1] = 0.5 * (ranges[k, 0] + ranges[k, 1])
        for j in range(n):
            work[0, j] = response(found[row, 1], low[j], high[j])
        i = median_sensor(y, work[0], n, work[1], order)
        found[row, 2] = y[i] / work[0, i] if work[0, i] > 0.0 else 0.0
