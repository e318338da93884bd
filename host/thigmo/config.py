"""What a lab knows of its robot: `robot.toml`, validated.

Written by calibration, read by the robot object (which sends it to the board), by the localizer's
callers and by the emulator (whose scene describes the *true* robot with the same model, so that a
calibration can be compared with the truth). Lengths in cm, pressures in psi gauge, curvature in
1/cm, time in s, resistance in ohm.

Sign convention, everywhere in this project: x runs along the straight robot from its base, y to
its left; curvature is positive when the body bends to the left (towards +y). Inflating the left
muscle bends the body to the left. Sensors are numbered base to tip, left side first.

Each `_se` is one sigma of what the entry may be off by. Calibration writes what it found; the
defaults are those of a robot that nobody has calibrated: wide, so that the localizer says
"ambiguous" rather than something wrong. `thigmo.reading_errors` gathers them for one stage.
"""

from __future__ import annotations

import os
import shutil
import tomllib
from math import tanh
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import tomlkit
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from thigmo.errors import ConfigError
from thigmo.files import write_whole

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Model(BaseModel):
    """A strict record: unknown keys are errors, so that a typing slip is never ignored."""

    model_config = ConfigDict(extra="forbid", validate_assignment=True)

    def _write(self, path: str | os.PathLike[str]) -> None:
        """Write the record as TOML, with every entry that has a value; ConfigError if it cannot."""
        with ConfigError.from_os(f"cannot write {path}", "choose a folder that you may write to"):
            write_whole(path, tomlkit.dumps(self.model_dump(mode="json", exclude_none=True)))


class PressureZone(Model):
    """Body pressure set by hand for a range of everted length (thesis, section 3.5)."""

    until_cm: Positive
    pressure_psi: Positive


class Body(Model):
    """The tube."""

    length_cm: Positive = 53.0
    diameter_cm: Positive = 3.5
    # Contact moment over EI at which the base folds, measured at `critical_pressure_psi`;
    # it scales with body pressure.
    critical_curvature: Positive = 0.01108
    critical_curvature_se: NonNegative = 0.002  # 1/cm; uncalibrated: 18 %
    critical_pressure_psi: Positive = 0.49
    # Bending stiffness EI and its standard error; without them forces are told over EI only.
    stiffness_n_cm2: Positive | None = None
    stiffness_se_n_cm2: NonNegative = 0.0
    zones: list[PressureZone] = Field(
        default_factory=lambda: [
            PressureZone(until_cm=26.5, pressure_psi=1.47),
            PressureZone(until_cm=35.3, pressure_psi=1.01),
            PressureZone(until_cm=53.0, pressure_psi=0.49),
        ],
        min_length=1,
        max_length=3,
    )

    @model_validator(mode="after")
    def _zones_ascend(self) -> Self:
        ends = [zone.until_cm for zone in self.zones]
        if ends != sorted(set(ends)):
            raise ValueError("body.zones: until_cm must ascend")
        if ends[-1] < self.length_cm:
            raise ValueError("body.zones: the last zone must reach body.length_cm")
        return self

    @property
    def radius_cm(self) -> float:
        """Tube radius."""
        return self.diameter_cm / 2

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


class FlexSensor(Model):
    """One flex sensor: reading = scale_per_ohm * (R - R at the last zeroing)."""

    center_cm: Positive
    span_cm: NonNegative = 5.5
    scale_per_ohm: Finite = 3.5e-5  # 1/cm per ohm; sign included, so that left bends read positive
    scale_se: NonNegative = 0.15  # relative; resistances differ by 30 % from part to part
    zero_ohm: Positive = 12_000.0  # flat resistance, a start value: zeroing re-measures it
    zero_se: NonNegative = 3.6e-4  # 1/cm, what zeroing and averaging leave: its loop, slow drift
    valid_direction: Literal[-1, 0, 1] = 0  # the bending direction it answers to; 0 = both
    noise: NonNegative = 4.8e-4  # 1/cm, white, of an averaged reading; 6e-4 with `zero_se`
    settle_tau_s: Positive = 8.0  # decay after eversion
    settle_amplitude: Finite = 0.0  # 1/cm at eversion
    healthy: bool = True  # false: dead, never used


