"""Creep after eversion: decay time and amplitude of each sensor, from records of it standing still.

Each record starts when the sensor has just everted. The compensation that uses the result is
`thigmo.mechanics.settling`, which also says how much noise it adds.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit, least_squares
from scipy.stats import median_abs_deviation

from thigmo.calibrate.columns import grouped, sides_of
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import RobotConfig, Side
from thigmo.errors import DataError
from thigmo.mechanics.settling import Settling
from thigmo.record.table import Table

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CreepRecord:
    """One sensor after one eversion."""

    # side, index: which sensor
    side: Side
    index: int
    t_s: Array  # (n,) since eversion
    curvature: Array  # (n,) readings, 1/cm

    @classmethod
    def read_all(cls, path: str | os.PathLike[str]) -> list[CreepRecord]:
        """From a CSV: side, index, eversion, t_s, curvature."""
        table = Table.read(path)
        keys = sides_of(table), table.whole("index").tolist(), table.whole("eversion", 0).tolist()
        t, k = table.numbers("t_s"), table.numbers("curvature")
        return [
            cls(side, index, t[rows], k[rows])
            for (side, index, _), rows in grouped(zip(*keys, strict=True))
        ]


@dataclass(frozen=True)
class CreepFit:
    """One sensor's law over its eversions."""

    # side, index: which sensor
    side: Side
    index: int
    law: Settling  # decay, with the spread from eversion to eversion
    usable_s: float  # when readings add less than their own noise, compensated
    good: bool  # the law may be used
    reason: str  # why


@dataclass(frozen=True)
class HysteresisResult(StepResult):
    """All sensors."""

    sensors: tuple[CreepFit, ...]
    verdict: Verdict
    records: tuple[CreepRecord, ...]
    EVIDENCE: ClassVar = ("records",)

    def as_data(self) -> dict[str, Any]:
        """Plain data; each sensor's law beside its use."""
        data = super().as_data()
        data["sensors"] = [{**fit.pop("law"), **fit} for fit in data["sensors"]]
        return data

    def write(self, config: RobotConfig) -> None:
        """Decay time and amplitude."""
        for fit in self.sensors:
            if fit.good:
                sensor = config.sensors.column(fit.side)[fit.index]
                sensor.settle_tau_s = fit.law.tau_s
                sensor.settle_amplitude = fit.law.amplitude


def fit_decay(t_s: Array, curvature: Array) -> tuple[Array, Array]:
    """tau, amplitude, rest (3,) of one record and their covariance (3, 3); outliers left out.

    Raises:
        DataError: fewer than ten readings, or a record shorter than 5 s.
    """
    finite = np.isfinite(t_s) & np.isfinite(curvature)
    t, y = t_s[finite], curvature[finite]
    if len(t) < 10 or np.ptp(t) < 5:
        raise DataError("the record is too short to see a decay", "record 30 s after eversion")

    def law(t: Array, log_tau: float, amplitude: float, rest: float) -> Array:
        return np.asarray(amplitude * np.exp(-t / np.exp(log_tau)) + rest)

    def residuals(x: Array) -> Array:
        return law(t, *x) - y

    spread = median_abs_deviation(np.diff(y), scale="normal") / np.sqrt(2) or 1e-9
    rest = float(np.median(y[t > t.min() + 0.7 * np.ptp(t)]))
    early = float(np.median(y[t < t.min() + 0.1 * np.ptp(t)]))
    starts = [[np.log(tau), (early - rest) * np.exp(t.min() / tau), rest] for tau in (3, 8, 15)]
    tried = [
        least_squares(residuals, start, loss="cauchy", f_scale=2.5 * spread, x_scale="jac")
        for start in starts
    ]
    best = min(tried, key=lambda fit: float(fit.cost)).x
    keep = np.abs(residuals(best)) < 4 * spread
    if keep.sum() < 10:
        keep[:] = True
    found, covariance = curve_fit(law, t[keep], y[keep], best)
    tau = float(np.exp(found[0]))
    turn = np.diag([tau, 1.0, 1.0])
    return np.array([tau, *found[1:]]), turn @ covariance @ turn


def fit_hysteresis(records: Sequence[CreepRecord], config: RobotConfig) -> HysteresisResult:
    """Decay law of every sensor that was recorded.

    Raises:
        DataError: no records, or a sensor that the configuration does not have.
    """
    if not records:
        raise DataError("no eversions were recorded", "grow past a sensor and wait 30 s")
    fits, notes = [], []
    for (side, index), rows in grouped((record.side, record.index) for record in records):
        if not 0 <= index < len(config.sensors.column(side)):
            raise DataError(f"no sensor {side} {index} in robot.toml", "use this robot's file")
        found = []
        for record in (records[row] for row in rows):
            try:
                found.append(fit_decay(record.t_s, record.curvature))
            except DataError as error:
                notes.append(f"{side} {index}: {error.what}")
        fits.append(_law(side, index, found, config.sensors.column(side)[index].noise))
    bad = [fit for fit in fits if not fit.good]
    notes.extend(f"{fit.side} {fit.index}: {fit.reason}" for fit in bad)
    good = len(bad) < len(fits)
    reason = "no sensor shows a decay that can be fitted"
    if good:
        ready = max(fit.usable_s for fit in fits if fit.good)
        reason = f"compensated readings count from {ready:.0f} s after eversion"
    verdict = Verdict(good, reason, tuple(notes))
    return HysteresisResult(tuple(fits), verdict, tuple(records))


def _law(side: Side, index: int, found: list[tuple[Array, Array]], noise: float) -> CreepFit:
    if not found:
        return CreepFit(side, index, Settling(8.0), 60.0, False, "no usable record")
    each = np.array([x for x, _ in found])
    tau_se, amplitude_se, _ = np.sqrt([np.diag(covariance) for _, covariance in found]).T
    clear = np.abs(each[:, 1]) > 4 * amplitude_se
    if not clear.any():
        law = Settling(8.0, 4.0, 0.0, float(amplitude_se.mean()))
        return CreepFit(side, index, law, 0.0, True, "no creep beyond the noise")
    weights = 1 / tau_se[clear] ** 2
    tau = float((weights * each[clear, 0]).sum() / weights.sum())
    # Eversions differ in tau more than each one's error says: take whichever is larger.
    count = int(clear.sum())
    scatter = float(each[clear, 0].std(ddof=1) / np.sqrt(count)) if count > 1 else 0.0
    tau_error = max(float(weights.sum() ** -0.5), scatter)
    amplitude = float(each[:, 1].mean())
    spread = float(each[:, 1].std(ddof=1)) if len(each) > 1 else 0.5 * abs(amplitude)
    law = Settling(tau, tau_error, amplitude, max(spread, float(amplitude_se.mean())))
    good = 0.5 < tau < 60 and tau_error < 0.5 * tau
    reason = (
        f"tau {tau:.1f} +- {tau_error:.1f} s, amplitude {amplitude:.4f} 1/cm"
        if good
        else f"tau of {tau:.1f} +- {tau_error:.1f} s is no decay; record for longer"
    )
    return CreepFit(side, index, law, law.usable_after_s(noise), good, reason)
