"""Trials taken with a robot: kept in a folder, resumed, evaluated again.

OUT/EXPERIMENT/
  robot.toml, trials.jsonl  as `folder.py` says
  run-1.mcap                every frame of the first session's link, run-2.mcap of the next
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thigmo import __version__
from thigmo.config import RobotConfig, Side
from thigmo.errors import DataError
from thigmo.exploration.reference import scale_errors
from thigmo.record import LogWriter
from thigmo.robot import Robot, SensorTable
from thigmo.studies.experiments.attendant import Attendant
from thigmo.studies.experiments.folder import Folder, Row, Say
from thigmo.studies.experiments.plan import Planned, plan
from thigmo.studies.experiments.procedure import prepare, take
from thigmo.studies.experiments.trial import Passed, Trial
from thigmo.studies.rod import Floats

_PLACE_SE_CM = 0.1  # of a sensor's centre, by a ruler; robot.toml does not state it
_LEAST_GAIN_SE = 1e-3


def trials(folder: Folder) -> list[Trial]:
    """The kept trials, for `evaluate`.

    Raises:
        DataError: a damaged line.
    """
    kept = folder.kept()
    try:
        return [_trial(row, folder.config, kept) for row in kept]
    except (LookupError, TypeError, ValueError) as error:
        raise DataError(
            f"the table in {folder.path} is damaged: {error!r}", "mend or delete that line"
        ) from error


def run_trials(
    robot: Robot,
    attendant: Attendant,
    folder: Folder,
    experiment: str,
    count: int,
    say: Say = lambda text: None,
) -> bool:
    """Take so many trials of each place and condition, but for those that the folder holds.

    What was taken is kept in every case.

    Returns:
        Whether all are done; False if the attendant stopped.
    """
    config, body = folder.config, folder.config.body
    planned = plan(experiment, count, body.length_cm, body.critical_curvature)
    todo = folder.missing(planned, say, experiment)
    if not todo:
        return True
    session = 1 + len(list(folder.path.glob("run-*.mcap")))
    facts = {"thigmo": __version__, "url": robot.url, **robot.identity}
    with LogWriter(folder.path / f"run-{session}.mcap", facts) as log:
        robot.record_frames(log.frame)

        def one(trial: Planned) -> tuple[Row, str]:
            log.note("trial", robot.now(), key=trial.key)
            row = take(robot, config, attendant, trial)
            read = row["curvature"]
            left, right = read[0], read[len(read) // 2]
            return row, f"base sensors read {left:+.4f} (left) and {right:+.4f} 1/cm (right)"

        prepare(robot, config, say)
        done = folder.take(todo, one, attendant.verdict, say)
        if done:
            attendant.clear()
    return done


def _shown_gains(rows: Sequence[Row], config: RobotConfig, side: Side) -> tuple[Floats, Floats]:
    """What the untouched robot showed of its sensors' gains at 6 psi, and their errors, (N,) each.

    As `Specimen.learn_gains`; but what a reading errs by on a real robot (its zero, its hysteresis)
    is much the same in all trials, so that many of them tell no more than one.
    """
    table, muscle = SensorTable.of(config), config.actuators.side(side)
    mine = [row for row in rows if row["side"] == side and row["passed_psi"]]
    zone, sign = muscle.maps[-1], 1 if side == "left" else -1
    spread = np.maximum(np.hypot(scale_errors(config), zone.scale_se), _LEAST_GAIN_SE)
    believed = np.mean([sign * zone.inflate.curvature(row["passed_psi"][0]) for row in mine])
    departure = np.mean([row["passed_curvature"][0] for row in mine], axis=0) - believed
    variance = table.noise**2 + muscle.offset_se**2
    precision = 1 / spread**2 + believed**2 / variance
    return 1 + np.nan_to_num(believed * departure / variance / precision), precision**-0.5


def _trial(row: Row, config: RobotConfig, rows: Sequence[Row]) -> Trial:
    """A line of the table as a trial: usable sensors only, free curvature by the map."""
    table = SensorTable.of(config)
    curvature = np.array(row["curvature"])
    side: Side = row["side"]
    muscle, sign = config.actuators.side(side), 1 if side == "left" else -1
    zone = muscle.maps[-1]
    scale_se = scale_errors(config)
    if row["passed_psi"]:
        free = sign * zone.inflate.curvature(row[f"{side}_psi"])
        gain, gain_se = _shown_gains(rows, config, side)
        use = table.usable(side, row["zeroed"]) & np.isfinite(curvature)
        passed = Passed(
            np.array(row["passed_curvature"])[:, use],
            np.array([sign * zone.inflate.curvature(psi) for psi in row["passed_psi"]]),
            float(np.median(gain_se[use])),
            _PLACE_SE_CM,
        )
        # The zero, and what scale and map may be off by.
        more = table.noise**2 + (np.hypot(scale_se, zone.scale_se) * free) ** 2
    else:
        free, gain, passed, more = 0.0, np.ones(curvature.size), None, np.zeros(curvature.size)
        use = table.healthy & (table.direction * curvature >= 0)
    sigma = np.sqrt(table.noise**2 + (scale_se * (curvature - free)) ** 2 + more)
    arcs = tuple(row["true_arcs_cm"] or row["arcs_cm"])
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
        tuple(row["true_forces"]) or unknown,
        tuple(row["dowel_x_cm"]),
        tuple(row["true_contact_x_cm"]) or unknown,
        offset_sigma=muscle.offset_se,
        length_cm=row["length_cm"],
        critical=config.body.critical_curvature,
        radius_cm=config.body.radius_cm,
        passed=passed,
    )
