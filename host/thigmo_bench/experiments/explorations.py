"""Section 3.5: whole explorations by the thesis's protocol and by ours, emulated or with a robot.

By the thesis's protocol, the answer is that of the thesis's solver on the peak readings of the
full sweep, at the first stage with a contact. By ours, it is the exploration's. Robot time is
device time.

With a robot, explorations are made one by one. They can be labelled, resumed and evaluated again:

    OUT/exploration/
      robot.toml, trials.jsonl    as `session.py` says
      DATE-...                    run folders, as those of `thigmo explore`

Each trial is two explorations of the same room. Before each of them, the robot is wound in. A dowel
that the vented robot leans on must be taken away for that, and put back afterwards.
"""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from thigmo.config import RobotConfig
from thigmo.display.axes import BLUE, ORANGE, RED
from thigmo.errors import DataError
from thigmo.exploration import explore
from thigmo.exploration.map import best_contact
from thigmo.exploration.recorded import recorded_sweeps
from thigmo.exploration.run import Progress, Protocol
from thigmo.record import RunDocument, RunFolder
from thigmo.robot import Operator, SensorTable, connect
from thigmo.wiring import Wiring
from thigmo_bench.baselines import BASELINES, BaselineProblem
from thigmo_bench.experiments import thesis
from thigmo_bench.experiments.session import Attendant, Folder, Place, Row, Say
from thigmo_bench.studies import charts
from thigmo_bench.studies.engine import Claim, Context, Outcome, Record
from thigmo_bench.studies.rooms import explored

_URL = "emulator://default"
_BASE_CM = 0.2
_PROTOCOLS: dict[Protocol, str] = {"measure": "our protocol", "thesis": "the thesis's protocol"}

_QUANTITIES = "x_cm", "cm", "s"
ProtocolResult = dict[str, float]
"""An exploration's |x error| "x_cm", error in the plane "cm" and robot time "s"; "solver_cm" of the
thesis's solver where its protocol was followed. Errors are infinite where no contact was mapped."""

Trials = Mapping[int, Mapping[Protocol, ProtocolResult]]
"""By seed of the room, or number of the trial."""


def run(robots: int, context: Context) -> Outcome:
    """Explore the emulator's default room once by each protocol for each seed."""
    seeds = [context.seed + robot for robot in range(robots)]
    trials = dict(zip(seeds, context.map(_explore_by_both, seeds, "explorations"), strict=True))
    return _promises(trials)


def _explore_by_both(seed: int) -> dict[Protocol, ProtocolResult]:
    """Explore the default room by both protocols."""
    with tempfile.TemporaryDirectory() as folder:
        thesis_run = explored(_URL, folder, seed, protocol="thesis", frames=True)
        assert thesis_run.document.truth is not None  # the emulator's room knows itself
        (peg,) = thesis_run.document.truth.pegs
        dowel = peg.x_cm, peg.y_cm
        return {
            "thesis": _result(thesis_run.document, dowel, RunFolder(thesis_run.folder)),
            "measure": _result(explored(_URL, folder, seed).document, dowel),
        }


def _result(
    document: RunDocument, dowel: Place, thesis_run: RunFolder | None = None
) -> ProtocolResult:
    """The result of an exploration; its folder is needed if it followed the thesis's protocol.

    On a real robot the point of contact is unknown. The dowel that would touch the body at the
    mapped point is therefore compared with the measured dowel.
    """
    best = best_contact(document.contacts)
    x = plane = float("inf")
    if document.error_x_cm is not None and document.error_cm is not None:
        x, plane = document.error_x_cm, document.error_cm
    elif document.truth is None and best is not None:
        # Centre of a dowel that touches the skin there.
        error_x = best.x_cm + thesis.DOWEL_CM * float(np.cos(best.normal_rad)) - dowel[0]
        error_y = best.y_cm + thesis.DOWEL_CM * float(np.sin(best.normal_rad)) - dowel[1]
        x, plane = abs(error_x), float(np.hypot(error_x, error_y))
    result = {"x_cm": x, "cm": plane, "s": document.robot_time_s}
    return result | ({"solver_cm": _thesis_solver(thesis_run, dowel[0])} if thesis_run else {})


