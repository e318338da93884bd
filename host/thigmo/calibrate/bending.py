"""Bending stiffness EI, which converts forces over EI, as curvature gives them, to newtons.

There are two ways. A known force, of a hung weight or a spring balance, bends the calibrated robot,
and its sensors measure the force over EI. Or EI follows from the fold: a thin inflated tube folds
at a moment between pi p r^3 / 2, where its wall first goes slack (Comer and Levy, AIAA Journal
1963), and pi p r^3, where no part of it is taut. Which of these moments a robot's sensors show as
the fold is not known, so the error covers the whole range.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thigmo.calibrate.columns import Array, constants_of, of_sensors
from thigmo.calibrate.regression import outlying
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.mechanics import push
from thigmo.record.table import Table

COLUMNS = "force_n, curvature_SENSOR of each sensor [force_arc_cm, force_se]"
_N_PER_CM2 = 0.6894757  # per psi
_FOLD, _FOLD_SE = 0.75, 0.5 / np.sqrt(12.0)  # moment over pi p r^3: anywhere from a half to one
_PASSES = 4
_GOOD = 0.2  # relative standard error of EI below which forces in newtons are useful


@dataclass(frozen=True)
class BendingResult(StepResult):
    """Bending stiffness."""

    stiffness_n_cm2: float
    stiffness_se_n_cm2: float
    pull_stiffness: Array  # (t,) EI by each pull alone, N cm^2; nan if too few sensors read it
    verdict: Verdict

    def write(self, config: RobotConfig) -> None:
        """Put in EI and its error."""
        config.body.stiffness_n_cm2 = self.stiffness_n_cm2
        config.body.stiffness_se_n_cm2 = self.stiffness_se_n_cm2


def of_csv(table: Table, config: RobotConfig) -> BendingResult:
    """Fit EI to pulls with known forces in a CSV, a row each.

    Curvatures are readings less those of the straight robot, 1/cm.
    """
    curvature = of_sensors(table, "curvature", config)
    force = table.numbers("force_n")
    arc = table.numbers("force_arc_cm", config.body.length_cm)
    return fit_bending(force, arc, table.numbers("force_se", 0.05), curvature, config)


def fit_bending(
    force_n: Array, arc_cm: Array, force_se: Array, curvature: Array, config: RobotConfig
) -> BendingResult:
    """EI from t pulls.

    Args:
        force_n: (t,) forces, N.
        arc_cm: (t,) arcs at which they act.
        force_se: (t,) relative standard errors of the forces.
        curvature: (t, m) readings less those of the straight robot, 1/cm.
        config: the calibrated robot.

    Raises:
        DataError: a force or an arc is impossible, or no pull is read by two sensors.
    """
    if not (np.isfinite(force_n) & (np.abs(force_n) > 0)).all() or not (force_se >= 0).all():
        raise DataError("a force_n is 0 or missing", "give newtons: kg times 9.81")
    if not ((arc_cm > 0) & (arc_cm <= config.body.length_cm)).all():
        raise DataError("a force_arc_cm is off the body", "give where it acts, from the base")
    names = ("center_cm", "span_cm", "reading_se", "scale_se", "bend_sign", "healthy")
    center, span, noise, gain, valid_sign, healthy = constants_of(config, *names)
    # If the base folds, the first sensors do not show its turn.
    far = (healthy > 0) & (center - span / 2 >= config.body.diameter_cm)
    stiffness, stiffness_se = np.full((2, len(force_n)), np.nan)
    for trial, (force, arc, row) in enumerate(zip(force_n, arc_cm, curvature, strict=True)):
        pick = far & np.isfinite(row) & (center + span / 2 <= arc)
        if pick.any():
            pick &= (valid_sign == 0) | (valid_sign == np.sign(np.median(row[pick])))
        if pick.sum() < 2:
            continue
        sign = float(np.sign(np.median(row[pick]))) or 1.0
        force_over_ei, error = _over_stiffness(
            sign * row[pick], center[pick], span[pick], noise[pick], arc
        )
        stiffness[trial] = abs(force) / force_over_ei
        stiffness_se[trial] = stiffness[trial] * error / force_over_ei
    usable = np.isfinite(stiffness)
    n = int(usable.sum())
    if n == 0:
        raise DataError(
            "no pull is read by two healthy sensors before it", "pull at the tip, and harder"
        )
    notes = [] if usable.all() else [f"{int((~usable).sum())} pull(s) omitted: too few readings"]
    if n >= 4:
        outliers = np.zeros(len(stiffness), bool)
        outliers[usable] = outlying(stiffness[usable], 4.5, float(np.median(stiffness_se[usable])))
        if outliers.any():
            notes.append(f"{int(outliers.sum())} pull(s) omitted as outliers")
        usable &= ~outliers
        n = int(usable.sum())
    mean = float(stiffness[usable].mean())
    scatter = float(stiffness[usable].std(ddof=1)) if n > 1 else 0.0
    random_se = max(scatter, float(np.sqrt(np.mean(stiffness_se[usable] ** 2)))) / np.sqrt(n)
    # Errors of the gains and of the balance are the same in every pull.
    common_se = np.hypot(np.sqrt(np.sum(gain[far] ** 2)) / far.sum(), force_se[usable].mean())
    error = float(np.hypot(random_se / mean, common_se))
    reason = f"EI {mean:.0f} N cm2 +- {100 * error:.0f} % from {n} pull(s)"
    if error > _GOOD:
        reason += "; pull harder, more often, or calibrate the flex sensors first"
    return BendingResult(
        mean, mean * error, stiffness, Verdict(error <= _GOOD, reason, tuple(notes))
    )


def from_fold(config: RobotConfig) -> BendingResult:
    """EI from the critical curvature, the body pressure and the radius, without readings."""
    body = config.body
    if not body.folds:
        raise DataError(
            "the base does not fold, so its fold tells no stiffness", "hang a weight (`--csv`)"
        )
    slack = np.pi * body.critical_pressure_psi * _N_PER_CM2 * body.radius_cm**3
    stiffness = float(_FOLD * slack / body.critical_curvature)
    error = float(np.hypot(_FOLD_SE / _FOLD, body.critical_curvature_se / body.critical_curvature))
    reason = (
        f"EI {stiffness:.0f} N cm2 +- {100 * error:.0f} %, stated from the fold at "
        f"{body.critical_curvature:.4g} 1/cm; a hung weight tells it better"
    )
    return BendingResult(stiffness, stiffness * error, np.array([]), Verdict(True, reason))


def _over_stiffness(
    row: Array, center: Array, span: Array, noise: Array, arc: float
) -> tuple[float, float]:
    """Force over EI at an arc, and its standard error, 1/cm^2, for positive curvatures (m,)."""
    force = 1e-6
    error = 0.0
    for _ in range(_PASSES):
        lever = np.asarray(
            push(force, arc, free_curvature=0.0, length=arc).averages(center, span) / force, float
        )
        power = float((lever**2 / noise**2).sum())
        force = max(float((lever * row / noise**2).sum()) / power, 1e-9)
        error = power**-0.5
    return force, error
