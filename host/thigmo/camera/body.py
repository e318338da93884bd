"""The robot in a picture: which pixels are body, where its axis runs, how it is curved.

The picture is laid flat at the height of the tube's axis (the silhouette's middle there is the
axis), body and table are told apart by the colour found at the base, the tube is followed from the
base by its two flanks, and a smooth curve is fitted to the flanks' middles. Curvature comes from
that fit with its covariance: constant for free bends, a spline for any other shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

from thigmo.camera.errors import BodyNotSeenError
from thigmo.camera.model import CameraModel, Picture
from thigmo.errors import DataError

Array = NDArray[np.float64]

BODY_PX_CM = 12  # enough for a tube that is 40 px wide
_STEP_CM = 0.5
_CLASH = 0.5  # bodyness at a flank


@dataclass(frozen=True)
class Flat:
    """A picture laid flat on a plane above the table, x to the right, y up (rows run down).

    Attributes:
        image: (h, w, 3) BGR.
        low: (2,) x, y of the lower left corner, cm.
        high: (2,) x, y of the upper right corner, cm.
        height_cm: of the plane.
        px_per_cm: resolution.
    """

    image: Picture
    low: Array
    high: Array
    height_cm: float
    px_per_cm: int

    def pixels(self, points_cm: Array) -> NDArray[np.float32]:
        """Workspace x, y (n, 2) to column, row (n, 2)."""
        columns = (points_cm[..., 0] - self.low[0]) * self.px_per_cm - 0.5
        rows = (self.high[1] - points_cm[..., 1]) * self.px_per_cm - 0.5
        return np.stack([columns, rows], axis=-1).astype(np.float32)

    def places(self, pixels: Array) -> Array:
        """Column, row (n, 2) to workspace x, y (n, 2)."""
        x = (pixels[..., 0] + 0.5) / self.px_per_cm + self.low[0]
        y = self.high[1] - (pixels[..., 1] + 0.5) / self.px_per_cm
        return np.stack([x, y], axis=-1)


def flatten(
    picture: Picture,
    camera: CameraModel,
    height_cm: float,
    low: Sequence[float] = (-4.0, -58.0),
    high: Sequence[float] = (60.0, 58.0),
    px_per_cm: int = BODY_PX_CM,
) -> Flat:
    """Lay a picture flat at a height."""
    box_low, box_high = np.asarray(low, float), np.asarray(high, float)
    columns, rows = (ceil(n * px_per_cm) for n in box_high - box_low)
    # The map is smooth: computed every 16 px, interpolated between.
    step = 16
    grid_x = np.arange(0, columns + 2 * step, step)
    grid_y = np.arange(0, rows + 2 * step, step)
    x = (grid_x + 0.5) / px_per_cm + box_low[0]
    y = box_high[1] - (grid_y + 0.5) / px_per_cm
    mesh = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    solid = np.column_stack([mesh, np.full(len(mesh), height_cm)])
    coarse = camera.project(solid).astype(np.float32).reshape(len(y), len(x), 2)
    lookup = np.einsum("rR,RCk->rCk", _between(rows, step, len(y)), coarse, optimize=True)
    lookup = np.einsum("cC,rCk->rck", _between(columns, step, len(x)), lookup, optimize=True)
    columns_of, rows_of = (np.ascontiguousarray(lookup[..., k]) for k in (0, 1))
    colored = picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    image = cv2.remap(colored, columns_of, rows_of, cv2.INTER_LINEAR)
    return Flat(np.asarray(image, np.uint8), box_low, box_high, height_cm, px_per_cm)


def _between(n: int, step: int, knots: int) -> NDArray[np.float32]:
    """Linear interpolation matrix (n, knots) for knots every `step` pixels."""
    at = np.arange(n) / step
    left = np.floor(at).astype(int)
    weights = np.zeros((n, knots), np.float32)
    weights[np.arange(n), left] = 1 - (at - left)
    weights[np.arange(n), left + 1] += at - left
    return weights


def bodyness(
    flat: Flat, radius_cm: float, covers: Sequence[Array] = (), background: Flat | None = None
) -> NDArray[np.float32]:
    """How much each pixel looks like the body, about 0 (table) to 1 (body).

    The body's colour is sampled where the robot leaves its base, the table's everywhere; a linear
    discriminant in log-chromaticity (which shadows leave alone) and, weakly, brightness tells them
    apart. With a `background` picture of the empty table, change against it counts as well.

    Args:
        flat: picture laid flat at the axis's height.
        radius_cm: tube radius.
        covers: polygons (n, 2) in cm that hide the body (the tip marker): counted as body.
        background: the same view without the robot.

    Raises:
        BodyNotSeenError: base and table have the same colour.
    """
    features = _features(flat.image)
    # Light differs along the body and across it far more than in the sample.
    lighting = np.diag([0.002, 0.002, 0.3])
    loosest = 0.15
    if background is not None:
        # What was there before cancels, and a small change of colour is enough.
        features = features - _features(background.image)
        lighting, loosest = np.diag([1e-5, 1e-5, 0.03]), 0.04
    seed = _patch(features, flat, (1.0, 4.0), 0.5 * radius_cm)
    table = features[::6, ::6].reshape(-1, 3)
    center, spread = np.median(seed, axis=0), np.cov(seed.T)
    middle = np.median(table, axis=0)
    quiet = table[np.abs(table - middle).max(axis=1) < (0.5 if background is None else 0.1)]
    pooled = spread + np.cov(quiet.T) + lighting
    direction = np.linalg.solve(pooled, center - middle)
    distance = float(np.sqrt((center - middle) @ direction))
    if distance < 2.0:
        raise BodyNotSeenError(
            "the body at the base has the colour of the table",
            "lay a cloth of another colour under the robot, or give a picture of the empty table",
        )
    score = (features - middle) @ direction / ((center - middle) @ direction)
    # Another colour altogether (clutter) is as little body as the table is.
    away = features[..., :2] - center[:2]
    reach = np.sqrt(np.maximum(np.diag(spread)[:2], loosest**2 / 8)) * 4 + loosest
    strange = np.sqrt(((away / reach) ** 2).sum(axis=-1))
    score = (np.clip(score, 0, 1) * np.clip(2 - strange, 0, 1)).astype(np.float32)
    for cover in covers:
        polygon = np.round(flat.pixels(cover)).astype(np.int32).reshape(-1, 1, 2)
        cv2.fillPoly(score, [polygon], 1.0)
    return np.asarray(cv2.GaussianBlur(score, (0, 0), 1.2), np.float32)


def _features(image: Picture) -> NDArray[np.float32]:
    """Log-chromaticities and log-brightness (h, w, 3)."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5).astype(np.float32) + 12.0
    logs = np.log(smooth)
    return np.dstack(
        [logs[..., 2] - logs[..., 1], logs[..., 0] - logs[..., 1], logs.mean(axis=-1)]
    ).astype(np.float32)


