"""The thesis's static trials with a robot: how each one is taken.

The same steps for a robot on the bench, whose operator answers prompts, and for the emulator, whose
operator is code (`attendant.py`). Each trial starts with the robot straight, vented and zeroed, as
in the thesis; one second of readings is averaged while the dowels press, and at every pressure that
an actuated robot passes on its way (`thesis.PASSED_PSI`). `recorded.py` keeps them.
"""

from __future__ import annotations

import numpy as np

from thigmo.config import RobotConfig, Side
from thigmo.errors import CommandRefusedError
from thigmo.robot import Reading, Robot
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.attendant import Attendant
from thigmo.studies.experiments.fit import frozen
from thigmo.studies.experiments.folder import Row, Say
from thigmo.studies.experiments.plan import Planned
from thigmo.studies.experiments.specimen import pushed

_STEADY_S = 2.5  # from a new load to a body at rest
_READ_S = 1.0
_QUIET_S = 5.0  # after venting, before zeros are taken
_RAMP_PSI_S = 1.0  # slow: an overshoot would turn the muscle over to its other branch
_ZERO_TRIES = 3
_SAME_CM = 0.2


def prepare(robot: Robot, config: RobotConfig, say: Say) -> None:
    """Configure, arm, grow to the full length stage by stage, and let every sensor settle."""
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


def pushes_cm(trial: Planned, config: RobotConfig) -> list[float]:
    """The y to which dowels push this robot's centreline, where they touch it, base first."""
    shape = pushed(
        trial.arcs_cm,
        trial.forces,
        fold_rad=trial.sign * frozen().fold_rad if trial.folds else 0.0,
        length_cm=config.body.length_cm,
        diameter_cm=config.body.diameter_cm,
    )
    return [round(shape.pose(arc)[1], 2) for arc in trial.arcs_cm]


def take(robot: Robot, config: RobotConfig, attendant: Attendant, trial: Planned) -> Row:
    """Take one trial, vent the robot, and return what is kept of it beside its plan."""
    attendant.clear()
    _zero(robot)
    passed: list[Reading] = []
    if trial.pressure_psi > 0:
        now = 0.0
        for psi in thesis.passed_psi(trial.pressure_psi):
            _press(robot, trial.side, psi, since_psi=now)
            if psi == thesis.TOUCH_PSI:
                attendant.touch(trial)
            passed.append(robot.read(_READ_S))
            now = psi
        _press(robot, trial.side, trial.pressure_psi, since_psi=now)
    else:
        attendant.push_aside(trial, pushes_cm(trial, config))
        robot.wait(_STEADY_S)
    reading = robot.read(_READ_S)
    dowels = attendant.dowels(len(trial.arcs_cm))
    truth = attendant.truth()
    robot.vent()
    return {
        **{name: getattr(reading, name) for name in ("t_s", "length_cm", "left_psi", "right_psi")},
        "zeroed": robot.status().zeroed,
        "curvature": reading.curvature.tolist(),
        "dowel_x_cm": [x for x, _ in dowels],
        "dowel_y_cm": [y for _, y in dowels],
        **truth,
        "passed_psi": [getattr(r, f"{trial.side}_psi") for r in passed],
        "passed_curvature": [r.curvature.tolist() for r in passed],
    }


def _press(robot: Robot, side: Side, psi: float, *, since_psi: float) -> None:
    left, right = (psi, 0.0) if side == "left" else (0.0, psi)
    robot.press(left_psi=left, right_psi=right, ramp_psi_s=_RAMP_PSI_S)
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