def _errors_text(result: ProtocolResult) -> str:
    return f"|x error| {result['x_cm']:.2f} cm, in the plane {result['cm']:.2f} cm"


def _thesis_solver(run: RunFolder, obstacle_x_cm: float) -> float:
    """|a - x of the obstacle| of the thesis's solver on the peak of the first contact, cm.

    Stages with fewer readings than the solver needs are skipped, as in the thesis.
    """
    table = SensorTable.laid_out(Wiring.laid_out(run.read_config()))
    for sweep in recorded_sweeps(run.path):
        triggered = {trigger.side for trigger in sweep.triggers}
        for peak in (peak for peak in sweep.peaks if peak.side in triggered):
            usable = table.usable(peak.side, peak.sensors) & np.isfinite(peak.curvature)
            if usable.sum() >= thesis.LEAST_READINGS:
                contact_curvature = peak.curvature[usable] - peak.free_curvature
                problem = BaselineProblem(
                    contact_curvature,
                    table.center_cm[usable],
                    table.span_cm[usable],
                    peak.length_cm,
                )
                arcs, _ = BASELINES["alternating"](problem)
                return abs(float(arcs[0]) - obstacle_x_cm)
    return float("inf")


def _promises(trials: Trials) -> Outcome:
    """Promises over all rooms that were explored by both protocols."""
    runs: list[Record] = [
        {
            "seed": number,
            "thesis_solver_cm": by_protocol["thesis"]["solver_cm"],
            **{f"thesis_protocol_{name}": by_protocol["thesis"][name] for name in _QUANTITIES},
            **{f"ours_{quantity}": value for quantity, value in by_protocol["measure"].items()},
        }
        for number, by_protocol in trials.items()
        if len(by_protocol) == len(_PROTOCOLS)
    ]
    if not runs:
        return Outcome()
    ours, times, theirs = (
        np.array([run[quantity] for run in runs], dtype=np.float64)
        for quantity in ("ours_x_cm", "ours_s", "thesis_protocol_s")
    )
    return Outcome(
        {"runs": runs},
        {"errors": _figure(runs)},
        [
            Claim("exploration: mean |x error| over the seeds", ours.mean(), 1.5, unit="cm"),
            Claim("exploration: robot time over the thesis's protocol's",
                  times.sum() / theirs.sum(), 0.5),
            Claim("exploration: worst |x error| over the seeds", ours.max(), 3.0, unit="cm"),
        ],
    )  # fmt: skip


def _figure(runs: list[Record]) -> Figure:
    """Error on the map against robot time, for both protocols."""
    figure, (axis,) = charts.panels(
        size=(7, 4.4), title=f"Exploration of the default room, {len(runs)} seeds"
    )
    for label, color, time, error in (
        ("thesis's protocol and solver", RED, "thesis_protocol_s", "thesis_solver_cm"),
        ("thesis's protocol, our localizer", ORANGE, "thesis_protocol_s",
         "thesis_protocol_x_cm"),
        ("ours", BLUE, "ours_s", "ours_x_cm"),
    ):  # fmt: skip
        points = np.array([(run[time], run[error]) for run in runs], dtype=np.float64)
        mapped = points[np.isfinite(points[:, 1])]
        count = f"{len(mapped)} of {len(runs)} mapped"
        axis.plot(*mapped.T, "o", color=color, alpha=0.7, label=f"{label} ({count})")
    published, _ = thesis.RESULTS["exploration", "obstacle at the farthest place"]
    axis.axhline(published, color="gray", linestyle="--", label=f"thesis, one run: {published} cm")
    axis.set(
        xlabel="robot time (s)", ylabel="|x error| of the mapped contact (cm)", xlim=(0, None),
        ylim=(0, None),
    )  # fmt: skip
    axis.legend(fontsize=8)
    return figure


