"""What a lab knows of its robot: `robot.toml`, validated.

Written by calibration, read by the robot object (which sends it to the board), by the localizer's
callers and by the emulator (whose scene describes the *true* robot with the same model, so that a
calibration can be compared with the truth). Lengths in cm, pressures in psi gauge, curvature in
1/cm, time in s, resistance in ohm.

A robot is lists: muscles, sensors and body pressures, each with what is known of it.

Sign convention, everywhere in this project: x runs along the straight robot from its base, y to
its left; curvature is positive when the body bends to the left (towards +y). Angles
around the body are in degrees: 90 is +y (left), 270 is -y (right), 0 and 180 leave the plane. A
muscle bends the body towards its angle; a sensor lies at its own.

Each `_se` is one sigma of what the entry may be off by. Calibration writes what it found; the
defaults are those of a robot that nobody has calibrated: wide, so that the localizer says
"ambiguous" rather than something wrong. `thigmo.reading_errors` gathers them for one stage.
"""

from __future__ import annotations

import os
import shutil
from math import inf, pi, tanh
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from thigmo.errors import ConfigError
from thigmo.sensors import (
    IMU_CM,
    KINDS,
    RAD_PER_OHM,
    SAME_IMU_CM,
    BoardSensor,
    FibreSensor,
    FlexSensor,
    HeadingSensor,
    Sensor,
)
from thigmo.sides import DEGREES, SIDES, SIGN, Placed, Side, opposite, side_at
from thigmo.toml_model import Finite, Model, NonNegative, Positive, load_toml, read_toml

# Sides and kinds of sensors are words of robot.toml.
__all__ = [
    "DEGREES",
    "IMU_CM",
    "RAD_PER_OHM",
    "SAME_IMU_CM",
    "SAME_LENGTH_CM",
    "SAME_PRESSURE",
    "SIDES",
    "SIGN",
    "BoardSensor",
    "BoardSettings",
    "Body",
    "BodyPressure",
    "FibreSensor",
    "FlexSensor",
    "HeadingSensor",
    "Muscle",
    "MuscleMap",
    "RestCurvature",
    "RobotConfig",
    "Sensor",
    "Side",
    "Spool",
    "TanhMap",
    "opposite",
    "side_at",
]

_PASCAL = 6894.757  # of one psi
SAME_LENGTH_CM = 0.1  # everted lengths that are nearer are one: the spool stops within 0.05 cm
SAME_PRESSURE = 0.1  # body pressures that differ by less, relative, have one map


def _host_and_port(address: str) -> str:
    host, _, port = address.rpartition(":")
    if not host or any(c.isspace() or c == ":" for c in host):
        raise ValueError(f'{address!r} is no address: give "host:port"')
    if not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise ValueError(f"the port {port!r} does not exist: give 1 to 65535")
    return address


class BodyPressure(Model):
    """Body pressure set by hand for a range of everted length (thesis, section 3.5)."""

    until_cm: Positive  # everted length up to which it holds
    pressure_psi: NonNegative  # of the regulator; 0: a body of fixed length without air
    pull_duty: Finite = 0.0  # of 800, that the motor needs less in growth than its data say


class RestCurvature(Model):
    """A preformed bend: a stretch of the body that is curved where neither muscles nor contacts
    bend it. It begins where the one before ends; beyond the last, the body is straight.
    """

    until_cm: Positive  # arc, from the base, at which it ends
    curvature: Finite  # 1/cm, in the plane, positive to the left; 0: straight


# Entries of a growing body, which a body of fixed length does not have.
_OF_GROWTH = ("pitch_cm", "growth_psi", "growth_psi_per_cm")


def _default_fold(body: dict[str, Any]) -> float:
    return 0.01108 if body.get("grows", True) else inf


