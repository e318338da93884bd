"""Checks what callers give and converts it for the compiled code.

Input that looks like another unit is refused with the likely remedy, because a wrong answer must
not look like a right one.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError

Array = npt.NDArray[np.float64]
Range = tuple[float, float]


def vector(value: npt.ArrayLike, name: str, count: int | None = None) -> Array:
    """A scalar or a row of numbers as an array (1,) or (n,).

    Raises DataError for anything else, and for n other than 1 or `count` if a count is given.
    """
    if isinstance(value, float):
        return np.array([value])
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


def positive(value: float, name: str) -> float:
    """The value as a finite number of zero or more. Raises DataError for anything else."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError(f"{name} is {value!r}", f"give {name} as a number") from error
    if not (math.isfinite(number) and number >= 0.0):
        raise DataError(f"{name} is {value!r}", f"give a finite {name} of zero or more")
    return number


def stated(value: float | None, name: str) -> float:
    """As `positive`; NaN for None, which is not stated."""
    return math.nan if value is None else positive(value, name)


def correlation(value: float | None) -> float:
    """A correlation from 0 to less than 1; NaN if it is not stated. Raises DataError otherwise."""
    number = stated(value, "noise_correlation")
    if number > 0.99:
        raise DataError(f"noise_correlation is {value!r}", "give a correlation from 0 to 0.99")
    return number


def share(value: float, name: str) -> float:
    """The value as a number from 0 to 1. Raises DataError for anything else."""
    number = positive(value, name)
    if number > 1.0:
        raise DataError(f"{name} is {value!r}", f"give {name} from 0 to 1")
    return number


def white_noise(noise: npt.ArrayLike | None, count: int) -> Array:
    """Standard deviations, (1,) or (count,); empty if the noise is unknown."""
    if noise is None:
        return np.zeros(0)
    white = vector(noise, "noise", count)
    if not white.size or (white == 0.0).any():
        raise DataError(
            f"noise is {'0' if white.size else 'empty'}",
            "give the standard deviation of a reading, or None if it is unknown",
        )
    return white


def contact_count(contacts: Any, method: str, least: int, most: int) -> int:
    """The number of contacts, -1 for "auto". Raises DataError unless it is from least to most."""
    if isinstance(contacts, str) and contacts == "auto":
        return -1
    number = isinstance(contacts, (int, np.integer)) and not isinstance(contacts, bool)
    if not number or not least <= contacts <= most:
        raise DataError(
            f"{method} fits no {contacts!r} contacts", f'give "auto" or {least} to {most}'
        )
    return int(contacts)


def bending_stiffness(stiffness: tuple[float, float] | None) -> tuple[float, float] | None:
    """EI and its relative error, if they are given. Raises DataError if they are impossible."""
    if stiffness is None:
        return None
    try:
        bending, error = stiffness
    except (TypeError, ValueError) as wrong:
        raise DataError(
            f"stiffness is {stiffness!r}", "give EI and its relative standard error: (500, 0.1)"
        ) from wrong
    if positive(bending, "stiffness") == 0.0:
        raise DataError("stiffness is 0", "give EI, or None if it is not known")
    return float(bending), positive(error, "the error of stiffness")


def grip(held_end: bool | float | None) -> tuple[int, float]:
    """0, 1 or 2 if the end is not, perhaps or surely held; prior odds, NaN for the default."""
    if held_end is None:
        return 1, math.nan
    if isinstance(held_end, (bool, np.bool_, int, np.integer)) and held_end in (0, 1):
        return 2 * int(held_end), math.nan
    odds = positive(held_end, "held_end")
    return int(odds > 0.0), odds


def everted_length(length: float) -> float:
    """The length. Raises DataError if it is impossible."""
    total = positive(length, "length")
    if not 1e-9 <= total <= 1e9:
        raise DataError(f"length {total:g} is no length", "give the everted length, in cm, m or mm")
    return total


