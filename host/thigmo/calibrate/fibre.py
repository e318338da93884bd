"""A fibre: scale, zero, twist and drift of each grating's strains, by free bends.

Rows are free bends: the curvature by camera, and the strain of each reading from an interrogator,
live or as a CSV. A line in curvature and time is fitted to each reading. Its slope gives
`scale_per_ue`. The drift that all gratings share is due to temperature. If a reading across the
plane changes with bends in the plane, the fibre is twisted, and the ratio gives the angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thigmo.calibrate.bench import Bench, last_bends
from thigmo.calibrate.columns import Array, column
from thigmo.calibrate.overhead import CAMERA_SCALE_SE
from thigmo.calibrate.regression import LinearFit, Mask, fit_linear
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import FibreSensor, RobotConfig
from thigmo.errors import DataError
from thigmo.record.table import Table

_FEWEST = 8  # bends
_LEAST_BEND = 1e-3  # 1/cm, between the least and the most
_MOST_SE = 0.1  # largest relative error of a scale that is used
_GRATING_CM = 0.05  # readings closer than this belong to one grating


@dataclass(frozen=True)
class FibreFit:
    """One reading's calibration, by its number in the fibre."""

    index: int
    healthy: bool
    reason: str
    scale_per_ue: float = np.nan  # 1/cm per microstrain
    scale_se: float = np.inf  # relative standard error of the scale
    zero_ue: float = 0.0
    drift_ue_s: float = np.nan
    noise_ue: float = np.nan  # standard deviation of a strain about the line, microstrain
    twist_rad: float = np.nan  # twist of its grating; nan without a reading across the plane


@dataclass(frozen=True)
class FibreResult(StepResult):
    """All readings in the plane, and the errors that they share when a contact is measured."""

    sensors: tuple[FibreFit, ...]
    temperature_se: float  # error by temperature, 1/cm
    twist_se_rad: float  # error of the twist; nan if no reading shows it
    verdict: Verdict

    def write(self, config: RobotConfig) -> None:
        """Put in scales, zeros, noise, drift, twist, health; a dead reading keeps its constants."""
        for fit in self.sensors:
            sensor = config.gratings[fit.index]
            sensor.healthy = fit.healthy
            if not fit.healthy:
                continue
            sensor.scale_per_ue, sensor.scale_se = fit.scale_per_ue, fit.scale_se
            sensor.zero_ue, sensor.temperature_se = fit.zero_ue, self.temperature_se
            sensor.noise = abs(fit.scale_per_ue) * fit.noise_ue
            if np.isfinite(self.twist_se_rad):
                sensor.twist_se_rad = self.twist_se_rad


def guided(bench: Bench) -> FibreResult:
    """Fit the free bends of the last body pressure, after taking those that are missing."""
    if not bench.config.interrogator:
        raise DataError(
            "nothing reads the fibre live",
            "give `interrogator` in robot.toml, or strains as a file: `thigmo calibrate fibre "
            "--csv FILE`",
        )
    bends = last_bends(bench)
    if not all("strain" in row for row in bends):
        raise DataError(
            "the free bends were taken without the fibre", "run `thigmo calibrate actuator --again`"
        )
    return fit_fibre(
        column(bends, "t_s"), column(bends, "k"), column(bends, "strain"), bench.config
    )


def of_csv(table: Table, config: RobotConfig) -> FibreResult:
    """Fit free bends from a CSV: time, curvature by camera, and strains in microstrain."""
    strain = [table.numbers(f"strain_{number}") for number in range(len(config.gratings))]
    return fit_fibre(
        table.numbers("t_s"), table.numbers("curvature"), np.column_stack(strain), config
    )


def fit_fibre(t_s: Array, curvature: Array, strain: Array, config: RobotConfig) -> FibreResult:
    """Fit a fibre to free bends.

    Args:
        t_s: (n,) times, s.
        curvature: (n,) curvatures by camera, 1/cm.
        strain: (n, readings) strains in microstrain; nan where a peak was lost.
        config: the robot, with its gratings.

    Raises:
        DataError: there are too few bends, or they differ too little.
    """
    measured = np.isfinite(t_s) & np.isfinite(curvature)
    if measured.sum() < _FEWEST or np.ptp(curvature[measured]) < _LEAST_BEND:
        raise DataError(
            f"{int(measured.sum())} free bends that the camera saw",
            f"take {_FEWEST} and more, apart",
        )
    gratings = config.gratings
    lines = [_line(t_s, curvature, strain[:, n], measured) for n in range(len(gratings))]
    fits = [_fit(n, gratings, lines) for n, sensor in enumerate(gratings) if sensor.side]
    good = [fit for fit in fits if fit.healthy]
    notes = tuple(f"strain_{fit.index} {fit.reason}" for fit in fits if not fit.healthy)
    if not good:
        return FibreResult(
            tuple(fits), np.nan, np.nan, Verdict(False, "no grating can be used", notes)
        )
    drift = np.median([fit.drift_ue_s * fit.scale_per_ue for fit in good])
    temperature = float(abs(drift) * FibreSensor.warm_s)
    twists = np.array([fit.twist_rad for fit in good])
    twists = twists[np.isfinite(twists)]
    twist = float(np.sqrt(np.mean(twists**2))) if twists.size else np.nan
    worst = max(fit.scale_se for fit in good)
    reason = (
        f"{len(good)} of {len(fits)} gratings; scales known to {100 * worst:.1f} % at worst; "
        f"temperature shifts all by {60 * abs(drift):.1e} 1/cm a minute"
    )
    if twists.size:
        reason += f"; twisted by {np.degrees(twist):.1f} degrees"
    return FibreResult(tuple(fits), temperature, twist, Verdict(True, reason, notes))


def _line(t_s: Array, curvature: Array, strain: Array, measured: Mask) -> LinearFit | None:
    """Zero, drift and slope (microstrain per 1/cm) of a reading; None if too few bends have it."""
    usable = measured & np.isfinite(strain)
    if usable.sum() < _FEWEST or np.ptp(curvature[usable]) < _LEAST_BEND:
        return None
    elapsed_s = t_s[usable] - t_s[usable].mean()
    return fit_linear(
        np.column_stack([np.ones_like(elapsed_s), elapsed_s, curvature[usable]]), strain[usable]
    )


def _fit(index: int, gratings: list[FibreSensor], lines: list[LinearFit | None]) -> FibreFit:
    """The fit of one reading in the plane, with its grating's twist by the reading across."""
    line = lines[index]
    if line is None:
        return FibreFit(index, False, f"is read at fewer than {_FEWEST} bends: its peak is lost")
    zero, drift, slope = line.coefficients.tolist()
    se = float(np.hypot(line.se(2) / max(abs(slope), 1e-9), CAMERA_SCALE_SE))
    if se > _MOST_SE:
        return FibreFit(index, False, "does not follow the bends; check which grating it is")
    cross_lines = [
        lines[n]
        for n, grating in enumerate(gratings)
        if grating.side is None and abs(grating.center_cm - gratings[index].center_cm) < _GRATING_CM
    ]
    twist = np.nan
    if cross_lines and (cross_line := cross_lines[0]) is not None:
        twist = float(np.arctan2(abs(cross_line.coefficients[2]), abs(slope)))
    return FibreFit(
        index, True, f"scale known to {100 * se:.1f} %", 1.0 / slope, se, zero, drift, line.sigma,
        twist,
    )  # fmt: skip
