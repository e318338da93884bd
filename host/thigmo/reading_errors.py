"""What calibration says the readings of one stage may be off by, as the localizer takes it.

Used by explorations, studies and the command line: robot.toml holds the standard errors, a stage
picks the muscle, the pressure zone and the sensors. It does not import the localizer; the names are
those of its arguments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from thigmo.config import SAME_IMU_CM, FibreSensor, HeadingSensor, RobotConfig, Sensor, Side
from thigmo.errors import DataError

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
    critical_curvature: float  # contact moment over EI at which the base folds, at this zone
    critical_curvature_error: float  # relative
    tube_radius: float  # cm
    stiffness: tuple[float, float] | None  # EI in N cm^2, and its relative standard error
    shared_errors: Floats | None  # (N, K) what sensors share with each other, if they do

    def arguments(self) -> dict[str, Any]:
        """Keywords of `thigmo.localize`; nothing holds the end of a robot that everts."""
        stated = {each.name: getattr(self, each.name) for each in fields(self)}
        return {"held_end": False} | SETTLED | stated


def imus_of(sensors: Sequence[HeadingSensor]) -> tuple[Floats, npt.NDArray[np.intp]]:
    """Places (k,) of IMUs, cm, and the numbers (n, 2) of those where each span begins and ends.

    Spans that meet share one. A place of 0 is the base, which does not turn, and no IMU.
    """
    ends = np.array([sensor.ends_cm for sensor in sensors]).reshape(-1, 2)
    ascending = np.sort(ends, axis=None)
    places = ascending[np.diff(ascending, prepend=-np.inf) > SAME_IMU_CM]
    return places, np.searchsorted(places, ends + SAME_IMU_CM) - 1


def shared_errors(sensors: Sequence[Sensor | None]) -> Floats:
    """What sensors share, at one standard error: (N, K) columns, 1/cm.

    An IMU stands between two turns: what it drifts by is in both, with opposite signs. What the
    temperature adds is in all gratings of a fibre alike.
    """
    turning = {n: s for n, s in enumerate(sensors) if isinstance(s, HeadingSensor)}
    places, imus = imus_of([*turning.values()])
    columns = np.zeros((len(sensors), len(places)))
    for (row, sensor), ends in zip(turning.items(), imus, strict=True):
        columns[row, ends] = np.array([-1.0, 1.0]) * sensor.heading_se_rad / sensor.span_cm
    columns = columns[:, places > SAME_IMU_CM]
    warm = [[s.temperature_se if isinstance(s, FibreSensor) else 0.0] for s in sensors]
    return np.hstack([columns, warm]) if np.any(warm) else columns


def reading_errors(
    config: RobotConfig, side: Side | None, zone: int, sensors: Sequence[tuple[Side, int]]
) -> ReadingErrors:
    """Errors of one stage's readings.

    Args:
        config: robot.toml.
        side: inflated muscle; None where the body is straight and pushed.
        zone: index of the body-pressure zone.
        sensors: (column, index from the base) of each reading.

    Raises:
        DataError: a sensor or a zone that robot.toml does not have.
    """
    for column, index in sensors:
        if not 0 <= index < len(config.column(column)):
            raise DataError(f"robot.toml has no sensor {column} {index}", "count from the base, 0")
    return errors_of(config, side, zone, [config.column(column)[n] for column, n in sensors])


def errors_of(
    config: RobotConfig, side: Side | None, zone: int, found: Sequence[Sensor]
) -> ReadingErrors:
    """As `reading_errors`, of sensors of any kind that robot.toml has."""
    body = config.body
    if not 0 <= zone < len(body.zones):
        raise DataError(f"robot.toml has no pressure zone {zone}", "count body.pressure from 0")
    ratio = body.zones[zone].pressure_psi / body.critical_pressure_psi
    muscle = None if side is None else config.muscle(side)
    shared = shared_errors(found)
    return ReadingErrors(
        noise=np.array([sensor.noise for sensor in found]),
        zero_error=np.array([sensor.zero_error for sensor in found]),
        gain_error=np.array([sensor.gain_error for sensor in found]),
        offset_error=0.0 if muscle is None else muscle.offset_se,
        map_error=0.0 if muscle is None else muscle.maps[zone].scale_se,
        critical_curvature=body.critical_curvature * ratio,
        critical_curvature_error=float(
            np.hypot(
                body.critical_curvature_se / body.critical_curvature,
                _FOLD_LAW_SE * np.log(ratio),
            )
        ),
        tube_radius=body.radius_cm,
        stiffness=body.stiffness,
        shared_errors=shared if shared.size else None,
    )
