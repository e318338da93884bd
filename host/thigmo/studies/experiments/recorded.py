"""Trials taken with a robot: kept in a folder, resumed, evaluated again.

    OUT/EXPERIMENT/
      robot.toml, trials.csv    as `folder.py` says
      run-1.mcap                every frame of the first session's link, run-2.mcap of the next

Tables of earlier versions end before the readings at the pressures on the way; such trials are
evaluated by their last reading alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from thigmo import __version__
from thigmo.config import SIDES, RobotConfig, Side
from thigmo.errors import DataError
from thigmo.exploration.reference import scale_errors
from thigmo.record import LogWriter
from thigmo.robot import SensorTable
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.folder import Folder, Line, Row, Say
from thigmo.studies.experiments.plan import Planned
from thigmo.studies.experiments.procedure import plan, prepare, take
from thigmo.studies.experiments.trial import Floats, Passed, Trial

if TYPE_CHECKING:
    from thigmo.robot import Robot
    from thigmo.studies.experiments.attendant import Attendant

_PLACE_SE_CM = 0.1  # of a sensor's centre, by a ruler; robot.toml does not state it
_LEAST_GAIN_SE = 1e-3


class TrialFolder(Folder):
    """One experiment's trials on disk."""

    columns = (
        "key", "experiment", "condition", "place", "number", "side", "state", "arcs_cm",
        "pressure_psi", "t_s", "length_cm", "left_psi", "right_psi", "zeroed", "curvature",
        "dowel_x_cm", "dowel_y_cm", "true_arcs_cm", "true_forces", "true_contact_x_cm",
        "passed_psi", "passed_curvature",
    )  # fmt: skip
    earlier = columns[:-2]

    @contextmanager
    def recording(self, robot: Robot) -> Iterator[LogWriter]:
        """Keep every frame of the link in the next `run-N.mcap`."""
        number = 1 + len(list(self.path.glob("run-*.mcap")))
        facts = {"thigmo": __version__, "url": robot.url, **robot.identity}
        with LogWriter(self.path / f"run-{number}.mcap", facts) as log:
            robot.record_frames(log.frame)
            yield log

    def trials(self) -> list[Trial]:
        """The kept trials, for `evaluate`.

        Raises:
            DataError: a damaged line.
        """
        kept = self.kept()
        try:
            shown = _shown_gains(kept, self.config)
            return [_trial(row, self.config, shown) for row in kept]
        except (ValueError, IndexError) as error:
            raise DataError(
                f"{self.table} is damaged: {error}", "mend or delete that line"
            ) from error


def run_trials(
    robot: Robot,
    attendant: Attendant,
    folder: TrialFolder,
    experiment: str,
    trials: int,
    say: Say = lambda text: None,
) -> bool:
    """Take the planned trials that the folder does not hold yet.

    Args:
        robot: connected.
        attendant: places dowels, measures them, judges.
        folder: with the robot's constants.
        experiment: one of `plan.STATIC`.
        trials: for each place and condition.
        say: told what happens.

    Returns:
        Whether all are done; False if the attendant stopped.

    Raises:
        ThigmoError: as the robot raises. What was taken is kept in every case.
    """
    todo = folder.missing(plan(experiment, folder.config, trials), say, experiment)
    if not todo:
        return True
    half = SensorTable.of(folder.config).healthy.size // 2
    with folder.recording(robot) as log:

        def one(trial: Planned) -> tuple[Row, str]:
            log.note("trial", robot.now(), key=trial.key)
            row = take(robot, attendant, trial)
            left, right = row["curvature"][0], row["curvature"][half]
            return row, f"base sensors read {left:+.4f} (left) and {right:+.4f} 1/cm (right)"

        prepare(robot, folder.config, say)
        done = folder.take(todo, one, attendant.verdict, say)
        if done:
            attendant.clear()
    return done


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(";")) if text else ()


def _frames(row: Line) -> Floats:
    """(T, 10) readings at the pressures on the way."""
    text = row["passed_curvature"]
    return np.array([_numbers(part) for part in text.split("/")] if text else [], dtype=np.float64)