class _LengthRemembered:
    """An operator who is not asked again for a length that the robot has just reached.

    Opening the port restarts the board, which then asks for the length again.
    """

    def __init__(self, operator: Operator) -> None:
        self._measure = operator.everted_length_cm
        self.set_body_pressure = operator.set_body_pressure
        self.place_pegs = operator.place_pegs
        self.warn = operator.warn
        self.length_cm: float | None = None

    def everted_length_cm(self) -> float:
        """The remembered length, or else the measured one."""
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
    """Make those planned explorations, of both protocols, that the folder does not hold yet.

    The emulator's seed differs from trial to trial. Returns whether all are done; False if the
    attendant stopped.
    """
    person = _LengthRemembered(operator) if operator else None

    def take_exploration(planned: Row) -> tuple[Row, str]:
        protocol, number = planned["protocol"], planned["number"]
        _wind_in(url, folder.config, person, say)
        attendant.set_dowel(f"{_PROTOCOLS[protocol]} | {number}")
        run = explore(
            url, config=folder.config, seed=seed + number, out=folder.path,
            name=f"{protocol}-{number}", protocol=protocol, operator=person, progress=progress,
        )  # fmt: skip
        if person:
            # The encoder may show a hair more than the whole body, which the board refuses.
            person.length_cm = min(run.length_cm, folder.config.body.length_cm)
        document = run.document
        pegs = document.truth.pegs if document.truth else ()
        (dowel,) = attendant.dowels(1, [(peg.x_cm, peg.y_cm) for peg in pegs])
        errors = _errors_text(_result(document, dowel)) if document.contacts else "no contact"
        summary = (
            f"{document.outcome}; {errors}. "
            "Take the dowel away if the robot leans on it: it is wound in next"
        )
        return {"run": run.folder.name, "dowel_cm": dowel}, summary

    planned: dict[str, Row] = {
        f"{words} | {number}": {"protocol": protocol, "number": number}
        for number in range(1, trials + 1)
        for protocol, words in _PROTOCOLS.items()
    }
    todo = folder.missing(planned, say, "exploration")
    return folder.take(todo, take_exploration, attendant.verdict, say)


def _wind_in(url: str, config: RobotConfig, person: _LengthRemembered | None, say: Say) -> None:
    """Wind in a robot that is still everted; an emulated robot starts at its base."""
    with connect(url, operator=person) as robot:
        if robot.scenery() is not None:
            return
        robot.configure(config)
        if robot.known_length_cm() > _BASE_CM:
            say("winding the robot in")
            robot.arm()
            retraction = robot.retract_to(0.0)
            say(retraction.words)
            if person:
                person.length_cm = retraction.length_cm


def evaluate(folder: Folder) -> Outcome:
    """Compute errors of the kept explorations from their run folders, as for simulated robots.

    Raises:
        DataError: no exploration was kept.
    """
    trials: dict[int, dict[Protocol, ProtocolResult]] = defaultdict(dict)
    for line in sorted(folder.kept_rows(), key=lambda line: int(line["number"])):
        run, protocol = RunFolder(folder.path / line["run"]), line["protocol"]
        thesis_run = run if protocol == "thesis" else None
        trials[line["number"]][protocol] = _result(
            run.read_document(), line["dowel_cm"], thesis_run
        )
    if not trials:
        raise DataError("there are no explorations to evaluate", "make some first")
    outcome = _promises(trials)
    rows: list[Record] = []
    for number, by_protocol in trials.items():
        for protocol, label in _PROTOCOLS.items():
            if protocol not in by_protocol:
                continue
            result = by_protocol[protocol]
            rows.append({
                "number": number,
                "protocol": protocol,
                "error_x_cm": result["x_cm"],
                "error_cm": result["cm"],
                "robot_time_s": result["s"],
            })  # fmt: skip
            text = f"trial {number}, {label}: {_errors_text(result)}, {result['s']:.0f} s"
            outcome.notes.append(text)
    outcome.tables["trials"] = rows
    return outcome
