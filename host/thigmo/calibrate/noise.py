"""Noise at rest and within a sweep (docs/methods.md, Noise)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from thigmo.calibrate.columns import places_of
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import RobotConfig, Side
from thigmo.errors import DataError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SensorNoise:
    """One sensor at rest."""

    # side, index: which sensor
    side: Side
    index: int
    white: float  # one sigma of a reading, 1/cm
    white_se: float  # its standard error
    drift_per_min: float  # slope at rest, 1/cm a minute
    slow: float  # scatter beyond white noise of ten-reading means, 1/cm
    hysteresis: float  # half the gap between rising and falling pressure, 1/cm (nan = unknown)
    dropouts: float  # share of wild readings


@dataclass(frozen=True)
class NoiseResult(StepResult):
    """All sensors."""

    sensors: tuple[SensorNoise, ...]
    verdict: Verdict

    def write(self, config: RobotConfig) -> None:
        """White noise, and what no average takes away."""
        for s in self.sensors:
            sensor = config.sensors.column(s.side)[s.index]
            if np.isfinite(s.white) and s.white > 0 and sensor.healthy:
                sensor.noise = s.white
                # Rest shows drift, bends show the loop: flex may have seen more of both.
                lasting = float(np.hypot(s.slow, np.nan_to_num(s.hysteresis)))
                sensor.zero_se = max(sensor.zero_se, lasting)


def fit_noise(
    t_s: Array,
    curvature: Array,
    config: RobotConfig,
    *,
    rising: Array | None = None,
    falling: Array | None = None,
) -> NoiseResult:
    """Noise of every sensor.

    Args:
        t_s: (n,) times of averaged readings of the resting robot.
        curvature: (n, m) readings, 1/cm.
        config: for the sensors' names.
        rising: (s, m) readings at a pressure, rising.
        falling: (s, m) readings at the same pressures, falling.

    Raises:
        DataError: fewer than 20 readings, or columns that disagree with the configuration.
    """
    sensors = places_of(config)
    y = np.asarray(curvature, float)
    if y.ndim != 2 or y.shape[1] != len(sensors) or len(y) != len(t_s):
        raise DataError(f"{y.shape} readings for {len(sensors)} sensors", "use this robot's file")
    if len(y) < 20:
        raise DataError(f"{len(y)} readings at rest", "record 20 or more")
    t_s, found, notes = np.asarray(t_s, float), [], []
    for column, (side, k) in enumerate(sensors):
        finite = np.isfinite(y[:, column]) & np.isfinite(t_s)
        if finite.sum() < 20:
            notes.append(f"sensor {side} {k} (0 = at the base) gives no readings: check its wire")
            continue
        own, middle = y[finite, column], np.median(y[finite, column])
        calm = np.abs(own - middle) < 6 * max(median_abs_deviation(own, scale="normal"), 1e-12)
        t, quiet = t_s[finite][calm], own[calm]
        # Differences of neighbours know nothing of drift.
        white = float(np.sqrt(np.mean(np.diff(quiet) ** 2) / 2))
        line = np.polyfit(t, quiet, 1)
        drift, level = float(line[0]) * 60, quiet - np.polyval(line, t)
        blocks = level[: len(level) // 10 * 10].reshape(-1, 10).mean(axis=1)
        extra = float(blocks.var(ddof=1)) - white**2 / 10 if len(blocks) > 2 else 0.0
        gap = float("nan")
        if rising is not None and falling is not None:
            gap = abs(float(np.nanmedian(falling[:, column] - rising[:, column]))) / 2
        sensor = SensorNoise(
            side, k, white, white * float(np.sqrt(3 / (4 * len(quiet)))), drift,
            slow=float(np.sqrt(extra)) if extra > white**2 / 10 else 0.0,
            hysteresis=gap, dropouts=float(1 - calm.mean()),
        )  # fmt: skip
        found.append(sensor)
        if sensor.dropouts > 0.05:
            notes.append(f"{side} {k}: {100 * sensor.dropouts:.0f} % wild readings; check its wire")
        if abs(drift) > max(5e-4, 4 * 60 * white / float(np.sqrt(len(quiet)) * t.std())):
            notes.append(f"{side} {k} drifts by {drift:.4f} 1/cm a minute; wait for it to settle")
    return NoiseResult(tuple(found), _verdict(found, notes))


def _verdict(found: Sequence[SensorNoise], notes: list[str]) -> Verdict:
    if not found:
        return Verdict(False, "no sensor gives readings; check wiring", tuple(notes))
    loud = [s for s in found if s.white > 2e-3]
    worst = max(found, key=lambda s: s.white)
    if len(loud) > len(found) / 2:
        return Verdict(
            False,
            f"most readings scatter by more than 0.002 1/cm (worst {worst.white:.4f}): average "
            "longer, or look for interference",
            tuple(notes),
        )
    notes.extend(f"{s.side} {s.index} is loud: {s.white:.4f} 1/cm" for s in loud)
    typical = float(np.median([s.white for s in found]))
    return Verdict(True, f"white noise {typical:.5f} 1/cm a reading (median)", tuple(notes))
