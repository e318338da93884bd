"""The thesis's own fits of flex sensors and of the fold, for robots on which it is repeated.

Source: M. Bryant, 2022, sections 2.3 and 3.2. The deflection y of a pushed tip gives the force,
F/EI = 3 y / x^3 for small deflections (2.12). The beam's curvature at each sensor's centre (2.9) is
regressed on its resistance above that of the straight robot, which gives one constant for each
sensor (2.4). The critical curvature is the mean over the trials of a line through the curvatures of
the sensors that do not buckle, read off at the base. Neither has an error. So robot.toml keeps the
error of an uncalibrated sensor, and a tenth for the fold, until `flex` and `buckling` are run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thigmo.calibrate.buckling import BucklingResult
from thigmo.calibrate.columns import Array, constants_of, mark_health, sensors_of
from thigmo.calibrate.flex import FlexFit, FlexResult
from thigmo.calibrate.flex_data import FlexReadings
from thigmo.calibrate.flex_lines import LOOP_WIDTHS
from thigmo.calibrate.flex_rows import model_rows
from thigmo.calibrate.verdict import Verdict
from thigmo.config import FlexSensor, RobotConfig
from thigmo.errors import DataError

_LEAST_PLACES = 3
_SCALE_SE = float(FlexSensor.model_fields["scale_se"].default)
_FOLD_SE = (
    0.1  # relative; errors of gains are the same in all trials, so their scatter does not show them
)


@dataclass(frozen=True)
class ThesisFlexResult(FlexResult):
    """Constants without errors."""

    def write(self, config: RobotConfig) -> None:
        """Put in scales and zeros, with at least the errors of an uncalibrated sensor."""
        for fit, sensor in mark_health(config, self.sensors, FlexSensor):
            sensor.scale_per_ohm, sensor.zero_ohm = fit.scale_per_ohm, fit.zero_ohm
            sensor.scale_se = max(sensor.scale_se, _SCALE_SE)


def fit_flex(readings: FlexReadings, config: RobotConfig) -> ThesisFlexResult:
    """Fit one constant for each sensor to rows of the straight robot and of its pushed tip."""
    rows = model_rows(readings, config)
    straight = np.array(readings.kind) == "straight"
    tips = rows.tips & rows.good
    if not straight.any() or tips.sum() < _LEAST_PLACES:
        raise DataError(
            f"{int(straight.sum())} rows of the straight robot, {int(tips.sum())} usable tip "
            "places",
            f"the thesis's fit takes one or more, and {_LEAST_PLACES} or more",
        )
    (center,) = constants_of(config, "center_cm")
    x, y = readings.tip_cm[tips].T
    force = 3.0 * y / x**3  # over EI
    model = force[:, None] * np.clip(x[:, None] - center, 0.0, None)
    rows.model[tips] = model
    fits = []
    for number, name in enumerate(sensors_of(config)):
        at_rest = rows.ohm[straight, number]
        change = rows.ohm[tips, number] - (np.nanmean(at_rest) if np.isfinite(at_rest).any() else 0)
        used = np.isfinite(change)
        power = float(change[used] @ change[used])
        if not rows.to_fit[number]:
            reason = "not everted at this length, or no flex sensor"
        elif used.sum() < _LEAST_PLACES or not np.isfinite(at_rest).any():
            reason = "has too few readings in range: check its wire"
        elif power <= 0.0:
            reason = "does not answer to bending: check its pouch and its wire"
        else:
            reason = ""
        if reason:
            fits.append(FlexFit(name, False, reason, int(used.sum())))
            continue
        scale = float(change[used] @ model[used, number]) / power
        residuals = model[used, number] - scale * change[used]
        fits.append(
            FlexFit(
                name,
                True,
                f"{scale:.3g} 1/cm per ohm, {int(used.sum())} places",
                int(used.sum()),
                scale_per_ohm=scale,
                zero_ohm=float(np.nanmean(at_rest)),
                noise=float(np.sqrt(np.mean(residuals**2))),
            )
        )
    everted = [fit for fit, is_fitted in zip(fits, rows.to_fit, strict=True) if is_fitted]
    healthy = sum(fit.healthy for fit in everted)
    verdict = Verdict(
        2 * healthy >= len(everted) > 0,
        f"constants of {healthy} of {len(everted)} sensors by (2.12), from {int(tips.sum())} tip "
        f"places; it states no errors, so {100 * _SCALE_SE:.0f} % is kept for each",
        (*rows.notes, *(f"omitted sensor {f.name}, which {f.reason}" for f in everted
                        if not f.healthy)),
    )  # fmt: skip
    return ThesisFlexResult(tuple(fits), verdict, rows, LOOP_WIDTHS[1])


def fit_buckling(
    curvature: Array, body_pressure_psi: float, length_cm: float, config: RobotConfig
) -> BucklingResult:
    """Critical curvature from hard pushes at the tip; arguments as in `buckling.fit_buckling`."""
    center, span, healthy = constants_of(config, "center_cm", "span_cm", "healthy")
    if curvature.shape[1] != len(center):
        shapes = f"{curvature.shape[1]} columns for {len(center)} sensors"
        raise DataError(shapes, "use this robot's file")
    near = center - span / 2 < config.body.diameter_cm
    beyond_fold = (healthy > 0) & ~near & (center + span / 2 <= length_cm)
    trial_curvature, excess = np.full((2, len(curvature)), np.nan)
    for trial, row in enumerate(curvature):
        pick = beyond_fold & np.isfinite(row)
        if len(np.unique(center[pick])) < 2:
            continue
        line = np.polynomial.Polynomial.fit(center[pick], row[pick], 1)
        trial_curvature[trial] = abs(line(0.0))
        base = (healthy > 0) & near & np.isfinite(row)
        if base.any():
            beam = np.sign(line(0.0)) * line(center[base])
            excess[trial] = float(np.mean(np.sign(line(0.0)) * row[base] - beam))
    usable = trial_curvature[np.isfinite(trial_curvature)]
    if not usable.size:
        raise DataError("no trial has two sensors beyond the fold", "calibrate the flex sensors")
    mean = float(usable.mean())
    scatter = float(usable.std(ddof=1) / np.sqrt(usable.size)) if usable.size > 1 else 0.0
    omitted = tuple(
        f"trial {n + 1} omitted, too few readings"
        for n in np.flatnonzero(~np.isfinite(trial_curvature))
    )
    reason = f"{mean:.5f} 1/cm, by a line through the sensors beyond the fold, {usable.size} trials"
    enough = usable.size >= 3
    if not enough:
        reason += "; take three or more"
    verdict = Verdict(enough, reason, omitted)
    critical_se = max(scatter, _FOLD_SE * mean)
    return BucklingResult(mean, critical_se, trial_curvature, excess, body_pressure_psi, verdict)
