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
from scipy.optimize import least_squares

from thigmo.calibrate import bending
from thigmo.calibrate.bench import Bench, bow_rows, tip_rows
from thigmo.calibrate.columns import Array, constants_of, grouped
from thigmo.calibrate.regression import correlation_factor, outlying
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.mechanics import heading_along, traced
from thigmo.record.table import Table

_LEAST_BEND, _ASIDE = 0.055, (0.1, 0.19)  # offsets of the tip, as shares of the length


@dataclass(frozen=True)
class AxisPoints:
    """The body's axis in one picture, tip pushed aside."""

    points_cm: Array  # (n, 2) along the axis, base to tip
    force_arc_cm: float  # arc at which the force acts


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
    picture = table.integers("picture")
    rows = np.column_stack([table.numbers(name) for name in ("x_cm", "y_cm", "force_arc_cm")])
    finite = np.isfinite(rows).all(axis=1)
    picture, rows = picture[finite], rows[finite]
    pictures = [
        AxisPoints(rows[members, :2], rows[members[0], 2])
        for _, members in grouped(picture.tolist())
    ]
    return fit_stiffness(pictures, config)


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
        if len(picture.points_cm) < 20 or bend < _LEAST_BEND * config.body.length_cm:
            notes.append(f"picture {number} omitted: bent by {bend:.1f} cm only, or too few points")
        else:
            ratios.append((*_picture_ratio(picture, fine, gap), bend))
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


def _picture_ratio(picture: AxisPoints, fine: Array, gap: Array) -> tuple[float, float]:
    """Ratio and its standard error from one picture."""
    points, arc, step = picture.points_cm, picture.force_arc_cm, fine[1] - fine[0]
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    arc_cm = points[0, 0] + np.concatenate([[0.0], np.cumsum(steps)])

    def residuals(x: Array) -> Array:
        # The lever follows the bend: the force stays normal to the body where it acts.
        heading = np.zeros(len(fine))
        for _ in range(3):
            end = np.interp(arc, fine, heading)
            lean = np.where(fine < arc, np.cos(heading - end), 0.0)
            lever = np.cumsum(lean[::-1])[::-1] * step
            k = x[2] * lever * (1 + x[3] * gap)
            heading = x[1] + heading_along(k, step)
        x_cm, y_cm = traced(heading, step)
        curve_x, curve_y = np.interp(arc_cm, fine, x_cm), np.interp(arc_cm, fine, x[0] + y_cm)
        turn = np.interp(arc_cm, fine, heading)
        return np.asarray(
            np.cos(turn) * (points[:, 1] - curve_y) - np.sin(turn) * (points[:, 0] - curve_x)
        )

    start = np.array([points[0, 1], 0.0, 3 * points[-1, 1] / arc**3, 0.0])
    fit = least_squares(
        residuals, start, loss="soft_l1", f_scale=0.05, x_scale=[0.1, 0.01, 1e-5, 0.1]
    )
    misfit, slopes = residuals(fit.x), np.asarray(fit.jac, float)
    variance = float(misfit @ misfit) / max(1, len(misfit) - 4) * correlation_factor(misfit, 0.9)
    covariance = np.linalg.pinv(slopes.T @ slopes) * variance
    return 1 + float(fit.x[3]), float(np.sqrt(covariance[3, 3]))
