"""Noise at rest and within a sweep (docs/methods.md, Noise)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thigmo.calibrate.bench import Bench, Row
from thigmo.calibrate.columns import (
    Array,
    column,
    constants_of,
    medians,
    of_sensors,
    places_of,
    sensors_of,
)
from thigmo.calibrate.regression import outlying
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import FlexSensor, RobotConfig
from thigmo.errors import DataError
from thigmo.record.table import Table

_PEAK_S = 0.05


@dataclass(frozen=True)
class SensorNoise:
    """One sensor at rest."""

    name: str
    white: float  # standard deviation of a reading's white noise, 1/cm
    white_se: float  # its standard error, 1/cm
    drift_per_min: float  # slope at rest, 1/cm a minute
    slow: float  # scatter of ten-reading means beyond white noise, 1/cm
    hysteresis: float  # half the gap between rising and falling pressure, 1/cm (nan = unknown)
    dropouts: float  # share of wild readings


@dataclass(frozen=True)
class NoiseResult(StepResult):
    """All sensors."""

    sensors: tuple[SensorNoise, ...]
    verdict: Verdict

    def write(self, config: RobotConfig) -> None:
        """Put in white noise, and the errors that averaging does not reduce."""
        sensors = sensors_of(config)
        for s in self.sensors:
            sensor = sensors[s.name]
            # Neighbouring IMUs share their scatter, which the step `heading` measures.
            if not isinstance(sensor, FlexSensor):
                continue
            if np.isfinite(s.white) and s.white > 0 and sensor.healthy:
                sensor.noise = s.white
                # Rest shows the drift and bends the loop; the flex step may have found more.
                lasting = float(np.hypot(s.slow, np.nan_to_num(s.hysteresis)))
                sensor.zero_se = max(sensor.zero_se, lasting)


def guided(bench: Bench) -> NoiseResult:
    """Measure noise at rest, and hysteresis within a sweep from the bends if they were taken."""

    def take(key: str, _: None) -> Row:
        # A sweep's peak is averaged for as long.
        reading = bench.robot.read(_PEAK_S)
        bench.robot.wait(0.5)
        return {"t_s": reading.t_s, "ohm": bench.ohm(reading)}

    planned = {f"rest {n}": None for n in range(bench.plan.rest_readings)}
    rows = bench.rows("rest", planned, take)
    (scale,) = constants_of(bench.config, "raw_scale")
    ohm = column(rows, "ohm")
    level = (ohm - np.nanmedian(ohm, axis=0)) * scale
    return fit_noise(column(rows, "t_s"), level, bench.config, _loops(bench, scale))


def _loops(bench: Bench, scale: Array) -> Array | None:
    """(s, m) falling less rising deviation from the camera at equal set points, 1/cm."""
    rows, gaps = bench.session.rows("bends"), []
    lies = np.array([side for side, _ in places_of(bench.config)])
    for key, row in rows.items():
        twin = rows.get(key.replace("inflate", "deflate"))
        if row["branch"] != "inflate" or twin is None or row["k"] is None or twin["k"] is None:
            continue
        up, down = column([row, twin], "ohm") * scale - column([row, twin], "k")[:, None]
        # The active side wrinkles.
        up[lies == row["side"]] = np.nan
        gaps.append(down - up)
    return np.array(gaps) if len(gaps) >= 4 else None


def of_csv(table: Table, config: RobotConfig) -> NoiseResult:
    """Fit readings of the resting robot from a CSV."""
    return fit_noise(table.numbers("t_s"), of_sensors(table, "curvature", config), config)


def fit_noise(
    t_s: Array, curvature: Array, config: RobotConfig, loops: Array | None = None
) -> NoiseResult:
    """Noise of every sensor from averaged readings (n, m) of the resting robot, 1/cm.

    `loops` (s, m) holds readings at falling pressure less those at rising pressure, 1/cm.
    """
    sensors = sensors_of(config)
    if curvature.shape != (len(t_s), len(sensors)):
        shapes = f"{curvature.shape} readings for {len(sensors)} sensors"
        raise DataError(shapes, "use this robot's file")
    if len(t_s) < 20:
        raise DataError(f"{len(t_s)} readings at rest", "record 20 or more")
    gap = np.full(len(sensors), np.nan) if loops is None else np.abs(medians(loops)) / 2
    noises: list[SensorNoise] = []
    notes: list[str] = []
    for number, name in enumerate(sensors):
        finite = np.isfinite(curvature[:, number]) & np.isfinite(t_s)
        if finite.sum() < 20:
            notes.append(f"sensor {name} (0 = at the base) gives no readings: check its wire")
            continue
        values = curvature[finite, number]
        calm = ~outlying(values, 6, 1e-12)
        t, quiet = t_s[finite][calm], values[calm]
        # Differences of successive readings are free of drift.
        white = float(np.sqrt(np.mean(np.diff(quiet) ** 2) / 2))
        line = np.polyfit(t, quiet, 1)
        drift, level = float(line[0]) * 60, quiet - np.polyval(line, t)
        blocks = level[: len(level) // 10 * 10].reshape(-1, 10).mean(axis=1)
        extra = float(blocks.var(ddof=1)) - white**2 / 10 if len(blocks) > 2 else 0.0
        sensor = SensorNoise(
            name, white, white * float(np.sqrt(3 / (4 * len(quiet)))), drift,
            slow=float(np.sqrt(extra)) if extra > white**2 / 10 else 0.0,
            hysteresis=float(gap[number]),
            dropouts=float(1 - calm.mean()),
        )  # fmt: skip
        noises.append(sensor)
        if sensor.dropouts > 0.05:
            notes.append(f"{name}: {100 * sensor.dropouts:.0f} % wild readings; check its wire")
        if abs(drift) > max(5e-4, 4 * 60 * white / float(np.sqrt(len(quiet)) * t.std())):
            notes.append(f"{name} drifts by {drift:.4f} 1/cm a minute; wait for it to settle")
    loud = [s for s in noises if s.white > 2e-3]
    good = False
    if not noises:
        reason = "no sensor gives readings; check wiring"
    elif len(loud) > len(noises) / 2:
        worst = max(s.white for s in noises)
        reason = (
            f"most readings scatter by more than 0.002 1/cm (worst {worst:.4f}): average longer, "
            "or look for interference"
        )
    else:
        notes.extend(f"{s.name} is loud: {s.white:.4f} 1/cm" for s in loud)
        typical = float(np.median([s.white for s in noises]))
        good, reason = True, f"white noise {typical:.5f} 1/cm a reading (median)"
    return NoiseResult(tuple(noises), Verdict(good, reason, tuple(notes)))