def _patch(
    features: NDArray[np.float32], flat: Flat, x: tuple[float, float], half_y: float
) -> NDArray[np.float64]:
    corners = flat.pixels(np.array([[x[0], half_y], [x[1], -half_y]]))
    (left, upper), (right, lower) = np.round(corners).astype(int)
    return features[upper:lower, left:right].reshape(-1, 3).astype(float)


@dataclass(frozen=True)
class Track:
    """The body as followed from its base.

    Attributes:
        middle: (n, 2) cm, mid-points of the flanks, base to tip, about 0.5 cm apart.
        good: (n,) whether both flanks were seen there.
        tip: (2,) cm, where the body ends.
    """

    middle: Array
    good: NDArray[np.bool_]
    tip: Array


def follow(
    flat: Flat,
    score: NDArray[np.float32],
    radius_cm: float,
    start: Sequence[float] = (0.6, 0.0),
    longest_cm: float = 200.0,
) -> Track:
    """Follow the tube from its base by both flanks.

    Where one flank is hidden (a peg before the body) the other and the known radius stand in.

    Raises:
        BodyNotSeenError: nothing like a tube of that radius starts at the base.
    """
    reach = np.arange(-2.2, 2.2001, 0.05) * radius_cm

    def sample(points: Array) -> NDArray[np.float32]:
        at = flat.pixels(points)
        return np.asarray(
            cv2.remap(score, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=0), np.float32
        )

    def flanks(point: Array, heading: float) -> tuple[float, float, float]:
        """Offsets of the left and right flank (nan if not plausible), and filling between."""
        normal = np.array([-np.sin(heading), np.cos(heading)])
        profile = sample((point + reach[:, None] * normal)[None])[0]
        edge = {}
        for side in (1.0, -1.0):
            values, offsets = (profile, reach) if side > 0 else (profile[::-1], reach[::-1])
            drop = np.nonzero((values[:-1] >= _CLASH) & (values[1:] < _CLASH))[0]
            place = offsets[drop] + (values[drop] - _CLASH) / (values[drop] - values[drop + 1]) * (
                offsets[drop + 1] - offsets[drop]
            )
            near = np.abs(place - side * radius_cm)
            at = int(np.argmin(near)) if len(near) else -1
            edge[side] = float(place[at]) if at >= 0 and near[at] < 0.6 * radius_cm else np.nan
        inner = np.abs(reach) < 0.8 * radius_cm
        return edge[1.0], edge[-1.0], float(profile[inner].mean())

    point, heading = np.asarray(start, float), 0.0
    middles: list[Array] = []
    good: list[bool] = []
    lost = 0
    while len(middles) * _STEP_CM < longest_cm:
        left, right, filling = flanks(point, heading)
        whole = bool(abs((left - right) / (2 * radius_cm) - 1) < 0.22)
        if filling < 0.5:
            break
        if whole:
            shift = (left + right) / 2
        elif np.isfinite(left) and not np.isfinite(right):
            shift = left - radius_cm
        elif np.isfinite(right) and not np.isfinite(left):
            shift = right + radius_cm
        else:
            shift = 0.0
        lost = 0 if whole else lost + 1
        if lost * _STEP_CM > 4 * radius_cm:
            break
        normal = np.array([-np.sin(heading), np.cos(heading)])
        point = point + float(np.clip(shift, -0.35 * radius_cm, 0.35 * radius_cm)) * normal
        middles.append(point)
        good.append(whole)
        recent = np.array(middles[-12:])
        if len(recent) >= 4:
            # A parabola through the last 6 cm tells where the tube goes next.
            along = np.arange(len(recent)) * _STEP_CM
            degree = 2 if len(recent) >= 9 else 1
            slope = [np.polyfit(along, recent[:, k], degree) for k in (0, 1)]
            end = along[-1] + _STEP_CM / 2
            ahead = [np.polyval(np.polyder(line), end) for line in slope]
            heading = float(np.arctan2(ahead[1], ahead[0]))
        point = point + _STEP_CM * np.array([np.cos(heading), np.sin(heading)])
    if len(middles) * _STEP_CM < 3 * radius_cm or np.mean(good) < 0.5:
        raise BodyNotSeenError(
            "no tube of the configured diameter starts at the base",
            "check body.diameter_cm and the cards' places, or click its axis by hand (`--click`)",
        )
    middle = np.array(middles)
    # The end: where bodyness along the axis (mean over its width) falls through a half.
    end_heading = heading
    forward = np.array([np.cos(end_heading), np.sin(end_heading)])
    normal = np.array([-forward[1], forward[0]])
    ahead_cm = np.arange(-2.5, 2.5, 0.05)
    lanes = np.linspace(-0.6, 0.6, 13) * radius_cm
    base = middle[-1]
    grid = base + ahead_cm[:, None, None] * forward + lanes[None, :, None] * normal
    fade = gaussian_filter1d(np.median(sample(grid), axis=1).astype(float), 2)
    falls = np.nonzero((fade[:-1] >= 0.5) & (fade[1:] < 0.5))[0]
    overshoot = float(ahead_cm[falls[-1]] + 0.025) if len(falls) else 0.0
    return Track(middle, np.array(good), base + overshoot * forward)


