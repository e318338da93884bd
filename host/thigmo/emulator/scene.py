"""Scene files: the true robot, the room around it, and all that is wrong with both.

A scene is TOML. Everything has a default, so the shortest scene is an empty file: the robot of
`RobotConfig` in an empty room. `extends = "default"` starts from another scene: tables are merged,
lists (pegs, faults, sensors, pressures, maps) are replaced. `scenes/default.toml` shows every key
with its source; what is a guess is marked [G] there. `robot` holds the *true* constants; `belief`
says how far the host's robot.toml is off. Lengths in cm, pressures in psi, curvature in 1/cm, time
in s.
"""

from __future__ import annotations

from math import hypot
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from thigmo.config import (
    SIDES,
    FlexSensor,
    HeadingSensor,
    RobotConfig,
    Side,
)
from thigmo.errors import ConfigError
from thigmo.mechanics import Peg, Wall
from thigmo.toml_model import Finite, Model, NonNegative, Positive, read_toml, validated
from thigmo.wiring import beyond_board

SCENES = Path(__file__).parent / "scenes"


class Yields(Model):
    """How an obstacle gives under a force over EI."""

    compliance_cm3: NonNegative = 0.0  # cm for each 1/cm^2: of a post that leans, or of foam
    gives_way: Positive | None = None  # 1/cm^2 beyond which it is gone for good; none: it stands


class PegTable(Yields):
    """A round peg."""

    x: Finite
    y: Finite
    radius: Annotated[float, Field(ge=0.05, le=100, allow_inf_nan=False)]


class WallTable(Yields):
    """A straight wall with round ends: all within a radius of the line between two points."""

    x: Finite
    y: Finite
    end_x: Finite
    end_y: Finite
    radius: Annotated[float, Field(ge=0.05, le=10, allow_inf_nan=False)] = 0.25

    @model_validator(mode="after")
    def _has_a_length(self) -> Self:
        if hypot(self.end_x - self.x, self.end_y - self.y) < self.radius:
            raise ValueError("a wall must be longer than its radius; a shorter one is a peg")
        return self

    def clear_of_base(self, half_width: float) -> bool:
        """Whether it stays clear of a body of this half width where it leaves the base."""
        share = np.linspace(0.0, 1.0, 400)
        x = self.x + share * (self.end_x - self.x)
        y = self.y + share * (self.end_y - self.y)
        gap = np.maximum(np.abs(y) - half_width, 0.0)
        return bool(np.hypot(x, gap).min() >= self.radius)


class Noise(Model):
    """The three parts of the sensors' noise (docs/methods.md), and the pressure sensors'."""

    white_counts: NonNegative = 1.0  # one sigma of one conversion, in ADC counts
    pressure_counts: NonNegative = 0.5
    hysteresis: NonNegative = 3e-4  # 1/cm, one sigma over sensors of the loop's half width
    hysteresis_width: Positive = 5e-3  # 1/cm of bending that turns the loop around
    per_eversion: NonNegative = 2e-3  # 1/cm, one sigma of the offset drawn at each eversion


class Transducer(Model):
    """Current-to-pressure transducer and the pressure sensor at its outlet."""

    at_4ma_psi: NonNegative = 2.0
    at_20ma_psi: Positive = 60.0
    lag_s: Positive = 0.15
    delay_s: NonNegative = 0.03
    gain_error: NonNegative = 0.01  # one sigma over units
    hysteresis_psi: NonNegative = 0.1  # play, half width
    slew_psi_s: Positive = 30.0
    supply_psi: Positive = 70.0
    sensor_full_psi: Positive = 60.0
    sensor_zero_error_psi: NonNegative = 0.05  # one sigma over units, after zeroing at vent


class Muscle(Model):
    """From pressure to bend."""

    inflate_tau_s: Positive = 0.16
    deflate_tau_s: Positive = 0.22
    delay_s: NonNegative = 0.033


class BodyDynamics(Model):
    """How the body swings, and how it grows."""

    frequency_hz: Positive = 1.5
    damping: Positive = 0.5
    growth_cm_s_psi: Positive = 30.0  # eversion speed per psi above that
    growth_force: NonNegative = 6.5e-3  # 1/cm^2 per psi: axial push at which the tip stalls
    fold: bool = True  # whether the base folds
    friction: Annotated[float, Field(ge=0, le=2)] = 0.0  # Coulomb's, between skin and obstacles
    base_compliance_cm: NonNegative = 0.0  # rad by which the base turns for each 1/cm of moment
    tip_rounding_cm: NonNegative = 0.0  # radius of the end's corners, at most the tube's


