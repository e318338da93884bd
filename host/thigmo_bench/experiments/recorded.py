"""The thesis's static trials with a robot: how they are taken, kept, resumed and evaluated again.

OUT/EXPERIMENT/
  robot.toml, trials.jsonl  as `session.py` says
  run-1.mcap                every frame of the first session's link, run-2.mcap of the next

Each trial starts with the robot straight, vented and zeroed, as in the thesis. One second of
readings is averaged while the dowels press, and another before an actuated robot touches its dowel.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from thigmo.calibrate.bench import READ_S, STEADY_S, grow_to, zero
from thigmo.config import DEGREES, SIDES, SIGN, RobotConfig, Side
from thigmo.errors import DataError
from thigmo.record import LogWriter
from thigmo.robot import Reading, Robot, SensorTable
from thigmo.version import VERSION
from thigmo.wiring import Wiring
from thigmo_bench.experiments import thesis
from thigmo_bench.experiments.session import Attendant, Folder, Row, Say
from thigmo_bench.experiments.specimen import frozen, pushed
from thigmo_bench.experiments.trial import Planned, Trial, arc_bound_cm, plan
from thigmo_bench.studies.rod import Floats

_RAMP_PSI_S = 1.0  # slow: an overshoot would turn the muscle over to its other branch
_LEAST_GAIN_SE = 1e-3


def run_trials(
    robot: Robot,
    attendant: Attendant,
    folder: Folder,
    experiment: str,
    count: int,
    say: Say = lambda text: None,
) -> bool:
    """Take this many trials of each place and condition, except those that the folder holds.

    Returns whether all are done; False if the attendant stopped.
    """
    config, body = folder.config, folder.config.body
    planned = plan(experiment, count, body.length_cm, body.critical_curvature)
    todo = folder.missing({trial.key: trial for trial in planned}, say, experiment)
    if not todo:
        return True
    session = 1 + len(list(folder.path.glob("run-*.mcap")))
    facts = {"thigmo": VERSION, "url": robot.url, **robot.identity}
    with LogWriter(folder.path / f"run-{session}.mcap", facts) as log:
        robot.record_frames(log.frame)

        def take_trial(trial: Planned) -> tuple[Row, str]:
            log.note("trial", robot.now(), key=trial.key)
            row = _take(robot, config, attendant, trial)
            read = row["curvature"]
            left, right = read[0], read[len(read) // 2]
            return row, f"base sensors read {left:+.4f} (left) and {right:+.4f} 1/cm (right)"

        _prepare(robot, config, say)
        complete = folder.take(todo, take_trial, attendant.verdict, say)
        if complete:
            attendant.clear()
    return complete


def _prepare(robot: Robot, config: RobotConfig, say: Say) -> None:
    """Configure and arm, grow to the full length stage by stage, and let every sensor settle."""
    robot.configure(config)
    robot.known_length_cm()
    if robot.status().state == "safe":
        robot.arm()
    grow_to(robot, config, config.body.length_cm, say)
    robot.pressurize(len(config.body.pressures) - 1)
    say("waiting for the sensors to settle")
    robot.wait_settled()


def _take(robot: Robot, config: RobotConfig, attendant: Attendant, trial: Planned) -> Row:
    """Take one trial, vent the robot, and return the values to store beside the plan."""
    attendant.clear()
    robot.vent()
    zero(robot, lambda text: None)
    untouched: list[Reading] = []
    if trial.pressure_psi > 0:
        for previous_psi, psi in pairwise((0.0, thesis.TOUCH_PSI, trial.pressure_psi)):
            if previous_psi > 0.0:
                untouched.append(robot.read(READ_S))
            robot.press(DEGREES[trial.side], psi, ramp_psi_s=_RAMP_PSI_S)
            robot.wait((psi - previous_psi) / _RAMP_PSI_S + STEADY_S)
            if psi == thesis.TOUCH_PSI:
                attendant.touch(trial)
    else:
        shape = pushed(
            trial.arcs_cm, trial.forces, length_cm=config.body.length_cm,
            diameter_cm=config.body.diameter_cm, fold_rad=trial.fold(frozen().fold_rad),
        )  # fmt: skip
        attendant.push_aside(trial, [round(shape.pose(arc)[1], 2) for arc in trial.arcs_cm])
        robot.wait(STEADY_S)
    reading = robot.read(READ_S)
    dowels = attendant.dowels(len(trial.arcs_cm))
    truth = attendant.truth()
    robot.vent()
    return {
        **{name: getattr(reading, name) for name in ("t_s", "length_cm")},
        **{
            f"{side}_psi": reading.pressure_psi[config.muscle_number(DEGREES[side])]
            for side in SIDES
        },
        "zeroed": robot.status().zeroed,
        "curvature": reading.curvature.tolist(),
        "dowel_x_cm": [x for x, _ in dowels],
        "dowel_y_cm": [y for _, y in dowels],
        **truth,
        "passed_psi": [
            r.pressure_psi[config.muscle_number(DEGREES[trial.side])] for r in untouched
        ],
        "passed_curvature": [r.curvature.tolist() for r in untouched],
    }


def trials(folder: Folder) -> list[Trial]:
    """The kept trials, for `evaluate`.

    Raises:
        DataError: a line is damaged.
    """
    rows, wiring = folder.kept_rows(), Wiring.laid_out(folder.config)
    try:
        return [_trial(row, wiring, rows) for row in rows]
    except (LookupError, TypeError, ValueError) as error:
        raise DataError(
            f"the table in {folder.path} is damaged: {error!r}", "correct or delete that line"
        ) from error


def _trial(row: Row, wiring: Wiring, rows: Sequence[Row]) -> Trial:
    """A line of the table as a trial with usable sensors only, and free curvature from the map."""
    config, table, scale_se = wiring.config, SensorTable.laid_out(wiring), _scale_errors(wiring)
    side: Side = row["side"]
    muscle, sign = config.muscle(side), SIGN[side]
    muscle_map = muscle.maps[-1]
    readings = np.array(row["curvature"])
    gain: Floats = np.ones(readings.size)
    free, is_actuated = 0.0, bool(row["passed_psi"])
    if is_actuated:
        free = sign * muscle_map.inflate.curvature(row[f"{side}_psi"])
        gain = _gains_at_touch(rows, wiring, side)
        usable = table.usable(side, row["zeroed"]) & np.isfinite(readings)
        # The zero's noise, and the errors of scale and map at this free curvature.
        extra_variance = table.noise**2 + (np.hypot(scale_se, muscle_map.scale_se) * free) ** 2
    else:
        usable, extra_variance = (
            table.healthy & (table.bend_sign * readings >= 0),
            np.zeros(readings.size),
        )
    sigma = np.sqrt(table.noise**2 + (scale_se * (readings - free)) ** 2 + extra_variance)[usable]
    position, span = table.center_cm[usable], table.span_cm[usable]
    arcs, forces = tuple(row["true_arcs_cm"] or row["arcs_cm"]), tuple(row["true_forces"])
    unknown = (float("nan"),) * len(arcs)
    length = row["length_cm"]
    bound = arc_bound_cm(arcs, forces, position, span, sigma, length) if forces else unknown
    return Trial(
        row["condition"], row["place"], position, span, readings[usable], free, gain[usable],
        sigma, arcs, forces or unknown, tuple(row["dowel_x_cm"]),
        tuple(row["true_contact_x_cm"]) or unknown,
        unknown if is_actuated else bound, muscle.offset_se, length, config.body.critical_curvature,
        config.body.radius_cm,
    )  # fmt: skip


def _gains_at_touch(rows: Sequence[Row], wiring: Wiring, side: Side) -> Floats:
    """(N,) gains of the sensors, from the untouched robot's readings at 6 psi.

    As `Specimen.learn_gains`. On a real robot, however, the errors of a reading (zero, hysteresis)
    are much the same in all trials, so that many trials say no more than one.
    """
    table, muscle = SensorTable.laid_out(wiring), wiring.config.muscle(side)
    bent_rows = [row for row in rows if row["side"] == side and row["passed_psi"]]
    muscle_map, sign = muscle.maps[-1], SIGN[side]
    spread = np.maximum(np.hypot(_scale_errors(wiring), muscle_map.scale_se), _LEAST_GAIN_SE)
    believed = np.mean(
        [sign * muscle_map.inflate.curvature(row["passed_psi"][0]) for row in bent_rows]
    )
    departure = np.mean([row["passed_curvature"][0] for row in bent_rows], axis=0) - believed
    variance = table.noise**2 + muscle.offset_se**2
    precision = 1 / spread**2 + believed**2 / variance
    return np.asarray(1 + np.nan_to_num(believed * departure / variance / precision))


def _scale_errors(wiring: Wiring) -> Floats:
    """(n,) relative standard error of each sensor's scale; 0 where there is no sensor."""
    return np.array([sensor.gain_error if sensor else 0.0 for sensor in wiring.read_sensors])