@dataclass(frozen=True)
class Centerline:
    """The fitted axis, with the uncertainty of its curvature.

    Attributes:
        arc_cm: (n,) from the base's plane to the tip.
        x_cm: (n,).
        y_cm: (n,).
        heading: (n,) rad.
        curvature: (n,) 1/cm.
        curvature_se: (n,) one sigma.
        residual_cm: rms distance of the flanks' middles from the curve.
        constant: whether a single curvature was fitted.
        coefficients: (m,) lateral start, heading start, curvature coefficients.
        covariance: (m, m) of them.
        average: (n, m-2) cumulative integrals of the basis, for `mean_curvature`.
        points_cm: (p, 2) what was fitted.
    """

    arc_cm: Array
    x_cm: Array
    y_cm: Array
    heading: Array
    curvature: Array
    curvature_se: Array
    residual_cm: float
    constant: bool
    coefficients: Array
    covariance: Array
    average: Array
    points_cm: Array

    @property
    def length_cm(self) -> float:
        """Arc length from the base to the tip."""
        return float(self.arc_cm[-1])

    @property
    def tip_cm(self) -> tuple[float, float]:
        """Tip's place."""
        return float(self.x_cm[-1]), float(self.y_cm[-1])

    def mean_curvature(self, center_cm: float, span_cm: float) -> tuple[float, float]:
        """Average curvature over a sensor's span, and its one sigma (1/cm).

        Raises:
            DataError: the span is not on the body.
        """
        low, high = center_cm - span_cm / 2, center_cm + span_cm / 2
        if low < self.arc_cm[0] - 0.5 or high > self.arc_cm[-1] + 0.5 or span_cm <= 0:
            raise DataError(
                f"the span {low:.1f}..{high:.1f} cm is not on the seen body", "grow the robot first"
            )
        ends = np.array(
            [
                [np.interp(at, self.arc_cm, column) for column in self.average.T]
                for at in (low, high)
            ]
        )
        weights = (ends[1] - ends[0]) / span_cm
        value = float(weights @ self.coefficients[2:])
        return value, float(np.sqrt(weights @ self.covariance[2:, 2:] @ weights))


