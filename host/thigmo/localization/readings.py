"""Checks and normalisation of readings: from the caller's units to fractions of the length.

Everything behind this file works with arcs as fractions of the everted length and curvature times
length, so that a result scales exactly with the unit of length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.errors import DataError

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

# Turning of more than this (rad over the body) is no reading of a beam; larger readings are taken
# as this, so that squares stay finite.
LARGEST = 1e6
# Readings are never trusted to more than this share of the largest of them or of the free
# curvature: no beam model and no sensor constant is better.
TRUST = 5e-4

_PROBLEMS = {
    1: ("position and curvature differ in length", "give one position for each reading"),
    2: ("span is neither a scalar nor one value for each reading", "give a scalar or (N,)"),
    3: (
        "free_curvature is neither a scalar nor one value for each reading",
        "give a scalar or (N,)",
    ),
    4: ("noise is neither a scalar nor one value for each reading", "give a scalar or (N,)"),
    5: ("a position is not finite", "give each sensor's centre"),
    6: ("a sensor is centred beyond the length or behind the base", "check positions and units"),
    7: ("a span is negative or not finite", "give sensor lengths of zero or more"),
    8: ("a reading is infinite", "mark missing sensors with NaN"),
    9: ("free_curvature is not finite", "give the free curvature of the actuation, or 0"),
    10: ("noise is negative or not finite", "give one standard deviation, or None if unknown"),
    11: ("no reading is finite", "give at least one reading"),
}


@dataclass(frozen=True, slots=True)
class Readings:
    """Finite readings of one frame, normalised by the length.

    Attributes:
        y: (N,) curvature above free curvature, times length.
        low: (N,) near end of each sensor over length.
        high: (N,) far end over length.
        variance: (N,) noise variance of y, or ones where the scale is not known.
        known: whether the noise is known.
        bend: mean free curvature, times length.
        index: (N,) place of each in the caller's arrays.
        length: the everted length, caller's unit.
    """

    y: Array
    low: Array
    high: Array
    variance: Array
    known: bool
    bend: float
    index: Indices
    length: float


@compiled
def normalise_into(
    curvature: Array,
    position: Array,
    span: Array,
    free: Array,
    noise: Array,
    length: float,
    block: Array,
    index: Indices,
) -> tuple[int, int, float]:
    """Check and scale a frame, as `vectors` gives it.

    Args:
        curvature, position, span, free, noise: (n,) or, but for the first two, one for all; no
            noise if it is not known.
        length: everted length.
        block: (4, n) written: y, low, high and variance of the finite readings, as in `Readings`.
        index: (n,) written: their places.

    Returns:
        problem (see `fault`) or 0; number of finite readings; mean free curvature times length.
    """
    y, low, high, variance = block[0], block[1], block[2], block[3]
    n = curvature.shape[0]
    if position.shape[0] != n:
        return 1, 0, 0.0
    if span.shape[0] != n and span.shape[0] != 1:
        return 2, 0, 0.0
    if free.shape[0] != n and free.shape[0] != 1:
        return 3, 0, 0.0
    if noise.shape[0] > 1 and noise.shape[0] != n:
        return 4, 0, 0.0
    count = 0
    most = 0.0
    bend = 0.0
    slack = 1e-9 * length
    for i in range(n):
        x = position[i]
        width = span[i if span.shape[0] > 1 else 0]
        g = free[i if free.shape[0] > 1 else 0]
        s = 1.0 / length
        if noise.shape[0] > 0:
            s = noise[i if noise.shape[0] > 1 else 0]
        if not np.isfinite(x):
            return 5, 0, 0.0
        if x > length + slack or x < -slack:
            return 6, 0, 0.0
        if not np.isfinite(width) or width < 0.0:
            return 7, 0, 0.0
        if np.isinf(curvature[i]):
            return 8, 0, 0.0
        if not np.isfinite(g):
            return 9, 0, 0.0
        if not np.isfinite(s) or s < 0.0:
            return 10, 0, 0.0
        if np.isnan(curvature[i]):
            continue
        half = min(0.5 * width / length, 1e3)
        # A span too short to divide by is a point.
        if half < 1e-9:
            half = 0.0
        y[count] = min(max((curvature[i] - g) * length, -LARGEST), LARGEST)
        low[count] = x / length - half
        high[count] = x / length + half
        variance[count] = min(s * length, LARGEST) ** 2
        bend += min(max(g * length, -LARGEST), LARGEST)
        index[count] = i
        most = max(most, abs(y[count]), min(abs(g) * length, LARGEST))
        count += 1
    if count == 0:
        return 11, 0, 0.0
    if noise.shape[0] > 0:
        least = max(TRUST * most, 1e-9) ** 2
        for i in range(count):
            variance[i] = max(variance[i], least)
    return 0, count, bend / count


def _vector(value: npt.ArrayLike, name: str) -> Array:
    """One row of numbers, in the one layout that the compiled code takes."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError(f"{name} is not numeric", f"give {name} as numbers") from error
    if array.ndim == 0:
        array = array.reshape(1)
    elif array.ndim != 1:
        raise DataError(f"{name} has {array.ndim} dimensions", f"give {name} as one row of numbers")
    # A row of a transposed table or one that is read-only would have everything compiled again.
    return array if array.flags.carray else array.copy()


_UNKNOWN = np.zeros(0)
_ZERO = np.zeros(1)


def vectors(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    length: float,
    span: npt.ArrayLike,
    free_curvature: npt.ArrayLike,
    noise: npt.ArrayLike | None,
) -> tuple[Array, Array, Array, Array, Array, float]:
    """One frame as `normalise_into` takes it: curvature, position, span, free, noise, length.

    Raises:
        DataError: what is not numeric, not one row of numbers, or no length.
    """
    k = _vector(curvature, "curvature")
    x = _vector(position, "position")
    width = _vector(span, "span")
    g = _ZERO if isinstance(free_curvature, float) and free_curvature == 0.0 else None
    if g is None:
        g = _vector(free_curvature, "free_curvature")
    s = _UNKNOWN if noise is None else _vector(noise, "noise")
    if noise is not None and len(s) == 0:
        raise DataError("noise is empty", "give one standard deviation, or None if unknown")
    try:
        total = float(length)
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError("length is not a number", "give the everted length") from error
    if not (math.isfinite(total) and 1e-9 <= total <= 1e9):
        raise DataError(f"length {total:g} is no length", "give the everted length, in cm, m or mm")
    return k, x, width, g, s, total


def fault(problem: int) -> DataError:
    """What `normalise_into` found wrong."""
    return DataError(*_PROBLEMS[problem])


def normalise(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    length: float,
    span: npt.ArrayLike,
    free_curvature: npt.ArrayLike,
    noise: npt.ArrayLike | None,
) -> Readings:
    """Check one frame and normalise it.

    Raises:
        DataError: wrong shapes, no finite reading, sensors beyond the length, negative spans or
            noise, infinite values, a length that is no length.
    """
    k, x, width, g, s, total = vectors(curvature, position, length, span, free_curvature, noise)
    block = np.empty((4, len(k)))
    index = np.empty(len(k), dtype=np.int64)
    problem, count, bend = normalise_into(k, x, width, g, s, total, block, index)
    if problem:
        raise fault(problem)
    y, low, high, variance = block[:, :count]
    return Readings(y, low, high, variance, noise is not None, bend, index[:count], total)