class Flex(Model):
    """Imperfections of every flex sensor."""

    # 1/cm just after eversion, one sigma over sensors; less in a tube thicker than 3.5 cm
    creep: NonNegative = 0.02
    against_gain: NonNegative = 0.6  # response to bends against bend_sign
    wrinkle: NonNegative = 0.012  # 1/cm, size of the garbage on the active side
    wrinkle_start_psi: NonNegative = 1.0
    wrinkle_full_psi: Positive = 4.0
    fold_bend: NonNegative = 0.15  # 1/cm, seen while the fold of a tip of 1.75 cm radius passes
    stowed: NonNegative = 0.01  # 1/cm, one sigma of the reading of a sensor inside the tail


class Imu(Model):
    """Imperfections of every IMU: a BNO080/085 without its magnetometer (data sheet, 2.2.2)."""

    drift_deg_min: NonNegative = 0.5  # one sigma over units
    walk_deg_root_s: NonNegative = 0.01  # angle random walk
    noise_deg: NonNegative = 0.05  # of one report
    seat_deg: NonNegative = 1.0  # how it comes to lie at each eversion


class Fibre(Model):
    """Imperfections of every fibre and its interrogator: guesses, except for the noise (1 pm)."""

    lines_hz: Annotated[float, Field(ge=1, le=100, allow_inf_nan=False)] = 50.0
    noise_ue: NonNegative = 0.8  # of one line
    walk_ue_root_s: NonNegative = 0.05  # of each grating's zero
    seat_ue: NonNegative = 5.0  # how a grating comes to lie at each eversion
    warming_k_min: NonNegative = 0.5  # ramp of the temperature, one sigma over rooms, and
    warm_k_root_s: NonNegative = 0.02  # its random walk; a kelvin is 1.1 microstrain in all alike
    dropout: Annotated[float, Field(ge=0, lt=1)] = 0.002  # share of peaks that a line lacks
    twist_deg: NonNegative = 2.0  # one sigma over robots


class SpoolMotor(Model):
    """The true motor behind the spool."""

    line_cm_s: Positive = 23.6  # no-load speed of the line at full duty
    lag_s: Positive = 0.07
    dead_zone: NonNegative = 60.0  # duty, of 800, that overcomes sliding friction
    stall_n: Positive = 147.0  # pull on the line at which full duty stalls
    touch_n_s_m: NonNegative = 450.0  # pull that a sudden stop adds for each m/s of line
    wiring: Literal[
        "right", "motor_swapped", "encoder_swapped", "both_swapped", "encoder_unplugged"
    ] = "right"
    winding: NonNegative = 0.0  # relative change of counts per cm for each cm of line wound


class Brake(Model):
    """The spool's spring-applied brake, where `[robot.spool] brake` says that there is one."""

    holds_n: Positive = 150.0  # pull on the line, at rest and while it slides
    closes_s: Positive = 0.04  # from the end of its current
    opens_s: Positive = 0.06
    contact_s: Positive = 0.015  # of the contacts in the motor's supply


class Supply(Model):
    """Electric supply of the board."""

    millivolt: Annotated[int, Field(gt=0, le=6000)] = 5000


class Belief(Model):
    """Errors of the host's robot.toml: one sigma of each; the seed draws them."""

    gain_spread: NonNegative = 0.0  # relative, of each sensor's scale
    position_spread_cm: NonNegative = 0.0  # of each sensor's centre
    curvature_error: NonNegative = 0.0  # relative, of each map's amplitude
    lag_error: NonNegative = 0.0  # relative
    critical_error: NonNegative = 0.0  # relative, of the critical curvature


class Enables(Model):
    """Valves that empty muscles and body unless the firmware holds them (docs/hardware/air.md)."""

    fitted: bool = False  # the thesis's robot has none
    body_empties_s: Positive = 0.4  # time constants: through the valve [C], and
    body_fills_s: Positive = 3.0  # through the throttle [G]


class OperatorTable(Model):
    """The emulated operator."""

    takes_s: NonNegative = 5.0  # to set the regulator
    length_error_cm: NonNegative = 0.0  # one sigma of a measured length


class PlantTable(Model):
    """Which mechanics, and how exact."""

    model: Literal["auto", "arc", "beam", "elastica"] = "auto"
    tolerance_cm: Positive = 0.05  # error in position that the automatic choice may make
    cell_cm: Annotated[float, Field(ge=0.1, le=5)] = 1.0


