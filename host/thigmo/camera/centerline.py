"""The body's axis: a smooth curve through points along it, with the uncertainty of its curvature.

The points come from `thigmo.camera.body`. Calibration depends on the curvature and its error, so
the fit takes into account that errors of neighbouring points are correlated.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.optimize import least_squares

from thigmo.errors import DataError
from thigmo.mechanics import heading_along, traced

Array = NDArray[np.float64]
_KNOT_CM = 7.0  # distance of the spline's knots
_POINT_SE_CM = 0.02  # least standard error of a point


@dataclass(frozen=True)
class Centerline:
    """The fitted axis, with the uncertainty of its curvature."""

    arc_cm: Array  # (n,) arc length from the base's plane to the tip
    x_cm: Array  # (n,) points of the axis
    y_cm: Array  # (n,)
    heading: Array  # (n,) heading of the axis, rad
    residual_cm: float  # rms distance of the fitted points from the curve
    coefficients: Array  # (m,) lateral start, heading start, curvature coefficients
    covariance: Array  # (m, m) of them
    average: Array  # (n, m-2) cumulative integrals of the basis, for `mean_curvature`
    points_cm: Array  # (p, 2) points that were fitted

    @property
    def length_cm(self) -> float:
        """Arc length from the base to the tip."""
        return float(self.arc_cm[-1])

    @property
    def tip_cm(self) -> tuple[float, float]:
        """(x, y) of the tip."""
        return float(self.x_cm[-1]), float(self.y_cm[-1])

    @property
    def curvature(self) -> float:
        """Mean curvature of the body, 1/cm."""
        return float(self.heading[-1] - self.heading[0]) / self.length_cm

    def mean_curvature(self, center_cm: float, span_cm: float) -> tuple[float, float]:
        """Mean curvature over a sensor's span on the body, and its standard error, 1/cm."""
        low, high = center_cm - span_cm / 2, center_cm + span_cm / 2
        if low < self.arc_cm[0] - 0.5 or high > self.arc_cm[-1] + 0.5 or span_cm <= 0:
            raise DataError(
                f"the span {low:.1f}..{high:.1f} cm is not on the seen body", "grow the robot first"
            )
        ends = [np.interp([low, high], self.arc_cm, column) for column in self.average.T]
        weights = np.diff(ends)[:, 0] / span_cm
        value = float(weights @ self.coefficients[2:])
        return value, float(np.sqrt(weights @ self.covariance[2:, 2:] @ weights))


def fit_centerline(
    points_cm: Array,
    tip_cm: Array | None = None,
    *,
    constant: bool = False,
    good: NDArray[np.bool_] | None = None,
) -> Centerline:
    """Smooth axis through points along the body.

    The curve starts at x = 0 with a free lateral place and heading. Its curvature is one number
    (`constant`) or a cubic spline, fitted with a Huber loss. The covariance is scaled by the
    residuals and by their correlation along the arc, because neighbouring points are correlated.

    Args:
        points_cm: (n, 2) points from base to tip.
        tip_cm: (2,) end of the body; the last point if not given.
        constant: whether it is a free bend.
        good: (n,) whether to use a point; all if not given.

    Raises:
        DataError: fewer than six points, or points that are not finite.
    """
    points = np.asarray(points_cm, float)
    if points.ndim != 2 or len(points) < 6 or not np.isfinite(points).all():
        raise DataError("the axis needs six or more finite points", "clear the view of the body")
    end = points[-1] if tip_cm is None else np.asarray(tip_cm, float)
    weights = np.ones(len(points))
    if good is not None and good.sum() >= 6:
        weights[~good] = 0.05
    # Arcs of the points start as lengths along the chain (the body leaves the base along +x, so the
    # first arc is its x), which noise lengthens. Then they are projected onto the fitted curve.
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    arcs = points[0, 0] + np.concatenate([[0.0], np.cumsum(steps)])
    last = points[-1] - points[-2]
    total = arcs[-1] + float((end - points[-1]) @ last) / max(float(np.linalg.norm(last)), 1e-9)
    fit = partial(_fit, points, weights, constant)
    fitted = fit(arcs, total)
    for _ in range(2):
        arcs = _project(points, arcs, fitted)
        total = float(_project(end[None], np.array([total]), fitted)[0])
        fitted = fit(arcs, total)
    return fitted


