"""A CSV of curvature readings, checked row by row.

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
    """Readings along the body: arrays of shape (N,); `span` is None without that column.

    `lines` are those of the file, from 1.
    """

    position: Floats
    curvature: Floats
    span: Floats | None
    lines: tuple[int, ...]


def read_readings(path: str | os.PathLike[str]) -> ReadingsTable:
    """Read a CSV of readings.

    Whether they can be those of a body (places, units) is the localizer's to say.

    Raises:
        DataError: naming file, line and column: unreadable, empty, too long, a missing or empty
            column, or a value that is no finite number.
    """
    table = Table.read(path, most_rows=_MOST_ROWS)
    position, curvature = (_column(table, name) for name in _COLUMNS[:2])
    span = _column(table, "span") if "span" in table else None
    return ReadingsTable(position, curvature, span, tuple(table.lines))


def _column(table: Table, name: str) -> Floats:
    if name not in table:
        raise MissingColumnError(
            f"{table.name}: no column `{name}` in its header ({', '.join(table.columns)})",
            "name the columns position, curvature and optionally span",
        )
    if not any(table.columns[name]):
        raise DataError(f"{table.name}: the column `{name}` is empty", "fill it, or leave it out")
    values = table.numbers(name)
    for row in np.flatnonzero(np.isnan(values))[:1]:
        raise DataError(
            f"{table.name}, line {table.lines[row]}: {name} is nan", "leave that row out"
        )
    return values
