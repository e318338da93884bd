"""The thesis's static trials with a robot: what is planned, and how each one is taken.

The same steps for a robot on the bench, whose operator answers prompts, and for the emulator, whose
operator is code (`attendant.py`). Each trial starts with the robot straight, vented and zeroed, as
in the thesis; one second of readings is averaged while the dowels press, and at every pressure that
an actuated robot passes on its way (`thesis.PASSED_PSI`). `recorded.py` keeps them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from thigmo.config import RobotConfig, Side
from thigmo.errors import CommandRefusedError, DataError
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.conditions import STATIC, opposed_forces
from thigmo.studies.experiments.fit import frozen
from thigmo.studies.experiments.folder import Row, Say
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


@dataclass(frozen=True)
class Planned:
    """One trial to take.

    Attributes:
        experiment, condition, place, number: its label; trials of a condition count from 1.
        side: of the robot on which the (distal) dowel stands; an actuated robot bends to it.
        arcs_cm: where the dowels touch, base first.
        pushes_cm: y to which they push the body's centreline; empty for an actuated robot.
        folds: the push folds the base.
        pressure_psi: of the muscle on the dowel's side; 0 unactuated.
    """

    experiment: str
    condition: str
    place: str
    number: int
    side: Side
    arcs_cm: tuple[float, ...]
    pushes_cm: tuple[float, ...] = ()
    folds: bool = False
    pressure_psi: float = 0.0

    @property
    def key(self) -> str:
        """What names it in trials.csv."""
        return f"{self.condition} | {self.place} | {self.number}"


def plan(experiment: str, config: RobotConfig, trials: int) -> list[Planned]:
    """All trials of an experiment, in the thesis's order; sides in turn.

    Args:
        experiment: one of STATIC.
        config: of the robot; places scale with its length.
        trials: for each place and condition.

    Raises:
        DataError: no such experiment; a robot too short for it.
    """
    length, critical = config.body.length_cm, config.body.critical_curvature
    scale = length / thesis.LENGTH_CM
    places = [
        (place, scale * arc)
        for place, arc in zip(thesis.PLACES, thesis.SINGLE_ARCS_CM, strict=True)
    ]
    numbers = range(1, trials + 1)
    if experiment == "single-contact":
        return [
            _pushed(config, experiment, level, place, number, (arc,), (share * critical / arc,))
            for level, share in zip(thesis.LEVELS, (1.0, thesis.LOW_LEVEL), strict=True)
            for place, arc in places
            for number in numbers
        ]
    if experiment == "two-contacts":
        if length <= thesis.GAPS_CM[0]:
            raise DataError(
                f"two contacts {thesis.GAPS_CM[0]:g} cm apart do not fit on {length:g} cm",
                "use a longer robot",
            )
        return [
            _pushed(
                config, experiment, thesis.separation(gap), f"{gap:g} cm apart", number,
                (length - gap, length), opposed_forces(gap, 1.0, length, critical),
            )
            for gap in thesis.GAPS_CM
            for number in numbers
        ]  # fmt: skip
    if experiment == "actuated":
        return [
            Planned(experiment, level, place, number, _side(number), (arc,), pressure_psi=pressure)
            for level, pressure in thesis.ACTUATED_PSI.items()
            for place, arc in places
            for number in numbers
        ]
    raise DataError(
        f"{experiment!r} is not taken trial by trial", f"choose from {', '.join(STATIC)}"
    )


def _side(number: int) -> Side:
    return "left" if number % 2 else "right"


def _pushed(
    config: RobotConfig,
    experiment: str,
    condition: str,
    place: str,
    number: int,
    arcs: tuple[float, ...],
    forces: tuple[float, ...],
) -> Planned:
    """A trial whose forces (1/cm^2) are given by how far the dowels push the body."""
    side = _side(number)
    sign = -1.0 if side == "left" else 1.0  # a dowel on the left pushes to the right
    folds = condition == thesis.LEVELS[0]
    body = pushed(
        arcs,
        tuple(sign * force for force in forces),
        fold_rad=sign * frozen().fold_rad if folds else 0.0,
        length_cm=config.body.length_cm,
        diameter_cm=config.body.diameter_cm,
    )
    pushes = tuple(round(body.pose(arc)[1], 2) for arc in arcs)
    return Planned(experiment, condition, place, number, side, arcs, pushes, folds)


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
        way = [psi for psi in thesis.PASSED_PSI if psi < trial.pressure_psi]
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