def _default_pressures(body: dict[str, Any]) -> list[BodyPressure]:
    if not body.get("grows", True):
        return [BodyPressure(until_cm=body.get("length_cm", 53.0), pressure_psi=0.0)]
    return [
        BodyPressure(until_cm=26.5, pressure_psi=1.47),
        BodyPressure(until_cm=35.3, pressure_psi=1.01),
        BodyPressure(until_cm=53.0, pressure_psi=0.49),
    ]


class Body(Model):
    """The tube, or another slender body."""

    grows: bool = True  # false: a fixed length, without spool, pouches and eversion
    length_cm: Positive = 53.0  # fully everted
    diameter_cm: Positive = 3.5  # of the inflated tube
    pitch_cm: Positive = 10.0  # pouch length: growth stops only at whole multiples of it
    # Contact moment over EI at which the base folds, measured at `critical_pressure_psi`;
    # it scales with body pressure. inf: it does not fold, as a body that does not grow by default.
    critical_curvature: Annotated[float, Field(gt=0)] = Field(default_factory=_default_fold)
    critical_curvature_se: NonNegative = 0.002  # 1/cm; uncalibrated: 18 %
    critical_pressure_psi: Positive = 0.49  # body pressure at which it was measured
    # Angle (rad) by which the base turns for each 1/cm of contact moment over EI there, so cm;
    # `thigmo calibrate base` measures it.
    base_compliance_cm: NonNegative = 0.0
    # One sigma of it, cm. Default: not measured; bases turn by up to 0.05 rad before they fold.
    base_compliance_se_cm: NonNegative = 2.5
    # Preformed bends, base first. Sensors are zeroed at rest, so that they read what is added.
    rest_curvature: list[RestCurvature] = Field(default_factory=list)
    # Bending stiffness EI and its standard error; without them forces are given over EI only.
    stiffness_n_cm2: Positive | None = None
    stiffness_se_n_cm2: NonNegative = 0.0  # one sigma of it, N cm^2
    growth_psi: NonNegative = 0.2  # body pressure at which the tip begins to evert
    growth_psi_per_cm: NonNegative = 0.003  # what the tail's friction adds for each cm everted
    # Body pressures, set by hand, by everted length.
    pressures: list[BodyPressure] = Field(
        default_factory=_default_pressures,
        min_length=1,
        validation_alias="pressure",
        serialization_alias="pressure",
    )

    @model_validator(mode="after")
    def _preformed_bends_fit(self) -> Self:
        ends = [piece.until_cm for piece in self.rest_curvature]
        if ends != sorted(set(ends)):
            raise ValueError("body.rest_curvature: until_cm must ascend")
        if ends and ends[-1] > self.length_cm:
            raise ValueError(
                f"body.rest_curvature: until_cm = {ends[-1]:g} lies beyond body.length_cm = "
                f"{self.length_cm:g}"
            )
        tightest = max((abs(piece.curvature) for piece in self.rest_curvature), default=0.0)
        if tightest * self.radius_cm >= 1.0:
            raise ValueError(
                f"body.rest_curvature: a tube of {self.diameter_cm:g} cm cannot be curved by "
                f"{tightest:g} 1/cm, around a circle that is smaller than itself"
            )
        return self

    @model_validator(mode="after")
    def _pressures_ascend(self) -> Self:
        ends = [pressure.until_cm for pressure in self.pressures]
        if ends != sorted(set(ends)):
            raise ValueError("body.pressure: until_cm must ascend")
        if ends[-1] < self.length_cm:
            raise ValueError("body.pressure: the last until_cm must reach body.length_cm")
        if self.grows and not all(pressure.pressure_psi for pressure in self.pressures):
            raise ValueError(
                "body.pressure: no body grows at 0 psi: give its pressure, or `grows = false`"
            )
        if not self.grows and (stated := sorted(self.model_fields_set.intersection(_OF_GROWTH))):
            raise ValueError(
                f"body.{stated[0]} is of a body that grows: leave it out, or `grows = false`"
            )
        return self

    @model_serializer(mode="wrap")
    def _without_what_it_lacks(self, dumped: SerializerFunctionWrapHandler) -> dict[str, Any]:
        entries: dict[str, Any] = dumped(self)
        if not self.rest_curvature:
            entries.pop("rest_curvature", None)
        if not self.grows:
            for name in _OF_GROWTH:
                entries.pop(name, None)
        return entries

    @property
    def rest_pieces(self) -> tuple[tuple[float, float], ...]:
        """End (cm) and curvature (1/cm) of each preformed bend, as `thigmo.mechanics` takes them.

        Empty for a body that is straight at rest.
        """
        return tuple((piece.until_cm, piece.curvature) for piece in self.rest_curvature)

    @property
    def folds(self) -> bool:
        """Whether the base folds at all."""
        return self.critical_curvature < inf

    @property
    def push_curvature(self) -> float:
        """Contact moment over EI (1/cm) up to which a hand may push the tip aside.

        That of the fold; or what turns the tip by 0.3 rad, where nothing folds.
        """
        return self.critical_curvature if self.folds else 0.6 / self.length_cm

    @property
    def radius_cm(self) -> float:
        """Tube radius."""
        return self.diameter_cm / 2

    @property
    def fold_swing(self) -> float:
        """Swing of a flex sensor's reading (1/cm) by which the tip's fold is seen to pass it.

        A third of what the fold bends the sensor: a guess of 0.15 1/cm in a tube of 3.5 cm, and
        less in a thicker one, which folds more gently.
        """
        return 0.15 * 3.5 / self.diameter_cm / 3

    def pull_n(self, pressure_psi: float) -> float:
        """Tension (N) of the tail: half of pressure times section (docs/hardware/facts.md)."""
        return 0.5 * pressure_psi * _PASCAL * pi * self.radius_cm**2 * 1e-4

    @property
    def stiffness(self) -> tuple[float, float] | None:
        """EI (N cm^2) and its relative standard error, if it is known."""
        if self.stiffness_n_cm2 is None:
            return None
        return self.stiffness_n_cm2, self.stiffness_se_n_cm2 / self.stiffness_n_cm2

    def pressure_number(self, length_cm: float) -> int:
        """Number of the body pressure that holds at an everted length (boundaries belong below)."""
        beyond = sum(length_cm > pressure.until_cm + 1e-6 for pressure in self.pressures)
        return min(beyond, len(self.pressures) - 1)


