"""A folder of what is taken with a robot, one by one: resumed, kept through every kind of end.

    FOLDER/
      robot.toml    the robot's constants as used; with the first line they are fixed
      trials.csv    a line a trial, on disk as soon as it is judged

Trials (`recorded.py`) and whole explorations (`explorations.py`) are taken so. The same command
goes on after the last line.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from thigmo.config import RobotConfig
from thigmo.errors import DataError, RunFolderError
from thigmo.record import write_whole
from thigmo.record.table import Table
from thigmo.studies.experiments.attendant import Verdict

Say = Callable[[str], None]
Row = Mapping[str, Any]
Line = dict[str, str]


class Planned(Protocol):
    """What is to be taken; attributes with a column's name are kept in it."""

    @property
    def key(self) -> str:
        """What names it in trials.csv."""


Plan = TypeVar("Plan", bound=Planned)


class Folder:
    """The table of one folder; a kind of it says which columns, the key first.

    Args:
        path: the folder; made if `config` is given.
        config: of the robot; None where it is only read.

    Raises:
        RunFolderError: the folder cannot be made.
        DataError: its lines are of another robot.toml.
    """

    columns: ClassVar[tuple[str, ...]]
    things: ClassVar[str] = "trials"

    def __init__(self, path: str | os.PathLike[str], config: RobotConfig | None = None) -> None:
        self.path = Path(path)
        self.table = self.path / "trials.csv"
        file = self.path / "robot.toml"
        self.config = RobotConfig.load(file) if config is None else config
        if config is None:
            return
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunFolderError(
                f"cannot make {self.path}: {error.strerror}", "choose another --out"
            ) from error
        if not self.table.exists():
            config.save(file)
        elif RobotConfig.load(file) != config:
            raise DataError(
                f"the {self.things} in {self.path} were made with another robot.toml",
                f"use {file} again, or choose another --out",
            )

    def rows(self) -> dict[str, Line]:
        """Lines so far, by key.

        Raises:
            DataError: a damaged line, or another table.
        """
        if not self.table.exists():
            return {}
        columns = Table.read(self.table).columns
        if tuple(columns) != self.columns:
            raise DataError(
                f"{self.table} is no table of {self.things}",
                "move it away, or choose another --out",
            )
        lines = zip(*columns.values(), strict=True)
        return {cells[0]: dict(zip(columns, cells, strict=True)) for cells in lines}

    def kept(self) -> list[Line]:
        """Lines that were kept, not skipped."""
        return [row for row in self.rows().values() if row["state"] == "kept"]

    def add(self, planned: Planned, row: Row | None) -> None:
        """Append what was kept, or (without a row) skipped; on disk on return.

        Raises:
            RunFolderError: the folder cannot be written.
        """
        cells = {name: getattr(planned, name, "") for name in self.columns} | dict(row or {})
        cells["state"] = "skipped" if row is None else "kept"
        held = [list(line.values()) for line in self.rows().values()]
        text = io.StringIO(newline="")
        csv.writer(text).writerows([self.columns, *held, [_cell(cells[n]) for n in self.columns]])
        write_whole(self.table, text.getvalue().encode())

    def missing(self, planned: Sequence[Plan], say: Say, what: str) -> list[tuple[str, Plan]]:
        """What is planned and not there, each with its place among all."""
        held = self.rows()
        found = [
            (f"{what} {number} of {len(planned)}: {one.key}", one)
            for number, one in enumerate(planned, start=1)
            if one.key not in held
        ]
        if len(found) < len(planned):
            there = f"{len(planned) - len(found)} of {len(planned)}"
            say(f"{what}: {there} {self.things} are there")
        return found

    def take(
        self,
        todo: Sequence[tuple[str, Plan]],
        take: Callable[[Plan], tuple[Row, str]],
        judge: Callable[[str], Verdict],
        say: Say,
    ) -> bool:
        """Take one after the other, each again until it is kept or skipped.

        Args:
            todo: of `missing`.
            take: takes one; what the table holds of it, and a summary for the judge.
            judge: whether to keep it.
            say: told which one.

        Returns:
            Whether all are done; False if the judge stopped.
        """
        for text, planned in todo:
            say(text)
            verdict: Verdict = "redo"
            while verdict == "redo":
                try:
                    row, summary = take(planned)
                    verdict = judge(summary)
                except (KeyboardInterrupt, SystemExit) as stopped:
                    stopped.add_note(
                        f"{len(self.rows())} {self.things} are in {self.path}, the same command "
                        "goes on"
                    )
                    raise
            if verdict == "quit":
                return False
            self.add(planned, row if verdict == "keep" else None)
        return True


def _cell(value: Any) -> str:
    """Lists separated by semicolons, lists of them by slashes."""
    if isinstance(value, list | tuple):
        lists = any(isinstance(item, list) for item in value)
        return (" / " if lists else ";").join(_cell(item) for item in value)
    return f"{value:.9g}" if isinstance(value, float) else str(value)