def _project(points: Array, arcs: Array, line: Centerline) -> Array:
    """Arcs of points, moved along the curve's tangent to the foot of each point."""
    inside = np.clip(arcs, 0.0, line.arc_cm[-1])
    turn = np.interp(inside, line.arc_cm, line.heading)
    x, y = (np.interp(inside, line.arc_cm, c) for c in (line.x_cm, line.y_cm))
    tangential = np.cos(turn) * (points[:, 0] - x) + np.sin(turn) * (points[:, 1] - y)
    return np.asarray(inside + tangential)


def _fit(
    points: Array,
    weights: Array,
    constant: bool,
    arcs: Array,
    total: float,
) -> Centerline:
    """One fit with fixed arcs of the points."""
    n = 1 if constant else max(4, int(total / _KNOT_CM) + 3)
    fine = np.linspace(0.0, total, max(60, int(total / 0.1)))
    if constant:
        basis = np.ones((len(fine), 1))
    else:  # clamped cubic B-splines
        knots = np.concatenate([[0.0] * 3, np.linspace(0, total, n - 2), [total] * 3])
        basis = np.asarray(BSpline.design_matrix(fine, knots, 3).toarray(), float)
    step = fine[1] - fine[0]
    integral = heading_along(basis.T, step).T

    def curve(p: Array) -> tuple[Array, Array, Array]:
        heading = p[1] + integral @ p[2:]
        x, y = traced(heading, step)
        return x, p[0] + y, heading

    # Second differences of the spline's coefficients are penalised, so that noise between knots
    # does not become bends; 2e-3 1/cm per knot squared is more than a loaded body has.
    roughness = np.diff(np.eye(n), 2, axis=0) / 4e-3 if n > 3 else np.zeros((0, n))

    def residuals(p: Array) -> Array:
        x, y, heading = curve(p)
        offset = points - np.column_stack([np.interp(arcs, fine, x), np.interp(arcs, fine, y)])
        turn = np.interp(arcs, fine, heading)
        normal = -np.sin(turn) * offset[:, 0] + np.cos(turn) * offset[:, 1]
        return np.concatenate([weights * normal / _POINT_SE_CM, roughness @ p[2:]])

    chord = float(np.arctan2(points[-1, 1] - points[0, 1], points[-1, 0] - points[0, 0]))
    first = np.concatenate([[points[0, 1], 0.0], np.full(n, 2 * chord / total)])
    fit = least_squares(residuals, first, loss="huber", f_scale=2.5, x_scale="jac", max_nfev=60)
    raw = residuals(fit.x)[: len(points)]
    used = weights > 0.5
    errors = np.clip(raw[used], -4 * np.std(raw[used]), 4 * np.std(raw[used]))
    scale = max(1.0, float(np.sqrt(np.sum(errors**2) / max(1, len(errors) - n - 2))))
    lagged = float(np.corrcoef(errors[1:], errors[:-1])[0, 1]) if len(errors) > 8 else 0.0
    lagged = min(0.9, max(0.0, lagged)) if np.isfinite(lagged) else 0.0
    inflation = scale**2 * (1 + lagged) / (1 - lagged)
    slopes = np.asarray(fit.jac, float)
    covariance = np.linalg.pinv(slopes.T @ slopes) * inflation
    residual_cm = float(np.sqrt(np.mean(errors**2)) * _POINT_SE_CM)
    return Centerline(fine, *curve(fit.x), residual_cm, fit.x, covariance, integral, points[used])
