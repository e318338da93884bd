"""The robot in a picture: which pixels are body, where its axis runs, how it is curved.

The picture is rectified to the height of the tube's axis, where the middle of the silhouette is the
axis. Body and table are separated by the colour found at the base. The tube is followed from the
base by its two flanks, and a smooth curve is fitted to the points midway between them. The fit
gives the curvature with its covariance: constant for free bends, a spline for any other shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from thigmo.camera.exceptions import BodyNotSeenError
from thigmo.camera.model import CameraModel, Picture

Array = NDArray[np.float64]

BODY_PX_CM = 12  # enough for a tube that is 40 px wide
# Corners of the region searched, over the robot's full length.
_AROUND = np.array([-4.0, -58.0]) / 53.0, np.array([60.0, 58.0]) / 53.0
_STEP_CM, _LONGEST_CM = 0.5, 400.0
_WIDTH_CM = 0.05  # change of width by wrinkles
# Width of the line around the tip marker in which blur mixes its margin with the body's colour.
COVER_RIM_PX = 5
_CLASH = 0.5  # bodyness at a flank
_EDGE_CM = 0.4  # distance to both sides of a flank in which its edge is searched
_EDGE_GRAY = 15.0  # least contrast of an edge that is used


@dataclass(frozen=True)
class Flat:
    """A picture rectified to a plane above the table, x to the right, y up (rows run down)."""

    image: Picture  # (h, w, 3) BGR
    px_per_cm: float  # resolution
    corner_cm: Array  # (2,) its upper left corner: least x, greatest y

    def pixels(self, points_cm: Array) -> NDArray[np.float32]:
        """Workspace x, y (..., 2) to column, row (..., 2)."""
        pixels = (points_cm - self.corner_cm) * [self.px_per_cm, -self.px_per_cm] - 0.5
        return np.asarray(pixels, np.float32)

    def places(self, pixels: Array) -> Array:
        """Column, row (..., 2) to workspace x, y (..., 2)."""
        return np.asarray((pixels + 0.5) / [self.px_per_cm, -self.px_per_cm] + self.corner_cm)


def flatten(
    picture: Picture,
    camera: CameraModel,
    height_cm: float,
    full_cm: float,
    most_px_cm: float = BODY_PX_CM,
) -> Flat:
    """Rectify the area that a robot of full length can reach, at a height above the table.

    The resolution is the picture's, `most_px_cm` at most.
    """
    px_per_cm = min(most_px_cm, most_px_cm / BODY_PX_CM / camera.cm_per_px)
    low, high = (share * full_cm for share in _AROUND)
    columns, rows = np.round((high - low) * px_per_cm).astype(int).tolist()
    turn = camera.turn
    # The plane to the pinhole's rays, and the flat picture's pixels to the plane.
    to_ray = np.column_stack([turn[:, :2], turn[:, 2] * height_cm + np.ravel(camera.translation)])
    cell = 1 / px_per_cm
    to_plane = np.array([
        [cell, 0, low[0] + cell / 2], [0, -cell, high[1] - cell / 2], [0, 0, 1],
    ])  # fmt: skip
    lookup = cv2.initUndistortRectifyMap(
        camera.lens.matrix, camera.lens.distortion, np.eye(3), np.linalg.inv(to_ray @ to_plane),
        (columns, rows), cv2.CV_32FC1,
    )  # fmt: skip
    image = cv2.remap(picture, *lookup, cv2.INTER_LINEAR)
    return Flat(np.asarray(image, np.uint8), px_per_cm, np.array([low[0], high[1]]))


def bodyness(
    flat: Flat, radius_cm: float, cover: Array | None, background: Flat | None
) -> NDArray[np.float32]:
    """(h, w) score of each pixel, from about 0 (table) to about 1 (body).

    The body's colour is sampled where the robot leaves its base, the table's everywhere; a linear
    discriminant in log-chromaticity (which shadows do not change) and, weakly, brightness separates
    them. With a `background` picture of the empty table, differences from it count as well. The
    area of the polygon `cover` (n, 2) in cm, the tip marker, counts as body.

    Raises BodyNotSeenError if base and table have the same colour.
    """
    features = _features(flat.image)
    # Light varies along and across the body far more than in the sample.
    lighting = np.diag([0.002, 0.002, 0.3])
    loosest = 0.15
    if background is not None:
        # The empty table cancels, so a small change of colour is enough.
        features = features - _features(background.image)
        lighting, loosest = np.diag([1e-5, 1e-5, 0.03]), 0.04
    corners = flat.pixels(np.array([[1.0, 0.5 * radius_cm], [4.0, -0.5 * radius_cm]]))
    (near, upper), (far, lower) = np.round(corners).astype(int)
    seed = features[upper:lower, near:far].reshape(-1, 3).astype(float)
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
    # A third colour (clutter) is not the body either.
    away = features[..., :2] - center[:2]
    reach = np.sqrt(np.maximum(np.diag(spread)[:2], loosest**2 / 8)) * 4 + loosest
    strange = np.sqrt(((away / reach) ** 2).sum(axis=-1))
    score = (np.clip(score, 0, 1) * np.clip(2 - strange, 0, 1)).astype(np.float32)
    if cover is not None:
        polygon = np.round(flat.pixels(cover)).astype(np.int32).reshape(-1, 1, 2)
        cv2.fillPoly(score, [polygon], 1.0)
        cv2.polylines(score, [polygon], True, 1.0, COVER_RIM_PX)
    return np.asarray(cv2.GaussianBlur(score, (0, 0), 1.2), np.float32)


def _features(image: Picture) -> NDArray[np.float32]:
    """Log-chromaticities and log-brightness (h, w, 3)."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5).astype(np.float32) + 12.0
    logs = np.log(smooth)
    return np.dstack(
        [logs[..., 2] - logs[..., 1], logs[..., 0] - logs[..., 1], logs.mean(axis=-1)]
    ).astype(np.float32)


