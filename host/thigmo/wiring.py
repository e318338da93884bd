"""The board that a robot needs, and on which of its inputs and outputs the robot hangs.

A board's first half of inputs is for one column, the second for the other; the contact trigger can
work on the first input of each. A column takes its own half first, base first, and then what the
other column leaves free: the first input of that last. `Wiring.laid_out` computes this once from a
robot.toml where a robot is connected, emulated, judged or read from a record; all other functions
are given it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import cos, radians
from typing import NamedTuple

from thigmo.config import (
    SIDES,
    BoardSensor,
    Muscle,
    RobotConfig,
    Sensor,
    Side,
)
from thigmo.errors import ConfigError

_LEAST_SHARE = 0.5 - 1e-6  # of a bend, that a sensor must read to measure it: at 60 degrees too
_SAME_SHARE = 1e-6


class BoardSize(NamedTuple):
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
        imus = sum(sensor.imu_inputs for sensor in wired)
        needed = len(config.muscles), len(wired), len(config.body.pressures), imus
        return all(n <= most for n, most in zip(needed, self.capacity.values(), strict=True))


BOARD_SIZES = (
    BoardSize("mega", 2, 10, 3, 0),
    BoardSize("large, the virtual board with an external converter", 4, 16, 8, 16),
)  # the smallest first


class Limitation(NamedTuple):
    """What is not possible with a robot, and what to do about it."""

    problem: str
    cure: str


def board_size(config: RobotConfig) -> BoardSize:
    """The smallest board that holds the robot; the largest if none does."""
    return next((size for size in BOARD_SIZES if size.holds(config)), BOARD_SIZES[-1])


def beyond_board(config: RobotConfig) -> list[Limitation]:
    """What of the robot no board can hold; empty if its board holds all of it."""
    size, limitations = board_size(config), []
    for part, count, most in (
        ("muscles", len(config.muscles), size.muscles),
        ("sensors", len(config.board_sensors), size.sensors),
        ("body pressures", len(config.body.pressures), size.body_pressures),
    ):
        if count > most:
            problem = f"{count} {part}, and the largest board holds {most}"
            limitations.append(Limitation(problem, f"keep at most {most} in robot.toml"))
    # The board would take the column's last sensor, on its other trigger input, for a base sensor.
    if any(
        len(column) == size.sensors and not column[0].healthy
        for column in map(config.column, SIDES)
    ):
        limitations.append(
            Limitation(
                f"a column of {size.sensors} sensors without a healthy one at its base",
                "correct that sensor: the contact trigger works on it",
            )
        )
    return limitations


class WiredSensor(NamedTuple):
    """A sensor on one of the board's inputs, as it reads the bend of one muscle."""

    number: int  # of its input
    sensor: BoardSensor
    share: float  # cosine between the muscle's angle and that towards which it reads positive

    @property
    def sound(self) -> bool:
        """Whether it is healthy, and answers to bends that way."""
        answers = self.sensor.bend_sign in (0, 1 if self.share > 0 else -1)
        return self.sensor.healthy and answers


class Column(NamedTuple):
    """The sensors at one angle, base first."""

    name: str  # of the muscle there, or the angle
    side: Side | None  # of the plane
    inputs: list[int]
    centers_cm: list[float]


