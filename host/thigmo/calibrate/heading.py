"""IMUs: zero, alignment and drift of the turn from each to the next, by free bends.

In a free bend every span turns by curvature times span. The turn that the IMUs measure differs by
their alignment and gain, and drifts while the bends are taken. A line in curvature and time is
fitted for each span: its slopes give `scale` and the drift, its constant is the turn measured on
the straight body. The drift of a span is that of two IMUs, each of which neighbouring spans share.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from thigmo.calibrate.bench import Bench, last_bends
from thigmo.calibrate.columns import Array, column, mark_health, of_sensors, sensors_of
from thigmo.calibrate.overhead import CAMERA_SCALE_SE
from thigmo.calibrate.regression import fit_linear
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import RAD_PER_OHM, HeadingSensor, RobotConfig
from thigmo.errors import DataError
from thigmo.record.table import Table

_FEWEST = 8  # bends
_FROM_ZERO_S = 20.0  # time from the zeros to a sweep's last peak
_LEAST_RAD = 2e-4


@dataclass(frozen=True)
class HeadingFit:
    """One span's calibration."""

    name: str
    healthy: bool
    reason: str
    scale: float = 1.0  # true turn over the IMUs' turn
    scale_se: float = np.inf  # relative standard error of the scale
    zero_rad: float = 0.0  # the IMUs' turn of the straight body
    drift_rad_s: float = np.nan
    noise_rad: float = np.nan  # standard deviation of a reading about the line
    turns: Array = field(default_factory=lambda: np.zeros((2, 0)))  # by camera, and by its IMUs


@dataclass(frozen=True)
class HeadingResult(StepResult):
    """Results of all spans, and the error of one IMU's heading when a sweep is measured."""

    sensors: tuple[HeadingFit, ...]
    heading_se_rad: float
    verdict: Verdict

    def as_data(self) -> dict[str, Any]:
        """Plain data, without the turns that only the figure needs."""
        data = super().as_data()
        for fit in data["sensors"]:
            del fit["turns"]
        return data

    def write(self, config: RobotConfig) -> None:
        """Store scales, zeros, drift and health; a dead span keeps its old constants."""
        for fit, sensor in mark_health(config, self.sensors, HeadingSensor):
            sensor.scale, sensor.scale_se = fit.scale, fit.scale_se
            sensor.zero_rad, sensor.heading_se_rad = fit.zero_rad, self.heading_se_rad


def guided(bench: Bench) -> HeadingResult:
    """Fit the free bends of the last body pressure, after taking those that are missing."""
    bends = last_bends(bench)
    return fit_heading(column(bends, "t_s"), column(bends, "k"), column(bends, "ohm"), bench.config)


def of_csv(table: Table, config: RobotConfig) -> HeadingResult:
    """Fit free bends from a CSV: time, curvature by camera, and the reader's value of each span."""
    resistance = of_sensors(table, "ohm", config)
    return fit_heading(table.numbers("t_s"), table.numbers("curvature"), resistance, config)


def fit_heading(t_s: Array, curvature: Array, ohm: Array, config: RobotConfig) -> HeadingResult:
    """Fit all spans of IMUs to free bends: times (n,), curvatures (n,), 1/cm, readings (n, m)."""
    measured = np.isfinite(t_s) & np.isfinite(curvature)
    if measured.sum() < _FEWEST or np.ptp(curvature[measured]) < 1e-3:
        raise DataError(
            f"{int(measured.sum())} free bends that the camera saw",
            f"take {_FEWEST} and more, apart",
        )
    fits = []
    for number, (name, sensor) in enumerate(sensors_of(config).items()):
        if isinstance(sensor, HeadingSensor):
            usable = measured & np.isfinite(ohm[:, number])
            turn = (ohm[usable, number] - HeadingSensor.straight_ohm) * RAD_PER_OHM
            fits.append(_fit(name, t_s[usable], curvature[usable] * sensor.span_cm, turn))
    good = [fit for fit in fits if fit.healthy]
    notes = [f"{fit.name} {fit.reason}" for fit in fits if not fit.healthy]
    if not good:
        return HeadingResult(
            tuple(fits), np.nan, Verdict(False, "no span of IMUs can be used", tuple(notes))
        )
    # Drift and scatter of a span are those of two IMUs.
    drift = np.sqrt(np.mean([fit.drift_rad_s**2 for fit in good]) / 2)
    scatter = np.sqrt(np.median([fit.noise_rad**2 for fit in good]) / 2)
    heading_se = max(float(np.hypot(drift * _FROM_ZERO_S, scatter)), _LEAST_RAD)
    worst = max(good, key=lambda fit: fit.scale_se)
    reason = (
        f"{len(good)} of {len(fits)} spans; scales known to {100 * worst.scale_se:.1f} % at worst; "
        f"IMUs drift by {np.degrees(drift) * 60:.2f} degrees a minute"
    )
    return HeadingResult(tuple(fits), heading_se, Verdict(True, reason, tuple(notes)))


def _fit(name: str, t_s: Array, true_turn: Array, turn: Array) -> HeadingFit:
    """Fit one span to turns by its IMUs and by the camera: `turn` and `true_turn` (n,), rad."""
    if len(turn) < _FEWEST:
        return HeadingFit(name, False, "is not read: an IMU of it does not answer")
    elapsed_s = t_s - t_s.mean()
    line = fit_linear(np.column_stack([np.ones_like(true_turn), elapsed_s, true_turn]), turn)
    zero, drift, slope = line.coefficients.tolist()
    if slope < 0.5:
        problem = (
            "turns the other way: turn it round" if slope < -0.5 else "does not turn with bends"
        )
        return HeadingFit(name, False, f"{problem}; check how its IMUs lie")
    se = float(np.hypot(line.se(2) / slope, CAMERA_SCALE_SE))
    if se > 0.1:
        return HeadingFit(name, False, f"has a scale known to {100 * se:.0f} % only")
    return HeadingFit(
        name, True, f"scale known to {100 * se:.1f} %",
        1.0 / slope, se, zero, drift, line.sigma,
        np.array([true_turn, turn - zero - drift * elapsed_s]),
    )  # fmt: skip
