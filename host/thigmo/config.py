"""What a lab knows of its robot: `robot.toml`, validated.

Written by calibration, read by the robot object (which sends it to the board), by the localizer's
callers and by the emulator (whose scene describes the *true* robot with the same model, so that a
calibration can be compared with the truth). Lengths in cm, pressures in psi gauge, curvature in
1/cm, time in s, resistance in ohm.

A robot is lists: muscles, sensors and body pressures, each with what is known of it.

Sign convention, everywhere in this project: x runs along the straight robot from its base, y to
its left; curvature is positive when the body bends to the left (towards +y). A direction is an
angle around the body, in degrees: 90 is +y (left), 270 is -y (right), 0 and 180 leave the plane.
A muscle bends the body towards its direction; a sensor lies at its own.

Each `_se` is one sigma of what the entry may be off by. Calibration writes what it found; the
defaults are those of a robot that nobody has calibrated: wide, so that the localizer says
"ambiguous" rather than something wrong. `thigmo.reading_errors` gathers them for one stage.
"""

from __future__ import annotations

import os
import re
import shutil
import tomllib
from math import cos, hypot, pi, tanh
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

import tomlkit
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)

from thigmo.errors import ConfigError
from thigmo.files import CONFIG_BYTES, read_file, why_unreadable, write_whole

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")  # of the plane in which the robot moves
SIGN: dict[Side, float] = {"left": 1.0, "right": -1.0}  # of curvature towards a side
_PASCAL = 6894.757  # of one psi
_TOWARDS: dict[float, Side] = {90.0: "left", 270.0: "right"}
DEGREES: dict[Side, float] = {side: degrees for degrees, side in _TOWARDS.items()}
IMU_CM = 1.2  # length of an IMU's board along the body
SAME_IMU_CM = 0.05  # places that are nearer are one IMU's
SAME_PRESSURE = 0.1  # body pressures that differ by less, relative, have one map
RAD_PER_OHM = 1e-4  # by which the board's reader of IMUs says a turn


def _not_zero(value: float) -> float:
    if not value:
        raise ValueError("0 would make every reading 0: give its scale")
    return value


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
NonZero = Annotated[Finite, AfterValidator(_not_zero)]


Direction = Annotated[float, Field(ge=0, lt=360, allow_inf_nan=False)]  # around the body, degrees


def _host_and_port(address: str) -> str:
    host, _, port = address.rpartition(":")
    if not host or any(c.isspace() or c == ":" for c in host):
        raise ValueError(f'{address!r} is no address: give "host:port"')
    if not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise ValueError(f"the port {port!r} does not exist: give 1 to 65535")
    return address


def side_at(direction_deg: float) -> Side | None:
    """The side of the plane at a direction; None out of it."""
    return _TOWARDS.get(direction_deg)


def opposite(side: Side) -> Side:
    """The other side of the plane."""
    return "right" if side == "left" else "left"


class Model(BaseModel):
    """A strict record: unknown keys are errors, so that a typing slip is never ignored."""

    model_config = ConfigDict(extra="forbid", validate_assignment=True, populate_by_name=True)

    def _write(self, path: str | os.PathLike[str]) -> None:
        """Write the record as TOML, with every entry that has a value; ConfigError if it cannot."""
        with ConfigError.from_os(f"cannot write {path}", "choose a folder that you may write to"):
            write_whole(
                path, tomlkit.dumps(self.model_dump(mode="json", exclude_none=True, by_alias=True))
            )


class BodyPressure(Model):
    """Body pressure set by hand for a range of everted length (thesis, section 3.5)."""

    until_cm: Positive
    pressure_psi: Positive
    pull_duty: Finite = 0.0  # of 800, that the motor needs less in growth than its data say