def _default_sensors() -> list[Sensor]:
    return [
        FlexSensor(angle_deg=DEGREES[side], center_cm=center)
        for side in SIDES
        for center in (5.0, 15.0, 25.0, 35.0, 45.0)
    ]


class TanhMap(Model):
    """g(p) = amplitude * tanh((p - p0) / scale) - the same at p = 0; see `curvature`."""

    amplitude: Positive = 0.04  # 1/cm
    scale_psi: Positive = 10.0  # pressure over which g saturates
    offset_psi: Finite = 0.0  # p0, where g is steepest

    def curvature(self, pressure_psi: float) -> float:
        """Magnitude of free curvature (1/cm) at a muscle pressure; zero at zero pressure."""
        start = tanh(-self.offset_psi / self.scale_psi)
        return self.amplitude * (tanh((pressure_psi - self.offset_psi) / self.scale_psi) - start)


class MuscleMap(Model):
    """Free curvature of one muscle at one body pressure, inflating and deflating apart."""

    body_pressure_psi: NonNegative = 0.0  # at which it was measured
    scale_se: NonNegative = 0.1  # of all of g from one sweep to the next, relative
    inflate: TanhMap = Field(default_factory=TanhMap)  # while the pressure rises
    deflate: TanhMap = Field(default_factory=TanhMap)  # while it falls

    @property
    def calibrated(self) -> bool:
        """Whether it was measured: its error is not the one that is assumed."""
        return bool(self.scale_se != MuscleMap.model_fields["scale_se"].default)


def _default_maps() -> list[MuscleMap]:
    return [MuscleMap(body_pressure_psi=p) for p in (1.47, 1.01, 0.49)]


