"""A folder's table of what was taken with a robot, a line a trial, and the constants it holds.

    FOLDER/
      robot.toml    the robot's constants as used; with the first line they are fixed
      trials.csv    on disk as soon as a trial is judged

Kept by `recorded` (trials) and `explorations` (whole runs).
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from thigmo.config import RobotConfig
from thigmo.errors import DataError, RunFolderError
from thigmo.record import write_whole


class TrialTable:
    """The table of one folder.

    Args:
        folder: with it; made if `config` is given.
        config: of the robot; None where the folder is only read.
        columns: of the table, the key first.
        things: what its lines are, for messages.
        done: what was done to them, for messages.
        earlier: columns of earlier versions' tables; what they lack is empty.

    Raises:
        RunFolderError: the folder cannot be made.
        DataError: its lines are of another robot.toml.
    """

    def __init__(
        self,
        folder: Path,
        config: RobotConfig | None,
        columns: tuple[str, ...],
        *,
        things: str,
        done: str,
        earlier: tuple[str, ...] = (),
    ) -> None:
        self.path = folder / "trials.csv"
        self._columns = columns
        self._things = things
        self._earlier = earlier
        self.config = self._held_config(folder, config, done)

    def _held_config(self, folder: Path, config: RobotConfig | None, done: str) -> RobotConfig:
        file = folder / "robot.toml"
        if config is None:
            return RobotConfig.load(file)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunFolderError(
                f"cannot make {folder}: {error.strerror}", "choose another --out"
            ) from error
        if self.path.exists():
            if RobotConfig.load(file) != config:
                raise DataError(
                    f"the {self._things} in {folder} were {done} with another robot.toml",
                    f"use {file} again, or choose another --out",
                )
        else:
            config.save(file)
        return config

    def rows(self) -> dict[str, dict[str, str]]:
        """Lines so far, by key; a last line without its end was never whole and is left out.

        Raises:
            DataError: a damaged line other than the last, or another table.
        """
        if not self.path.exists():
            return {}
        text = self.path.read_text()
        lines = list(csv.reader(text.splitlines()))
        if not lines or tuple(lines[0]) not in (self._columns, self._earlier):
            raise DataError(
                f"{self.path} is no table of {self._things}",
                "move it away, or choose another --out",
            )
        found: dict[str, dict[str, str]] = {}
        for number, line in enumerate(lines[1:] if text.endswith("\n") else lines[1:-1], start=2):
            if len(line) != len(lines[0]):
                raise DataError(f"{self.path}, line {number} is damaged", "mend or delete it")
            found[line[0]] = dict.fromkeys(self._columns, "") | dict(
                zip(lines[0], line, strict=True)
            )
        return found

    def add(self, cells: Sequence[str]) -> None:
        """Append a line, a cell for each column; on disk on return.

        Raises:
            RunFolderError: the folder cannot be written.
        """
        held = [list(row.values()) for row in self.rows().values()]
        text = io.StringIO(newline="")
        csv.writer(text).writerows([self._columns, *held, cells])
        write_whole(self.path, text.getvalue().encode())
