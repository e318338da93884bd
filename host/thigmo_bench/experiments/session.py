"""A session beside a robot: its attendant, and the folder that keeps each trial.

An attendant places the dowels, measures them and judges the trials. It is a person who is asked, or
an emulated room. In a rehearsal it is both: the person answers every prompt, and the room does the
work.

    FOLDER/
      robot.toml      the robot's constants as used; they are fixed once a line is kept
      trials.jsonl    a line for each trial, on disk as soon as it is judged

Trials (`recorded.py`) and whole explorations (`explorations.py`) are taken in this way. The same
command, given again, continues after the last line.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from thigmo.calibrate.session import Session
from thigmo.calibrate.verdict import plain
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.mechanics import Peg
from thigmo.robot import Robot
from thigmo_bench.experiments import thesis
from thigmo_bench.experiments.trial import Planned

Place = tuple[float, float]
Verdict = Literal["keep", "redo", "skip", "quit"]
Say = Callable[[str], None]
Row = dict[str, Any]
Plan = TypeVar("Plan")

_CLEARANCE_CM = 0.01  # between skin and dowel that just touch
_WORDS: dict[str, Verdict] = {"": "keep", "r": "redo", "s": "skip", "q": "quit"}


@dataclass
class Attendant:
    """The person beside a robot, who removes, sets and measures dowels, and judges trials."""

    # puts a question to the person there; None: nobody is, and everything is kept
    ask: Callable[[str], str] | None = None
    # measures the dowels' centres, base first; None: they are typed in
    camera: Callable[[], list[Place]] | None = None
    robot: Robot | None = None  # an emulated robot, if its room does what is asked for

    def _request(self, text: str) -> None:
        if self.ask:
            self.ask(f"{text} Answer when this is done:")

    @property
    def _hands(self) -> Any:
        """The hands in the emulated room; None on a bench."""
        return self.robot and self.robot.operator

    def clear(self) -> None:
        """Take all dowels away, and return when the robot lies free."""
        self._request("Take all dowels away and lay the robot straight.")
        if self._hands:
            self._hands.push_aside([], 0.0)
            self._hands.place_pegs([])

    def push_aside(self, trial: Planned, pushes_cm: Sequence[float]) -> None:
        """Push the robot's axis to these y where the trial's dowels touch it, and hold it."""
        parts = []
        for arc, y in zip(trial.arcs_cm, pushes_cm, strict=True):
            # With two contacts each dowel stands on the side from which its own force comes.
            from_left = (trial.side == "left") == (arc == trial.arcs_cm[-1])
            side, away = ("left", "right") if from_left else ("right", "left")
            parts.append(
                f"a dowel at the robot's {side} side, {arc:.1f} cm along it from its base, and "
                f"push the robot's axis there to the {away} until it is at y = {y:+.1f} cm"
            )
        fold = "; the base folds" if trial.folds else ""
        self._request(f"{trial.label}: set {'; and '.join(parts)}{fold}.")
        if self._hands:
            pushes = list(zip(trial.arcs_cm, pushes_cm, strict=True))
            self._hands.push_aside(pushes, thesis.DOWEL_CM)

    def touch(self, trial: Planned) -> None:
        """Set a dowel that just touches the bent robot as planned."""
        (contact_arc,) = trial.arcs_cm
        self._request(
            f"{trial.label}: the robot is bent to the {trial.side}. Set a dowel firmly so that "
            f"it just touches the robot's {trial.side} side {contact_arc:.1f} cm along it from its "
            "base. The robot will then bend on, against the dowel."
        )
        if self.robot:
            arc, *line = self.robot.scenery().centreline.T
            heading, _, x, y = (float(np.interp(contact_arc, arc, values)) for values in line)
            radius = self.robot.config.body.radius_cm + thesis.DOWEL_CM + _CLEARANCE_CM
            normal = heading - trial.sign * np.pi / 2
            offset = float(radius * np.cos(normal)), float(radius * np.sin(normal))
            self._hands.place_pegs([Peg(x + offset[0], y + offset[1], thesis.DOWEL_CM)])

    def set_dowel(self, key: str) -> None:
        """Set the dowel for an exploration, at the same place for both protocols of a trial."""
        self._request(
            f"exploration {key}: the robot is in its base. Set one dowel firmly within its "
            "reach beside its path, for both protocols of a trial at the same place. Then press "
            "Enter; the robot grows and sweeps."
        )

    def dowels(self, count: int, emulated: Sequence[Place] = ()) -> list[Place]:
        """Centres of this many dowels, cm, base to tip.

        `emulated` are the pegs of an emulated room, if another robot than ours is in it.

        Raises:
            DataError: nobody is there to measure, and the room is empty.
        """
        if self.robot:
            emulated = [(float(peg.x), float(peg.y)) for peg in self.robot.scenery().pegs]
        centers = self.camera() if self.camera else emulated
        if self.ask:
            offered = (*centers, *[None] * count)
            return [self._place(number, offered[number], count) for number in range(count)]
        if len(centers) < count:
            raise DataError("the emulated room has no dowel", "name a scene with a peg")
        return list(centers[:count])

    def _place(self, number: int, offered: Place | None, count: int) -> Place:
        assert self.ask
        subject = (
            "the dowel's" if count == 1 else ("the first dowel's", "the second dowel's")[number]
        )
        offer = "" if offered is None else f" (Enter: {offered[0]:.1f} {offered[1]:.1f})"
        again = ""
        while True:
            answer = self.ask(f"{again}x and y of {subject} centre by the camera, cm, base first"
                               f"{offer}:").replace(",", " ").split()  # fmt: skip
            if not answer and offered is not None:
                return offered
            try:
                x, y = (float(part) for part in answer)
            except ValueError:
                again = "Give two numbers, as in 38.2 4.1. "
                continue
            return x, y

    def truth(self) -> dict[str, list[float]]:
        """The true contacts in an emulated room, base to tip, as they are kept with a trial."""
        touching = self.robot.scenery().contacts if self.robot else []
        return {
            "true_arcs_cm": [float(contact.arc) for contact in touching],
            "true_forces": [float(contact.normal) for contact in touching],
            "true_contact_x_cm": [float(contact.x) for contact in touching],
        }

    def verdict(self, summary: str) -> Verdict:
        """Ask whether to keep the trial that was just taken."""
        if self.ask is None:
            return "keep"
        question = f"{summary}. Enter = keep, r = redo, s = skip, q = stop here and go on later:"
        while (word := self.ask(question).strip().lower()[:1]) not in _WORDS:
            pass
        return _WORDS[word]


class Folder:
    """Trials of one experiment (`things`), taken with the robot of `config`, or only read.

    Raises:
        DataError: the folder cannot be made or read, or its lines are of another robot.toml.
    """

    def __init__(
        self, path: Path, config: RobotConfig | None = None, things: str = "trials"
    ) -> None:
        self.path, self._things = path, things
        file = path / "robot.toml"
        self.config = config or RobotConfig.load(file)
        self._session = Session(path, self.config)
        if self.config != self._session.config:
            if self._rows():
                raise DataError(
                    f"the {things} in {path} were made with another robot.toml",
                    f"use {file} again, or choose another --out",
                )
            self.config.save(file)

    def kept_rows(self) -> list[Row]:
        """Lines of trials that were kept, not skipped."""
        return [row for row in self._rows().values() if row["state"] == "kept"]

    def _rows(self) -> dict[str, Row]:
        return self._session.rows("trials")

    def missing(
        self, planned: Mapping[str, Plan], say: Say, label: str
    ) -> list[tuple[str, str, Plan]]:
        """Planned trials that the folder lacks, each with its place among all and its key."""
        stored, total = self._rows(), len(planned)
        missing = [
            (f"{label} {number} of {total}: {key}", key, plan)
            for number, (key, plan) in enumerate(planned.items(), start=1)
            if key not in stored
        ]
        if len(missing) < total:
            say(f"{label}: {total - len(missing)} of {total} {self._things} are there")
        return missing

    def take(
        self,
        todo: Sequence[tuple[str, str, Plan]],
        take: Callable[[Plan], tuple[Row, str]],
        judge: Callable[[str], Verdict],
        say: Say,
    ) -> bool:
        """Take the `missing` trials one after the other, each again until it is kept or skipped.

        `take` returns the values to store beside a trial's plan, and a summary for the judge.
        Returns whether all are done; False if the judge stopped.
        """
        try:
            for text, key, planned in todo:
                say(text)
                row, summary = take(planned)
                while (verdict := judge(summary)) == "redo":
                    row, summary = take(planned)
                if verdict == "quit":
                    return False
                outcome = {"state": "kept", **row} if verdict == "keep" else {"state": "skipped"}
                self._session.add("trials", {"key": key, **plain(planned), **outcome})
        except (KeyboardInterrupt, SystemExit) as stopped:
            progress = f"{len(self._rows())} {self._things} are in {self.path}"
            stopped.add_note(f"{progress}, the same command resumes")
            raise
        return True
