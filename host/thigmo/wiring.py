"""The board that a robot needs, and on which of its inputs the sensors hang.

A board's first half of inputs is for one column, the second for the other; the contact trigger can
work on the first input of each. A column takes its own half first, base first, and then what the
other column leaves free: the first input of that last.
"""

from __future__ import annotations

from math import cos, radians
from typing import NamedTuple

from thigmo.config import (
    SAME_IMU_CM,
    SIDES,
    SIGN,
    BoardSensor,
    HeadingSensor,
    Muscle,
    RobotConfig,
    Sensor,
    Side,
)
from thigmo.errors import ConfigError

_LEAST_SHARE = 0.5 - 1e-6  # of a bend, that a sensor must read to measure it: at 60 degrees too


class Board(NamedTuple):
    """What a board holds, as its `capacity` tells."""

    name: str
    muscles: int
    sensors: int
    body_pressures: int
    imus: int  # inputs that may be the turn from one IMU to the next

    @property
    def capacity(self) -> dict[str, int]:
        """How many of each, as `protocol.parameters` takes them."""
        return {key: n for key, n in self._asdict().items() if isinstance(n, int)}

    def holds(self, config: RobotConfig) -> bool:
        """Whether its inputs, outputs and maps are enough."""
        wired = config.board_sensors
        turns = sum(isinstance(sensor, HeadingSensor) for sensor in wired)
        needed = len(config.muscles), len(wired), len(config.body.zones), turns
        most = self.capacity.values()
        return all(n <= each for n, each in zip(needed, most, strict=True))


BOARDS = (
    Board("mega", 2, 10, 3, 0),
    Board("large, the virtual board with an external converter", 4, 16, 8, 16),
)  # the smallest first


class Beyond(NamedTuple):
    """What is not possible with a robot, and what to do about it."""

    what: str
    cure: str


def board_of(config: RobotConfig) -> Board:
    """The smallest board that holds the robot; the largest if none does."""
    return next((board for board in BOARDS if board.holds(config)), BOARDS[-1])


def beyond_board(config: RobotConfig) -> list[Beyond]:
    """What of the robot no board can hold; empty if its board holds all of it."""
    board, found = board_of(config), []
    for what, count, most in (
        ("muscles", len(config.muscles), board.muscles),
        ("sensors", len(config.board_sensors), board.sensors),
        ("body pressures", len(config.body.zones), board.body_pressures),
    ):
        if count > most:
            cure = f"keep at most {most} in robot.toml"
            found.append(Beyond(f"{count} {what}, and the largest board holds {most}", cure))
    # The board would take the column's last sensor, on its other trigger input, for a base sensor.
    if any(
        len(column) == board.sensors and not column[0].healthy
        for column in map(config.column, SIDES)
    ):
        found.append(
            Beyond(
                f"a column of {board.sensors} sensors without a healthy one at its base",
                "correct that sensor: the contact trigger works on it",
            )
        )
    return found


def unexplored(config: RobotConfig) -> Beyond | None:
    """What of the robot `explore` cannot do: bends out of the plane, or that no trigger guards."""
    if config.gratings and config.interrogator is None:
        return Beyond(
            f"{len(config.gratings)} readings of a fibre that no interrogator sends",
            'give `interrogator = "host:port"` in robot.toml, or leave the gratings out of it',
        )
    names = [
        f"muscle {muscle.name} ({muscle.direction_deg:g} degrees)"
        for muscle in config.muscles
        if muscle.side is None
    ]
    if count := sum(sensor.side is None for sensor in config.board_sensors):
        names.append(f"{count} sensor{'s'[: count > 1]}")
    if names:
        return Beyond(
            f"{' and '.join(names)} out of the plane, which is 90 and 270 degrees",
            "press its muscles by name (`Robot.press`), and localize its readings with a column "
            "`direction` (`thigmo localize`)",
        )
    if len(blind(config)) == len(config.muscles):
        return Beyond(
            "no healthy sensor at the base answers to the muscles, so no sweep feels a contact",
            "repair a base sensor, or correct its `healthy` and `valid_direction` in robot.toml"
            + (", or wire one to the board: its trigger sees no fibre" if config.gratings else ""),
        )
    return None