@dataclass(frozen=True)
class Track:
    """The body as followed from its base."""

    middle: Array  # (n, 2) cm, mid-points of the flanks, base to tip, about 0.5 cm apart
    good: NDArray[np.bool_]  # (n,) whether both flanks were seen there
    tip: Array  # (2,) cm, where the body ends
    flanks_lost: bool  # whether the flanks were lost before the body ended


def follow(flat: Flat, score: NDArray[np.float32], radius_cm: float) -> Track:
    """Follow the tube from its base by both flanks.

    If one flank is hidden (by a peg before the body), the other one and the known radius are used.
    Raises BodyNotSeenError if nothing like a tube of that radius starts at the base.
    """
    point, heading = np.array([0.6, 0.0]), 0.0
    steps: list[tuple[Array, float, float, bool]] = []  # middle, heading, width, both flanks seen
    missed_steps = 0
    while len(steps) * _STEP_CM < _LONGEST_CM:
        normal = np.array([-np.sin(heading), np.cos(heading)])
        port, starboard, filling = _flanks(flat, score, point, normal, radius_cm)
        if filling < 0.5:
            break
        both_flanks = bool(abs((port - starboard) / (2 * radius_cm) - 1) < 0.22)
        shift = 0.0
        if both_flanks:
            shift = (port + starboard) / 2
        elif np.isfinite(port) != np.isfinite(starboard):
            shift = port - radius_cm if np.isfinite(port) else starboard + radius_cm
        missed_steps = 0 if both_flanks else missed_steps + 1
        if missed_steps * _STEP_CM > 4 * radius_cm:
            break
        point = point + float(np.clip(shift, -0.35 * radius_cm, 0.35 * radius_cm)) * normal
        steps.append((point, heading, port - starboard, both_flanks))
        recent = np.array([middle for middle, *_ in steps[-12:]])
        if len(recent) >= 4:
            # A parabola through the last 6 cm predicts where the tube continues.
            arc_cm = np.arange(len(recent)) * _STEP_CM
            degree = 2 if len(recent) >= 9 else 1
            end = arc_cm[-1] + _STEP_CM / 2
            lines = np.polyfit(arc_cm, recent, degree).T
            x, y = (np.polyval(np.polyder(line), end) for line in lines)
            heading = float(np.arctan2(y, x))
        point = point + _STEP_CM * np.array([np.cos(heading), np.sin(heading)])
    share_seen = np.mean([both_flanks for *_, both_flanks in steps]) if steps else 0.0
    if len(steps) * _STEP_CM < 3 * radius_cm or share_seen < 0.5:
        raise BodyNotSeenError(
            "no tube of the configured diameter starts at the base",
            "check body.diameter_cm and the cards' places, and clear the view of the body",
        )
    middle, headings, width, sound = (np.array(column) for column in zip(*steps, strict=True))
    # Objects of the body's colour beside it make it look wider: the middle is not used where the
    # width differs from the usual one.
    usual = float(np.median(width[sound]))
    scatter = 1.4826 * float(np.median(np.abs(width[sound] - usual)))
    sound &= np.abs(width - usual) < max(3 * scatter, _WIDTH_CM)
    # The body ends where bodyness along the axis (mean over its width) falls below a half.
    forward = np.array([np.cos(heading), np.sin(heading)])
    ahead_cm = np.arange(-2.5, 2.5, 0.05)
    lanes = np.linspace(-0.6, 0.6, 13) * radius_cm
    base = middle[-1]
    normal_end = np.array([-forward[1], forward[0]])
    grid = base + ahead_cm[:, None, None] * forward + lanes[None, :, None] * normal_end
    fade = gaussian_filter1d(np.median(_sample(flat, score, grid), axis=1).astype(float), 2)
    falls = np.nonzero((fade[:-1] >= 0.5) & (fade[1:] < 0.5))[0]
    overshoot = float(ahead_cm[falls[-1]] + 0.025) if len(falls) else 0.0
    refined = _between_edges(flat, middle, headings, np.where(sound, width, 2 * radius_cm))
    middle = np.where((sound & np.isfinite(refined[:, 0]))[:, None], refined, middle)
    return Track(middle, sound, base + overshoot * forward, missed_steps * _STEP_CM > 4 * radius_cm)


