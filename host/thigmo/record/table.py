"""Readings as a lab has them: a CSV with a header, numbers and a few words.

Read line by line, so that a file of many frames is refused at its first line too many. The header
says what separates columns: commas, or, as spreadsheets of many countries write them, semicolons or
tabs, with which numbers may have decimal commas. The name `-` is the standard input.

Loggers write more than a header and numbers: notes above the header, rows of units below it (TOA5
has both), the time stamps of a serial monitor before each line, the header again after a restart,
and a last line that was cut off. These are skipped, and `Table.remarks` says which.
"""

from __future__ import annotations

import csv
import errno
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import chain, islice
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from thigmo.errors import DataError
from thigmo.files import whole_file

Array = NDArray[np.float64]

_SEPARATORS = (",", ";", "\t")
_MOST_CHARACTERS = 64 << 20
_MOST_ROWS = 1_000_000
_MOST_READINGS = 2000  # of one frame
_READINGS_COLUMNS = ("position", "curvature", "span", "angle_deg", "strain")
_MOST_NOTES = 200  # lines above the header
_MOST_UNIT_ROWS = 3  # below the header
# "12:34:56.789 -> 0.01,0.02", as the Arduino IDE's serial monitor writes it; PlatformIO writes ">".
_MONITOR_STAMP = re.compile(r"^\s*\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?\s*-?>\s?")


class MissingColumnError(DataError):
    """A column that is needed is not there."""


@dataclass(frozen=True, slots=True)
class Table:
    """Columns by name, in any case; empty cells are nan, words stay words."""

    columns: Mapping[str, Sequence[str]]  # in lower case
    name: str  # of the file
    lines: Sequence[int]  # of each row in the file, from 1
    decimal_commas: bool = False  # columns are not separated by commas: numbers may have them
    remarks: tuple[str, ...] = ()  # which lines were skipped, and why

    @classmethod
    def read(
        cls,
        path: str | os.PathLike[str],
        *,
        columns: Sequence[str] = (),
        most_rows: int = _MOST_ROWS,
    ) -> Table:
        """Read a CSV file, or the standard input (`-`); lines that start with # are comments.

        The header is the first row that has all `columns`, in any case. If none has, or none are
        named, it is the first row of words that stands above as many cells with a number.

        Raises DataError: unreadable, empty, ragged, too long, or separated by something else.
        """
        name = "the standard input" if str(path) == "-" else str(path)
        try:
            with _opened(path) as file:
                return _parsed(name, file, columns, most_rows)
        except OSError as error:
            raise DataError(f"cannot read {name}: {error.strerror}", "check the path") from error
        except (UnicodeDecodeError, csv.Error) as error:
            raise DataError(f"{name} is not a text file", "export it as CSV in UTF-8") from error

    def __contains__(self, column: str) -> bool:
        return column.lower() in self.columns

    def numbers(self, column: str, default: float | None = None) -> Array:
        """A column of numbers (n,); empty cells are nan.

        Raises MissingColumnError without a default, and DataError: a word where a number belongs.
        """
        values = np.empty(len(self.lines))
        cells = self.words(column, None if default is None else str(default))
        for number, (cell, line) in enumerate(zip(cells, self.lines, strict=True)):
            where, cure = f"{self.name}, line {line}: {column}", "correct it, or leave that row out"
            try:
                if self.decimal_commas and cell.count(",") == 1 and "." not in cell:
                    cell = cell.replace(",", ".")
                values[number] = float(cell) if cell else np.nan
            except ValueError as error:
                if cell.count(",") == 1 and cell.replace(",", "").lstrip("+-").isdecimal():
                    cure = "export it with points in numbers, not commas"
                raise DataError(f"{where} is {_short(cell)}, not a number", cure) from error
            if np.isinf(values[number]):
                raise DataError(f"{where} is {cell}, not a finite number", cure)
        return values

    def integers(self, column: str, default: int | None = None) -> NDArray[np.int64]:
        """A column of whole numbers (n,), none of them empty.

        Raises as `numbers` does, and DataError for an empty cell or a number that is not whole.
        """
        values = self.numbers(column, None if default is None else float(default))
        for row in np.flatnonzero(values != np.round(values))[:1]:
            where = f"{self.name}, line {self.lines[row]}"
            raise DataError(f"{where}: column '{column}' needs a whole number", "correct that cell")
        return values.astype(np.int64)

    def words(self, column: str, default: str | None = None) -> list[str]:
        """A column of words. Raises MissingColumnError if it is not there, without a default."""
        if column in self:
            return list(self.columns[column.lower()])
        if default is None:
            raise MissingColumnError(f"{self.name}: no column '{column}'", "add it")
        return [default] * len(self.lines)


