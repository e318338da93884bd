"""The door: the caller's arrays as the compiled code takes them, and what it refuses.

Input that looks like another unit is refused with the likely cure, because a wrong answer must not
look like a right one.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError

Array = npt.NDArray[np.float64]
Range = tuple[float, float]


def vector(value: npt.ArrayLike, name: str, count: int | None = None) -> Array:
    """One row of numbers; with a count, one number for all or one for each.

    Raises:
        DataError: not numeric, not one row, or of another length.
    """
    if isinstance(value, float):
        return _one(value)
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError(f"{name} is not numeric", f"give {name} as numbers") from error
    if array.ndim == 0:
        array = array.reshape(1)
    if array.ndim != 1:
        raise DataError(f"{name} has {array.ndim} dimensions", f"give {name} as one row of numbers")
    if count is not None and array.size not in (1, count):
        raise DataError(
            f"{name} is neither a scalar nor one value for each reading", "give a scalar or (N,)"
        )
    return array if array.flags.c_contiguous else np.ascontiguousarray(array)


@lru_cache(maxsize=64)
def _one(value: float) -> Array:
    """A number as an array, kept: most options are the same in every call."""
    array = np.array([value])
    array.flags.writeable = False
    return array


def positive(value: float, name: str) -> float:
    """A finite number of zero or more.

    Raises:
        DataError: anything else.
    """
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError(f"{name} is {value!r}", f"give {name} as a number") from error
    if not (math.isfinite(number) and number >= 0.0):
        raise DataError(f"{name} is {value!r}", f"give a finite {name} of zero or more")
    return number


def everted_length(length: float) -> float:
    """The length, if it is one.

    Raises:
        DataError: not a positive number.
    """
    total = positive(length, "length")
    if not 1e-9 <= total <= 1e9:
        raise DataError(f"length {total:g} is no length", "give the everted length, in cm, m or mm")
    return total


def share_of_length(within: Range | None, total: float) -> Range:
    """Two arcs as shares of the length.

    Raises:
        DataError: no two arcs, or nothing between them.
    """
    if within is None:
        return 0.0, 1.0
    low, high = (positive(end, "within") / total for end in within)
    high = min(high, 1.0)
    if not low < high:
        raise DataError(f"within={within!r} holds no place", "give two arcs, base first")
    return low, high


def columns(shared: npt.ArrayLike | None, count: int) -> Array:
    """(K, N) columns of the further shared errors, from the caller's (N, K).

    Raises:
        DataError: of another shape, or not finite.
    """
    if shared is None:
        return _none(count)
    try:
        table = np.asarray(shared, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DataError("shared_errors is not numeric", "give (N, K) numbers") from error
    if table.ndim != 2 or len(table) != count or not np.isfinite(table).all():
        raise DataError(
            f"shared_errors has shape {table.shape}", "give (N, K): one row for each reading"
        )
    return np.ascontiguousarray(table.T)


@lru_cache(maxsize=64)
def _none(count: int) -> Array:
    return np.zeros((0, count))


# In the order of `Problem` in readings.h; {0} is the number that shows it, {1} the length.
_PROBLEMS = (
    ("", ""),
    ("a reading is infinite", "mark missing sensors with NaN"),
    ("no reading is finite", "give at least one reading"),
    ("a position is not finite", "give each sensor's centre"),
    ("a span is {0:g}", "give sensor lengths of zero or more"),
    ("free_curvature is {0:g}", "give the free curvature of the actuation, or 0"),
    ("noise is {0:g}", "give one standard deviation, or None if it is unknown"),
    ("gain_error is {0:g}", "give relative standard errors of zero or more"),
    ("bad_reading_odds is {0:g}", "give odds of zero or more"),
    ("a sensor is centred at {0:g}, off a body of {1:g}", "check positions and units"),
    ("a sensor's span of {0:g} is longer than the body, {1:g}", "check spans and units"),
    (
        "every sensor is centred within {0:g} of a body of {1:g}",
        "give positions and length in the same unit (mm and cm, or cm and m, look mixed)",
    ),
    ("all positions are {0:g}", "give each sensor's centre"),
    ("a curvature of {0:g} is tighter than the tube itself can bend", "check its unit"),
    ("all readings are {0:g}", "check the column and the sensors' connection"),
)
_MIXED = ((10.0, "mm", "cm"), (100.0, "cm", "m"), (1000.0, "mm", "m"))


def refusal(problem: int, shows: float, total: float) -> DataError:
    """What the compiled code found wrong, and the likely cure."""
    what, cure = _PROBLEMS[problem]
    if "off a body" in what or "longer than the body" in what:
        for factor, given, meant in _MIXED:
            if 0.05 * total <= shows / factor <= total:
                cure = f"it looks like {given} where the length is in {meant}: use one unit"
                break
    if "tighter" in what:
        cure = "give the inverse of the length's unit (not degrees, ohm or counts)"
        for factor, unit in ((100.0, "cm"), (1000.0, "mm")):
            if shows / factor * total < 2.0 * math.pi:
                cure = f"it looks like 1/m with lengths in {unit}, or like degrees: give 1/{unit}"
                break
    return DataError(what.format(shows, total), cure)