FaultKind = Literal[
    "flex_wire_cut",
    "flex_short",
    "flex_frozen",
    "flex_noisy",
    "imu_hung",
    "grating_lost",
    "grating_noisy",
    "interrogator_silent",
    "pressure_wire_cut",
    "pressure_short",
    "pressure_frozen",
    "pressure_gain",
    "pressure_offset",
    "pressure_noisy",
    "pressure_flickers",
    "pressure_chatters",
    "pressure_stuck",
    "over_pressure",
    "air_lost",
    "spool_stall",
    "spool_slip",
    "motor_lost",
    "motor_shorted",
    "encoder_lost",
    "encoder_share",
    "tail_jam",
    "line_snapped",
    "brake_open",
    "brake_closed",
    "contact_welded",
    "reference_off",
    "host_silent",
    "brown_out",
    "power_cut",
    "power_cut_saving",
    "estop",
    "hang",
]


class FaultTable(Model):
    """A fault to inject, from a moment or a condition on, for a while or for good.

    It begins when all given conditions are met at once.
    """

    kind: FaultKind
    at_s: NonNegative | None = None
    above_length_cm: NonNegative | None = None
    above_pressure_psi: NonNegative | None = None  # of either muscle
    while_motor_runs: bool = False
    duration_s: Positive | None = None  # none = for good
    side: Side = "left"  # of a pressure fault or sensor
    sensor: Annotated[int, Field(ge=0, le=255)] = 0  # base first; of a fibre the reading's number
    value: Finite | None = None  # see faults.py

    @model_validator(mode="after")
    def _has_a_beginning(self) -> Self:
        conditions = (self.at_s, self.above_length_cm, self.above_pressure_psi)
        if conditions == (None, None, None) and not self.while_motor_runs:
            raise ValueError("a fault needs at_s or a condition for its beginning")
        return self


