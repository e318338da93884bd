"""A CSV of curvature readings, checked row by row and as a whole.

For `thigmo localize`: whoever has readings from anywhere may ask where the contact is. Columns
`position` and `curvature`, optionally `span`, in consistent units; lines that start with # are
comments; columns of other names are ignored.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thigmo.errors import DataError
from thigmo.record.table import MissingColumnError, Table

Floats = NDArray[np.float64]

_COLUMNS = ("position", "curvature", "span")
_MOST_ROWS = 2000  # of one frame


@dataclass(frozen=True, slots=True)
class ReadingsTable:
    """Readings along the body: arrays of shape (N,); `span` is None without that column."""

    position: Floats
    curvature: Floats
    span: Floats | None


def read_readings(path: str | os.PathLike[str], *, length: float) -> ReadingsTable:
    """Read a CSV of readings.

    Args:
        path: the file.
        length: of the body; no sensor may be centred beyond it.

    Raises:
        DataError: naming file, line and column: unreadable, empty, too long, a missing, empty or
            constant column, a value that is no finite number, a negative span, a sensor outside
            0..length, or positions in another unit than the length.
    """
    table = Table.read(path, most_rows=_MOST_ROWS)
    position, curvature = (_column(table, name) for name in _COLUMNS[:2])
    span = _column(table, "span") if "span" in table else None
    for name, values in (("position", position), ("curvature", curvature)):
        if len(values) > 2 and not np.ptp(values):
            raise DataError(
                f"{path}: {name} is {values[0]:g} in every row", f"check what `{name}` should hold"
            )
    _check_unit(table, position, length)
    _check_each(table, (position < 0) | (position > length * (1 + 1e-9)), position,
                "a sensor at {} lies outside 0.." + f"{length:g}",
                "correct the position, or --length")  # fmt: skip
    if span is not None:
        _check_each(table, span < 0, span, "span {} is negative", "correct it")
    return ReadingsTable(position, curvature, span)


def _column(table: Table, name: str) -> Floats:
    if name not in table:
        raise MissingColumnError(
            f"{table.name}: no column `{name}` in its header ({', '.join(table.columns)})",
            "name the columns position, curvature and optionally span",
        )
    if not any(table.columns[name]):
        raise DataError(f"{table.name}: the column `{name}` is empty", "fill it, or leave it out")
    values = table.numbers(name)
    _check_each(table, np.isnan(values), values, f"{name} is " + "{}", "leave that row out")
    return values


def _check_each(
    table: Table, wrong: NDArray[np.bool_], values: Floats, what: str, cure: str
) -> None:
    """Name the first wrong row."""
    for row in np.flatnonzero(wrong)[:1]:
        raise DataError(
            f"{table.name}, line {table.lines[row]}: {what.format(f'{values[row]:g}')}", cure
        )


def _check_unit(table: Table, position: Floats, length: float) -> None:
    """Whether the positions are in mm where the length is in cm, or the like."""
    if len(position) < 3:
        return
    reach = float(np.median(position)) / length
    if reach > 2:
        guess = "mm where the length is in cm" if reach < 10 else "a smaller unit than the length"
    elif 0 < float(position.max()) / length < 0.1:
        guess = "a larger unit than the length"
    else:
        return
    raise DataError(
        f"{table.name}: positions of {position.min():g} to {position.max():g} on a body of length "
        f"{length:g} seem to be in {guess}",
        "give both, and the curvature, in one unit",
    )
