"""Moment and turn at the base, from the body's axis in one picture, with its tip pushed aside.

The moment along the body is known up to one factor from where the force acts. The camera's heading
and the base's place are free, so a base that turns or yields does not bend the fitted body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from thigmo.calibrate.columns import Array, grouped
from thigmo.calibrate.regression import correlation_factor
from thigmo.mechanics import heading_along, traced
from thigmo.record.table import Table

FEWEST_POINTS = 20  # of an axis
_CORRELATION = 0.9  # ceiling of that of neighbouring points


@dataclass(frozen=True)
class AxisPoints:
    """The body's axis in one picture, tip pushed aside."""

    points_cm: Array  # (n, 2) along the axis, base to tip
    force_arc_cm: float  # arc at which the force acts


@dataclass(frozen=True)
class AxisFit:
    """A loaded body in one picture."""

    turn_rad: float  # heading of the axis at the base, in the camera's plane
    moment: float  # at the base, over EI, 1/cm
    excess: float  # of the curvature in gaps over that under sensors, relative; 0 if not fitted
    covariance: Array  # (3, 3) of these, in this order


def pictures_of(table: Table, length_cm: float) -> list[AxisPoints]:
    """Pictures of a CSV with the columns `picture`, `x_cm`, `y_cm` and perhaps `force_arc_cm`."""
    picture = table.integers("picture")
    rows = np.column_stack(
        [table.numbers("x_cm"), table.numbers("y_cm"), table.numbers("force_arc_cm", length_cm)]
    )
    finite = np.isfinite(rows).all(axis=1)
    picture, rows = picture[finite], rows[finite]
    return [
        AxisPoints(rows[members, :2], rows[members[0], 2])
        for _, members in grouped(picture.tolist())
    ]


def fit_axis(
    picture: AxisPoints, fine: Array, *, gap: Array | None = None, softness: Array | None = None
) -> AxisFit:
    """Turn and moment at the base of a body that a force normal to it bends.

    Args:
        picture: points along the axis.
        fine: (f,) arcs of the fitted body at even distances, cm, from 0.
        gap: (f,) 1 in gaps between sensors and 0 under them, to fit the excess of curvature in
            gaps; None if that is not fitted.
        softness: (f,) curvature under a moment over that of the mean body; None if it is 1.
    """
    points, arc, step = picture.points_cm, picture.force_arc_cm, fine[1] - fine[0]
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    arc_cm = points[0, 0] + np.concatenate([[0.0], np.cumsum(steps)])
    even = np.ones(len(fine)) if softness is None else softness

    def bent(x: Array) -> tuple[Array, Array]:
        """Headings without the base's turn, and moments over their scale."""
        # The lever follows the bend: the force stays normal to the body where it acts.
        heading, lever = np.zeros(len(fine)), np.zeros(len(fine))
        per_moment = even if gap is None else even * (1 + x[3] * gap)
        for _ in range(3):
            end = np.interp(arc, fine, heading)
            lean = np.where(fine < arc, np.cos(heading - end), 0.0)
            lever = np.cumsum(lean[::-1])[::-1] * step
            heading = x[1] + heading_along(x[2] * lever * per_moment, step)
        return heading, lever

    def residuals(x: Array) -> Array:
        heading, _ = bent(x)
        x_cm, y_cm = traced(heading, step)
        curve_x, curve_y = np.interp(arc_cm, fine, x_cm), np.interp(arc_cm, fine, x[0] + y_cm)
        turn = np.interp(arc_cm, fine, heading)
        return np.asarray(
            np.cos(turn) * (points[:, 1] - curve_y) - np.sin(turn) * (points[:, 0] - curve_x)
        )

    count = 3 if gap is None else 4
    start = np.array([points[0, 1], 0.0, 3 * points[-1, 1] / arc**3, 0.0])[:count]
    scale = [0.1, 0.01, 1e-5, 0.1][:count]
    fit = least_squares(residuals, start, loss="soft_l1", f_scale=0.05, x_scale=scale)
    misfit, slopes = residuals(fit.x), np.asarray(fit.jac, float)
    variance = float(misfit @ misfit) / max(1, len(misfit) - 4)
    variance *= correlation_factor(misfit, _CORRELATION)
    covariance = np.zeros((4, 4))
    covariance[:count, :count] = np.linalg.pinv(slopes.T @ slopes) * variance
    lever = float(bent(fit.x)[1][0])
    to_answer = np.diag([1.0, lever, 1.0])
    return AxisFit(
        float(fit.x[1]),
        float(fit.x[2]) * lever,
        float(fit.x[3]) if gap is not None else 0.0,
        to_answer @ covariance[1:, 1:] @ to_answer,
    )