class Scene(Model):
    """The whole of a scene file."""

    version: Literal[1] = 1
    extends: str | None = None  # scene, or path beside this file; its entries hold unless given
    name: str = "unnamed"
    about: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    start_length_cm: NonNegative = 0.0
    start_settled: bool = True  # sensors out at the start rested long ago
    robot: RobotConfig = Field(default_factory=RobotConfig)
    belief: Belief = Field(default_factory=Belief)
    pegs: list[PegTable] = Field(default_factory=list, max_length=64)
    walls: list[WallTable] = Field(default_factory=list, max_length=16)
    noise: Noise = Field(default_factory=Noise)
    transducer: Transducer = Field(default_factory=Transducer)
    muscle: Muscle = Field(default_factory=Muscle)
    body: BodyDynamics = Field(default_factory=BodyDynamics)
    flex: Flex = Field(default_factory=Flex)
    imu: Imu = Field(default_factory=Imu)
    fibre: Fibre = Field(default_factory=Fibre)
    spool: SpoolMotor = Field(default_factory=SpoolMotor)
    brake: Brake = Field(default_factory=Brake)
    supply: Supply = Field(default_factory=Supply)
    enables: Enables = Field(default_factory=Enables)
    operator: OperatorTable = Field(default_factory=OperatorTable)
    plant: PlantTable = Field(default_factory=PlantTable)
    faults: list[FaultTable] = Field(default_factory=list)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        radius = self.robot.body.radius_cm
        for index, peg in enumerate(self.pegs):
            side_cm = max(abs(peg.y) - radius, 0.0)
            if hypot(peg.x, side_cm) < peg.radius:
                raise ValueError(f"pegs[{index}] overlaps the robot's base at (0, 0)")
        for index, wall in enumerate(self.walls):
            if not wall.clear_of_base(radius):
                raise ValueError(f"walls[{index}] overlaps the robot's base at (0, 0)")
        if self.body.tip_rounding_cm > radius:
            raise ValueError("body.tip_rounding_cm exceeds the radius of robot.body")
        if self.start_length_cm > self.robot.body.length_cm:
            raise ValueError("start_length_cm exceeds robot.body.length_cm")
        for problem, cure in beyond_board(self.robot):
            raise ValueError(f"robot: {problem}; {cure}")
        return self

    @classmethod
    def load(cls, source: str | Path) -> Self:
        """Read a scene: the name of one that comes with the package, or a path to a TOML file."""
        path = _find(str(source))
        scene = validated(cls, _merged(path, ()), path)
        if scene.name == "unnamed":
            scene.name = path.stem
        return scene

    def save(self, path: str | Path) -> None:
        """Write the scene as TOML, with every entry that has a value."""
        self.write(path)

    def peg_list(self) -> tuple[Peg, ...]:
        """The pegs, for the mechanics."""
        return tuple(Peg(p.x, p.y, p.radius, p.compliance_cm3) for p in self.pegs)

    def wall_list(self) -> tuple[Wall, ...]:
        """The walls, for the mechanics."""
        return tuple(
            Wall(w.x, w.y, w.end_x, w.end_y, w.radius, w.compliance_cm3) for w in self.walls
        )

    def rescale_errors(self, factor: float) -> None:
        """Multiply the noise, and the errors of the lab's calibration; loops keep their width."""
        for part in (self.noise, self.belief):
            for attribute, value in part.model_dump().items():
                if attribute != "hysteresis_width":
                    setattr(part, attribute, value * factor)

    def believed(self, seed: int | None = None) -> RobotConfig:
        """The robot.toml that the scene's lab would have: the truth, with its errors drawn.

        That lab knows its errors: it states the spreads used here, and its sensors' loops.
        """
        rng = np.random.default_rng([self.seed if seed is None else seed, 0xBE11EF])
        config = self.robot.model_copy(deep=True)
        spread = self.belief
        begins: dict[float, float] = {}  # believed places of IMUs, by their true ones
        for side in SIDES:
            for sensor in config.column(side):
                gain = 1 + spread.gain_spread * rng.standard_normal()
                sensor.scale_se = spread.gain_spread
                sensor.center_se_cm = spread.position_spread_cm
                moved = spread.position_spread_cm * rng.standard_normal()
                sensor.rescale(gain)
                if isinstance(sensor, HeadingSensor):
                    first, last = sensor.ends_cm
                    start = begins.get(round(first, 3), first)
                    begins[round(last, 3)] = end = min(last + moved, config.body.length_cm)
                    # What an IMU lies off by makes one span longer, and the next one shorter.
                    end_error = 2**0.5 * spread.position_spread_cm / sensor.span_cm
                    sensor.scale_se = hypot(sensor.scale_se, end_error)
                    sensor.center_cm, sensor.span_cm = (start + end) / 2, end - start
                    continue
                if isinstance(sensor, FlexSensor):
                    sensor.zero_se = max(sensor.zero_se, self.noise.hysteresis)
                top = config.body.length_cm - sensor.span_cm / 2
                moved += sensor.center_cm
                sensor.center_cm = float(min(max(moved, sensor.span_cm / 2 + 1e-3), top))
            if side not in config.sides:
                continue
            muscle = config.muscle(side)
            muscle.lag_se_s = max(muscle.lag_se_s, spread.lag_error * muscle.lag_s)
            muscle.lag_s *= max(1 + spread.lag_error * rng.standard_normal(), 0.1)
            for muscle_map in muscle.maps:
                factor = 1 + spread.curvature_error * rng.standard_normal()
                muscle_map.scale_se = spread.curvature_error
                for curve in (muscle_map.inflate, muscle_map.deflate):
                    curve.amplitude *= factor
        for grating in config.gratings:
            grating.rescale(1 + spread.gain_spread * rng.standard_normal())
            grating.scale_se = spread.gain_spread
        body = config.body
        if body.folds:
            body.critical_curvature_se = spread.critical_error * body.critical_curvature
            body.critical_curvature *= max(1 + spread.critical_error * rng.standard_normal(), 0.1)
        return config


def _find(text: str) -> Path:
    """The file of a scene given by name or path."""
    if Path(text).suffix == ".toml":
        return Path(text)
    path = SCENES / f"{text}.toml"
    if Path(text).name != text or not path.is_file():
        names = ", ".join(sorted(p.stem for p in SCENES.glob("*.toml")))
        raise ConfigError(
            f"there is no scene named {text!r}",
            f"name one of {names}, or give the path of a .toml file",
        )
    return path


def _merged(path: Path, below: tuple[Path, ...]) -> dict[str, Any]:
    """A scene's entries over those of the scene that it extends."""
    if path in below:
        raise ConfigError(f"{path} extends itself", "remove that `extends`")
    data = read_toml(path)
    base = data.get("extends")
    if not isinstance(base, str):
        return data
    base_path = path.parent / base if base.endswith(".toml") else _find(base)
    start = {k: v for k, v in _merged(base_path, (*below, path)).items() if k not in _OWN}
    return _over(start, data)


_OWN = ("name", "about", "extends")  # never inherited


def _over(base: dict[str, Any], top: dict[str, Any]) -> dict[str, Any]:
    tables = {
        key: _over(base[key], value)
        for key, value in top.items()
        if isinstance(value, dict) and isinstance(base.get(key), dict)
    }
    return base | top | tables
