"""Global 2-norm fit of one contact: the stationary points of its profile in every interval.

For a fixed arc the best force leaves sum y^2 - B^2 / C with B the sum of reading x response and C
that of response^2. Between ends of spans B is a quadratic and C a quartic of the arc (a line and a
quadratic where no span holds the contact), so the profile is stationary where 2 B' C - B C' = 0:
a quartic, the fifth powers cancel. All its roots and the ends of the interval are tried.
"""

from __future__ import annotations

import numpy as np

from thigmo.compiled import compiled
from thigmo.localization.point_fits.response import Floats, expand

Best = tuple[float, float, float]
DEGREE = 4
HALVINGS = 60
INNER_END = 1e-9  # the first cell is open at its near end: so far inside it, as a share of it


@compiled
def value_at(derived: Floats, d: int, t: float) -> float:
    """The d-th derivative of a quartic."""
    total = 0.0
    for k in range(DEGREE - d, -1, -1):
        total = total * t + derived[d, k]
    return total


@compiled
def roots_between(derived: Floats, near: float, roots: Floats) -> int:
    """Write where a quartic changes sign between `near` and 1, ascending; returns how many.

    A polynomial is monotonous between the sign changes of its derivative, so those of the third
    derivative, a line, lead to those of the second, and so on. Row 0 of `derived` (4, 5) holds the
    coefficients by ascending power; the other rows are written.
    """
    for d in range(1, DEGREE):
        for k in range(DEGREE - d + 1):
            derived[d, k] = derived[d - 1, k + 1] * (k + 1)
    count = 0
    for d in range(DEGREE - 1, -1, -1):
        turns, count, before = count, 0, near
        for k in range(turns + 1):
            a = before
            b = roots[k] if k < turns else 1.0
            before = b
            rising = value_at(derived, d, b) > 0.0
            if rising == (value_at(derived, d, a) > 0.0):
                continue
            for _ in range(HALVINGS):
                t = 0.5 * (a + b)
                if (value_at(derived, d, t) > 0.0) == rising:
                    b = t
                else:
                    a = t
            # At most as many roots as pieces were passed: no turn is overwritten unread.
            roots[count] = 0.5 * (a + b)
            count += 1
    return count


@compiled
def best_in_cell(y: Floats, low: Floats, high: Floats, start: float, width: float) -> Best:
    """What a contact between two neighbouring edges explains at best, its arc and its force."""
    c, roots = np.empty(3), np.empty(DEGREE + 2)
    slope = np.empty((DEGREE, DEGREE + 1))
    b0 = b1 = b2 = c0 = c1 = c2 = c3 = c4 = 0.0
    for j in range(y.shape[0]):
        if low[j] >= start + 0.5 * width:
            continue
        # In shares of the interval, so that the coefficients are of one size.
        expand(start, start + 0.5 * width, low[j], high[j], c)
        p, q, r = c[0], c[1] * width, c[2] * width * width
        b0 += y[j] * p
        b1 += y[j] * q
        b2 += y[j] * r
        c0 += p * p
        c1 += 2.0 * p * q
        c2 += q * q + 2.0 * p * r
        c3 += 2.0 * q * r
        c4 += r * r
    slope[0, 0] = 2.0 * b1 * c0 - b0 * c1
    slope[0, 1] = b1 * c1 + 4.0 * b2 * c0 - 2.0 * b0 * c2
    slope[0, 2] = 3.0 * b2 * c1 - 3.0 * b0 * c3
    slope[0, 3] = 2.0 * b2 * c2 - b1 * c3 - 4.0 * b0 * c4
    slope[0, 4] = b2 * c3 - 2.0 * b1 * c4
    near = 0.0 if c0 > 0.0 else INNER_END
    count = roots_between(slope, near, roots)
    roots[count], roots[count + 1] = near, 1.0
    explained = force = 0.0
    best = 1.0
    for k in range(count + 2):
        t = roots[k]
        top = b0 + t * (b1 + t * b2)
        square = c0 + t * (c1 + t * (c2 + t * (c3 + t * c4)))
        if square > 0.0 and top * top / square > explained:
            explained, force, best = top * top / square, top / square, t
    return explained, start + best * width, force


@compiled
def fit_one_l2(rows: Floats, low: Floats, high: Floats, edges: Floats, found: Floats) -> None:
    """Global fit of every row (M, N): objective, arc, force, arc, arc into `found` (M, >= 5)."""
    for row in range(rows.shape[0]):
        most = force = rest = 0.0
        arc = 1.0
        for e in range(edges.shape[0] - 1):
            width = edges[e + 1] - edges[e]
            found_here = best_in_cell(rows[row], low, high, edges[e], width)
            if found_here[0] > most:
                most, arc, force = found_here
        for j in range(rows.shape[1]):
            rest += rows[row, j] * rows[row, j]
        found[row, 0] = max(rest - most, 0.0)
        found[row, 2] = force
        found[row, 1] = found[row, 3] = found[row, 4] = arc
