"""A folder of what is taken with a robot, one by one: resumed, kept through every kind of end.

    FOLDER/
      robot.toml      the robot's constants as used; with the first line they are fixed
      trials.jsonl    a line a trial, on disk as soon as it is judged

Trials (`recorded.py`) and whole explorations (`explorations.py`) are taken so. The same command
goes on after the last line.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from thigmo.calibrate.session import Session
from thigmo.calibrate.verdict import plain
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.studies.experiments.attendant import Verdict

Say = Callable[[str], None]
Row = dict[str, Any]


class Planned(Protocol):
    """What is to be taken: a record."""

    @property
    def key(self) -> str:
        """What names it in the folder."""


Plan = TypeVar("Plan", bound=Planned)


class Folder:
    """What was taken of one experiment.

    Args:
        path: the folder; made if `config` is given.
        config: of the robot; None where it is only read.
        things: what is taken, for messages.

    Raises:
        DataError: the folder cannot be made or read, or its lines are of another robot.toml.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        config: RobotConfig | None = None,
        things: str = "trials",
    ) -> None:
        self.path = Path(path)
        self.things = things
        file = self.path / "robot.toml"
        self._session = Session(self.path, config or RobotConfig.load(file))
        self.config = config or self._session.config
        if self.config != self._session.config:
            if self.rows():
                raise DataError(
                    f"the {things} in {self.path} were made with another robot.toml",
                    f"use {file} again, or choose another --out",
                )
            self.config.save(file)

    def rows(self) -> dict[str, Row]:
        """Lines so far, by key.

        Raises:
            DataError: a damaged line.
        """
        return self._session.rows("trials")

    def kept(self) -> list[Row]:
        """Lines that were kept, not skipped."""
        return [row for row in self.rows().values() if row["state"] == "kept"]

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
        """Take one after the other of `missing`, each again until it is kept or skipped.

        `take` returns what is kept of one beside its plan, and a summary for the judge.

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
            label = {"key": planned.key, **plain(planned)}
            taken = {"state": "kept", **row} if verdict == "keep" else {"state": "skipped"}
            self._session.add("trials", label | taken)
        return True
