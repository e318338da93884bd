"""Creep after eversion: decay time and amplitude of each sensor, from records at rest.

Each record starts when the sensor has just everted. The compensation that uses the result is
`thigmo.mechanics.settling`, which also says how much noise it adds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.optimize import curve_fit, least_squares
from scipy.stats import median_abs_deviation

from thigmo.calibrate.bench import Bench, growth_rows
from thigmo.calibrate.columns import Array, grouped, sensors_of
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import SAME_LENGTH_CM, RobotConfig
from thigmo.errors import DataError
from thigmo.mechanics.settling import Settling
from thigmo.record.table import Table
from thigmo.wiring import table_key


@dataclass(frozen=True)
class CreepRecord:
    """One sensor after one eversion."""

    name: str
    t_s: Array  # (n,) time since eversion
    curvature: Array  # (n,) readings, 1/cm


@dataclass(frozen=True)
class CreepFit:
    """One sensor's decay law over its eversions."""

    name: str
    law: Settling  # decay law, with the spread between eversions
    usable_s: float  # time after eversion at which compensation errs less than a reading's noise
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
        """Plain data: of each sensor, the law and whether it may be used."""
        data = super().as_data()
        data["sensors"] = [{**fit.pop("law"), **fit} for fit in data["sensors"]]
        return data

    def write(self, config: RobotConfig) -> None:
        """Put in decay times and amplitudes."""
        sensors = sensors_of(config)
        for fit in self.sensors:
            if fit.good:
                sensor = sensors[fit.name]
                sensor.settle_tau_s = fit.law.tau_s
                sensor.settle_amplitude = fit.law.amplitude


def guided(bench: Bench) -> HysteresisResult:
    """Fit creep to the growth rows. Run it after flex, which gives the scales."""
    config = bench.config
    records: list[CreepRecord] = []
    previous_cm = 0.0
    for row in growth_rows(bench):
        length = float(row["encoder_cm"])
        ohm, t = np.array(row["ohm"], float), np.array(row["t_s"], float)
        for (name, sensor), ohm_of_sensor in zip(sensors_of(config).items(), ohm.T, strict=True):
            end = sensor.center_cm + sensor.span_cm / 2
            if previous_cm + SAME_LENGTH_CM < end <= length and sensor.healthy:
                # The sensor everted when the tip passed its end, a little before growth stopped.
                elapsed_s = t + (length - end) / float(row["speed_cm_s"])
                rest_ohm = float(np.nanmedian(ohm_of_sensor[-max(3, len(ohm_of_sensor) // 10) :]))
                k = (ohm_of_sensor - rest_ohm) * sensor.raw_scale
                records.append(CreepRecord(name, elapsed_s, k))
        previous_cm = length
    return fit_hysteresis(records, config)


def of_csv(table: Table, config: RobotConfig) -> HysteresisResult:
    """Fit records of one or more eversions from a CSV."""
    keys = _names(table, config), table.integers("eversion", 0).tolist()
    t, k = table.numbers("t_s"), table.numbers("curvature")
    records = [
        CreepRecord(name, t[rows], k[rows]) for (name, _), rows in grouped(zip(*keys, strict=True))
    ]
    return fit_hysteresis(records, config)


def _names(table: Table, config: RobotConfig) -> list[str]:
    """(n,) names of the sensors, from the column `sensor`."""
    names = {table_key(name): name for name in sensors_of(config)}
    words = table.words("sensor")
    for name in words:
        if name not in names:
            cure = f"use {', '.join(names)}"
            raise DataError(f"{table.name}: no sensor {name} in robot.toml", cure)
    return [names[name] for name in words]


def fit_decay(t_s: Array, curvature: Array) -> tuple[Array, Array]:
    """Decay time (s), amplitude and rest (1/cm), (3,), and their covariance, without outliers."""
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
    fits = [
        least_squares(residuals, start, loss="cauchy", f_scale=2.5 * spread, x_scale="jac")
        for start in starts
    ]
    best = min(fits, key=lambda fit: float(fit.cost)).x
    keep = np.abs(residuals(best)) < 4 * spread
    if keep.sum() < 10:
        keep[:] = True
    try:
        law_fit, covariance = curve_fit(law, t[keep], y[keep], best)
    except RuntimeError as error:
        raise DataError("the record shows no decay", "record 30 s after eversion") from error
    law_fit[0] = np.exp(law_fit[0])
    turn = np.diag([law_fit[0], 1.0, 1.0])
    return law_fit, turn @ covariance @ turn


def fit_hysteresis(records: Sequence[CreepRecord], config: RobotConfig) -> HysteresisResult:
    """Fit the decay law of every sensor that was recorded."""
    if not records:
        raise DataError("no eversions were recorded", "grow past a sensor and wait 30 s")
    fits, notes = [], []
    sensors = sensors_of(config)
    rows_by_sensor = dict(grouped(record.name for record in records))
    for name in rows_by_sensor.keys() - sensors.keys():
        raise DataError(f"no sensor {name} in robot.toml", "use this robot's file")
    for name, sensor in sensors.items():
        if name not in rows_by_sensor:
            continue
        decays = []
        for record in (records[row] for row in rows_by_sensor[name]):
            try:
                decays.append(fit_decay(record.t_s, record.curvature))
            except DataError as error:
                notes.append(f"{name}: {error.problem}")
        fits.append(_law(name, decays, sensor.noise))
    notes.extend(f"{fit.name}: {fit.reason}" for fit in fits if not fit.good)
    usable_s = [fit.usable_s for fit in fits if fit.good]
    reason = "no sensor shows a decay that can be fitted"
    if usable_s:
        reason = f"compensated readings count from {max(usable_s):.0f} s after eversion"
    verdict = Verdict(bool(usable_s), reason, tuple(notes))
    return HysteresisResult(tuple(fits), verdict, tuple(records))


def _law(name: str, decays: list[tuple[Array, Array]], noise: float) -> CreepFit:
    if not decays:
        return CreepFit(name, Settling(8.0), 60.0, False, "no usable record")
    taus, amplitudes, _ = np.array([x for x, _ in decays]).T
    tau_se, amplitude_se, _ = np.sqrt([np.diag(covariance) for _, covariance in decays]).T
    clear = np.abs(amplitudes) > 4 * amplitude_se
    if not clear.any():
        law = Settling(8.0, 4.0, 0.0, float(amplitude_se.mean()))
        return CreepFit(name, law, 0.0, True, "no creep beyond the noise")
    weights, taus = 1 / tau_se[clear] ** 2, taus[clear]
    tau = float((weights * taus).sum() / weights.sum())
    # Eversions may differ in tau by more than its error: use the larger one.
    scatter = float(taus.std(ddof=1) / np.sqrt(len(taus))) if len(taus) > 1 else 0.0
    error = max(float(weights.sum() ** -0.5), scatter)
    amplitude = float(amplitudes.mean())
    spread = float(amplitudes.std(ddof=1)) if len(decays) > 1 else 0.5 * abs(amplitude)
    law = Settling(tau, error, amplitude, max(spread, float(amplitude_se.mean())))
    good = 0.5 < tau < 60 and error < 0.5 * tau
    reason = f"tau of {tau:.1f} +- {error:.1f} s is no decay; record for longer"
    if good:
        reason = f"tau {tau:.1f} +- {error:.1f} s, amplitude {amplitude:.4f} 1/cm"
    return CreepFit(name, law, law.usable_after_s(noise), good, reason)