def _word(name: str) -> str:
    """A name that fits a command (`left=6`) and a line of text."""
    if not name or not name.isprintable() or "=" in name or name != name.strip():
        raise ValueError("give a name on one line, without = and without spaces around it")
    return name


class Muscle(Placed):
    """One pneumatic muscle with its transducer and pressure sensor."""

    name: Annotated[str, AfterValidator(_word)]  # for commands and tables
    max_pressure_psi: Positive = 18.0  # no set point exceeds it
    lag_s: NonNegative = 0.2  # measured pressure to bend
    reversal_psi: Positive = 1.0  # pressure change over which the branch moves inflate <-> deflate
    lag_se_s: NonNegative = 0.05  # a quarter of the lag: inflating and deflating share one constant
    offset_se: NonNegative = 1e-3  # 1/cm: error that all readings share while it bends the body
    # One sigma by which all of its maps have drifted since the calibration, relative: it ages, and
    # its regulator is set by hand. `check` on later days shows it.
    drift_se: NonNegative = 0.08
    # By how much the same sweep's bend differs from one to the next: a share of it, and 1/cm.
    # Repeated sweeps show both.
    sweep_se: NonNegative = 0.01
    sweep_offset_se: NonNegative = 3e-4  # the same, 1/cm
    # Free curvature over pressure, one map for each body pressure.
    maps: list[MuscleMap] = Field(
        default_factory=_default_maps, validation_alias="map", serialization_alias="map"
    )

    @property
    def most_bend(self) -> float:
        """Highest free curvature to which it bends the body, 1/cm."""
        return max(entry.inflate.curvature(self.max_pressure_psi) for entry in self.maps)


def _default_muscles(robot: dict[str, Any]) -> list[Muscle]:
    pressures = robot["body"].pressures if "body" in robot else _default_pressures({})
    return [
        Muscle(
            name=side,
            angle_deg=DEGREES[side],
            maps=[MuscleMap(body_pressure_psi=pressure.pressure_psi) for pressure in pressures],
        )
        for side in SIDES
    ]


_OVER_PRESSURE_PSI = 3.0  # above the range: regulation overshoots by 1, and FR1 gives 5


class BoardSettings(Model):
    """The controller and its settings."""

    divider_ohm: Positive = 22_000.0  # fixed resistor of the flex sensors' dividers
    settle_s: NonNegative = 30.0  # thesis: no reading within 30 s of eversion
    # Highest pressure that the muscles' supply, valves and relief valve are built for: maps reach
    # to it, and a pressure 3 psi above it is a fault (docs/hardware/air.md).
    pressure_range_psi: Annotated[float, Field(ge=20, le=60)] = 20.0
    pressure_sensor_psi: Positive = 60.0  # full scale of the muscles' pressure sensors
    transducer_psi: Positive = 60.0  # what the transducers put out at 20 mA

    @property
    def over_pressure_psi(self) -> float:
        """Muscle pressure above which the board vents and stops (fault over_pressure)."""
        return self.pressure_range_psi + _OVER_PRESSURE_PSI

    @model_validator(mode="after")
    def _pressures_fit(self) -> Self:
        if self.pressure_sensor_psi < self.over_pressure_psi:
            raise ValueError(
                f"board.pressure_sensor_psi = {self.pressure_sensor_psi:g} shows no "
                f"{self.over_pressure_psi:g} psi, where over_pressure vents the muscles: fit a "
                "sensor of a wider range, or lower board.pressure_range_psi"
            )
        return self