def blind(config: RobotConfig) -> list[Muscle]:
    """Muscles that bend the body without any sensor for the contact trigger.

    Raises as `places` for a robot with muscles out of the plane.
    """
    return [
        muscle
        for muscle in config.muscles
        if not (trigger_sensors(config, muscle.side) if muscle.side else guards(config, muscle))
    ]


def trigger_sensors(config: RobotConfig, side: Side) -> list[BoardSensor]:
    """The healthy base sensors that answer while the muscle of a side bends the body."""
    return [
        sensor
        for sensor in config.sensors_for(side)
        if isinstance(sensor, BoardSensor)
        and sensor.healthy
        and sensor.valid_direction in (0, SIGN[side])
        and _first(config, sensor)
    ]


def places(config: RobotConfig) -> list[tuple[Side, int] | None]:
    """Side and index from the base of the sensor on each input; None where there is none.

    Raises ConfigError for a robot that the board cannot hold.
    """
    for what, cure in beyond_board(config):
        raise ConfigError(what, cure)
    board = board_of(config)
    found: list[tuple[Side, int] | None] = [None] * board.sensors
    half = board.sensors // 2
    firsts = dict(zip(SIDES, (0, half), strict=True))
    for side, other in (SIDES, SIDES[::-1]):
        own, free = firsts[side], firsts[other]
        taken = len(config.column(other))
        inputs = [*range(own, own + half), *range(free + max(taken, 1), free + half), free]
        for index, number in zip(range(len(config.column(side))), inputs, strict=False):
            found[number] = side, index
    return found


