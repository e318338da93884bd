"""A CSV of curvature readings, checked row by row.

For `thigmo localize`: whoever has readings from anywhere may ask where the contact is. Columns
`position` and `curvature`, optionally `span`, in consistent units; lines that start with # are
comments; columns of other names are ignored.
"""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thigmo.errors import DataError

_COLUMNS = ("position", "curvature")


@dataclass(frozen=True, slots=True)
class ReadingsTable:
    """Readings along the body: arrays of shape (N,); `span` is None without that column."""

    position: NDArray[np.float64]
    curvature: NDArray[np.float64]
    span: NDArray[np.float64] | None


def read_readings(path: str | os.PathLike[str], *, length: float) -> ReadingsTable:
    """Read a CSV of readings.

    Args:
        path: the file.
        length: of the body; no sensor may be centred beyond it.

    Raises:
        DataError: naming file, line and column: unreadable, empty, a missing column, a value that
            is no finite number, a negative span, or a sensor outside 0..length.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise DataError(f"cannot read {path}: {error.strerror}", "check the path") from error
    except UnicodeDecodeError as error:
        raise DataError(f"{path} is not a text file", "export it as CSV in UTF-8") from error
    numbered = [(n, s) for n, s in enumerate(lines, 1) if s.strip() and not s.startswith("#")]
    if not numbered:
        raise DataError(f"{path} is empty", "give a header `position,curvature` and rows")
    header = [name.strip().lower() for name in next(csv.reader([numbered[0][1]]))]
    for name in _COLUMNS:
        if name not in header:
            raise DataError(
                f"{path}: no column `{name}` in its header ({', '.join(header)})",
                "name the columns position, curvature and optionally span",
            )
    wanted = [name for name in (*_COLUMNS, "span") if name in header]
    rows: list[list[float]] = []
    for number, text in numbered[1:]:
        cells = next(csv.reader([text]))
        rows.append([_value(path, number, name, cells, header.index(name)) for name in wanted])
        position, span = rows[-1][0], rows[-1][2] if "span" in wanted else 0.0
        if not 0 <= position <= length * (1 + 1e-9):
            raise DataError(
                f"{path}, line {number}: a sensor at {position:g} lies outside 0..{length:g}",
                "correct the position, or --length",
            )
        if span < 0:
            raise DataError(f"{path}, line {number}: span {span:g} is negative", "correct it")
    if not rows:
        raise DataError(f"{path} has a header and no rows", "give at least one reading")
    table = np.asarray(rows, dtype=np.float64)
    return ReadingsTable(table[:, 0], table[:, 1], table[:, 2] if "span" in wanted else None)


def _value(
    path: str | os.PathLike[str], number: int, name: str, cells: list[str], index: int
) -> float:
    try:
        value = float(cells[index])
    except IndexError:
        raise DataError(f"{path}, line {number}: no {name}", "complete the row") from None
    except ValueError:
        raise DataError(
            f"{path}, line {number}: {name} is {cells[index].strip()!r}, not a number",
            "correct it, or leave that row out",
        ) from None
    if not isfinite(value):
        raise DataError(
            f"{path}, line {number}: {name} is {cells[index].strip()}, not a finite number",
            "leave that row out",
        )
    return value
