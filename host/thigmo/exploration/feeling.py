"""Contacts at this moment, of a robot that rests: by the sensors that the board reads, or a fibre.

Any robot feels so, muscles or none; one that grows also does at the stops of its growth. Bends out
of the plane are localized in space where a sensor that counts lies out of it. `thigmo feel` is its
command.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import cos, radians
from typing import Any

import numpy as np
import numpy.typing as npt

from thigmo.config import DEGREES, SAME_LENGTH_CM, Muscle, RobotConfig, Sensor
from thigmo.errors import DataError
from thigmo.exploration.growth import growth_body_pressure, growth_target
from thigmo.localization import LocalizeResult, localize
from thigmo.mechanics import rest_mean
from thigmo.reading_errors import errors_of
from thigmo.robot import Robot, zero_when_steady
from thigmo.robot.curvature import Floats

Ints = npt.NDArray[np.intp]

READ_S = 0.5
STEADY_S = 3.0  # from a change of pressure or length to a bend at rest
_SAME_SHARE = 1e-6
# A fold is weighed in the plane only (`localization.Body`).
_OF_THE_PLANE = ("critical_curvature", "critical_curvature_error", "base_fold_error")


@dataclass(frozen=True, slots=True)
class Feeling:
    """What touches the body now.

    Attributes:
        t_s: host time at the middle of the reading.
        length_cm: everted length.
        sensors: the n sensors that count, base first.
        curvature: (n,) their readings since the zeros, 1/cm.
        free_curvature: (n,) what they would read without a contact, 1/cm.
        result: where the body is touched.
        lines: lines of strains that were averaged; 0 without a fibre.
        zero_age_s: time since a fibre's zeros; 0 without a fibre.
    """

    t_s: float
    length_cm: float
    sensors: list[Sensor]
    curvature: Floats
    free_curvature: Floats
    result: LocalizeResult
    lines: int = 0
    zero_age_s: float = 0.0


def feel(robot: Robot, muscle: Muscle | None = None) -> Feeling:
    """Read an armed and zeroed robot for half a second, and localize what touches it.

    Args:
        muscle: the one that is held under pressure meanwhile.

    Raises:
        DataError: no sensor counts.
    """
    config = robot.config
    return _by_fibre(robot) if config.gratings else _by_board(robot, muscle)


def prepare(robot: Robot) -> None:
    """Arm a robot with the body pressure of its length, and zero it as it lies at rest.

    It must touch nothing.

    Raises:
        CommandRefusedError: its readings still drift.
    """
    robot.pressurize(robot.config.body.pressure_number(robot.known_length_cm()))
    if robot.status().state == "safe":
        robot.arm()
    robot.vent()
    robot.wait_settled()
    zero_when_steady(robot, pause_s=STEADY_S)


def grow_until_touched(robot: Robot, length_cm: float, say: Callable[[str], None]) -> bool:
    """Grow an armed robot to a length, and feel at each stop; end where something bends it.

    It stops at each stage and each boundary of body pressures. A sensor is zeroed at the first stop
    after it has everted, as long as nothing is felt: a zero that is taken later would call the
    touched shape straight.

    Returns:
        Whether something bends it.

    Raises:
        CommandRefusedError: the board refuses to grow or to zero.
    """
    config = robot.config
    body_pressure: int | None = None
    _zero_everted(robot)
    while (grown_cm := robot.known_length_cm()) < length_cm - SAME_LENGTH_CM:
        stop_cm = growth_target(config, grown_cm, length_cm)
        if (next_pressure := growth_body_pressure(config, grown_cm, stop_cm)) != body_pressure:
            body_pressure = next_pressure
            robot.pressurize(body_pressure)
        say(f"growing to {stop_cm:.1f} cm")
        robot.grow_to(stop_cm)
        robot.wait(STEADY_S)
        if robot.status().zeroed and feel(robot).result.contacts:
            return True
        _zero_everted(robot)
    return False


def _zero_everted(robot: Robot) -> None:
    """Zero the everted sensors that have no zero yet."""
    status = robot.status()
    if new := status.everted & ~status.zeroed:
        robot.wait_settled(sensors=new)
        zero_when_steady(robot, new, pause_s=STEADY_S)


def _by_fibre(robot: Robot) -> Feeling:
    config, reading = robot.config, robot.read_fibre()
    known = np.flatnonzero(np.isfinite(reading.curvature))
    if not known.size:
        raise DataError("no healthy grating of the fibre has everted", "grow the robot first")
    known = known[np.argsort([config.gratings[n].center_cm for n in known], kind="stable")]
    sensors: list[Sensor] = []
    for number in known:
        grating = config.gratings[number]
        # What temperature adds grows with the zero's age.
        warmer = max(1.0, reading.zero_age_s / grating.warm_s)
        sensors.append(
            grating.model_copy(update={"temperature_se": warmer * grating.temperature_se})
        )
    body_pressure = config.body.pressure_number(reading.length_cm)
    curvature = reading.curvature[known]
    free = np.full(len(sensors), reading.free_curvature)
    result = localize(
        curvature,
        [sensor.center_cm for sensor in sensors],
        length=reading.length_cm,
        span=[sensor.span_cm for sensor in sensors],
        free_curvature=reading.free_curvature,
        body_curvature=_shape(config, sensors, free),
        **errors_of(config, reading.side, body_pressure, sensors).arguments(),
    )
    return Feeling(
        reading.t_s, reading.length_cm, sensors, curvature, free, result,
        reading.lines, reading.zero_age_s,
    )  # fmt: skip


def _by_board(robot: Robot, muscle: Muscle | None) -> Feeling:
    config, reading = robot.config, robot.read(READ_S)
    psi = 0.0 if muscle is None else reading.pressure_psi[config.muscles.index(muscle)]
    body_pressure = config.body.pressure_number(reading.length_cm)
    free_bend = 0.0 if muscle is None else muscle.maps[body_pressure].inflate.curvature(psi)
    sensors: list[Sensor] = []
    curvatures, shares = [], []
    for sensor, curvature in zip(robot.wiring.sensors, reading.curvature.tolist(), strict=True):
        if sensor is None or not sensor.usable or not np.isfinite(curvature):
            continue
        share = 0.0 if muscle is None else _share(sensor, muscle)
        if muscle is not None and sensor.wrinkles and _under(sensor, muscle):
            continue
        sensor, curvature = sensor.straightened(curvature, _at_rest(config, sensor))
        sensors.append(sensor)
        curvatures.append(curvature)
        shares.append(share)
    if not sensors:
        raise DataError(
            "no healthy sensor has everted and is zeroed", "grow the robot, and zero it there"
        )
    order = np.argsort([sensor.center_cm for sensor in sensors], kind="stable")
    sensors = [sensors[n] for n in order]
    bend, free = np.array(curvatures)[order], free_bend * np.array(shares)[order]
    return Feeling(
        reading.t_s, reading.length_cm, sensors, bend, free,
        _localized(config, muscle, body_pressure, reading.length_cm, sensors, bend, free),
    )  # fmt: skip


def _localized(
    config: RobotConfig, muscle: Muscle | None, body_pressure: int, length_cm: float,
    sensors: Sequence[Sensor], curvature: Floats, free: Floats,
) -> LocalizeResult:  # fmt: skip
    side = None if muscle is None else muscle.side
    errors: dict[str, Any] = errors_of(config, side, body_pressure, sensors).arguments()
    if muscle is not None:
        errors |= {
            "offset_error": muscle.offset_se,
            "map_error": muscle.maps[body_pressure].scale_se,
        }
    shape = _shape(config, sensors, free)
    whole = np.arange(len(sensors))
    if all(sensor.side for sensor in sensors):
        return _answer(length_cm, sensors, curvature, free, shape, errors, whole)
    least_fold = errors["critical_curvature"] * (1 - 2 * errors["critical_curvature_error"])
    errors = {name: value for name, value in errors.items() if name not in _OF_THE_PLANE}
    errors["angle"] = np.array([_positive_towards(sensor) for sensor in sensors])
    result = _answer(length_cm, sensors, curvature, free, shape, errors, whole)
    if sum(abs(contact.force) * contact.arc for contact in result.contacts) < least_fold:
        return result
    # The base may have folded, which only the sensors beyond the fold do not read.
    starts_cm = np.array([sensor.center_cm - sensor.span_cm / 2 for sensor in sensors])
    beyond = np.flatnonzero(starts_cm >= config.body.diameter_cm)
    if beyond.size:
        again = _answer(length_cm, sensors, curvature, free, shape, errors, beyond)
        if again.contacts:
            return again
    return _somewhere(result, length_cm)


def _somewhere(result: LocalizeResult, length_cm: float) -> LocalizeResult:
    """The same contacts with intervals of the whole body: their places are unknown."""
    whole = (0.0, length_cm)
    contacts = tuple(
        replace(contact, status="ambiguous", interval=whole, intervals=(whole,))
        for contact in result.contacts
    )
    message = (
        "The base may have folded, and no sensor beyond its fold reads the contact, which is near "
        "the base: push less."
    )
    return replace(result, status="ambiguous", contacts=contacts, message=message)


def _answer(
    length_cm: float, sensors: Sequence[Sensor], curvature: Floats, free: Floats,
    shape: Floats | None, errors: dict[str, Any], used: Ints,
) -> LocalizeResult:  # fmt: skip
    """Localize by some of the sensors, with the errors of all of them."""
    count = len(sensors)
    of_used = {
        name: value[used] if isinstance(value, np.ndarray) and len(value) == count else value
        for name, value in errors.items()
    }
    return localize(
        curvature[used],
        [sensors[n].center_cm for n in used],
        length=length_cm,
        span=[sensors[n].span_cm for n in used],
        free_curvature=free[used],
        body_curvature=None if shape is None else shape[used],
        **of_used,
    )


def _positive_towards(sensor: Sensor) -> float:
    """Angle (rad) about the body towards which a bend reads positive: below 180 degrees."""
    return radians(sensor.angle_deg % 180.0)


def _share(sensor: Sensor, muscle: Muscle) -> float:
    """Share of a muscle's bend that a sensor reads, with its sign."""
    return cos(_positive_towards(sensor) - radians(muscle.angle_deg))


def _under(sensor: Sensor, muscle: Muscle) -> bool:
    """Whether a muscle wrinkles what lies at a sensor's angle."""
    return cos(radians(sensor.angle_deg - muscle.angle_deg)) > _SAME_SHARE


def _at_rest(config: RobotConfig, sensor: Sensor) -> float:
    """Mean curvature (1/cm) that a preformed bend has at a sensor, towards its angle."""
    bend = rest_mean(config.body.rest_pieces, [sensor.center_cm], [sensor.span_cm])
    return float(bend[0]) * cos(_positive_towards(sensor) - radians(DEGREES["left"]))


def _shape(config: RobotConfig, sensors: Sequence[Sensor], free: Floats) -> Floats | None:
    """Curvature (n,) of the free body at the sensors, if it differs from what they then read.

    They are zeroed at rest, and so do not read a preformed bend.
    """
    if not config.body.rest_curvature:
        return None
    return np.asarray(free + [_at_rest(config, sensor) for sensor in sensors])
