"""The L1 profile of one contact at one arc, for hundreds of sensors: a median near a guess.

The answer's slope and the density of keys around the median are what the bound over a stretch
(`dense_bound`) starts from.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_inner, compiled_sums
from thigmo.localization.exact.absolute_fit import crossing
from thigmo.localization.exact.response import ForceRange, Readings

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Dense(NamedTuple):
    """One problem, sensors ordered by their near ends.

    Attributes:
        readings: N of them, weights > 0.
        tail: (N + 1,) sum of w |y| from each sensor on.
        forces: what f may be.
    """

    readings: Readings
    tail: Floats
    forces: ForceRange


class Room(NamedTuple):
    """Work for one profile.

    Attributes:
        phi: (N,) influences of the sensors that answer.
        key: (N,) forces at which their residuals vanish.
        amount: (N,) their weights in the median.
        order: (N,) items of the median.
    """

    phi: Floats
    key: Floats
    amount: Floats
    order: Ints


class Profile(NamedTuple):
    """The profile at one arc.

    Attributes:
        value: least objective over f.
        force: that f.
        slope: sum of the residuals' dual signs times d phi / d arc (the objective's slope is
            -f times that).
        density: amount per force around the median.
    """

    value: float
    force: float
    slope: float
    density: float


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


@compiled_inner
def dense_profile(arc: float, guess: float, dense: Dense, room: Room) -> Profile:
    """Least objective over f at one arc.

    Args:
        arc: place of the contact.
        guess: f at a place nearby; only time depends on it.
        dense: the problem.
        room: work.
    """
    y, low, span, inverse, w = dense.readings
    tail, forces = dense.tail, dense.forces
    phi, key, amount, order = room
    n = answering(low, arc)
    if n == 0:
        return Profile(tail[0], min(max(0.0, forces.low), forces.high), 0.0, 0.0)
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
    if not forces.low < force < forces.high:
        force = min(max(force, forces.low), forces.high)
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
    return Profile(value, force, slope, density)


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