class Body(Model):
    """The tube."""

    length_cm: Positive = 53.0
    diameter_cm: Positive = 3.5
    pitch_cm: Positive = 10.0  # pouch length: growth stops only at whole multiples of it
    # Contact moment over EI at which the base folds, measured at `critical_pressure_psi`;
    # it scales with body pressure.
    critical_curvature: Positive = 0.01108
    critical_curvature_se: NonNegative = 0.002  # 1/cm; uncalibrated: 18 %
    critical_pressure_psi: Positive = 0.49
    # Bending stiffness EI and its standard error; without them forces are given over EI only.
    stiffness_n_cm2: Positive | None = None
    stiffness_se_n_cm2: NonNegative = 0.0
    growth_psi: NonNegative = 0.2  # body pressure at which the tip begins to evert
    growth_psi_per_cm: NonNegative = 0.003  # what the tail's friction adds for each cm everted
    zones: list[BodyPressure] = Field(
        default_factory=lambda: [
            BodyPressure(until_cm=26.5, pressure_psi=1.47),
            BodyPressure(until_cm=35.3, pressure_psi=1.01),
            BodyPressure(until_cm=53.0, pressure_psi=0.49),
        ],
        min_length=1,
        validation_alias="pressure",
        serialization_alias="pressure",
    )

    @model_validator(mode="after")
    def _zones_ascend(self) -> Self:
        ends = [zone.until_cm for zone in self.zones]
        if ends != sorted(set(ends)):
            raise ValueError("body.pressure: until_cm must ascend")
        if ends[-1] < self.length_cm:
            raise ValueError("body.pressure: the last until_cm must reach body.length_cm")
        return self

    @property
    def radius_cm(self) -> float:
        """Tube radius."""
        return self.diameter_cm / 2

    def pull_n(self, pressure_psi: float) -> float:
        """Tension (N) of the tail: half of pressure times section (docs/hardware/facts.md)."""
        return 0.5 * pressure_psi * _PASCAL * pi * self.radius_cm**2 * 1e-4

    @property
    def stiffness(self) -> tuple[float, float] | None:
        """EI (N cm^2) and its relative standard error, if it is known."""
        if self.stiffness_n_cm2 is None:
            return None
        return self.stiffness_n_cm2, self.stiffness_se_n_cm2 / self.stiffness_n_cm2

    def zone_at(self, length_cm: float) -> int:
        """Index of the pressure zone that holds at an everted length (boundaries belong below)."""
        beyond = sum(length_cm > zone.until_cm + 1e-6 for zone in self.zones)
        return min(beyond, len(self.zones) - 1)


class _Placed(Model):
    """What lies at a direction around the body."""

    direction_deg: Direction = 90.0

    @property
    def side(self) -> Side | None:
        """The side of the plane; None out of it."""
        return side_at(self.direction_deg)


class _Sensor(_Placed):
    """What every kind of sensor has: the mean curvature over a span, and its errors."""

    wrinkles: ClassVar[bool]  # whether a muscle at its side spoils it
    kind: str
    center_cm: Positive
    # One sigma of its place. Default: a ruler along the tube, read to a millimetre.
    center_se_cm: NonNegative = 0.1
    span_cm: NonNegative
    scale_se: NonNegative  # relative
    # One sigma by which its scale has drifted since then, relative; `check` on later days shows it.
    drift_se: NonNegative = 0.04
    noise: Positive  # 1/cm, white, of an averaged reading
    settle_tau_s: Positive = 8.0  # decay after eversion
    settle_amplitude: Finite = 0.0  # 1/cm at eversion
    healthy: bool = True  # false: dead, never used

    @property
    def zero_error(self) -> float:
        """One sigma of its zero, 1/cm, of its own."""
        return 0.0

    @property
    def gain_error(self) -> float:
        """One sigma of its scale as it lies in the body, relative."""
        return self.scale_se

    @property
    def reading_se(self) -> float:
        """One sigma of an averaged reading, 1/cm: noise, its zero, and what it shares."""
        return hypot(self.noise, self.zero_error)

    @property
    def fold_cm(self) -> tuple[float, float]:
        """Centre and span of what must not lie in the tip's fold."""
        return self.center_cm, self.span_cm