@dataclass(frozen=True, slots=True)
class ReadingsTable:
    """Readings along the body: arrays of shape (N,), in consistent units."""

    position: Array
    curvature: Array
    span: Array | None  # None without that column
    lines: tuple[int, ...]  # of the file, from 1
    angle: Array | None = None  # around the body, rad; None without that column
    strain: Array | None = None  # microstrain, in place of a curvature, which is nan then
    remarks: tuple[str, ...] = ()  # which lines of the file were skipped, or columns not used


def read_readings(path: str | os.PathLike[str]) -> ReadingsTable:
    """Read a CSV of readings: columns `position`, `curvature` and optionally `span`, `angle_deg`.

    `angle_deg` is around the body; the result has it in rad, as `Sensors` takes it. The table of a
    fibre may have `strain` (microstrain) in place of `curvature`. An empty curvature, or NaN, is a
    sensor that was not read. Whether the values can belong to a body, only the localizer checks.

    Raises:
        DataError: the file is unreadable, empty or too long, a column is missing or empty, or a
            value is no finite number. The message names file, line and column.
    """
    table = Table.read(path, columns=("position",), most_rows=_MOST_READINGS)
    position, strain = _readings(table, "position"), None
    if "strain" in table and "curvature" not in table:
        strain = _readings(table, "strain", missing=True)
        curvature = np.full(len(position), np.nan)
    else:
        curvature = _readings(table, "curvature", missing=True)
    span = _readings(table, "span") if "span" in table else None
    angle = np.deg2rad(_readings(table, "angle_deg")) if "angle_deg" in table else None
    remarks = list(table.remarks)
    if unused := [name for name in table.columns if name not in _READINGS_COLUMNS]:
        remarks.append(
            f"{table.name}: not used: {', '.join(unused)}; the columns of readings are "
            f"{', '.join(_READINGS_COLUMNS)}"
        )
    return ReadingsTable(
        position, curvature, span, tuple(table.lines), angle, strain, tuple(remarks)
    )


def _readings(table: Table, name: str, *, missing: bool = False) -> Array:
    if name not in table:
        raise MissingColumnError(
            f"{table.name}: no column `{name}` in its header ({', '.join(table.columns)})",
            "name the columns position, curvature and optionally span; if each row is a frame, "
            "give --columns",
        )
    if not any(table.columns[name]):
        raise DataError(f"{table.name}: the column `{name}` is empty", "fill it, or leave it out")
    values = table.numbers(name)
    for row in np.flatnonzero(np.isnan(values))[:1] if not missing else []:
        where = f"{table.name}, line {table.lines[row]}"
        raise DataError(f"{where}: {name} is nan", "leave that row out")
    return values


@dataclass(frozen=True, slots=True)
class FramesTable:
    """Frames of the same sensors, a row each."""

    position: Array  # (N,) of the sensors
    curvature: Array  # (M, N); NaN where a sensor was not read
    time_s: Array | None  # (M,); None without a column `t_s`
    lines: tuple[int, ...]  # of the file, from 1
    remarks: tuple[str, ...] = ()  # which lines of the file were skipped, and why