def fit_centerline(
    points_cm: Array,
    tip_cm: Array | None = None,
    *,
    constant: bool = False,
    good: NDArray[np.bool_] | None = None,
    knot_cm: float = 7.0,
    point_se_cm: float = 0.02,
) -> Centerline:
    """Smooth axis through points along the body.

    The curve starts at x = 0 with a free lateral place and heading; its curvature is one number
    (`constant`) or a cubic spline. Huber loss; the covariance is scaled by the residuals and by
    their correlation along the arc, which is what neighbouring points of a picture have.

    Args:
        points_cm: (n, 2) base to tip.
        tip_cm: (2,) where the body ends (default: the last point).
        constant: fit one curvature (a free bend).
        good: (n,) points to use.
        knot_cm: distance of the spline's knots.
        point_se_cm: least standard error of a point.

    Raises:
        DataError: fewer than six points, or points that are not finite.
    """
    points = np.asarray(points_cm, float)
    if points.ndim != 2 or len(points) < 6 or not np.isfinite(points).all():
        raise DataError("the axis needs six or more finite points", "click more points")
    end = points[-1] if tip_cm is None else np.asarray(tip_cm, float)
    weights = np.ones(len(points))
    if good is not None and good.sum() >= 6:
        weights[~good] = 0.05
    # Arc of each point: along the chain at first (the body leaves the base along +x, so the first
    # one's is its x), which noise lengthens; then by projection onto the fitted curve.
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    at = points[0, 0] + np.concatenate([[0.0], np.cumsum(steps)])
    last = points[-1] - points[-2]
    total = at[-1] + float((end - points[-1]) @ last) / max(float(np.linalg.norm(last)), 1e-9)
    fitted = _fit(points, at, total, weights, constant, knot_cm, point_se_cm)
    for _ in range(2):
        at = _project(points, at, fitted)
        total = float(_project(end[None], np.array([total]), fitted)[0])
        fitted = _fit(points, at, total, weights, constant, knot_cm, point_se_cm)
    return fitted


