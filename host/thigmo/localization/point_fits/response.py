"""How a sensor answers to a contact: the average, over its span, of the curvature of a unit force.

With a sensor from `low` to `high` and a contact at a that is 0 up to `low`, (a - low)^2 / (2 span)
inside the span and a - (low + high) / 2 beyond it. Names that all kernels share: `y` (N,) readings,
`low` and `high` (N,) the ends of their spans, `edges` those ends within the body, ascending from 0
to 1. Everything is in units of the length.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@compiled
def integer(value: int) -> int:
    """The same integer, but no literal: what it is passed to is not compiled for its value."""
    return value + 0


@compiled
def response(arc: float, low: float, high: float) -> float:
    """Average curvature of one sensor for a unit force at `arc`."""
    if arc <= low:
        return 0.0
    if arc >= high:
        return arc - 0.5 * (low + high)
    return 0.5 * (arc - low) * (arc - low) / (high - low)


@compiled
def expand(start: float, middle: float, low: float, high: float, c: Floats) -> None:
    """Write the response near `middle` as a polynomial `c` (3,) of arc - start."""
    c[0] = c[1] = c[2] = 0.0
    if middle >= high:
        c[0] = start - 0.5 * (low + high)
        c[1] = 1.0
    elif middle > low:
        c[2] = 0.5 / (high - low)
        c[1] = 2.0 * (start - low) * c[2]
        c[0] = (start - low) * (start - low) * c[2]


@compiled
def crossing(key: Floats, amount: Floats, order: Ints, count: int, need: float) -> int:
    """Place in `order` up to which the amounts, by ascending key, first add up to `need`.

    Weighted quickselect over `count` items of `order`, which is rearranged: `order[:place]` holds
    the smaller keys. Returns `count` if the amounts do not suffice.
    """
    left, right = 0, count
    while left < right:
        pivot = key[order[(left + right) // 2]]
        less = k = left
        more = right
        below = equal = 0.0
        while k < more:
            item = order[k]
            if key[item] < pivot:
                order[k], order[less] = order[less], item
                below += amount[item]
                less += 1
                k += 1
            elif key[item] > pivot:
                more -= 1
                order[k], order[more] = order[more], item
            else:
                equal += amount[item]
                k += 1
        if below >= need:
            right = less
            continue
        need -= below
        if equal >= need:
            for k in range(less, more):
                need -= amount[order[k]]
                if need <= 0.0:
                    return k
            return more - 1
        need -= equal
        left = more
    # Sums in another order may round to less: then the next item is as good.
    return right