def read_frames(path: str | os.PathLike[str], columns: Mapping[str, float]) -> FramesTable:
    """Read a CSV with a frame in each row, of the `columns` that are named with their positions.

    Raises DataError as `read_readings` does.
    """
    table = Table.read(path, columns=tuple(columns))
    for name in columns:
        if name not in table:
            raise MissingColumnError(
                f"{table.name}: no column `{name}` in its header ({', '.join(table.columns)})",
                "name columns that it has: --columns NAME=POSITION,NAME=POSITION",
            )
    curvature = np.column_stack([table.numbers(name) for name in columns])
    time_s = table.numbers("t_s") if "t_s" in table else None
    positions = np.array([*columns.values()])
    return FramesTable(positions, curvature, time_s, tuple(table.lines), table.remarks)


def write_table(path: str | os.PathLike[str], columns: Mapping[str, Sequence[object]]) -> None:
    """Write columns as CSV; nan and None become empty cells. Raises DataError if it cannot."""

    def cell(value: object) -> str:
        if value is None or (isinstance(value, float) and not np.isfinite(value)):
            return ""
        return f"{value:.9g}" if isinstance(value, float) else str(value)

    refused = DataError.from_os(f"cannot write {path}", "choose another folder")
    with refused, whole_file(path, text=True) as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow([cell(value) for value in row])


def _opened(path: str | os.PathLike[str]) -> IO[str]:
    """A text file, or the standard input."""
    if str(path) == "-":
        return _bounded(sys.stdin, "the input")
    if Path(path).is_char_device() or Path(path).is_block_device():
        raise OSError(errno.EINVAL, "it is a device", str(path))
    with Path(path).open(newline="", encoding="utf-8-sig") as file:  # a pipe is welcome
        return _bounded(file, str(path))


def _bounded(file: IO[str], name: str) -> IO[str]:
    """All of a text, which may have no line's end. Raises OSError if it is too long for a table."""
    text = file.read(_MOST_CHARACTERS + 1)
    if len(text) > _MOST_CHARACTERS:
        raise OSError(errno.EFBIG, f"it is larger than {_MOST_CHARACTERS >> 20} MB", name)
    return StringIO(text, newline="")


def _parsed(name: str, file: IO[str], columns: Sequence[str], most_rows: int) -> Table:
    """The table in a text. Raises DataError as `Table.read` does."""
    stamped = (_MONITOR_STAMP.sub("", line, count=1) for line in file)
    first_lines = list(islice(stamped, _MOST_NOTES))
    start, separator = _header_line(first_lines, columns)
    skipped_notes = [
        number for number, line in enumerate(first_lines[:start], start=1) if not _is_comment(line)
    ]
    reader = csv.reader(chain(first_lines[start:], stamped), delimiter=separator)
    cells_by_line = (
        (start + reader.line_num, [cell.strip() for cell in row])
        for row in reader
        if not _is_comment(separator.join(row))
    )
    _, names = next(cells_by_line, (0, []))
    if not any(names):
        raise DataError(f"{name} is empty", "give a header line, and a line for each reading")
    header = [cell.lower() for cell in names]
    _check_header(name, header)

    rows: list[list[str]] = []
    lines: list[int] = []
    unit_rows: list[list[str]] = []
    unit_lines: list[int] = []
    repeated_headers: list[int] = []
    short_row: tuple[int, list[str]] | None = None
    for line, cells in cells_by_line:
        if not any(cells):
            continue
        if short_row is not None:
            raise _ragged(name, short_row[0], header, short_row[1])
        if [cell.lower() for cell in cells] == header:
            repeated_headers.append(line)
        elif len(cells) < len(header):
            short_row = line, cells
        elif len(cells) > len(header):
            raise _ragged(name, line, header, cells)
        elif not rows and len(unit_rows) < _MOST_UNIT_ROWS and not _has_number(cells, separator):
            unit_rows.append(cells)
            unit_lines.append(line)
        else:
            rows.append(cells)
            lines.append(line)
        if len(rows) > most_rows:
            raise DataError(f"{name} has more than {most_rows} rows", "cut out those of one frame")
    if short_row is not None and not rows:
        raise _ragged(name, short_row[0], header, short_row[1])
    if not rows:  # words where numbers belong: whoever needs a number names line and column
        rows, lines, unit_lines = unit_rows, unit_lines, []
    if not rows:
        raise DataError(f"{name} has a header but no rows", "add a row, or delete the file")

    remarks = [
        f"{name}: {_lines(numbers)} skipped: {reason}"
        for numbers, reason in (
            (skipped_notes, "above the header"),
            (unit_lines, "no number below the header"),
            (repeated_headers, "the header again"),
        )
        if numbers
    ]
    if short_row is not None:
        torn = f"it has {len(short_row[1])} of {len(header)} cells"
        remarks.append(f"{name}: the last line, {short_row[0]}, was cut off and left out: {torn}")
    cells_by_name = {key: [row[k] for row in rows] for k, key in enumerate(header)}
    return Table(cells_by_name, name, lines, separator != ",", tuple(remarks))