class Spool(Model):
    """Motorised spool. Base-fed eversion pays out `payout_ratio` cm of tail per cm of growth."""

    counts_per_cm: Positive = 76.0  # x4 encoder counts per cm of line
    payout_ratio: Positive = 2.0  # cm of line for each cm of tip
    max_speed_cm_s: Positive = 2.0  # of the tip
    acceleration_cm_s2: Positive = 4.0  # of the tip
    line_speed_cm_s: Positive = 23.6  # of the line at full duty, without load
    stall_n: Positive = 147.0  # pull on the line at which full duty stalls
    line_rating_n: Positive = 100.0  # what line and tail may be pulled with
    # Pull that friction holds at rest: more than the 4.9 N with which 1.47 psi pulls at 3.5 cm.
    holding_n: NonNegative = 6.0
    brake: bool = False  # a spring-applied brake, and contacts in the motor's supply
    brake_closes_s: NonNegative = 0.04  # after its current ends; the most that BR1 may take


_SCENE_KEYS = {"extends", "robot", "pegs"}  # of a scene, and in no version of robot.toml


class RobotConfig(Model):
    """Contents of robot.toml."""

    union_tags = frozenset(KINDS)
    version: Literal[2] = 2  # of the file's entries
    name: str = "vine-53"  # of the robot
    # Where lines of a fibre's strains come from (`thigmo.link.interrogator`): host:port.
    interrogator: Annotated[str, AfterValidator(_host_and_port)] | None = None
    body: Body = Field(default_factory=Body)  # the tube, and its pressures
    # Muscles, in the order of the board's outputs. `muscle = []`: none, so nothing sweeps.
    muscles: list[Muscle] = Field(
        default_factory=_default_muscles,
        validation_alias="muscle",
        serialization_alias="muscle",
    )
    # Sensors, those at an angle base first.
    sensors: list[Sensor] = Field(
        default_factory=_default_sensors,
        min_length=1,
        validation_alias="sensor",
        serialization_alias="sensor",
    )
    spool: Spool = Field(default_factory=Spool)  # motor, line and brake
    board: BoardSettings = Field(default_factory=BoardSettings)  # the controller

    @model_serializer(mode="wrap")
    def _without_spool(self, dumped: SerializerFunctionWrapHandler) -> dict[str, Any]:
        entries: dict[str, Any] = dumped(self)
        if not self.body.grows:
            entries.pop("spool", None)
        return entries

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.body.grows and "spool" in self.model_fields_set:
            raise ValueError("spool: a body with `grows = false` has none: leave [spool] out")
        first: dict[tuple[bool, float], float] = {}  # of each column: the board's base sensor
        for number, sensor in enumerate(self.sensors):
            if sensor.center_cm + sensor.span_cm / 2 > self.body.length_cm + 1e-6:
                raise ValueError(f"sensor[{number}] ends beyond body.length_cm")
            if sensor.center_cm - sensor.span_cm / 2 < -1e-6:
                raise ValueError(f"sensor[{number}] begins before the base: see its span_cm")
            column = sensor.on_board, sensor.angle_deg
            if sensor.center_cm < first.setdefault(column, sensor.center_cm):
                raise ValueError(
                    f"sensor[{number}] lies before the first of its column: list them base first"
                )
        angles = [muscle.angle_deg for muscle in self.muscles]
        if len(set(angles)) < len(angles):
            raise ValueError("muscle: two of them have the same angle_deg")
        if len({muscle.name for muscle in self.muscles}) < len(angles):
            raise ValueError("muscle: two of them have the same name")
        for number, muscle in enumerate(self.muscles):
            if muscle.name in SIDES and muscle.side not in (None, muscle.name):
                raise ValueError(
                    f"muscle[{number}] is named {muscle.name}, which is {DEGREES[muscle.name]:g} "
                    "degrees: give it another name or angle_deg"
                )
            if len(muscle.maps) != len(self.body.pressures):
                raise ValueError(f"muscle[{number}].map: one for each of body.pressure is needed")
            if muscle.max_pressure_psi > self.board.pressure_range_psi:
                raise ValueError(
                    f"muscle[{number}].max_pressure_psi = {muscle.max_pressure_psi:g} is above "
                    f"board.pressure_range_psi = {self.board.pressure_range_psi:g}: lower it, or "
                    "state the range that supply, valves and relief valve are built for (at most "
                    "60 psi; docs/hardware/air.md)"
                )
        return self

    @property
    def sides(self) -> tuple[Side, ...]:
        """The sides of the plane towards which a muscle bends the body."""
        muscle_sides = {muscle.side for muscle in self.muscles}
        return tuple(side for side in SIDES if side in muscle_sides)

    @property
    def muscle_sides(self) -> tuple[Side, ...]:
        """The side towards which each muscle bends the body, in the order of the board.

        Raises ConfigError for a muscle that bends it out of the plane.
        """
        sides = []
        for muscle in self.muscles:
            if muscle.side is None:
                raise ConfigError(
                    f"muscle {muscle.name} bends the body out of the plane",
                    "press it by name; sweeps and explorations are in the plane (90, 270 degrees)",
                )
            sides.append(muscle.side)
        return tuple(sides)

    def muscle_number(self, towards: str | float) -> int:
        """The board's number of a muscle: its place in robot.toml.

        It is found by its name, or by the angle (degrees) towards which it bends the body.
        Raises ConfigError if there is none.
        """
        for number, muscle in enumerate(self.muscles):
            if towards in (muscle.name, muscle.angle_deg):
                return number
        raise ConfigError(
            f"the robot has no muscle {towards}",
            f"use {' or '.join(f'{m.name} ({m.angle_deg:g})' for m in self.muscles)}",
        )

    def muscle(self, side: Side) -> Muscle:
        """The muscle that bends the body towards a side; ConfigError if there is none."""
        for muscle in self.muscles:
            if muscle.side == side:
                return muscle
        raise ConfigError(
            f"the robot has no muscle that bends it to the {side}",
            f"use {' or '.join(muscle.name for muscle in self.muscles)}",
        )

    def column_name(self, angle_deg: float) -> str:
        """What the sensors at an angle are called: as the muscle there, or by the angle."""
        names = (m.name for m in self.muscles if m.angle_deg == angle_deg)
        return next(names, f"{angle_deg:g} deg")

    @property
    def board_sensors(self) -> list[BoardSensor]:
        """The sensors that are wired to the board."""
        return [sensor for sensor in self.sensors if isinstance(sensor, BoardSensor)]

    @property
    def gratings(self) -> list[FibreSensor]:
        """The sensors of a fibre, which an interrogator reads."""
        return [sensor for sensor in self.sensors if isinstance(sensor, FibreSensor)]

    def column(self, side: Side) -> list[BoardSensor]:
        """The board's sensors that lie on a side, in the file's order: base to tip."""
        return [sensor for sensor in self.board_sensors if sensor.side == side]

    def sensors_for(self, side: Side) -> list[Sensor]:
        """The sensors that read right while the muscle of a side bends the body, base first."""
        reading = [s for s in self.sensors if s.side and not (s.wrinkles and s.side == side)]
        return sorted(reading, key=lambda sensor: sensor.center_cm)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read and validate a robot.toml.

        Raises:
            ConfigError: unreadable file, malformed TOML, unknown key or bad value (which is named),
                or a scene.
        """
        if not _SCENE_KEYS.isdisjoint(read_toml(path)):
            raise ConfigError(
                f"{path} is a scene, not a robot",
                "check it with `thigmo scene check`, or give its robot's robot.toml, which "
                "`thigmo emulate` writes",
            )
        return load_toml(cls, path)

    def save(self, path: str | os.PathLike[str]) -> Path | None:
        """Write robot.toml; an existing file is first copied aside. Returns the backup's path."""
        target = Path(path)
        backup: Path | None = None
        if target.exists():
            taken = {path.name for path in target.parent.glob(f"{target.name}.*.bak")}
            number = next(
                n for n in range(1, len(taken) + 2) if f"{target.name}.{n}.bak" not in taken
            )
            backup = target.with_name(f"{target.name}.{number}.bak")
            shutil.copy2(target, backup)
        self.write(target)
        return backup
