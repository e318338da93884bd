"""Critical curvature: the contact moment at which the base folds (thesis, section 2.3.3).

In each trial the tip is pushed hard until the base folds. Beyond the fold, the body still bends as
a beam, so the sensors there determine the moment at the base. The force is known to act at the tip,
so one number is fitted; the thesis fits two, a line through the curvatures, and reads it off at
s = 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from thigmo.calibrate.bench import READ_S, STEADY_S, Bench, Row
from thigmo.calibrate.columns import Array, column, constants_of, of_sensors
from thigmo.calibrate.flex_lines import loop_turns
from thigmo.calibrate.regression import Mask, outlying
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.mechanics import critical_moment, push_tip
from thigmo.record.table import Table

# Share of the fold's length before which a sensor must begin to show the fold. One that begins
# later reads too little of it: a push would seem not to have folded the base.
_SHOWS_FOLD = 0.9
_HARD = 1.7  # moment of a push over the expected moment that folds the base
_DEEPER = 1.2  # between two pushes of a base whose fold no sensor reads
_BENT = 2.8  # moment times length over EI, beyond which a push turns the tip back
_GROWS = 0.5  # exponent of the moment over the push: 1 for a beam, 0 for a folded base


@dataclass(frozen=True)
class BucklingResult(StepResult):
    """Critical curvature at one body pressure."""

    critical_curvature: float  # mean over the trials, 1/cm
    critical_se: float  # its standard error, gains included
    trial_curvature: Array  # (t,) per trial, 1/cm; nan = did not fold or could not be read
    excess: Array  # (t,) curvature of the base sensors above the beam model, 1/cm
    body_pressure_psi: float  # body pressure at which it was measured
    verdict: Verdict  # in words

    def write(self, config: RobotConfig) -> None:
        """Store the critical curvature, its error and its body pressure in the configuration."""
        config.body.critical_curvature = self.critical_curvature
        config.body.critical_curvature_se = self.critical_se
        config.body.critical_pressure_psi = self.body_pressure_psi


Fit = Callable[[Array, float, float, RobotConfig], BucklingResult]


def guided(bench: Bench, fit: Fit | None = None) -> BucklingResult:
    """Measure hard pushes, each with its own straight reading, and fit the critical curvature.

    The pushes alternate between both sides, or go to the only side that enough sensors can read.
    Where no sensor reads the fold, they are of two depths, because only a base that has folded is
    bent by the same moment in both. The flex step must come first. Raises DataError if too few
    sensors can read either side.
    """
    body = bench.config.body
    signs = _readable_signs(bench.config, body.length_cm)
    folds_at = critical_moment(
        body.critical_curvature, body.critical_pressure_psi, body.pressures[-1].pressure_psi
    )
    deepest = min(_HARD * folds_at, _BENT / body.length_cm)
    depths = [deepest] if _in_fold(bench.config).any() else [deepest / _DEEPER, deepest]
    if depths[0] < folds_at:
        reason = (
            f"pushes at the tip bend this base to {depths[0]:.4f} 1/cm only, and it folds at about "
            f"{folds_at:.4f}; keep what robot.toml says"
        )
        no_trials = np.empty(0)
        verdict = Verdict(False, reason)
        return BucklingResult(
            np.nan, np.inf, no_trials, no_trials, body.pressures[-1].pressure_psi, verdict
        )

    def take(key: str, moment: float) -> Row:
        y_cm = float(np.sign(moment)) * push_tip(abs(moment), body.length_cm).tip[1]
        bench.hand.push_tip(None)
        bench.robot.wait(STEADY_S)
        straight = bench.robot.read(READ_S)
        bench.hand.push_tip(y_cm)
        bench.robot.wait(STEADY_S)
        pushed = bench.robot.read(2 * READ_S)
        bench.hand.push_tip(None)
        return {"rest": bench.ohm(straight), "ohm": bench.ohm(pushed), "moment": moment}

    planned = {
        f"push {n}": signs[n % len(signs)] * depths[n // len(signs) % len(depths)]
        for n in range(bench.plan.pushes)
    }
    rows = bench.rows("pushes", planned, take)
    (scale,) = constants_of(bench.config, "raw_scale")
    pushed_k, straight_k = column(rows, "ohm") * scale, column(rows, "rest") * scale
    flex = bench.session.good_result("flex")
    if flex is not None:
        # Each push ends on the opposite branch of the hysteresis loops from the rest before it.
        walk = np.stack([np.zeros_like(pushed_k), pushed_k - straight_k], axis=1).reshape(
            -1, pushed_k.shape[1]
        )
        block = np.zeros(len(walk), np.int64)
        turn = loop_turns(np.nan_to_num(walk), block, float(flex["loop_width"]))
        loop = np.nan_to_num(column(flex["sensors"], "hysteresis"))
        straight_k -= loop * turn[0::2]
        pushed_k -= loop * turn[1::2]
    fitted = fit or fit_buckling
    result = fitted(
        pushed_k - straight_k, body.pressures[-1].pressure_psi, body.length_cm, bench.config
    )
    return _require_fold(result, np.abs(column(rows, "moment")), bench.config)


def _in_fold(config: RobotConfig) -> Mask:
    """(m,) the healthy sensors that show the fold, which spreads over a diameter from the base."""
    center, span, healthy = constants_of(config, "center_cm", "span_cm", "healthy")
    reached = center - span / 2 < _SHOWS_FOLD * config.body.diameter_cm
    return np.asarray((healthy > 0) & reached)


def _require_fold(result: BucklingResult, pushed: Array, config: RobotConfig) -> BucklingResult:
    """The result, marked as not good unless something shows that the base folded.

    `pushed` (t,) are the moments to which the pushes would bend a base that does not fold, 1/cm;
    nan if unknown. Where no sensor reads the fold, the moment must not grow with them.
    """
    if _in_fold(config).any() or not result.verdict.good:
        return result
    valid = np.isfinite(result.trial_curvature) & np.isfinite(pushed)
    x, y = np.log(pushed[valid]), np.log(result.trial_curvature[valid])
    if len(x) < 2 or np.ptp(x) < 0.5 * np.log(_DEEPER):
        reason = (
            "no sensor reads the fold, and without pushes of two depths nothing shows that the "
            "base folded; take them again (`thigmo calibrate buckling --again`)"
        )
    elif np.polynomial.Polynomial.fit(x, y, 1).convert().coef[1] > _GROWS:
        reason = "the moment at the base grew with the push, so the base did not fold"
    else:
        return result
    return replace(result, verdict=Verdict(False, reason, result.verdict.notes))


def of_csv(table: Table, config: RobotConfig, fit: Fit | None = None) -> BucklingResult:
    """Fit pushes at one body pressure and length from a CSV."""
    body = table.numbers("body_pressure_psi", config.body.critical_pressure_psi)
    length = table.numbers("length_cm", config.body.length_cm)
    if np.ptp(body) > 1e-9 or np.ptp(length) > 1e-9:
        raise DataError(f"{table.name}: body pressure or length varies", "one file for each")
    curvature = of_sensors(table, "curvature", config)
    result = (fit or fit_buckling)(curvature, float(body[0]), float(length[0]), config)
    return _require_fold(result, np.full(len(curvature), np.nan), config)


def fit_buckling(
    curvature: Array, body_pressure_psi: float, length_cm: float, config: RobotConfig
) -> BucklingResult:
    """Critical curvature from hard pushes at the tip.

    Args:
        curvature: (t, m) readings of t pushes less those at rest, 1/cm; nan = unusable.
        body_pressure_psi: body pressure of the pushes.
        length_cm: everted length.
        config: the calibrated robot.

    Raises:
        DataError: the columns are not this robot's, or too few sensors can read either side.
    """
    names = ("center_cm", "span_cm", "reading_se", "scale_se", "bend_sign")
    center, span, noise, gain, valid_sign = constants_of(config, *names)
    if curvature.shape[1] != len(center):
        shapes = f"{curvature.shape[1]} columns for {len(center)} sensors"
        raise DataError(shapes, "use this robot's file")
    in_fold = _in_fold(config)
    beyond_fold = _beyond_fold(config, length_cm)
    _readable_signs(config, length_cm)  # refuses a robot with too few of them
    trial_curvature, excess, trial_se = np.full((3, len(curvature)), np.nan)
    shallow, unread = [], []
    for trial, row in enumerate(curvature):
        pick = beyond_fold & np.isfinite(row)
        if pick.sum() >= 2:
            pick &= (valid_sign == 0) | (valid_sign == np.sign(np.median(row[pick])))
        if pick.sum() < 2:
            unread.append(trial)
            continue
        sign = float(np.sign(np.median(row[pick]))) or 1.0
        moment, error = _moment(sign * row[pick], center[pick], span[pick], noise[pick], length_cm)
        base = in_fold & np.isfinite(row) & ((valid_sign == 0) | (valid_sign == sign))
        threshold = 0.0
        if base.any():
            # Share of the moment that base sensors would show on a beam without a fold.
            lever = _levers(moment, center[base], span[base], length_cm)
            excess[trial] = np.mean(sign * row[base] - moment * lever)
            threshold = 3 * float(np.hypot(noise[base].max() / np.sqrt(base.sum()), error))
        if excess[trial] < threshold:
            shallow.append(trial)
        else:
            trial_curvature[trial], trial_se[trial] = moment, error
    usable = np.isfinite(trial_curvature)
    outliers = []
    if usable.sum() >= 4:
        threshold = max(
            float(np.nanmedian(trial_se)), 0.01 * float(np.median(trial_curvature[usable]))
        )
        outliers = np.flatnonzero(usable)[
            outlying(trial_curvature[usable], 4.5, threshold)
        ].tolist()
        trial_curvature[outliers] = np.nan
    left_out = ((shallow, ", the base did not fold: push harder"),
                (unread, ", too few readings"), (outliers, " as outlier"))  # fmt: skip
    notes = tuple(
        f"trial {', '.join(str(r + 1) for r in rows)} omitted{shapes}"
        for rows, shapes in left_out
        if rows
    )
    usable = np.isfinite(trial_curvature)
    n = int(usable.sum())
    if n == 0:
        verdict = Verdict(False, "no trial shows a fold; push the tip harder", notes)
        return BucklingResult(np.nan, np.inf, trial_curvature, excess, body_pressure_psi, verdict)
    mean = float(trial_curvature[usable].mean())
    # Few trials estimate their scatter poorly, so it is at least the error of the readings.
    scatter = float(trial_curvature[usable].std(ddof=1)) if n > 1 else 0.0
    random_se = max(scatter, float(np.sqrt(np.mean(trial_se[usable] ** 2)))) / float(np.sqrt(n))
    # Gain errors are the same in every trial: they do not average out over trials.
    common_se = mean * float(np.sqrt(np.sum(gain[beyond_fold] ** 2)) / beyond_fold.sum())
    se = float(np.hypot(random_se, common_se))
    percent = 100 * se / mean
    good = n >= 3 and percent <= 5
    reason = f"{mean:.5f} 1/cm +- {percent:.1f} % from {n} trials at {body_pressure_psi:g} psi"
    if n < 3:
        reason += "; three or more trials are needed"
    elif not good:
        reason += "; take more trials or calibrate the flex sensors better"
    verdict = Verdict(good, reason, notes)
    return BucklingResult(mean, se, trial_curvature, excess, body_pressure_psi, verdict)


def _beyond_fold(config: RobotConfig, length_cm: float) -> Mask:
    """(m,) whether a sensor is healthy and beyond the fold, a diameter from the base."""
    center, span, healthy = constants_of(config, "center_cm", "span_cm", "healthy")
    near = center - span / 2 < config.body.diameter_cm
    return np.asarray((healthy > 0) & ~near & (center + span / 2 <= length_cm))


def _readable_signs(config: RobotConfig, length_cm: float) -> list[int]:
    """Signs of the bends that at least two healthy sensors beyond the fold can read, 1 first.

    Raises DataError if there are none.
    """
    (valid_sign,) = constants_of(config, "bend_sign")
    beyond_fold = _beyond_fold(config, length_cm)
    signs = [
        sign
        for sign in (1, -1)
        if (beyond_fold & ((valid_sign == 0) | (valid_sign == sign))).sum() >= 2
    ]
    if not signs:
        raise DataError(
            "fewer than two healthy sensors beyond the fold answer to a push to the same side",
            "calibrate the flex sensors first",
        )
    return signs


def _moment(
    row: Array, center: Array, span: Array, noise: Array, length: float
) -> tuple[float, float]:
    """Moment at the base over EI, and its standard error, 1/cm, for positive curvatures (m,)."""
    estimate, error = 0.01, 0.0
    for _ in range(4):
        lever = _levers(estimate, center, span, length)
        weights = 1 / noise**2
        if len(row) >= 6:
            # A single outlying reading must not decide a trial.
            ratio = row / lever
            weights *= ~outlying(ratio, 5, noise / lever)
        power = float((weights * lever**2).sum())
        estimate = max(float((weights * lever * row).sum()) / power, 1e-5)
        error = power**-0.5
    return estimate, error


def _levers(moment: float, center: Array, span: Array, length: float) -> Array:
    """(m,) curvature of each sensor over the base moment, for large deflection without a fold."""
    bent = push_tip(moment, length)
    return np.asarray(bent.averages(center, span) / abs(bent.base_moment), float)