@dataclass(frozen=True, eq=False)
class Wiring:
    """Where a robot's sensors and muscles hang. It does not follow later changes of the config."""

    config: RobotConfig
    size: BoardSize  # of the board that the robot needs
    sensors: tuple[BoardSensor | None, ...]  # on each input; None where there is none
    inputs: Mapping[tuple[Side, int], int]  # in the plane, by side and place from the base

    @classmethod
    def laid_out(cls, config: RobotConfig) -> Wiring:
        """Lay out a robot's sensors; ConfigError for one that no board can hold.

        Those that lie out of the plane take what the two columns leave, a base sensor first where
        the trigger can work.
        """
        for problem, cure in beyond_board(config):
            raise ConfigError(problem, cure)
        size = board_size(config)
        sensors: list[BoardSensor | None] = [None] * size.sensors
        inputs = _column_inputs(config, size.sensors // 2)
        for (side, place), number in inputs.items():
            sensors[number] = config.column(side)[place]
        half = size.sensors // 2
        free = [number for number, sensor in enumerate(sensors) if sensor is None]
        free.sort(key=lambda number: number % half > 0)
        off_plane = [sensor for sensor in config.board_sensors if sensor.side is None]
        off_plane.sort(key=lambda sensor: not _is_base(config, sensor))
        for number, sensor in zip(free, off_plane, strict=False):
            sensors[number] = sensor
        return cls(config, size, tuple(sensors), inputs)

    @property
    def read_sensors(self) -> tuple[Sensor | None, ...]:
        """The sensor behind each reading of a sweep: on each input, then the fibre's gratings."""
        return (*self.sensors, *self.config.gratings)

    @cached_property
    def base_inputs(self) -> tuple[int, ...]:
        """The inputs of the columns' base sensors, on which the contact trigger works."""
        return tuple(
            number
            for number in (0, len(self.sensors) // 2)
            if (sensor := self.sensors[number]) is not None and _is_base(self.config, sensor)
        )

    def sensors_reading(self, muscle: Muscle) -> list[WiredSensor]:
        """The sensors that read at least half of a muscle's bend and do not wrinkle, base first.

        A sensor and the one opposite read positive towards the same angle, that below 180
        degrees: in the plane towards 90.
        """
        reading = []
        for number, sensor in enumerate(self.sensors):
            if sensor is None:
                continue
            lies, bends = radians(sensor.angle_deg), radians(muscle.angle_deg)
            share = cos(lies - bends) * (1 if sensor.angle_deg < 180.0 else -1)
            wrinkles = sensor.wrinkles and cos(lies - bends) > _SAME_SHARE
            if abs(share) >= _LEAST_SHARE and not wrinkles:
                reading.append(WiredSensor(number, sensor, share))
        return sorted(reading, key=lambda wired: wired.sensor.center_cm)

    def trigger_sensors(self, muscle: Muscle) -> list[WiredSensor]:
        """The base sensors with which the board's contact trigger guards a muscle's bend.

        They are healthy and answer to the bend; empty if none can. The board compares their mean
        with one map, so all of them read the same share of the bend: the largest that a base sensor
        reads.
        """
        bases = [
            wired
            for wired in self.sensors_reading(muscle)
            if wired.sound and wired.number in self.base_inputs
        ]
        best = max(bases, key=lambda wired: abs(wired.share), default=None)
        return [wired for wired in bases if best and abs(wired.share - best.share) < _SAME_SHARE]

    @cached_property
    def unguarded_muscles(self) -> tuple[Muscle, ...]:
        """Muscles that bend the body without any sensor for the contact trigger."""
        return tuple(m for m in self.config.muscles if not self.trigger_sensors(m))

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """The robot's columns, and the inputs that they hang on."""
        inputs = {id(sensor): number for number, sensor in enumerate(self.sensors) if sensor}
        columns: dict[float, Column] = {}
        for sensor in sorted(self.config.board_sensors, key=lambda sensor: sensor.angle_deg):
            lies = sensor.angle_deg
            name = self.config.column_name(lies)
            column = columns.setdefault(lies, Column(name, sensor.side, [], []))
            column.inputs.append(inputs[id(sensor)])
            column.centers_cm.append(sensor.center_cm)
        return tuple(columns.values())

    def sensor_name(self, number: int) -> str:
        """The sensor on an input, by its column and its place from the base."""
        for column in self.columns:
            if number in column.inputs:
                return f"{column.name} {column.inputs.index(number)}"
        return f"on input {number}, which robot.toml leaves free"

    def muscle_name(self, output: int) -> str:
        """The muscle on an output: outputs are in the file's order."""
        muscles = self.config.muscles
        return muscles[output].name if output < len(muscles) else str(output)

    @property
    def unexplorable(self) -> Limitation | None:
        """What of the robot `explore` cannot do: bends out of the plane, or that nothing guards."""
        config = self.config
        if config.gratings and config.interrogator is None:
            return Limitation(
                f"{len(config.gratings)} readings of a fibre that no interrogator sends",
                'give `interrogator = "host:port"` in robot.toml, or leave the gratings out of it',
            )
        names = [
            f"muscle {muscle.name} ({muscle.angle_deg:g} degrees)"
            for muscle in config.muscles
            if muscle.side is None
        ]
        if count := sum(sensor.side is None for sensor in config.board_sensors):
            names.append(f"{count} sensor{'s'[: count > 1]}")
        if names:
            return Limitation(
                f"{' and '.join(names)} out of the plane, which is 90 and 270 degrees",
                "press its muscles by name and feel in space (`thigmo feel`), or localize its "
                "readings with a column `angle_deg` (`thigmo localize`)",
            )
        if config.body.rest_curvature:
            return Limitation(
                "the body is curved at rest, and explorations map with a body that is straight",
                "feel what touches it: `thigmo feel`",
            )
        if not config.muscles:
            return Limitation(
                "the robot has no muscles, so it cannot sweep",
                "feel what bends it while it grows or rests: `thigmo feel`",
            )
        if len(self.unguarded_muscles) == len(config.muscles):
            return Limitation(
                "no healthy sensor at the base answers to the muscles, so no sweep feels a contact",
                "repair a base sensor, or correct its `healthy` and `bend_sign` in robot.toml"
                + (
                    ", or wire one to the board: its trigger sees no fibre"
                    if config.gratings
                    else ""
                ),
            )
        return None


def _column_inputs(config: RobotConfig, half: int) -> dict[tuple[Side, int], int]:
    """The inputs of the two columns in the plane, by side and place from the base."""
    firsts = dict(zip(SIDES, (0, half), strict=True))
    inputs: dict[tuple[Side, int], int] = {}
    for side, opposite in (SIDES, SIDES[::-1]):
        first, free = firsts[side], firsts[opposite]
        taken = len(config.column(opposite))
        numbers = [*range(first, first + half), *range(free + max(taken, 1), free + half), free]
        inputs |= {
            (side, place): number
            for place, number in zip(range(len(config.column(side))), numbers, strict=False)
        }
    return inputs


def _is_base(config: RobotConfig, sensor: BoardSensor) -> bool:
    """Whether a sensor is the base one at its angle."""
    lies = sensor.angle_deg
    return sensor is next(base for base in config.board_sensors if base.angle_deg == lies)


def table_key(name: str) -> str:
    """A sensor's name as headers of tables have it: `left_0`, `270deg_7`."""
    column, _, place = name.rpartition(" ")
    return f"{column.replace(' ', '')}_{place}"
