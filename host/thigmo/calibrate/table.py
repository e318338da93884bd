"""Readings as a lab has them: a CSV with a header, numbers and a few words."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thigmo.errors import DataError

Array = NDArray[np.float64]


class MissingColumnError(DataError):
    """A column that is needed is not there."""


class Table:
    """Columns by name; empty cells are nan, words stay words."""

    def __init__(self, columns: Mapping[str, Sequence[str]], name: str = "table") -> None:
        self.columns = {key: list(values) for key, values in columns.items()}
        self.name = name
        self.rows = len(next(iter(self.columns.values()), []))

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Table:
        """Read a CSV file.

        Raises:
            DataError: unreadable, without a header, without rows, or ragged.
        """
        try:
            with Path(path).open(newline="", encoding="utf-8-sig") as file:
                lines = [line for line in csv.reader(file) if any(cell.strip() for cell in line)]
        except (OSError, UnicodeDecodeError) as error:
            raise DataError(f"cannot read {path}: {error}", "check the path and format") from error
        if len(lines) < 2:
            raise DataError(
                f"{path} holds no readings", "give a header line and one line a reading"
            )
        header = [cell.strip() for cell in lines[0]]
        if len(set(header)) != len(header):
            raise DataError(f"{path}: a column name appears twice", "rename one of them")
        for number, line in enumerate(lines[1:], start=2):
            if len(line) != len(header):
                raise DataError(
                    f"{path}, line {number}: {len(line)} cells for {len(header)} columns",
                    "mend that line",
                )
        body = lines[1:]
        return cls({key: [line[k].strip() for line in body] for k, key in enumerate(header)},
                   str(path))  # fmt: skip

    def __contains__(self, column: str) -> bool:
        return column in self.columns

    def numbers(self, column: str, default: float | None = None) -> Array:
        """A column of numbers (n,); empty cells are nan.

        Raises:
            MissingColumnError: there is no such column, and no default.
            DataError: a word where a number belongs.
        """
        if column not in self.columns:
            if default is not None:
                return np.full(self.rows, default)
            raise MissingColumnError(f"{self.name}: no column '{column}'", "add it")
        found = np.empty(self.rows)
        for number, cell in enumerate(self.columns[column]):
            try:
                found[number] = float(cell) if cell else np.nan
            except ValueError as error:
                raise DataError(
                    f"{self.name}, line {number + 2}: '{cell}' in column '{column}' is no number",
                    "mend that cell, or leave it empty",
                ) from error
            if np.isinf(found[number]):
                raise DataError(
                    f"{self.name}, line {number + 2}: '{cell}' in column '{column}' is not finite",
                    "mend that cell, or leave it empty",
                )
        return found

    def whole(self, column: str, default: int | None = None) -> NDArray[np.int64]:
        """A column of whole numbers (n,), none of them empty.

        Raises:
            MissingColumnError: there is no such column, and no default.
            DataError: an empty cell, or a number that is not whole.
        """
        values = self.numbers(column, None if default is None else float(default))
        odd = np.nonzero(~(values == np.round(values)))[0]
        if len(odd):
            raise DataError(
                f"{self.name}, line {odd[0] + 2}: column '{column}' needs a whole number",
                "mend that cell",
            )
        return values.astype(np.int64)

    def words(self, column: str, default: str | None = None) -> list[str]:
        """A column of words.

        Raises:
            MissingColumnError: there is no such column, and no default.
        """
        if column not in self.columns:
            if default is not None:
                return [default] * self.rows
            raise MissingColumnError(f"{self.name}: no column '{column}'", "add it")
        return list(self.columns[column])

    def block(self, prefix: str, count: int) -> Array:
        """Columns `prefix0` .. side by side (n, count)."""
        return np.column_stack([self.numbers(f"{prefix}{k}") for k in range(count)])


def write_table(path: str | os.PathLike[str], columns: Mapping[str, Sequence[object]]) -> None:
    """Write columns as CSV; nan and None become empty cells.

    Raises:
        DataError: the folder cannot be written.
    """

    def cell(value: object) -> str:
        if value is None or (isinstance(value, float) and not np.isfinite(value)):
            return ""
        return f"{value:.9g}" if isinstance(value, float) else str(value)

    try:
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            for row in zip(*columns.values(), strict=True):
                writer.writerow([cell(value) for value in row])
    except OSError as error:
        raise DataError(
            f"cannot write {path}: {error.strerror}", "choose another folder"
        ) from error