class FlexSensor(_Sensor):
    """One flex sensor: reading = scale_per_ohm * (R - R at the last zeroing)."""

    wrinkles = True
    kind: Literal["flex"] = "flex"
    span_cm: NonNegative = 5.5
    scale_per_ohm: NonZero = 3.5e-5  # 1/cm per ohm; sign included, so that left bends read positive
    scale_se: NonNegative = 0.15  # resistances differ by 30 % from part to part
    zero_ohm: Positive = 12_000.0  # flat resistance, a start value: zeroing re-measures it
    zero_se: NonNegative = 3.6e-4  # 1/cm, what zeroing and averaging leave: its loop, slow drift
    valid_direction: Literal[-1, 0, 1] = 0  # the bending direction it answers to; 0 = both
    # Response to bends against `valid_direction` over that to bends along it, and one sigma: a data
    # sheet states one direction only. A bench that bends both ways measures it.
    against_gain: NonNegative = 0.7
    against_gain_se: NonNegative = 0.3
    noise: Positive = 4.8e-4  # 6e-4 with `zero_se`

    @property
    def zero_error(self) -> float:
        """One sigma of its zero, 1/cm, of its own."""
        return self.zero_se

    def rescale(self, factor: float) -> None:
        """Let it stand for so much more curvature."""
        self.scale_per_ohm *= factor


class HeadingSensor(_Sensor):
    """What the body turns by from one IMU to the next; or from its base, where the span begins.

    The board's reader of IMUs says the turn as a divider would: by a resistance.
    """

    wrinkles = False
    kind: Literal["heading"]
    span_cm: Positive  # from one IMU to the other
    scale: Positive = 1.0  # turn over what the IMUs say: how they lie, and their gain
    scale_se: NonNegative = 0.05
    zero_rad: Finite = 0.0  # turn that they say of the straight body
    heading_se_rad: NonNegative = 3e-3  # of either IMU: what it drifts by from zeroing to reading
    noise: Positive = 1e-4
    # Of the IMU at the span's far end: the multiplexer's channel, and its address; 0 = not stated.
    mux_channel: Annotated[int, Field(ge=0, le=7)] = 0
    i2c_address: Annotated[int, Field(ge=0, le=127)] = 0

    valid_direction: ClassVar[int] = 0
    straight_ohm: ClassVar[float] = 12_000.0  # that the reader says for no turn

    def rescale(self, factor: float) -> None:
        """Let it stand for so much more curvature."""
        self.scale *= factor

    @property
    def zero_ohm(self) -> float:
        """What the reader says of the straight body."""
        return self.straight_ohm + self.zero_rad / RAD_PER_OHM

    @property
    def scale_per_ohm(self) -> float:
        """Curvature (1/cm) for each ohm that the reader says."""
        return self.scale * RAD_PER_OHM / self.span_cm

    @property
    def ends_cm(self) -> tuple[float, float]:
        """Places of its IMUs; 0 is the base, which does not turn."""
        return self.center_cm - self.span_cm / 2, self.center_cm + self.span_cm / 2

    @property
    def reading_se(self) -> float:
        """One sigma of an averaged reading, 1/cm: noise, and what its IMUs drift by."""
        imus = 1 if self.ends_cm[0] < SAME_IMU_CM else 2
        return hypot(self.noise, self.heading_se_rad * imus**0.5 / self.span_cm)

    @property
    def fold_cm(self) -> tuple[float, float]:
        """Centre and span of what must not lie in the tip's fold: its farther IMU."""
        return self.ends_cm[1], IMU_CM


class FibreSensor(_Sensor):
    """One bend at a grating of a multi-core fibre: the strain of its cores in one direction.

    A grating has two, at different directions. An interrogator reads them, and the board does not.
    Defaults: an outer core 37 um off the axis, where a bend of 0.01 1/cm strains by 37 microstrain.
    """

    wrinkles = False
    kind: Literal["fibre"]
    span_cm: NonNegative = 0.5  # length of the grating
    scale_per_ue: NonZero = 2.7e-4  # 1/cm per microstrain; sign included
    scale_se: NonNegative = 0.05
    zero_ue: Finite = 0.0  # of the straight body
    noise: Positive = 2.7e-4  # a microstrain
    # What temperature adds to all gratings alike, 1/cm. A kelvin strains a core by 11 microstrain
    # [a typical grating at 1550 nm]; reading each core by itself leaves a tenth of that [assumed].
    temperature_se: NonNegative = 3e-4
    twist_se_rad: NonNegative = 0.05  # by which the fibre lies turned about its axis

    valid_direction: ClassVar[int] = 0
    warm_s: ClassVar[float] = 20.0  # from zeros to a reading, for which `temperature_se` holds

    @property
    def gain_error(self) -> float:
        """One sigma of its scale, relative: what a twist turns out of its direction is lost."""
        return hypot(self.scale_se, 1 - cos(self.twist_se_rad))

    @property
    def reading_se(self) -> float:
        """One sigma of an averaged reading, 1/cm: noise and temperature."""
        return hypot(self.noise, self.temperature_se)

    def rescale(self, factor: float) -> None:
        """Let it stand for so much more curvature."""
        self.scale_per_ue *= factor

    def curvature(self, strain_ue: float) -> float:
        """Curvature (1/cm) at a strain that the interrogator says."""
        return self.scale_per_ue * (strain_ue - self.zero_ue)