def base_inputs(config: RobotConfig) -> list[int]:
    """The inputs of the columns' base sensors, on which the contact trigger works."""
    wired = sensors(config)
    return [
        number
        for number in (0, len(wired) // 2)
        if (sensor := wired[number]) is not None and _first(config, sensor)
    ]


def sensors(config: RobotConfig) -> list[BoardSensor | None]:
    """The sensor on each input; None where there is none. Raises as `places`.

    Those that lie out of the plane take what the two columns leave, a base sensor first where the
    trigger can work.
    """
    found = [place and config.column(place[0])[place[1]] for place in places(config)]
    half = len(found) // 2
    free = sorted(
        (n for n, sensor in enumerate(found) if sensor is None), key=lambda n: n % half > 0
    )
    others = [sensor for sensor in config.board_sensors if sensor.side is None]
    others.sort(key=lambda sensor: not _first(config, sensor))
    for number, sensor in zip(free, others, strict=False):
        found[number] = sensor
    return found


def rows(config: RobotConfig) -> list[Sensor | None]:
    """The sensor behind each reading of a sweep: on each input, and then the fibre's gratings."""
    return [*sensors(config), *config.gratings]


class Witness(NamedTuple):
    """A sensor that reads part of a muscle's bend."""

    number: int  # of its input
    sensor: BoardSensor
    share: float  # cosine between the muscle's direction and that in which it reads positive

    @property
    def sound(self) -> bool:
        """Whether it is healthy, and answers to bends that way."""
        answers = self.sensor.valid_direction in (0, 1 if self.share > 0 else -1)
        return self.sensor.healthy and answers


def witnesses(config: RobotConfig, muscle: Muscle) -> list[Witness]:
    """The sensors that read at least half of a muscle's bend and do not wrinkle, base first.

    A sensor and the one opposite read positive towards the same direction, that below 180 degrees:
    in the plane towards 90. Raises as `places`.
    """
    found = []
    for number, sensor in enumerate(sensors(config)):
        if sensor is None:
            continue
        lies, bends = radians(sensor.direction_deg), radians(muscle.direction_deg)
        share = cos(lies - bends) * (1 if sensor.direction_deg < 180.0 else -1)
        wrinkles = sensor.wrinkles and cos(lies - bends) > 1e-6
        if abs(share) >= _LEAST_SHARE and not wrinkles:
            found.append(Witness(number, sensor, share))
    return sorted(found, key=lambda one: one.sensor.center_cm)


def guards(config: RobotConfig, muscle: Muscle) -> list[Witness]:
    """The base sensors with which the board's trigger guards a muscle's bend; empty if none can.

    They are healthy and answer to the bend. The board compares their mean with one map, so all of
    them read the same share of the bend: the largest that one of them reads. Raises as `places`.
    """
    bases = base_inputs(config)
    found = [one for one in witnesses(config, muscle) if one.sound and one.number in bases]
    best = max(found, key=lambda one: abs(one.share), default=None)
    return [one for one in found if best and abs(one.share - best.share) < 1e-6]


def _first(config: RobotConfig, sensor: BoardSensor) -> bool:
    """Whether a sensor is the base one at its direction."""
    return sensor is next(
        s for s in config.board_sensors if s.direction_deg == sensor.direction_deg
    )


def input_of(config: RobotConfig) -> dict[tuple[Side, int], int]:
    """The input of each sensor, by side and index from the base. Raises as `places`."""
    return {place: number for number, place in enumerate(places(config)) if place}


class Column(NamedTuple):
    """The sensors at one direction, base first."""

    name: str  # of the muscle there, or the direction
    side: Side | None  # of the plane
    inputs: list[int]
    centers_cm: list[float]


def column_name(config: RobotConfig, direction_deg: float) -> str:
    """What the sensors at a direction are called: as the muscle there, or by the direction."""
    names = (m.name for m in config.muscles if m.direction_deg == direction_deg)
    return next(names, f"{direction_deg:g} deg")


def key_of(name: str) -> str:
    """A sensor's name as headers of tables have it: `left_0`, `270deg_7`."""
    column, _, place = name.rpartition(" ")
    return f"{column.replace(' ', '')}_{place}"


def columns(config: RobotConfig) -> list[Column]:
    """The robot's columns, and the inputs that they hang on; none if the board cannot hold them."""
    if beyond_board(config):
        return []
    inputs = {id(sensor): number for number, sensor in enumerate(sensors(config)) if sensor}
    found: dict[float, Column] = {}
    for sensor in sorted(config.board_sensors, key=lambda sensor: sensor.direction_deg):
        lies = sensor.direction_deg
        column = found.setdefault(lies, Column(column_name(config, lies), sensor.side, [], []))
        column.inputs.append(inputs[id(sensor)])
        column.centers_cm.append(sensor.center_cm)
    return list(found.values())


def muscle_outputs(config: RobotConfig) -> dict[int, str]:
    """The names of the muscles by the board's outputs that they hang on: in the file's order."""
    return {number: muscle.name for number, muscle in enumerate(config.muscles)}


def sensor_name(config: RobotConfig, number: int) -> str:
    """The sensor on an input, by its column and its place from the base."""
    for column in columns(config):
        if number in column.inputs:
            return f"{column.name} {column.inputs.index(number)}"
    return f"on input {number}, which robot.toml leaves free"


def imu_ends(config: RobotConfig) -> tuple[list[int], list[int]]:
    """The IMUs where the span on each input begins and ends, as `imu_from` and `imu_to` have them.

    0 is the base, and no IMU. An IMU has the address of the sensor that ends with it: a span that
    begins where none ends has no address there, and does not count as read over the bus.
    """
    wired = sensors(config)
    places = [
        (sensor.ends_cm[1], sensor.mux_channel << 7 | sensor.i2c_address)
        for sensor in wired
        if isinstance(sensor, HeadingSensor) and sensor.i2c_address
    ]
    begins, ends = [0] * len(wired), [0] * len(wired)
    for number, sensor in enumerate(wired):
        if not isinstance(sensor, HeadingSensor):
            continue
        start = sensor.ends_cm[0]
        nearest = min(places, key=lambda place: abs(place[0] - start), default=(0.0, 0))
        based = start < SAME_IMU_CM
        if sensor.i2c_address and (based or abs(nearest[0] - start) < SAME_IMU_CM):
            begins[number] = 0 if based else nearest[1]
            ends[number] = sensor.mux_channel << 7 | sensor.i2c_address
    return begins, ends
