"""Critical curvature: the contact moment at which the base folds (thesis, section 2.3.3).

In each trial the tip is pushed hard until the base folds. The sensors beyond the fold still obey
the beam, and tell the moment at the base. The tip is the known place of the force, so one number is
fitted; the thesis's line through their curvatures, read off at s = 0, takes two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from thigmo.calibrate.columns import constants_of
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.mechanics import push

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BucklingResult(StepResult):
    """Critical curvature at one body pressure."""

    critical_curvature: float  # mean over the trials, 1/cm
    critical_se: float  # its standard error, gains included
    each: Array  # (t,) per trial; nan = did not fold or could not be read
    excess: Array  # (t,) how much more the base sensors show than the beam says, 1/cm
    body_pressure_psi: float  # at which it holds
    verdict: Verdict  # in words

    def write(self, config: RobotConfig) -> None:
        """Critical curvature, its error and its body pressure."""
        config.body.critical_curvature = self.critical_curvature
        config.body.critical_curvature_se = self.critical_se
        config.body.critical_pressure_psi = self.body_pressure_psi


def fit_buckling(
    curvature: Array, body_pressure_psi: float, length_cm: float, config: RobotConfig
) -> BucklingResult:
    """Critical curvature over hard pushes at the tip.

    Args:
        curvature: (t, m) readings of each trial, 1/cm, left base first; nan = unusable.
        body_pressure_psi: set by hand.
        length_cm: everted length; the tip is pushed.
        config: with the sensors' errors.

    Raises:
        DataError: no sensor lies beyond the fold, or the columns disagree with the configuration.
    """
    k = np.atleast_2d(curvature)
    names = ("center_cm", "span_cm", "noise", "zero_se", "scale_se", "valid_direction", "healthy")
    center, span, white, zero_se, gain, way, healthy = constants_of(config, *names)
    if k.shape[1] != len(center):
        raise DataError(f"{k.shape[1]} columns for {len(center)} sensors", "use this robot's file")
    noise = np.hypot(white, zero_se)
    # The fold spreads over a diameter from the base.
    near = center - span / 2 < config.body.diameter_cm
    beyond = (healthy > 0) & ~near & (center + span / 2 <= length_cm)
    if beyond.sum() < 2:
        raise DataError(
            "fewer than two healthy sensors lie beyond the fold", "calibrate the flex sensors first"
        )
    each, excess, own = np.full((3, len(k)), np.nan)
    notes: list[str] = []
    shallow, unread = [], []
    for trial, row in enumerate(k):
        pick = beyond & np.isfinite(row)
        if pick.sum() >= 2:
            pick &= (way == 0) | (way == np.sign(np.median(row[pick])))
        if pick.sum() < 2:
            unread.append(trial)
            continue
        sign = float(np.sign(np.median(row[pick]))) or 1.0
        moment, error = _moment(sign * row[pick], center[pick], span[pick], noise[pick], length_cm)
        base = (healthy > 0) & near & np.isfinite(row) & ((way == 0) | (way == sign))
        least = 0.0
        if base.any():
            # A beam without a fold would show this at the base sensors.
            lever = _levers(moment, center[base], span[base], length_cm)
            excess[trial] = np.mean(sign * row[base] - moment * lever)
            least = 3 * float(np.hypot(noise[base].max() / np.sqrt(base.sum()), error))
        if excess[trial] < least:
            shallow.append(trial)
        else:
            each[trial], own[trial] = moment, error
    kept = np.isfinite(each)
    odd = []
    if kept.sum() >= 4:
        middle = float(np.median(each[kept]))
        scatter = float(median_abs_deviation(each[kept], scale="normal"))
        limit = 4.5 * max(scatter, float(np.nanmedian(own)), 0.01 * middle)
        odd = np.flatnonzero(kept & (np.abs(each - middle) > limit)).tolist()
        each[odd] = np.nan
    for rows, what in (
        (shallow, ", the base did not fold: push harder"),
        (unread, ", too few readings"),
        (odd, " as outlier"),
    ):
        if rows:
            notes.append(f"trial {', '.join(str(r + 1) for r in rows)} left out{what}")
    kept = np.isfinite(each)
    n = int(kept.sum())
    if n == 0:
        verdict = Verdict(False, "no trial shows a fold; push the tip harder", tuple(notes))
        return BucklingResult(np.nan, np.inf, each, excess, body_pressure_psi, verdict)
    mean = float(each[kept].mean())
    # A handful of trials tells their scatter poorly: never less than the readings' own error.
    scatter = float(each[kept].std(ddof=1)) if n > 1 else 0.0
    within = max(scatter, float(np.sqrt(np.mean(own[kept] ** 2)))) / float(np.sqrt(n))
    # Gain errors are the same in every trial: they do not average out over trials.
    common = mean * float(np.sqrt(np.sum(gain[beyond] ** 2)) / beyond.sum())
    se = float(np.hypot(within, common))
    share = se / mean
    good = n >= 3 and share <= 0.05
    reason = f"{mean:.5f} 1/cm +- {100 * share:.1f} % from {n} trials at {body_pressure_psi:g} psi"
    if n < 3:
        reason += "; three or more trials are needed"
    elif not good:
        reason += "; take more trials or calibrate the flex sensors better"
    verdict = Verdict(good, reason, tuple(notes))
    return BucklingResult(mean, se, each, excess, body_pressure_psi, verdict)


def _moment(
    row: Array, center: Array, span: Array, noise: Array, length: float
) -> tuple[float, float]:
    """Contact moment at the base (1/cm) and its standard error in one trial, bent to the left."""
    estimate, error = 0.01, 0.0
    for _ in range(4):
        lever = _levers(estimate, center, span, length)
        weights = 1 / noise**2
        if len(row) >= 6:
            # One outlier among the readings must not carry a trial.
            ratio = row / lever
            loose = median_abs_deviation(ratio, scale="normal") + 1e-9
            weights *= np.abs(ratio - np.median(ratio)) < 5 * np.maximum(loose, noise / lever)
        estimate = float((weights * lever * row).sum() / (weights * lever**2).sum())
        error = float(1 / np.sqrt((weights * lever**2).sum()))
        estimate = max(estimate, 1e-5)
    return estimate, error


def _levers(moment: float, center: Array, span: Array, length: float) -> Array:
    """Curvature of each sensor over the moment at the base, large deflection (no fold)."""
    bent = push(moment / length, length, free_curvature=0.0, length=length)
    scale = moment / max(abs(bent.base_moment), 1e-12)
    bent = push(moment / length * scale, length, free_curvature=0.0, length=length)
    return np.asarray(bent.averages(center, span) / abs(bent.base_moment), float)
