"""The L1 profile of one contact at one arc, for hundreds of sensors: a median near a guess.

The answer's slope and the density of keys around the median are what the bound over a stretch
(`dense_bound`) starts from.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_sums
from thigmo.localization.exact.absolute_fit import crossing

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

BAND = 0.15  # share of the guess within which the median is looked for first


@compiled_sums
def answering(low: Floats, arc: float) -> int:
    """How many of the sensors, ordered by their near ends, answer to a contact at `arc`."""
    first = 0
    last = low.shape[0]
    while first < last:
        middle = (first + last) >> 1
        if low[middle] < arc:
            first = middle + 1
        else:
            last = middle
    return first


@compiled_sums
def dense_profile(
    arc: float,
    guess: float,
    y: Floats,
    low: Floats,
    span: Floats,
    inverse: Floats,
    w: Floats,
    tail: Floats,
    f_low: float,
    f_high: float,
    phi: Floats,
    key: Floats,
    amount: Floats,
    order: Ints,
) -> tuple[float, float, float, float]:
    """Least objective over f at one arc.

    Args:
        arc: place of the contact.
        guess: f at a place nearby; only time depends on it.
        y: (N,), by ascending `low`.
        low: (N,).
        span: (N,).
        inverse: (N,).
        w: (N,).
        tail: (N + 1,) sum of w |y| from each sensor on.
        f_low: least f.
        f_high: largest f.
        phi: (N,) work; influences of the sensors that answer.
        key: (N,) work; forces at which their residuals vanish.
        amount: (N,) work; their weights in the median.
        order: (N,) work.

    Returns:
        objective, f, sum of the residuals' dual signs times d phi / d arc (the objective's slope is
        -f times that), amount per force around the median.
    """
    n = answering(low, arc)
    if n == 0:
        return tail[0], min(max(0.0, f_low), f_high), 0.0, 0.0
    half = 0.0
    for j in range(n):
        inside = min(arc - low[j], span[j])
        phi[j] = inside * inside * inverse[j] + (max(arc - low[j], span[j]) - span[j])
        key[j] = y[j] / phi[j]
        amount[j] = w[j] * phi[j]
        half += 0.5 * amount[j]
    # The median is most often among the few keys near the guess.
    band = BAND * abs(guess)
    below, within = amounts_near(key, amount, n, guess, band)
    count = 0
    if below < half <= below + within:
        for j in range(n):
            order[count] = j
            count += abs(key[j] - guess) <= band
        place = crossing(key, amount, order, count, half - below)
        basis = order[min(place, count - 1)]
        force = key[basis]
    else:
        for j in range(n):
            order[j] = j
        place = crossing(key, amount, order, n, half)
        basis = order[min(place, n - 1)]
        force = key[basis]
        band = BAND * abs(force)
        below, within = amounts_near(key, amount, n, force, band)
    density = within / (2.0 * band) if band > 0.0 else 0.0
    if not f_low < force < f_high:
        force = min(max(force, f_low), f_high)
        basis = -1
    value = tail[n]
    balance = 0.0
    slope = 0.0
    for j in range(n):
        r = y[j] - force * phi[j]
        value += w[j] * abs(r)
        s = w[j] if r > 0.0 else -w[j]
        rate = 1.0 if arc - low[j] >= span[j] else 2.0 * inverse[j] * (arc - low[j])
        balance += s * phi[j]
        slope += s * rate
    if basis >= 0:
        t = arc - low[basis]
        rate = 1.0 if t >= span[basis] else 2.0 * inverse[basis] * t
        slope -= balance / phi[basis] * rate
    return value, force, slope, density


@compiled_sums
def amounts_near(
    key: Floats, amount: Floats, n: int, centre: float, band: float
) -> tuple[float, float]:
    """Amounts with keys below `centre` - `band`, and within `band` of it."""
    below = 0.0
    within = 0.0
    for j in range(n):
        near = abs(key[j] - centre) <= band
        within += amount[j] if near else 0.0
        below += amount[j] if key[j] < centre and not near else 0.0
    return below, within
