"""Section 3.5 with a robot: explorations one by one, labelled, resumed, evaluated again.

    OUT/exploration/
      robot.toml      the robot's constants as used
      trials.csv      a line an exploration: its label, its run folder, where the dowel stood
      DATE-...        run folders, as those of `thigmo explore`

Each trial is two explorations of the same room, by our protocol and by the thesis's. Before each
the robot is wound in; a dowel that the robot leans on when it is vented must be taken away for
that, and put back. The same command goes on after the last line.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.exploration import explore
from thigmo.exploration.map import best_contact
from thigmo.record import MapContact, RunDocument, RunFolder
from thigmo.robot import connect
from thigmo.studies.engine import Table
from thigmo.studies.experiments import explored, thesis
from thigmo.studies.experiments.attendant import Place, Verdict
from thigmo.studies.experiments.evaluate import Results
from thigmo.studies.experiments.trial_table import TrialTable

if TYPE_CHECKING:
    from thigmo.exploration.run import Progress
    from thigmo.exploration.run import Protocol as Way
    from thigmo.link.transport import Dowel
    from thigmo.robot import Operator

Say = Callable[[str], None]

WAYS: tuple[Way, Way] = ("measure", "thesis")
_NAMES = {"measure": "our protocol", "thesis": "the thesis's protocol"}
_COLUMNS = ("key", "protocol", "number", "state", "run", "dowel_x_cm", "dowel_y_cm")
_BASE_CM = 0.2


@dataclass(frozen=True)
class PlannedRun:
    """One exploration to make.

    Attributes:
        protocol: "measure", ours, or "thesis".
        number: of the trial, from 1.
    """

    protocol: Way
    number: int

    @property
    def key(self) -> str:
        """What names it in trials.csv."""
        return f"{_NAMES[self.protocol]} | {self.number}"


class Bystander(Protocol):
    """Sets the dowel, measures it, and judges an exploration."""

    def set_dowel(self, run: PlannedRun) -> None:
        """Set the dowel for a trial (the same place for both protocols); return when it stands."""

    def dowel(self, run: PlannedRun, known: Place | None) -> Place:
        """Centre of the dowel, cm; `known` is what an emulated room says."""

    def verdict(self, run: PlannedRun, summary: str) -> Verdict:
        """Whether to keep the exploration that was just made."""


class EmulatedBystander:
    """Beside an emulated robot, whose room has its dowel: keeps every exploration."""

    def set_dowel(self, run: PlannedRun) -> None:
        """The room has it."""

    def dowel(self, run: PlannedRun, known: Place | None) -> Place:
        """Where the room's first dowel is.

        Raises:
            DataError: the room is empty.
        """
        if known is None:
            raise DataError("the emulated room has no dowel", "name a scene with a peg")
        return known

    def verdict(self, run: PlannedRun, summary: str) -> Verdict:
        """Keep it."""
        return "keep"


class _Remembers:
    """An operator who need not measure a length that the robot was just brought to.

    Opening the port restarts the board, which then asks for it again.
    """

    def __init__(self, operator: Operator) -> None:
        self._operator = operator
        self.length_cm: float | None = None

    def everted_length_cm(self) -> float:
        """As remembered, else as measured."""
        if self.length_cm is None:
            self.length_cm = self._operator.everted_length_cm()
        return self.length_cm

    def set_body_pressure(self, pressure_psi: float) -> None:
        """As the operator does."""
        self._operator.set_body_pressure(pressure_psi)

    def place_pegs(self, pegs: Sequence[Dowel]) -> None:
        """As the operator does."""
        self._operator.place_pegs(pegs)


class ExplorationFolder:
    """Explorations on disk.

    Args:
        path: the folder.
        config: of the robot; None where explorations are only read.

    Raises:
        RunFolderError: the folder cannot be made.
        DataError: its explorations were made with another robot.toml.
    """

    def __init__(self, path: str | os.PathLike[str], config: RobotConfig | None = None) -> None:
        self.path = Path(path)
        self._table = TrialTable(self.path, config, _COLUMNS, things="explorations", done="made")
        self.config = self._table.config

    def rows(self) -> dict[str, dict[str, str]]:
        """Lines so far, by key, as `TrialTable.rows`."""
        return self._table.rows()

    def add(self, run: PlannedRun, kept: Path | None, dowel: Place | None) -> None:
        """Append an exploration that was kept, or (without a folder) skipped; on disk on return.

        Raises:
            RunFolderError: the folder cannot be written.
        """
        line = [run.key, run.protocol, str(run.number)]
        line += ["kept", kept.name, *map(str, dowel)] if kept and dowel else ["skipped", "", "", ""]
        self._table.add(line)


def run_explorations(
    url: str,
    bystander: Bystander,
    folder: ExplorationFolder,
    trials: int,
    *,
    seed: int,
    operator: Operator | None = None,
    progress: Progress | None = None,
    say: Say = lambda text: None,
) -> bool:
    """Make the planned explorations that the folder does not hold yet.

    Args:
        url: where the robot is.
        bystander: sets the dowel, measures it, judges.
        folder: with the robot's constants.
        trials: of both protocols each.
        seed: of the emulator's noise, which differs from trial to trial.
        operator: answers what the board cannot know.
        progress: told what the robot is doing.
        say: told what happens.

    Returns:
        Whether all are done; False if the bystander stopped.

    Raises:
        ThigmoError: as the robot raises. What was kept stays in every case.
    """
    person = _Remembers(operator) if operator else None
    planned = [PlannedRun(way, number) for number in range(1, trials + 1) for way in WAYS]
    held = folder.rows()
    missing = [run for run in planned if run.key not in held]
    if len(missing) < len(planned):
        say(f"exploration: {len(planned) - len(missing)} of {len(planned)} are there")
    for count, run in enumerate(missing, start=len(planned) - len(missing) + 1):
        say(f"exploration {count} of {len(planned)}: {run.key}")
        while True:
            _wind_in(url, folder.config, person, say)
            bystander.set_dowel(run)
            try:
                found = explore(
                    url, config=folder.config, seed=seed + run.number, out=folder.path,
                    name=f"{run.protocol}-{run.number}", protocol=run.protocol,
                    operator=person, progress=progress,
                )  # fmt: skip
            except KeyboardInterrupt as stopped:
                stopped.add_note(
                    f"{len(folder.rows())} explorations are in {folder.path}, the same command "
                    "goes on"
                )
                raise
            if person:
                # The encoder may show a hair more than the whole body, which the board refuses.
                person.length_cm = min(found.length_cm, folder.config.body.length_cm)
            truth = found.document.truth
            pegs = truth.pegs if truth else ()
            dowel = bystander.dowel(run, (pegs[0].x_cm, pegs[0].y_cm) if pegs else None)
            verdict = bystander.verdict(run, _summary(found.document, dowel))
            if verdict == "quit":
                return False
            if verdict != "redo":
                folder.add(run, found.folder if verdict == "keep" else None, dowel)
                break
    return True


def _wind_in(url: str, config: RobotConfig, person: _Remembers | None, say: Say) -> None:
    """A robot that is out from before goes back to its base; an emulated one begins there."""
    with connect(url, operator=person) as robot:
        if robot.scenery() is not None:
            return
        robot.configure(config)
        if robot.status().length_cm is None:
            robot.confirm_length(robot.operator.everted_length_cm())
        if (robot.status().length_cm or 0.0) > _BASE_CM:
            say("winding the robot in")
            robot.arm()
            reached = robot.retract_to(0.0)
            if person:
                person.length_cm = reached


def evaluate(folder: ExplorationFolder) -> Results:
    """Errors of the kept explorations from their run folders, as those of simulated robots.

    On a real robot nobody knows the point of contact: there the dowel that touches it at the
    mapped point is compared with the one that was measured.

    Raises:
        DataError: none was kept.
    """
    kept: dict[int, dict[str, tuple[RunFolder, Place]]] = {}
    for row in folder.rows().values():
        if row["state"] == "kept":
            place = float(row["dowel_x_cm"]), float(row["dowel_y_cm"])
            entry = RunFolder(folder.path / row["run"]), place
            kept.setdefault(int(row["number"]), {})[row["protocol"]] = entry
    if not kept:
        raise DataError("there are no explorations to evaluate", "make some first")
    runs: list[explored.Run] = []
    single: list[tuple[int, str, float, float, float]] = []
    for number, made in sorted(kept.items()):
        if set(made) == set(WAYS):
            theirs, dowel = made["thesis"]
            mine, place = made["measure"]
            runs.append(
                explored.Run(
                    number,
                    explored.thesis_solver(theirs, dowel[0]),
                    *errors(theirs.read_document(), dowel),
                    theirs.read_document().robot_time_s,
                    *errors(mine.read_document(), place),
                    mine.read_document().robot_time_s,
                )
            )
        for way, (run, place) in made.items():
            document = run.read_document()
            single.append((number, way, *errors(document, place), document.robot_time_s))
    columns = ("number", "protocol", "error_x_cm", "error_cm", "robot_time_s")
    results = Results(
        tables=[Table("each", columns, list(single))],
        notes=[
            f"trial {number}, {_NAMES[way]}: |x error| {x:.2f} cm, in the plane {plane:.2f} cm, "
            f"{time:.0f} s"
            for number, way, x, plane, time in single
        ],
    )
    if runs:
        results.tables.append(explored.table(runs))
        results.figures["errors"] = explored.figure(runs)
        results.claims = explored.claims(runs)
    return results


def errors(document: RunDocument, dowel: Place) -> tuple[float, float]:
    """|x error| and distance in the plane, cm; infinite without a contact on the map."""
    if document.error_x_cm is not None and document.error_cm is not None:
        return document.error_x_cm, document.error_cm
    best = best_contact(document.contacts)
    if document.truth is not None or best is None:
        return float("inf"), float("inf")
    found = _touching(best)
    return abs(found[0] - dowel[0]), float(np.hypot(found[0] - dowel[0], found[1] - dowel[1]))


def _touching(contact: MapContact) -> Place:
    """Centre of a dowel that touches the skin there."""
    x = contact.x_cm + thesis.DOWEL_CM * float(np.cos(contact.normal_rad))
    return x, contact.y_cm + thesis.DOWEL_CM * float(np.sin(contact.normal_rad))


def _summary(document: RunDocument, dowel: Place) -> str:
    doubt = f"; {document.doubt}" if document.doubt else ""
    if not document.contacts:
        return f"{document.outcome}; no contact{doubt}"
    x, plane = errors(document, dowel)
    return f"{document.outcome}; |x error| {x:.2f} cm, in the plane {plane:.2f} cm{doubt}"
