"""Is the body as stiff under a sensor as between sensors? (The thesis's open question.)

Readings with a known force go to `bending`, which gives the stiffness in N cm^2.

Pictures of the robot with its tip pushed aside give the axis; the moment along it is known up to
one factor from where the force acts. With k = m(s) (1 + rho w(s)), w = 1 in gaps and 0 under
sensors, rho is the excess of curvature in the gaps: EI_sensor / EI_gap = 1 + rho. A sensor's
calibration already holds the curvature under it; rho matters for the shape of the whole body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thigmo.calibrate import bending
from thigmo.calibrate.axis import FEWEST_POINTS, AxisPoints, fit_axis, pictures_of
from thigmo.calibrate.bench import Bench, bow_rows, tip_rows
from thigmo.calibrate.columns import Array, constants_of
from thigmo.calibrate.regression import outlying
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.record.table import Table

_LEAST_BEND, _ASIDE = 0.055, (0.1, 0.19)  # offsets of the tip, as shares of the length


@dataclass(frozen=True)
class StiffnessResult(StepResult):
    """Stiffness under sensors over stiffness in gaps."""

    ratio: float  # EI_sensor / EI_gap
    ratio_se: float  # its standard error
    picture_ratio: Array  # (p,) ratio of every picture alone
    verdict: Verdict  # in words


def guided(bench: Bench) -> StiffnessResult:
    """Fit pictures of the flex step's tip places, and further ones."""
    rows = [*(row for row in tip_rows(bench) if row["kind"] == "tip"), *bow_rows(bench)]
    axes = [np.array(r["points"], float) for r in rows if r.get("points") is not None]
    length = bench.config.body.length_cm
    return fit_stiffness([AxisPoints(points, length) for points in axes], bench.config)


def of_csv(table: Table, config: RobotConfig) -> StepResult:
    """Fit a CSV of pulls with known forces (`bending`), or of points along the axis by picture."""
    if "force_n" in table:
        return bending.of_csv(table, config)
    return fit_stiffness(pictures_of(table, config.body.length_cm), config)


def fit_stiffness(pictures: Sequence[AxisPoints], config: RobotConfig) -> StiffnessResult:
    """Ratio of stiffness under sensors to that in gaps."""
    fine = np.arange(0.0, config.body.length_cm + 1e-9, 0.1)
    center, span = constants_of(config, "center_cm", "span_cm")
    gap = (np.abs(fine[:, None] - center) > span / 2).all(axis=1).astype(float)
    if not 0.05 < gap.mean() < 0.95:
        raise DataError("sensors cover all of the body or none of it", "there is no gap to compare")
    ratios, notes = [], []
    for number, picture in enumerate(pictures, start=1):
        bend = float(np.abs(picture.points_cm[:, 1]).max())
        if len(picture.points_cm) < FEWEST_POINTS or bend < _LEAST_BEND * config.body.length_cm:
            notes.append(f"picture {number} omitted: bent by {bend:.1f} cm only, or too few points")
        else:
            fit = fit_axis(picture, fine, gap=gap)
            ratios.append((1 + fit.excess, float(fit.covariance[2, 2] ** 0.5), bend))
    if len(ratios) < 3:
        raise DataError(
            f"{len(ratios)} usable pictures",
            "take three or more with the tip {:.0f}..{:.0f} cm aside".format(
                *(share * config.body.length_cm for share in _ASIDE)
            ),
        )
    estimates, errors, bends = np.array(ratios).T
    # The error of a picture grows with its estimate, which would favour low estimates. So it is
    # computed at the common estimate, from how far the body was bent.
    middle = float(np.median(estimates))
    se = middle * float(np.median(errors / estimates * bends)) / bends
    outliers = outlying(estimates, 4.5, se)
    if outliers.any():
        notes.append(f"{int(outliers.sum())} picture(s) omitted as outliers")
    inliers, weights = estimates[~outliers], 1 / se[~outliers] ** 2
    ratio = float((weights * inliers).sum() / weights.sum())
    scatter = float(np.sqrt((weights * (inliers - ratio) ** 2).sum() / max(1, len(inliers) - 1)))
    error = float(weights.sum() ** -0.5) * max(1.0, scatter)
    if error > 0.15:
        reason = (
            f"ratio {ratio:.2f} +- {error:.2f}: too uncertain, take more pictures (`thigmo "
            f"calibrate stiffness --pictures {3 * len(pictures)} --again`); nothing else needs it"
        )
    else:
        words = "stiffer under the sensors" if ratio > 1 else "softer under the sensors"
        if abs(ratio - 1) < 3 * error:
            words = "as stiff under sensors as between"
        reason = f"the body is {words}: ratio {ratio:.3f} +- {error:.3f}"
    return StiffnessResult(ratio, error, estimates, Verdict(error <= 0.15, reason, tuple(notes)))
