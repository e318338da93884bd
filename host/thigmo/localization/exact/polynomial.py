"""Real roots of small polynomials in the unit interval, to machine precision.

Between neighbouring roots of its derivative a polynomial is monotone, so each root is bracketed
and found by Newton steps that never leave the bracket. Bernstein coefficients of one sign prove
that there is none, which settles most calls.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_sums

Floats = NDArray[np.float64]


@compiled_sums
def quartic_misses_unit(c: Floats) -> bool:
    """Whether the Bernstein coefficients prove that a quartic has no root in [0, 1].

    Args:
        c: (5,) coefficients, lowest power first.
    """
    b0 = c[0]
    b1 = c[0] + c[1] / 4.0
    b2 = c[0] + c[1] / 2.0 + c[2] / 6.0
    b3 = c[0] + 0.75 * c[1] + 0.5 * c[2] + 0.25 * c[3]
    b4 = c[0] + c[1] + c[2] + c[3] + c[4]
    lowest = min(min(b0, b1), min(min(b2, b3), b4))
    highest = max(max(b0, b1), max(max(b2, b3), b4))
    return bool(lowest > 0.0 or highest < 0.0)


@compiled_sums
def unit_roots(c: Floats, degree: int, roots: Floats, derivatives: Floats, brackets: Floats) -> int:
    """Roots in [0, 1], ascending; returns how many.

    Args:
        c: (degree + 1,) coefficients, lowest power first; degree <= 4.
        degree: at least 1.
        roots: (5,), written.
        derivatives: (5, 5), work.
        brackets: (6,), work.
    """
    for k in range(degree + 1):
        derivatives[degree, k] = c[k]
    for d in range(degree - 1, 0, -1):
        for k in range(d + 1):
            derivatives[d, k] = derivatives[d + 1, k + 1] * (k + 1)
    count = 0
    for d in range(1, degree + 1):
        brackets[0] = 0.0
        for k in range(count):
            brackets[k + 1] = roots[k]
        brackets[count + 1] = 1.0
        ends = count + 2
        count = 0
        for k in range(ends - 1):
            left = brackets[k]
            right = brackets[k + 1]
            at_left = derivatives[d, d]
            at_right = derivatives[d, d]
            for m in range(d - 1, -1, -1):
                at_left = at_left * left + derivatives[d, m]
                at_right = at_right * right + derivatives[d, m]
            if at_left == 0.0:
                if count == 0 or roots[count - 1] < left:
                    roots[count] = left
                    count += 1
                continue
            if at_left * at_right > 0.0:
                continue
            t = left + (right - left) * at_left / (at_left - at_right)
            for _ in range(80):
                value = derivatives[d, d]
                slope = 0.0
                for m in range(d - 1, -1, -1):
                    slope = slope * t + value
                    value = value * t + derivatives[d, m]
                if value == 0.0:
                    break
                if value * at_left > 0.0:
                    left = t
                else:
                    right = t
                step = t - value / slope if slope != 0.0 else left
                if not left < step < right:
                    step = 0.5 * (left + right)
                if abs(step - t) <= 1e-15 or not left < step < right:
                    t = step
                    break
                t = step
            if count == 0 or roots[count - 1] < t:
                roots[count] = t
                count += 1
    return count
