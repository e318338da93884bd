"""The thesis's static trials with a robot: what is planned, and how each one is taken.

The same steps for a robot on the bench, whose operator answers prompts, and for the emulator, whose
operator is code (`attendant.py`). Each trial starts with the robot straight, vented and zeroed, as
in the thesis; one second of readings is averaged while the dowels press, and at every pressure that
an actuated robot passes on its way (`thesis.PASSED_PSI`). `recorded.py` keeps them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from thigmo.config import RobotConfig, Side
from thigmo.errors import CommandRefusedError
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.fit import frozen
from thigmo.studies.experiments.folder import Row, Say
from thigmo.studies.experiments.plan import Planned
from thigmo.studies.experiments.plan import plan as planned
from thigmo.studies.experiments.specimen import pushed

if TYPE_CHECKING:
    from thigmo.robot import Reading, Robot
    from thigmo.studies.experiments.attendant import Attendant

_STEADY_S = 2.5  # from a new load to a body at rest
_READ_S = 1.0
_QUIET_S = 5.0  # after venting, before zeros are taken
_RAMP_PSI_S = 1.0  # slow: an overshoot would turn the muscle over to its other branch
_ZERO_TRIES = 3
_SAME_CM = 0.2


def plan(experiment: str, config: RobotConfig, trials: int) -> list[Planned]:
    """All trials of an experiment, and how far the dowels push this robot aside.

    Raises:
        DataError: no such experiment; a robot too short for it.
    """
    body = config.body
    found = []
    for trial in planned(experiment, trials, body.length_cm, body.critical_curvature):
        shape = (
            pushed(
                trial.arcs_cm,
                trial.forces,
                fold_rad=trial.sign * frozen().fold_rad if trial.folds else 0.0,
                length_cm=body.length_cm,
                diameter_cm=body.diameter_cm,
            )
            if trial.forces
            else None
        )
        pushes = tuple(round(shape.pose(arc)[1], 2) for arc in trial.arcs_cm) if shape else ()
        found.append(replace(trial, pushes_cm=pushes))
    return found


def prepare(robot: Robot, config: RobotConfig, say: Say) -> None:
    """Configure, arm, grow to the full length stage by stage, and let every sensor settle.

    Raises:
        ThigmoError: as the robot raises; it is vented then.
    """
    robot.configure(config)
    length = robot.status().length_cm
    if length is None:
        length = robot.operator.everted_length_cm()
        robot.confirm_length(length)
    if robot.status().state == "safe":
        robot.arm()
    robot.vent()
    body, pitch = config.body, config.sensors.pitch_cm
    stops = {*np.arange(pitch, body.length_cm, pitch).tolist(), body.length_cm}
    stops |= {zone.until_cm for zone in body.zones if zone.until_cm < body.length_cm}
    zone = -1
    for stop in sorted(stop for stop in stops if stop > length + _SAME_CM):
        if body.zone_at(stop) != zone:
            zone = body.zone_at(stop)
            _set_zone(robot, config, zone)
        say(f"growing to {stop:.1f} cm")
        robot.grow_to(stop)
    if zone != len(body.zones) - 1:
        _set_zone(robot, config, len(body.zones) - 1)
    say("waiting for the sensors to settle")
    robot.wait_settled()


def _set_zone(robot: Robot, config: RobotConfig, zone: int) -> None:
    robot.operator.set_body_pressure(config.body.zones[zone].pressure_psi)
    robot.select_zone(zone)


def take(robot: Robot, attendant: Attendant, trial: Planned) -> Row:
    """Take one trial; the robot is vented afterwards.

    Returns:
        What trials.csv holds of it beside its label (`recorded.COLUMNS`).

    Raises:
        ThigmoError: as the robot or the attendant raises.
    """
    attendant.clear()
    _zero(robot)
    passed: list[Reading] = []
    if trial.pressure_psi > 0:
        way = thesis.passed_psi(trial.pressure_psi)
        now = 0.0
        for psi in way:
            _press(robot, trial.side, psi, since_psi=now)
            if psi == thesis.TOUCH_PSI:
                attendant.touch(trial)
            passed.append(robot.read(_READ_S))
            now = psi
        _press(robot, trial.side, trial.pressure_psi, since_psi=now)
    else:
        attendant.push_aside(trial)
        robot.wait(_STEADY_S)
    reading = robot.read(_READ_S)
    dowels = attendant.dowels(trial)
    known = attendant.truth()
    robot.vent()
    return {
        "t_s": reading.t_s,
        "length_cm": reading.length_cm,
        "left_psi": reading.left_psi,
        "right_psi": reading.right_psi,
        "zeroed": robot.status().zeroed,
        "curvature": reading.curvature.tolist(),
        "dowel_x_cm": [x for x, _ in dowels],
        "dowel_y_cm": [y for _, y in dowels],
        "true_arcs_cm": list(known.arcs_cm),
        "true_forces": list(known.forces),
        "true_contact_x_cm": list(known.contact_x_cm),
        "passed_psi": [r.left_psi if trial.side == "left" else r.right_psi for r in passed],
        "passed_curvature": [r.curvature.tolist() for r in passed],
    }


def _press(robot: Robot, side: Side, psi: float, *, since_psi: float = 0.0) -> None:
    if side == "left":
        robot.press(left_psi=psi, ramp_psi_s=_RAMP_PSI_S)
    else:
        robot.press(right_psi=psi, ramp_psi_s=_RAMP_PSI_S)
    robot.wait((psi - since_psi) / _RAMP_PSI_S + _STEADY_S)


def _zero(robot: Robot) -> None:
    """Zero the straight, vented robot; once more if its readings still drift."""
    robot.vent()
    for attempt in range(1, _ZERO_TRIES + 1):
        robot.wait(_QUIET_S)
        try:
            robot.zero()
        except CommandRefusedError as error:
            if error.reason != "drifting" or attempt == _ZERO_TRIES:
                raise
        else:
            return