def _project(points: Array, at: Array, line: Centerline) -> Array:
    """Arcs of points, moved along the curve's tangent to the foot of each point."""
    inside = np.clip(at, 0.0, line.arc_cm[-1])
    turn = np.interp(inside, line.arc_cm, line.heading)
    x, y = (np.interp(inside, line.arc_cm, c) for c in (line.x_cm, line.y_cm))
    ahead = np.cos(turn) * (points[:, 0] - x) + np.sin(turn) * (points[:, 1] - y)
    return np.asarray(inside + ahead)


def _fit(
    points: Array,
    at: Array,
    total: float,
    weights: Array,
    constant: bool,
    knot_cm: float,
    point_se_cm: float,
) -> Centerline:
    """One fit with the points' arcs held."""
    n = 1 if constant else max(4, int(total / knot_cm) + 3)
    fine = np.linspace(0.0, total, max(60, int(total / 0.1)))
    basis = np.ones((len(fine), 1)) if n == 1 else _spline_basis(fine, total, n)
    step = fine[1] - fine[0]
    integral = np.vstack([np.zeros(n), np.cumsum((basis[1:] + basis[:-1]) / 2 * step, axis=0)])

    def curve(p: Array) -> tuple[Array, Array, Array]:
        heading = p[1] + integral @ p[2:]
        middle = (heading[1:] + heading[:-1]) / 2
        x = np.concatenate([[0.0], np.cumsum(np.cos(middle) * step)])
        y = p[0] + np.concatenate([[0.0], np.cumsum(np.sin(middle) * step)])
        return x, y, heading

    # Second differences of the spline's coefficients are held down, so that noise between
    # knots is not taken for bends; 2e-3 1/cm per knot squared is more than a loaded body shows.
    roughness = np.diff(np.eye(n), 2, axis=0) / 4e-3 if n > 3 else np.zeros((0, n))

    def residuals(p: Array) -> Array:
        x, y, heading = curve(p)
        away = points - np.column_stack([np.interp(at, fine, x), np.interp(at, fine, y)])
        turn = np.interp(at, fine, heading)
        normal = -np.sin(turn) * away[:, 0] + np.cos(turn) * away[:, 1]
        return np.concatenate([weights * normal / point_se_cm, roughness @ p[2:]])

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
    inverse = np.linalg.pinv(slopes.T @ slopes)
    covariance = inverse * inflation
    x, y, heading = curve(fit.x)
    spread = np.einsum("ij,jk,ik->i", basis, covariance[2:, 2:], basis)
    return Centerline(
        fine,
        x,
        y,
        heading,
        basis @ fit.x[2:],
        np.sqrt(np.maximum(spread, 0)),
        float(np.sqrt(np.mean(errors**2)) * point_se_cm),
        constant,
        fit.x,
        covariance,
        integral,
        points[used],
    )


def _spline_basis(at: Array, total: float, n: int) -> Array:
    """Clamped cubic B-splines (len(at), n) over 0..total."""
    inner = np.linspace(0, total, n - 2)
    knots = np.concatenate([[0.0] * 3, inner, [total] * 3])
    return np.asarray(BSpline.design_matrix(np.clip(at, 0, total), knots, 3).toarray(), float)
