"""What calibration says the readings of one stage may be off by, as the localizer takes it.

Used by explorations, studies and the command line: robot.toml holds the standard errors, a stage
picks the muscle, the body pressure and the sensors. It does not import the localizer; the names are
those of its arguments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import inf
from typing import Any

import numpy as np
import numpy.typing as npt

from thigmo.config import RobotConfig, Sensor, Side
from thigmo.errors import DataError
from thigmo.sensors import KINDS

Floats = npt.NDArray[np.float64]

# What calibrating a robot settles beside the standard errors: mistakes that `localize` need not
# weigh. Noise is averaged over a frame, so it may still exceed what calibration measured.
SETTLED: dict[str, Any] = {
    "largest_noise_factor": 2.4,
    "noise_correlation": 0.0,
    "base_fold_error": 0.0,
    "contact_couple_odds": 0.0,
}

# A fold's moment goes with body pressure; for one e times another than measured, so far [a guess].
_FOLD_LAW_SE = 0.05


@dataclass(frozen=True, slots=True)
class ReadingErrors:
    """Standard errors of a stage's N readings; 1/cm, or relative where it says so."""

    noise: Floats  # (N,) white noise of an averaged reading: new in every frame
    zero_error: Floats  # (N,) of each sensor's zero: the same in all frames between two zeroings
    gain_error: Floats  # (N,) relative, of each sensor's scale: the same in all frames
    offset_error: float  # of an offset that the readings share
    map_error: float  # relative, of the map's free curvature; 0 where no muscle bends the body
    critical_curvature: float  # contact moment over EI at which the base folds, at this pressure
    critical_curvature_error: float  # relative
    tube_radius: float  # cm
    stiffness: tuple[float, float] | None  # EI in N cm^2, and its relative standard error
    shared_errors: Floats | None  # (N, K) what sensors share with each other, if they do

    def arguments(self) -> dict[str, Any]:
        """Keywords of `thigmo.localize`; nothing holds the end of a robot that everts."""
        stated = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return {"held_end": False} | SETTLED | stated


def shared_errors(sensors: Sequence[Sensor | None]) -> Floats:
    """What sensors share with others of their kind, at one standard error: (N, K) columns, 1/cm."""
    blocks = []
    for kind in KINDS.values():
        members = {n: sensor for n, sensor in enumerate(sensors) if isinstance(sensor, kind)}
        columns = kind.shared_errors([*members.values()])
        block = np.zeros((len(sensors), columns.shape[1]))
        block[[*members]] = columns
        blocks.append(block)
    return np.hstack(blocks)


def reading_errors(
    config: RobotConfig, side: Side | None, body_pressure: int, sensors: Sequence[tuple[Side, int]]
) -> ReadingErrors:
    """Errors of one stage's readings.

    Args:
        config: robot.toml.
        side: inflated muscle; None where the body is straight and pushed.
        body_pressure: its number, from 0.
        sensors: (column, index from the base) of each reading.

    Raises:
        DataError: a sensor or a body pressure that robot.toml does not have.
    """
    for column, index in sensors:
        if not 0 <= index < len(config.column(column)):
            raise DataError(f"robot.toml has no sensor {column} {index}", "count from the base, 0")
    return errors_of(
        config, side, body_pressure, [config.column(column)[n] for column, n in sensors]
    )


def errors_of(
    config: RobotConfig, side: Side | None, body_pressure: int, sensors: Sequence[Sensor]
) -> ReadingErrors:
    """As `reading_errors`, of sensors of any kind that robot.toml has."""
    body = config.body
    if not 0 <= body_pressure < len(body.pressures):
        raise DataError(
            f"robot.toml has no body pressure {body_pressure}", "count body.pressure from 0"
        )
    critical, critical_error = inf, 0.0
    if body.folds:
        ratio = body.pressures[body_pressure].pressure_psi / body.critical_pressure_psi
        critical = body.critical_curvature * ratio
        measured_error = body.critical_curvature_se / body.critical_curvature
        critical_error = float(np.hypot(measured_error, _FOLD_LAW_SE * np.log(ratio)))
    muscle = None if side is None else config.muscle(side)
    shared = shared_errors(sensors)
    return ReadingErrors(
        noise=np.array([sensor.noise for sensor in sensors]),
        zero_error=np.array([sensor.zero_error for sensor in sensors]),
        gain_error=np.array([sensor.gain_error for sensor in sensors]),
        offset_error=0.0 if muscle is None else muscle.offset_se,
        map_error=0.0 if muscle is None else muscle.maps[body_pressure].scale_se,
        critical_curvature=critical,
        critical_curvature_error=critical_error,
        tube_radius=body.radius_cm,
        stiffness=body.stiffness,
        shared_errors=shared if shared.size else None,
    )
