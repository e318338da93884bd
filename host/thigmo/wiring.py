"""On which of the board's inputs a robot's sensors hang, and what of a robot the board cannot hold.

The firmware has ten inputs for flex sensors. The contact trigger works on inputs 0 and 5, the
bases of the two columns; the other eight read any sensor. A column takes
its own five inputs first, and then those that the other column leaves free.
"""

from __future__ import annotations

from typing import NamedTuple

from thigmo.config import SIDES, FlexSensor, RobotConfig, Side
from thigmo.errors import ConfigError

INPUTS = 10  # for flex sensors
BASES: dict[Side, int] = dict(zip(SIDES, (0, 5), strict=True))  # inputs of the trigger's sensors
_OTHERS: dict[Side, tuple[int, ...]] = dict(zip(SIDES, ((1, 2, 3, 4), (6, 7, 8, 9)), strict=True))
PRESSURES = 3  # body pressures that the board holds maps for


class Beyond(NamedTuple):
    """What the board cannot hold, and what to do about it."""

    what: str
    cure: str


def beyond_board(config: RobotConfig) -> list[Beyond]:
    """What of the robot the board cannot hold; empty if it holds all of it."""
    found = [
        Beyond(
            f"{what} lies at {each.direction_deg:g} degrees, out of the plane",
            "the firmware bends towards 90 and 270 degrees: use these",
        )
        for what, each in (
            *((f"muscle {muscle.name}", muscle) for muscle in config.muscles),
            *((f"sensor {number}", sensor) for number, sensor in enumerate(config.sensors)),
        )
        if each.side is None
    ]
    most = INPUTS - sum(not config.column(side) for side in SIDES)
    if len(config.sensors) > most:
        found.append(
            Beyond(
                f"{len(config.sensors)} sensors, and the board reads {most} in these columns",
                f"keep at most {most} in robot.toml: nine in one column, ten in two",
            )
        )
    if len(config.body.zones) > PRESSURES:
        found.append(
            Beyond(
                f"{len(config.body.zones)} body pressures, and the board holds {PRESSURES}",
                f"keep at most {PRESSURES} of [[body.pressure]] in robot.toml",
            )
        )
    return found


def places(config: RobotConfig) -> list[tuple[Side, int] | None]:
    """Side and index from the base of the sensor on each input; None where there is none.

    Raises ConfigError for a robot that the board cannot hold.
    """
    for what, cure in beyond_board(config):
        raise ConfigError(what, cure)
    found: list[tuple[Side, int] | None] = [None] * INPUTS
    free: dict[Side, list[int]] = {}
    for side in SIDES:
        count = len(config.column(side))
        inputs = [BASES[side], *_OTHERS[side]]
        for index, number in enumerate(inputs[:count]):
            found[number] = side, index
        free[side] = list(_OTHERS[side][max(count - 1, 0) :])
    for side, other in (SIDES, SIDES[::-1]):
        rest = range(1 + len(_OTHERS[side]), len(config.column(side)))
        for index, number in zip(rest, free[other], strict=False):
            found[number] = side, index
    return found


def sensors(config: RobotConfig) -> list[FlexSensor | None]:
    """The sensor on each input; None where there is none. Raises as `places`."""
    return [place and config.column(place[0])[place[1]] for place in places(config)]


def input_of(config: RobotConfig) -> dict[tuple[Side, int], int]:
    """The input of each sensor, by side and index from the base. Raises as `places`."""
    return {place: number for number, place in enumerate(places(config)) if place}


class Column(NamedTuple):
    """The sensors at one direction, base first."""

    name: str  # of the muscle there, or the direction
    side: Side
    inputs: list[int]
    centers_cm: list[float]


def columns(config: RobotConfig) -> list[Column]:
    """The robot's columns, and the inputs that they hang on; none if the board cannot hold them."""
    wired = {} if beyond_board(config) else input_of(config)
    found = []
    for side in SIDES:
        own = sorted((index, number) for (of, index), number in wired.items() if of == side)
        if own:
            name = next((m.name for m in config.muscles if m.side == side), "")
            centers = [sensor.center_cm for sensor in config.column(side)]
            lies = f"{config.column(side)[0].direction_deg:g} deg"
            found.append(Column(name or lies, side, [number for _, number in own], centers))
    return found


def muscle_outputs(config: RobotConfig) -> dict[int, str]:
    """The names of the muscles by the board's outputs that they hang on: in the file's order."""
    return {number: muscle.name for number, muscle in enumerate(config.muscles)}


def sensor_name(config: RobotConfig, number: int) -> str:
    """The sensor on an input, by its column and its place from the base."""
    for column in columns(config):
        if number in column.inputs:
            return f"{column.name} {column.inputs.index(number)}"
    return f"on input {number}, which robot.toml leaves free"