def share_of_length(within: Range | None, total: float) -> Range:
    """Two arcs as shares of the length. Raises DataError if nothing lies between them."""
    if within is None:
        return 0.0, 1.0
    low, high = (positive(end, "within") / total for end in within)
    high = min(high, 1.0)
    if not low < high:
        raise DataError(f"within={within!r} holds no place", "give two arcs, base first")
    return low, high


def columns(shared: npt.ArrayLike | None, count: int) -> Array:
    """The shared errors (N, K) transposed to (K, N). Raises DataError for another shape."""
    if shared is None:
        return np.zeros((0, count))
    try:
        table = np.asarray(shared, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DataError("shared_errors is not numeric", "give (N, K) numbers") from error
    if table.ndim != 2 or len(table) != count or not np.isfinite(table).all():
        raise DataError(
            f"shared_errors has shape {table.shape}", "give (N, K): one row for each reading"
        )
    return np.ascontiguousarray(table.T)


def check_layout(position: Array, span: Array, total: float, **errors: Array) -> None:
    """Check the sensors of a layout, and their `errors`, by the names of the options.

    Raises:
        DataError: a number is impossible, or lengths are in another unit.
    """
    if not position.size:
        raise DataError("there is no position", "give each sensor's centre")
    for name, values in {"span": span, **errors}.items():
        if not (np.isfinite(values) & (values >= 0.0)).all():
            raise DataError(f"{name} is {values}", f"give a finite {name} of zero or more")
    if not np.isfinite(position).all():
        raise DataError("a position is not finite", "give each sensor's centre")
    farthest, nearest = float(position.max()), float(position.min())
    slack = 1e-9 * total
    if not -slack <= nearest <= farthest <= total + slack:
        where = farthest if farthest > total else nearest
        cure = _same_unit(where, total, least=0.4) or "check positions and units"
        if total < where <= 1.25 * total:
            cure = "leave out sensors that are not everted yet, or check the length"
        raise DataError(f"a sensor is centred at {where:g}, off a body of {total:g}", cure)
    if span.max() > total:
        cure = _same_unit(span.max(), total, least=0.05) or "check spans and units"
        raise DataError(f"a span of {span.max():g} is longer than the body, {total:g}", cure)
    if position.size < 3:
        return
    if farthest == nearest:
        raise DataError(f"all positions are {farthest:g}", "give each sensor's centre")
    if farthest < 0.12 * total:
        raise DataError(
            f"every sensor is centred within {farthest:g} of a body of {total:g}",
            "give positions and length in the same unit (mm and cm, or cm and m, look mixed)",
        )


def _same_unit(given: float, total: float, *, least: float) -> str:
    """A hint, if `given` in a smaller unit would be at least this share of the body."""
    for factor, unit, meant in ((10.0, "mm", "cm"), (100.0, "cm", "m"), (1000.0, "mm", "m")):
        if least * total <= given / factor <= total:
            return f"it looks like {unit} where the length is in {meant}: use one unit"
    return ""


# In the order of `InputProblem` in input.h; {:g} is the offending number.
_PROBLEMS = (
    ("", ""),
    ("a reading is infinite", "mark missing sensors with NaN"),
    ("no reading is finite", "give at least one reading"),
    ("free_curvature is {:g}", "give the free curvature of the actuation, or 0"),
    ("a curvature of {:g} is tighter than the tube itself can bend", ""),
    ("all readings are {:g}", "check the column and the sensors' connection"),
    (
        "the readings turn the body by {:.3g} rad, more than a whole turn",
        "check that curvature and length are in the same unit: 1/cm with cm, 1/mm with mm",
    ),
)


def refusal(problem: int, shows: float, total: float) -> DataError:
    """The error for a problem that the compiled code found in a frame, with the likely remedy."""
    problem_text, cure = _PROBLEMS[problem]
    if not cure:
        cure = "give the inverse of the length's unit (not degrees, ohm or counts)"
        for factor, unit in ((100.0, "cm"), (1000.0, "mm")):
            if shows / factor * total < 2.0 * math.pi:
                cure = f"it looks like 1/m with lengths in {unit}, or like degrees: give 1/{unit}"
                break
    return DataError(problem_text.format(shows), cure)