def _header_line(lines: Sequence[str], columns: Sequence[str]) -> tuple[int, str]:
    """The index of the header in a file's first lines, and what separates its columns."""
    required = {column.lower() for column in columns}
    content_lines = [number for number, line in enumerate(lines) if not _is_comment(line)]
    if not content_lines:
        return 0, ","
    for number in content_lines if required else ():
        for separator in _SEPARATORS:
            if required <= {cell.lower() for cell in _cells(lines[number], separator)}:
                return number, separator
    for place, number in enumerate(content_lines):
        separator = max(_SEPARATORS, key=lines[number].count)
        cells = _cells(lines[number], separator)
        if _has_number(cells, separator):
            break  # rows begin, and nothing above them could be their header
        below = content_lines[place + 1 : place + 2 + _MOST_UNIT_ROWS]
        for row in (_cells(lines[line], separator) for line in below):
            if len(row) == len(cells) and _has_number(row, separator):
                return number, separator
    return content_lines[0], max(_SEPARATORS, key=lines[content_lines[0]].count)


def _cells(line: str, separator: str) -> list[str]:
    return [cell.strip() for row in csv.reader([line], delimiter=separator) for cell in row]


def _is_comment(line: str) -> bool:
    """Whether a line is empty or starts with #."""
    return not line.strip() or line.lstrip().startswith("#")


def _has_number(cells: Sequence[str], separator: str) -> bool:
    for cell in cells:
        try:
            float(cell if separator == "," else cell.replace(",", ".", 1))
        except ValueError:
            continue
        return True
    return False


def _lines(numbers: Sequence[int]) -> str:
    """Lines of a file in words: "line 3 was", "lines 1 to 4 were"."""
    if len(numbers) == 1:
        return f"line {numbers[0]} was"
    if list(numbers) == list(range(numbers[0], numbers[-1] + 1)):
        return f"lines {numbers[0]} to {numbers[-1]} were"
    listed = ", ".join(map(str, numbers[:5])) + (", ..." if len(numbers) > 5 else "")
    return f"lines {listed} were"


def _short(cell: str) -> str:
    """A cell on one line; an unclosed quotation mark makes one of all that follows."""
    return repr(cell if len(cell) <= 40 else f"{cell[:37]}...")


def _check_header(table: str, header: Sequence[str]) -> None:
    if len(header) == 1 and "|" in header[0]:
        raise DataError(
            f"{table} separates its columns by bars", "export it with commas or semicolons"
        )
    twice = next((name for name in header if name and header.count(name) > 1), None)
    if twice is not None:
        raise DataError(f"{table}: the column '{twice}' appears twice", "rename one of them")


def _ragged(table: str, line: int, header: Sequence[str], cells: Sequence[str]) -> DataError:
    where = f"{table}, line {line}: {len(cells)} cells for {len(header)} columns"
    if len(cells) > len(header) and all(cell.lstrip("+-").isdecimal() for cell in cells):
        return DataError(
            f"{where}, as decimal commas would give",
            "export it with points in numbers, or with semicolons between columns",
        )
    return DataError(where, "complete that line, or leave it out")