def _sample(flat: Flat, score: NDArray[np.float32], points: Array) -> NDArray[np.float32]:
    pixels = flat.pixels(points)
    scores = cv2.remap(score, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR, borderValue=0)
    return np.asarray(scores, np.float32)


def _flanks(
    flat: Flat, score: NDArray[np.float32], point: Array, normal: Array, radius_cm: float
) -> tuple[float, float, float]:
    """Offsets of both flanks, the left one first (nan if implausible), and the filling between."""
    reach = np.arange(-2.2, 2.2001, 0.05) * radius_cm
    profile = _sample(flat, score, (point + reach[:, None] * normal)[None])[0]
    edge = {}
    for side in (1.0, -1.0):
        values, offsets = (profile, reach) if side > 0 else (profile[::-1], reach[::-1])
        drop = np.nonzero((values[:-1] >= _CLASH) & (values[1:] < _CLASH))[0]
        place = offsets[drop] + (values[drop] - _CLASH) / (values[drop] - values[drop + 1]) * (
            offsets[drop + 1] - offsets[drop]
        )
        gap_cm = np.abs(place - side * radius_cm)
        edge[side] = np.nan
        if len(gap_cm) and gap_cm.min() < 0.6 * radius_cm:
            edge[side] = float(place[np.argmin(gap_cm)])
    inner = np.abs(reach) < 0.8 * radius_cm
    return edge[1.0], edge[-1.0], float(profile[inner].mean())


def _between_edges(flat: Flat, middle: Array, heading: Array, width: Array) -> Array:
    """Points (n, 2) halfway between the body's two edges; nan where an edge is not clear.

    An edge is where the brightness is halfway between that just inside and just outside. Bodyness
    uses mainly colour, which would put the edge of a shaded flank too far inside.
    """
    away = np.arange(-_EDGE_CM, _EDGE_CM + 1e-9, 0.02)
    normal = np.column_stack([-np.sin(heading), np.cos(heading)])
    axes = []
    for side in (1.0, -1.0):
        out = side * (width / 2)[:, None] + side * away
        pixels = flat.pixels(middle[:, None, :] + out[..., None] * normal[:, None, :])
        light = cv2.remap(flat.image, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR).astype(
            float
        )
        inside = light[:, away < -0.4 * _EDGE_CM].mean(axis=1)
        outside = light[:, away > 0.4 * _EDGE_CM].mean(axis=1)
        step = inside - outside
        clear = np.linalg.norm(step, axis=1) > _EDGE_GRAY
        share = (
            np.einsum("nmc,nc->nm", light - outside[:, None], step)
            / np.maximum((step**2).sum(axis=1), 1.0)[:, None]
        )
        falls = (share[:, :-1] >= 0.5) & (share[:, 1:] < 0.5)
        # Of several edges, the one nearest to that by bodyness.
        rank = np.where(falls, np.abs(away[:-1]), np.inf)
        first = np.argmin(rank, axis=1)
        rows = np.arange(len(middle))
        high, low = share[rows, first], share[rows, first + 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            place = away[first] + (high - 0.5) / (high - low) * 0.02
        place[~clear | ~np.isfinite(rank[rows, first])] = np.nan
        axes.append(side * (width / 2 + place))
    return np.asarray(middle + ((axes[0] + axes[1]) / 2)[:, None] * normal)