def _shown_gains(rows: Sequence[Line], config: RobotConfig) -> dict[Side, tuple[Floats, Floats]]:
    """What the untouched robot showed of its sensors' gains at 6 psi, and their errors, (10,) each.

    As `Specimen.learn_gains`; but what a reading errs by on a real robot (its zero, its hysteresis)
    is much the same in all trials, so that many of them tell no more than one.
    """
    made: dict[Side, tuple[Floats, Floats]] = {}
    table = SensorTable.of(config)
    for side in SIDES:
        muscle = config.actuators.side(side)
        first = [(_numbers(r["passed_psi"])[0], _frames(r)[0]) for r in rows
                 if r["side"] == side and r["passed_psi"]]  # fmt: skip
        zone = muscle.maps[-1]
        spread = np.hypot(scale_errors(config), zone.scale_se)
        spread = np.maximum(spread, _LEAST_GAIN_SE)
        gain, error = np.ones(spread.size), spread
        if first:
            sign = 1 if side == "left" else -1
            believed = np.mean([sign * zone.inflate.curvature(psi) for psi, _ in first])
            departure = np.mean([readings for _, readings in first], axis=0) - believed
            variance = table.noise**2 + muscle.offset_se**2
            precision = 1 / spread**2 + believed**2 / variance
            gain = 1 + np.nan_to_num(believed * departure / variance / precision)
            error = precision**-0.5
        made[side] = gain, error
    return made


def _trial(row: Line, config: RobotConfig, shown: dict[Side, tuple[Floats, Floats]]) -> Trial:
    """A line of the table as a trial: usable sensors only, free curvature by the map."""
    table = SensorTable.of(config)
    curvature = np.array(_numbers(row["curvature"]))
    side: Side = "left" if row["side"] == "left" else "right"
    muscle = config.actuators.side(side)
    free = 0.0
    gain, gain_se = np.ones(curvature.size), np.zeros(curvature.size)
    if float(row["pressure_psi"]) > 0:
        measured = float(row["left_psi"] if side == "left" else row["right_psi"])
        free = muscle.maps[-1].inflate.curvature(measured) * (1 if side == "left" else -1)
        use = table.usable(side, int(row["zeroed"]))
    else:
        use = table.healthy & (table.direction * curvature >= 0)
    use = use & np.isfinite(curvature)
    passed = None
    if row["passed_psi"]:
        gain, gain_se = shown[side]
        on_the_way = [muscle.maps[-1].inflate.curvature(psi) for psi in _numbers(row["passed_psi"])]
        passed = Passed(
            _frames(row)[:, use], np.copysign(on_the_way, free), float(np.median(gain_se[use])),
            _PLACE_SE_CM,
        )  # fmt: skip
    scale_se = scale_errors(config)
    sigma = np.sqrt(table.noise**2 + (scale_se * (curvature - free)) ** 2)
    if free:  # the zero, and what scale and map may be off by
        share = np.hypot(scale_se, muscle.maps[-1].scale_se)
        sigma = np.sqrt(sigma**2 + table.noise**2 + (share * free) ** 2)
    arcs = _numbers(row["true_arcs_cm"]) or _numbers(row["arcs_cm"])
    unknown = (float("nan"),) * len(arcs)
    return Trial(
        row["condition"],
        row["place"],
        curvature[use],
        table.center_cm[use],
        table.span_cm[use],
        free,
        float(np.median(table.noise[use])),
        gain[use],
        sigma[use],
        sigma[use],
        arcs,
        _numbers(row["true_forces"]) or unknown,
        _numbers(row["dowel_x_cm"]),
        _numbers(row["true_contact_x_cm"]) or unknown,
        offset_sigma=muscle.offset_se,
        length_cm=float(row["length_cm"]),
        critical=config.body.critical_curvature,
        radius_cm=config.body.radius_cm,
        dowel_cm=thesis.DOWEL_CM,
        passed=passed,
    )