BoardSensor = FlexSensor | HeadingSensor


def _kind(data: Any) -> str:
    """Kind of a sensor's entry; an entry that names none is a flex sensor."""
    if isinstance(data, dict):
        return str(data.get("kind", "flex"))
    return data.kind if isinstance(data, _Sensor) else ""


Sensor = Annotated[
    Annotated[FlexSensor, Tag("flex")]
    | Annotated[HeadingSensor, Tag("heading")]
    | Annotated[FibreSensor, Tag("fibre")],
    Discriminator(
        _kind,
        custom_error_type="kind",
        custom_error_message="a sensor is a table whose kind is flex, heading or fibre",
    ),
]


def _default_sensors() -> list[Sensor]:
    return [
        FlexSensor(direction_deg=DEGREES[side], center_cm=center)
        for side in SIDES
        for center in (5.0, 15.0, 25.0, 35.0, 45.0)
    ]


class TanhMap(Model):
    """g(p) = amplitude * tanh((p - p0) / scale) - the same at p = 0; see `curvature`."""

    amplitude: Positive = 0.04  # 1/cm
    scale_psi: Positive = 10.0
    offset_psi: Finite = 0.0

    def curvature(self, pressure_psi: float) -> float:
        """Magnitude of free curvature (1/cm) at a muscle pressure; zero at zero pressure."""
        start = tanh(-self.offset_psi / self.scale_psi)
        return self.amplitude * (tanh((pressure_psi - self.offset_psi) / self.scale_psi) - start)


class ZoneMap(Model):
    """Free curvature of one muscle at one body pressure, inflating and deflating apart."""

    body_pressure_psi: Positive
    scale_se: NonNegative = 0.1  # of all of g from one sweep to the next, relative
    inflate: TanhMap = Field(default_factory=TanhMap)
    deflate: TanhMap = Field(default_factory=TanhMap)

    @property
    def calibrated(self) -> bool:
        """Whether it was measured: its error is not the one that is assumed."""
        return bool(self.scale_se != ZoneMap.model_fields["scale_se"].default)


def _default_zone_maps() -> list[ZoneMap]:
    return [ZoneMap(body_pressure_psi=p) for p in (1.47, 1.01, 0.49)]


def _word(name: str) -> str:
    """A name that fits a command (`left=6`) and a line of text."""
    if not name or not name.isprintable() or "=" in name or name != name.strip():
        raise ValueError("give a name on one line, without = and without spaces around it")
    return name


class Muscle(_Placed):
    """One pneumatic muscle with its transducer and pressure sensor."""

    name: Annotated[str, AfterValidator(_word)]
    max_pressure_psi: Positive = 18.0
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
    sweep_offset_se: NonNegative = 3e-4
    maps: list[ZoneMap] = Field(
        default_factory=_default_zone_maps, validation_alias="map", serialization_alias="map"
    )


def _default_muscles() -> list[Muscle]:
    return [Muscle(name=side, direction_deg=DEGREES[side]) for side in SIDES]


class Board(Model):
    """The controller and its settings."""

    divider_ohm: Positive = 22_000.0  # fixed resistor of the flex sensors' dividers
    settle_s: NonNegative = 30.0  # thesis: no reading within 30 s of eversion