def _default_column() -> list[FlexSensor]:
    return [FlexSensor(center_cm=center) for center in (5.0, 15.0, 25.0, 35.0, 45.0)]


class Sensors(Model):
    """Both columns of flex sensors and their divider."""

    pitch_cm: Positive = 10.0  # pouch length: growth stops only at whole multiples of it
    divider_ohm: Positive = 22_000.0
    settle_s: NonNegative = 30.0  # thesis: no reading within 30 s of eversion
    left: list[FlexSensor] = Field(default_factory=_default_column)
    right: list[FlexSensor] = Field(default_factory=_default_column)

    def column(self, side: Side) -> list[FlexSensor]:
        """Sensors of one side, base to tip."""
        return self.left if side == "left" else self.right


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


def _default_zone_maps() -> list[ZoneMap]:
    return [ZoneMap(body_pressure_psi=p) for p in (1.47, 1.01, 0.49)]


class Actuator(Model):
    """One pneumatic muscle with its transducer and pressure sensor."""

    max_pressure_psi: Positive = 18.0
    lag_s: NonNegative = 0.2  # measured pressure to bend
    reversal_psi: Positive = 1.0  # pressure change over which the branch moves inflate <-> deflate
    offset_se: NonNegative = 1e-3  # 1/cm: error that all readings of a side share
    maps: list[ZoneMap] = Field(default_factory=_default_zone_maps)


class Actuators(Model):
    """Both muscles."""

    left: Actuator = Field(default_factory=Actuator)
    right: Actuator = Field(default_factory=Actuator)

    def side(self, side: Side) -> Actuator:
        """The muscle of one side."""
        return self.left if side == "left" else self.right


class Spool(Model):
    """Motorised spool. Base-fed eversion pays out `payout_ratio` cm of tail per cm of growth."""

    counts_per_cm: Positive = 76.0  # x4 encoder counts per cm of line
    payout_ratio: Positive = 2.0
    max_speed_cm_s: Positive = 2.0  # of the tip
    acceleration_cm_s2: Positive = 4.0
    line_speed_cm_s: Positive = 23.6  # of the line at full duty, without load
    stall_n: Positive = 147.0  # pull on the line at which full duty stalls
    line_rating_n: Positive = 100.0  # what line and tail may be pulled with
    brake: bool = False  # a spring-applied brake, and contacts in the motor's supply


class RobotConfig(Model):
    """The whole of robot.toml."""

    version: Literal[1] = 1
    name: str = "vine-53"
    body: Body = Field(default_factory=Body)
    sensors: Sensors = Field(default_factory=Sensors)
    actuators: Actuators = Field(default_factory=Actuators)
    spool: Spool = Field(default_factory=Spool)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for side in SIDES:
            for index, sensor in enumerate(self.sensors.column(side)):
                if sensor.center_cm + sensor.span_cm / 2 > self.body.length_cm + 1e-6:
                    raise ValueError(f"sensors.{side}[{index}] ends beyond body.length_cm")
            maps = self.actuators.side(side).maps
            if len(maps) != len(self.body.zones):
                raise ValueError(f"actuators.{side}.maps: one map for each of body.zones is needed")
        return self

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read and validate a robot.toml.

        Raises:
            ConfigError: unreadable file, malformed TOML, unknown key or bad value (which is named).
        """
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
        ConfigError: the file is missing, malformed or invalid.
    """
    return validated(model, read_toml(path), path)


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        ConfigError: the file is missing or malformed.
    """
    try:
        return tomllib.loads(Path(path).read_bytes().decode())
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}", "check the path") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path} is not valid TOML: {error}", "mend that line") from error


def validated(model: type[M], data: dict[str, Any], path: str | os.PathLike[str]) -> M:
    """Make a model of data that came from a file.

    Raises:
        ConfigError: an entry is invalid; it is named, and so is the file.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ConfigError(invalid_entry(path, error), "correct that entry") from error


def invalid_entry(path: str | os.PathLike[str], error: ValidationError) -> str:
    """What is wrong with a file's first invalid entry, which is named."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    return f"{path}: {where + ': ' if where else ''}{first['msg'].removeprefix('Value error, ')}"
