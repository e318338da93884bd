"""Section 3.5 with a robot: explorations one by one, labelled, resumed, evaluated again.

    OUT/exploration/
      robot.toml, trials.csv    as `folder.py` says
      DATE-...                  run folders, as those of `thigmo explore`

Each trial is two explorations of the same room, by our protocol and by the thesis's. Before each
the robot is wound in; a dowel that the robot leans on when it is vented must be taken away for
that, and put back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.exploration import explore
from thigmo.exploration.map import best_contact
from thigmo.record import RunDocument, RunFolder
from thigmo.robot import connect
from thigmo.studies.engine import Outcome, Record
from thigmo.studies.experiments import explored, thesis
from thigmo.studies.experiments.attendant import Place
from thigmo.studies.experiments.folder import Folder, Row, Say, Verdict

if TYPE_CHECKING:
    from thigmo.exploration.run import Progress
    from thigmo.exploration.run import Protocol as Way
    from thigmo.robot import Operator
    from thigmo.room import Dowel

WAYS: dict[Way, str] = {"measure": "our protocol", "thesis": "the thesis's protocol"}
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
        return f"{WAYS[self.protocol]} | {self.number}"


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


class ExplorationFolder(Folder):
    """Explorations on disk."""

    columns = ("key", "protocol", "number", "state", "run", "dowel_x_cm", "dowel_y_cm")
    things = "explorations"


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

    def one(run: PlannedRun) -> tuple[Row, str]:
        _wind_in(url, folder.config, person, say)
        bystander.set_dowel(run)
        found = explore(
            url, config=folder.config, seed=seed + run.number, out=folder.path,
            name=f"{run.protocol}-{run.number}", protocol=run.protocol, operator=person,
            progress=progress,
        )  # fmt: skip
        if person:
            # The encoder may show a hair more than the whole body, which the board refuses.
            person.length_cm = min(found.length_cm, folder.config.body.length_cm)
        truth = found.document.truth
        pegs = truth.pegs if truth else ()
        x, y = bystander.dowel(run, (pegs[0].x_cm, pegs[0].y_cm) if pegs else None)
        row = {"run": found.folder.name, "dowel_x_cm": str(x), "dowel_y_cm": str(y)}
        return row, _summary(found.document, (x, y))

    planned = [PlannedRun(way, number) for number in range(1, trials + 1) for way in WAYS]
    todo = folder.missing(planned, say, "exploration")
    return folder.take(todo, one, bystander.verdict, say)


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


def evaluate(folder: ExplorationFolder) -> Outcome:
    """Errors of the kept explorations from their run folders, as those of simulated robots.

    On a real robot nobody knows the point of contact: there the dowel that touches it at the
    mapped point is compared with the one that was measured.

    Raises:
        DataError: none was kept.
    """
    made: dict[int, dict[str, tuple[float, float, float]]] = {}
    solver: dict[int, float] = {}
    for row in folder.kept():
        run, number = RunFolder(folder.path / row["run"]), int(row["number"])
        dowel = float(row["dowel_x_cm"]), float(row["dowel_y_cm"])
        document = run.read_document()
        figures = (*errors(document, dowel), document.robot_time_s)
        made.setdefault(number, {})[row["protocol"]] = figures
        if row["protocol"] == "thesis":
            solver[number] = explored.thesis_solver(run, dowel[0])
    if not made:
        raise DataError("there are no explorations to evaluate", "make some first")
    runs = [
        explored.Run(number, solver[number], *ways["thesis"], *ways["measure"])
        for number, ways in sorted(made.items())
        if len(ways) == len(WAYS)
    ]
    outcome = explored.compared(runs) if runs else Outcome()
    each: list[Record] = []
    for number, ways in sorted(made.items()):
        for way in (way for way in WAYS if way in ways):
            x, plane, time = ways[way]
            each.append({
                "number": number, "protocol": way, "error_x_cm": x, "error_cm": plane,
                "robot_time_s": time,
            })  # fmt: skip
            outcome.notes.append(
                f"trial {number}, {WAYS[way]}: |x error| {x:.2f} cm, in the plane {plane:.2f} cm, "
                f"{time:.0f} s"
            )
    outcome.tables["each"] = each
    return outcome


def errors(document: RunDocument, dowel: Place) -> tuple[float, float]:
    """|x error| and distance in the plane, cm; infinite without a contact on the map."""
    best = best_contact(document.contacts)
    if document.error_x_cm is not None or document.truth is not None or best is None:
        return explored.known_errors(document)
    # Centre of a dowel that touches the skin there.
    x = best.x_cm + thesis.DOWEL_CM * float(np.cos(best.normal_rad))
    y = best.y_cm + thesis.DOWEL_CM * float(np.sin(best.normal_rad))
    return abs(x - dowel[0]), float(np.hypot(x - dowel[0], y - dowel[1]))


def _summary(document: RunDocument, dowel: Place) -> str:
    if not document.contacts:
        return f"{document.outcome}; no contact"
    x, plane = errors(document, dowel)
    return f"{document.outcome}; |x error| {x:.2f} cm, in the plane {plane:.2f} cm"