class Spool(Model):
    """Motorised spool. Base-fed eversion pays out `payout_ratio` cm of tail per cm of growth."""

    counts_per_cm: Positive = 76.0  # x4 encoder counts per cm of line
    payout_ratio: Positive = 2.0
    max_speed_cm_s: Positive = 2.0  # of the tip
    acceleration_cm_s2: Positive = 4.0
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

    version: Literal[2] = 2
    name: str = "vine-53"
    # Where lines of a fibre's strains come from (`thigmo.link.interrogator`): host:port.
    interrogator: Annotated[str, AfterValidator(_host_and_port)] | None = None
    body: Body = Field(default_factory=Body)
    muscles: list[Muscle] = Field(
        default_factory=_default_muscles,
        min_length=1,
        validation_alias="muscle",
        serialization_alias="muscle",
    )
    sensors: list[Sensor] = Field(
        default_factory=_default_sensors,
        min_length=1,
        validation_alias="sensor",
        serialization_alias="sensor",
    )
    spool: Spool = Field(default_factory=Spool)
    board: Board = Field(default_factory=Board)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        first: dict[tuple[bool, float], float] = {}  # of each column: the board's base sensor
        for number, sensor in enumerate(self.sensors):
            if sensor.center_cm + sensor.span_cm / 2 > self.body.length_cm + 1e-6:
                raise ValueError(f"sensor[{number}] ends beyond body.length_cm")
            if sensor.center_cm - sensor.span_cm / 2 < -1e-6:
                raise ValueError(f"sensor[{number}] begins before the base: see its span_cm")
            column = isinstance(sensor, FibreSensor), sensor.direction_deg
            if sensor.center_cm < first.setdefault(column, sensor.center_cm):
                raise ValueError(
                    f"sensor[{number}] lies before the first of its column: list them base first"
                )
        directions = [muscle.direction_deg for muscle in self.muscles]
        if len(set(directions)) < len(directions):
            raise ValueError("muscle: two of them have the same direction_deg")
        if len({muscle.name for muscle in self.muscles}) < len(directions):
            raise ValueError("muscle: two of them have the same name")
        for number, muscle in enumerate(self.muscles):
            if muscle.name in SIDES and muscle.side not in (None, muscle.name):
                raise ValueError(
                    f"muscle[{number}] is named {muscle.name}, which is {DEGREES[muscle.name]:g} "
                    "degrees: give it another name or direction_deg"
                )
            if len(muscle.maps) != len(self.body.zones):
                raise ValueError(f"muscle[{number}].map: one for each of body.pressure is needed")
        return self

    @property
    def sides(self) -> tuple[Side, ...]:
        """The sides of the plane towards which a muscle bends the body."""
        there = {muscle.side for muscle in self.muscles}
        return tuple(side for side in SIDES if side in there)

    @property
    def muscle_sides(self) -> tuple[Side, ...]:
        """The side towards which each muscle bends the body, in the order of the board.

        Raises ConfigError for a muscle that bends it out of the plane.
        """
        found = []
        for muscle in self.muscles:
            if muscle.side is None:
                raise ConfigError(
                    f"muscle {muscle.name} bends the body out of the plane",
                    "press it by name; sweeps and explorations are in the plane (90, 270 degrees)",
                )
            found.append(muscle.side)
        return tuple(found)

    def muscle_number(self, towards: str | float) -> int:
        """The board's number of a muscle: its place in robot.toml.

        It is found by its name, or by the direction (degrees) towards which it bends the body.
        Raises ConfigError if there is none.
        """
        for number, muscle in enumerate(self.muscles):
            if towards in (muscle.name, muscle.direction_deg):
                return number
        raise ConfigError(
            f"the robot has no muscle {towards}",
            f"use {' or '.join(f'{m.name} ({m.direction_deg:g})' for m in self.muscles)}",
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

    def column_name(self, direction_deg: float) -> str:
        """What the sensors at a direction are called: as the muscle there, or by the direction."""
        names = (m.name for m in self.muscles if m.direction_deg == direction_deg)
        return next(names, f"{direction_deg:g} deg")

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
        found = [s for s in self.sensors if s.side and not (s.wrinkles and s.side == side)]
        return sorted(found, key=lambda sensor: sensor.center_cm)

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
        self._write(target)
        return backup


M = TypeVar("M", bound=Model)


def load_toml(model: type[M], path: str | os.PathLike[str]) -> M:
    """Read a TOML file into a model, with errors that name file, key and cure.

    Raises:
        ConfigError: the file is missing, malformed or invalid; what is wrong is named by its line.
    """
    data = read_toml(path)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        line = _line_of(error, Path(path).read_text())
        where = f"{path}, line {line}" if line else path
        raise ConfigError(invalid_entry(where, error), "correct that entry") from error


def _line_of(error: ValidationError, text: str) -> int:
    """Line of a TOML file, from 1, with its first invalid entry, or the table where one is missing.

    0 if there is none.
    """
    first = error.errors()[0]
    # A check of the whole file names the table in its sentence; kinds of sensors are no keys.
    named = re.match(r"Value error, (\w+)\[(\d+)\]", first["msg"])
    wanted: list[int | str] = [named[1], int(named[2])] if named and not first["loc"] else []
    wanted += [part for part in first["loc"] if part not in ("flex", "heading", "fibre")]
    table: list[int | str] = []
    tables: dict[tuple[int | str, ...], int] = {}  # how many of each array have come
    best, length = 0, 0
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*(\[\[?)([\w.]+)\]", line):
            table = []
            *above, last = header[2].split(".")
            for name in above:
                table.append(name)
                if tuple(table) in tables:
                    table.append(tables[tuple(table)])
            table.append(last)
            if header[1] == "[[":
                tables[tuple(table)] = tables.get(tuple(table), -1) + 1
                table.append(tables[tuple(table)])
            here = table
        elif key := re.match(r"\s*(\w+)\s*=", line):
            here = [*table, key[1]]
        else:
            continue
        if len(here) > length and here == wanted[: len(here)]:
            best, length = number, len(here)
    return best


# tomllib takes the square of a dotted key's length.
_LONG_KEY = re.compile(r"""(?m)^\s*+\[{0,2}(?:\s*+(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')\s*+\.){64}""")


def _parsed(text: str) -> dict[str, Any]:
    """TOML's entries. Raises ValueError, or RecursionError if they are nested too deeply."""
    if _LONG_KEY.search(text):
        raise RecursionError
    return tomllib.loads(text)


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        ConfigError: the file is missing or malformed.
    """
    try:
        data = _parsed(read_file(path, CONFIG_BYTES).decode())
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}", "check the path") from error
    except (ValueError, RecursionError) as error:
        reason = why_unreadable(error)
        raise ConfigError(f"{path} is not valid TOML: {reason}", "correct that line") from error
    return data


def validated(model: type[M], data: dict[str, Any], path: str | os.PathLike[str]) -> M:
    """Make a model of data that came from a file.

    Raises:
        ConfigError: an entry is invalid; it is named, and so is the file.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ConfigError(invalid_entry(path, error), "correct that entry") from error


# What an entry must be, by the kind of pydantic's error; filled in from the error's context.
_MUST_BE = {
    "float_parsing": "a number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_parsing": "a whole number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_parsing": "true or false",
    "bool_type": "true or false",
    "string_type": "a text in quotes",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "greater_than": "above {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than": "below {lt:g}",
    "less_than_equal": "at most {le:g}",
    "literal_error": "{expected}",
    "too_short": "a list of at least {min_length}",
    "too_long": "a list of at most {max_length}",
}
_LONGEST_SHOWN = 40  # characters of a wrong value


def invalid_entry(path: str | os.PathLike[str], error: ValidationError) -> str:
    """What is wrong with a file's first invalid entry, which is named, in the file's words."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    if first["type"] == "missing":
        return f"{path}: {where} is missing"
    if first["type"] == "extra_forbidden":
        return f"{path}: {where} is no entry that is known here"
    if (wanted := _MUST_BE.get(first["type"])) is not None:
        value = first["input"]
        shown = repr(value) if isinstance(value, str | int | float) else ""
        instead = f", not {shown}" if 0 < len(shown) <= _LONGEST_SHOWN else ""
        must_be = wanted.format(**first.get("ctx", {}))
        return f"{path}: {where or 'the file'} must be {must_be}{instead}"
    return f"{path}: {where + ': ' if where else ''}{first['msg'].removeprefix('Value error, ')}"
