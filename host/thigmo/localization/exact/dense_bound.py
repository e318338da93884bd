"""A proven lower bound of the L1 profile of one contact along a whole stretch of arc.

For any signs |s_j| <= w_j, J(a, f) >= sum s_j y_j - f sum s_j phi_j(a). Two sets of signs, those of
the residuals at one place of the stretch for a force a little above and a little below its median,
bound every force; along the stretch the bound is a ratio of piecewise quadratics and is checked
exactly, in one sweep over the ends of spans.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_inner, compiled_sums
from thigmo.localization.exact.dense_profile import BAND, Dense, Profile, answering

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Ends(NamedTuple):
    """Ends of all spans.

    Attributes:
        arcs: (M,) ascending.
        owners: (M,) sensor of each end; ~sensor where it is a far end.
        signs: (2, N) work.
    """

    arcs: Floats
    owners: Ints
    signs: Floats


MARGIN = 1.3  # the signs' sums reach so much past what their slope needs over half a stretch
ROUNDING = 1e-13
WIDER = 4  # forces further and further apart are tried for that


@compiled_sums
def least_of(value: float, slope: float, bend: float, width: float) -> float:
    """Least value of a quadratic over [0, width], given at 0."""
    least = min(value, value + width * (slope + 0.5 * bend * width))
    if bend > 0.0 and slope < 0.0 and slope + bend * width > 0.0:
        least = min(least, value - 0.5 * slope * slope / bend)
    return least


@compiled_inner
def bounded(
    stretch: tuple[float, float, float], needed: float, profile: Profile, dense: Dense, spans: Ends
) -> bool:
    """Whether the objective is proven to be at least `needed` all along a stretch of arc.

    Args:
        stretch: near end, where `dense_profile` was called, far end.
        needed: bound that is asked for.
        profile: from `dense_profile` there.
        dense: the problem.
        spans: ends of the spans.
    """
    left, centre, right = stretch
    force, slope, density = profile.force, profile.slope, profile.density
    y, low, span, inverse, w = dense.readings
    tail, forces = dense.tail, dense.forces
    ends, owners, signs = spans
    n = answering(low, right)
    if tail[n] >= needed:
        return True
    # The sum of s phi must keep its sign while phi changes along the stretch; it falls by twice
    # the amounts that the force passes.
    half = max(right - centre, centre - left)
    # A sum that is a rounding error past zero costs the bound as little, for forces that matter
    # have |f| sum w phi <= 2 tail[0].
    rounding = 0.0
    for j in range(n):
        t = left - low[j]
        inside = min(max(t, 0.0), span[j])
        rounding += w[j] * (inside * inside * inverse[j] + (max(t, span[j]) - span[j]))
    rounding *= ROUNDING
    apart = MARGIN * 0.5 * half * abs(slope) / density if density > 0.0 else BAND * abs(force)
    apart_up = max(apart, 1e-12 * abs(force))
    apart_down = apart_up
    for _ in range(WIDER):
        f_up = max(force + apart_up, forces.low)
        f_down = min(force - apart_down, forces.high)
        up0 = 0.0
        up1 = 0.0
        down0 = 0.0
        down1 = 0.0
        for j in range(n):
            t = centre - low[j]
            inside = min(max(t, 0.0), span[j])
            here = inside * inside * inverse[j] + (max(t, span[j]) - span[j])
            rate = 1.0 if t >= span[j] else 2.0 * inverse[j] * inside
            s_up = w[j] if y[j] > f_up * here else -w[j]
            s_down = -w[j] if y[j] < f_down * here else w[j]
            up0 += s_up * here
            up1 += s_up * rate
            down0 += s_down * here
            down1 += s_down * rate
        short_up = half * abs(up1) + up0
        short_down = half * abs(down1) - down0
        if short_up <= rounding and short_down <= rounding:
            break
        step = 0.5 * MARGIN / density if density > 0.0 else np.inf
        if short_up > rounding:
            apart_up += min(max(apart_up, short_up * step), abs(force) + apart_up)
        if short_down > rounding:
            apart_down += min(max(apart_down, short_down * step), abs(force) + apart_down)
    f_up = max(force + apart_up, forces.low)
    f_down = min(force - apart_down, forces.high)

    # Dual values, and sums of s phi with their derivatives at the near end.
    d_up = tail[n]
    d_down = tail[n]
    up0 = 0.0
    up1 = 0.0
    up2 = 0.0
    down0 = 0.0
    down1 = 0.0
    down2 = 0.0
    for j in range(n):
        t = centre - low[j]
        inside = min(max(t, 0.0), span[j])
        here = inside * inside * inverse[j] + (max(t, span[j]) - span[j])
        s_up = w[j] if y[j] > f_up * here else -w[j]
        s_down = -w[j] if y[j] < f_down * here else w[j]
        signs[0, j] = s_up
        signs[1, j] = s_down
        d_up += s_up * y[j]
        d_down += s_down * y[j]
        t = left - low[j]
        inside = min(max(t, 0.0), span[j])
        here = inside * inside * inverse[j] + (max(t, span[j]) - span[j])
        rate = 1.0 if t >= span[j] else 2.0 * inverse[j] * inside
        bend = 2.0 * inverse[j] if 0.0 <= t < span[j] else 0.0
        up0 += s_up * here
        up1 += s_up * rate
        up2 += s_up * bend
        down0 += s_down * here
        down1 += s_down * rate
        down2 += s_down * bend
    # The bound holds where the first sum is <= 0, the second >= 0, and their mix is >= 0.
    a = d_up - needed
    b = d_down - needed
    both = a >= 0.0 and b >= 0.0
    up_alone = forces.low == 0.0 and a >= 0.0
    down_alone = forces.high == 0.0 and b >= 0.0
    good_up = True
    good_down = True
    good_mix = True
    at = left
    k = answering(ends, left)
    while k < ends.shape[0] and ends[k] <= left:
        k += 1
    while True:
        end = right
        if k < ends.shape[0]:
            end = min(ends[k], right)
        h = end - at
        good_up = good_up and least_of(-up0, -up1, -up2, h) >= -rounding
        good_down = good_down and least_of(down0, down1, down2, h) >= -rounding
        good_mix = good_mix and (
            both
            or least_of(a * down0 - b * up0, a * down1 - b * up1, a * down2 - b * up2, h) >= 0.0
        )
        if not (
            (good_up and good_down and good_mix)
            or (good_up and up_alone)
            or (good_down and down_alone)
        ):
            return False
        if end >= right:
            return True
        up0 += h * (up1 + 0.5 * up2 * h)
        up1 += up2 * h
        down0 += h * (down1 + 0.5 * down2 * h)
        down1 += down2 * h
        at = end
        while k < ends.shape[0] and ends[k] <= at:
            j = owners[k]
            k += 1
            far = j < 0
            if far:
                j = ~j
            if span[j] > 0.0:
                bend = -2.0 * inverse[j] if far else 2.0 * inverse[j]
                up2 += signs[0, j] * bend
                down2 += signs[1, j] * bend
            else:
                up1 += signs[0, j]
                down1 += signs[1, j]
