"""Section 3.5 with a robot: explorations one by one, labelled, resumed, evaluated again.

    OUT/exploration/
      robot.toml, trials.jsonl    as `folder.py` says
      DATE-...                    run folders, as those of `thigmo explore`

Each trial is two explorations of the same room, by our protocol and by the thesis's. Before each
the robot is wound in; a dowel that the robot leans on when it is vented must be taken away for
that, and put back.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.exploration import explore
from thigmo.exploration.run import Progress
from thigmo.exploration.run import Protocol as Way
from thigmo.record import RunFolder
from thigmo.robot import Operator, connect
from thigmo.studies.engine import Outcome
from thigmo.studies.experiments import explored
from thigmo.studies.experiments.attendant import Attendant
from thigmo.studies.experiments.folder import Folder, Row, Say

WAYS: dict[Way, str] = {"measure": "our protocol", "thesis": "the thesis's protocol"}
_BASE_CM = 0.2


@dataclass(frozen=True)
class PlannedRun:
    """One exploration by our protocol ("measure") or the thesis's; trials count from 1."""

    protocol: Way
    number: int

    @property
    def key(self) -> str:
        """What names it in a folder."""
        return f"{WAYS[self.protocol]} | {self.number}"


class _Remembers:
    """An operator who need not measure a length that the robot was just brought to.

    Opening the port restarts the board, which then asks for it again.
    """

    def __init__(self, operator: Operator) -> None:
        self._measure = operator.everted_length_cm
        self.set_body_pressure = operator.set_body_pressure
        self.place_pegs = operator.place_pegs
        self.length_cm: float | None = None

    def everted_length_cm(self) -> float:
        """As remembered, else as measured."""
        if self.length_cm is None:
            self.length_cm = self._measure()
        return self.length_cm


def run_explorations(
    url: str,
    attendant: Attendant,
    folder: Folder,
    trials: int,
    *,
    seed: int,
    operator: Operator | None = None,
    progress: Progress | None = None,
    say: Say = lambda text: None,
) -> bool:
    """Make the planned explorations, of both protocols, that the folder does not hold yet.

    The emulator's seed differs from trial to trial. What was kept stays in every case.

    Returns:
        Whether all are done; False if the attendant stopped.
    """
    person = _Remembers(operator) if operator else None

    def one(run: PlannedRun) -> tuple[Row, str]:
        _wind_in(url, folder.config, person, say)
        attendant.set_dowel(run.key)
        found = explore(
            url, config=folder.config, seed=seed + run.number, out=folder.path,
            name=f"{run.protocol}-{run.number}", protocol=run.protocol, operator=person,
            progress=progress,
        )  # fmt: skip
        if person:
            # The encoder may show a hair more than the whole body, which the board refuses.
            person.length_cm = min(found.length_cm, folder.config.body.length_cm)
        document = found.document
        pegs = document.truth.pegs if document.truth else ()
        (dowel,) = attendant.dowels(1, [(peg.x_cm, peg.y_cm) for peg in pegs])
        errors = explored.in_words(explored.made(document, dowel))
        summary = (
            f"{document.outcome}; {errors if document.contacts else 'no contact'}. "
            "Take the dowel away if the robot leans on it: it is wound in next"
        )
        return {"run": found.folder.name, "dowel_cm": dowel}, summary

    planned = [PlannedRun(way, number) for number in range(1, trials + 1) for way in WAYS]
    todo = folder.missing(planned, say, "exploration")
    return folder.take(todo, one, attendant.verdict, say)


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


def evaluate(folder: Folder) -> Outcome:
    """Errors of the kept explorations from their run folders, as those of simulated robots.

    Raises:
        DataError: none was kept.
    """
    trials: dict[int, dict[str, explored.Made]] = defaultdict(dict)
    for line in folder.kept():
        run, way = RunFolder(folder.path / line["run"]), line["protocol"]
        made = explored.made(
            run.read_document(), line["dowel_cm"], run if way == "thesis" else None
        )
        trials[line["number"]][way] = made
    if not trials:
        raise DataError("there are no explorations to evaluate", "make some first")
    runs = [
        explored.row(number, ways["thesis"], ways["measure"])
        for number, ways in sorted(trials.items())
        if len(ways) == len(WAYS)
    ]
    outcome = explored.compared(runs) if runs else Outcome()
    each = [
        (number, way, ways[way]) for number, ways in sorted(trials.items()) for way in WAYS
        if way in ways
    ]  # fmt: skip
    outcome.tables["each"] = [
        {"number": number, "protocol": way, "error_x_cm": made["x_cm"], "error_cm": made["cm"],
         "robot_time_s": made["s"]}
        for number, way, made in each
    ]  # fmt: skip
    outcome.notes += [
        f"trial {number}, {WAYS[way]}: {explored.in_words(made)}, {made['s']:.0f} s"
        for number, way, made in each
    ]
    return outcome
