"""Round obstacles (standing dowels) in a picture: centre and radius of their top faces.

OpenCV's Hough transform finds candidates in the picture rectified to the dowels' height, where a
top face is a true circle. A circle is fitted robustly to the edge of each, found by radial search,
and kept only if most of its rim is seen. Coins and screws are too small, scraps not round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from thigmo.camera.body import Flat

Array = NDArray[np.float64]

_RAYS = 72
_LEAST_RIM = 0.6  # share of the rim that must be seen
OBSTACLE_PX_CM = 16  # rims need finer pixels than flanks


@dataclass(frozen=True)
class Obstacle:
    """A round obstacle."""

    x_cm: float  # centre
    y_cm: float  # centre
    radius_cm: float  # radius of its top face
    rim: float  # share of its rim that was seen, 0..1

    def distance_cm(self, obstacle: Obstacle) -> float:
        """Distance of the centres."""
        return float(np.hypot(self.x_cm - obstacle.x_cm, self.y_cm - obstacle.y_cm))


def find_obstacles(
    flat: Flat, radius_cm: tuple[float, float], ignore: Sequence[Array]
) -> list[Obstacle]:
    """Circles in a picture rectified to the height of their tops, best rim first.

    `radius_cm` is the least and the largest radius. Polygons (n, 2) in cm to `ignore` are skipped.
    """
    channels = _channels(flat)
    low, high = (r * flat.px_per_cm for r in radius_cm)
    candidates: list[Array] = []
    for channel in channels:
        circles = cv2.HoughCircles(
            channel, cv2.HOUGH_GRADIENT_ALT, dp=1.5, minDist=max(4.0, low), param1=90, param2=0.55,
            minRadius=max(2, int(0.85 * low)), maxRadius=int(1.15 * high),
        )  # fmt: skip
        if circles is not None:
            candidates.extend(np.asarray(circles, float).reshape(-1, circles.shape[-1])[:60, :3])
    outlines = [np.asarray(polygon, np.float32) for polygon in ignore]
    # GRADIENT_ALT gives the most voted first, channel by channel.
    obstacles: list[Obstacle] = []
    for column, row, radius in candidates:
        center = flat.places(np.array([column, row]))
        x, y = center.tolist()
        if any(cv2.pointPolygonTest(outline, (x, y), False) >= 0 for outline in outlines):
            continue
        obstacle = _refine(channels, flat, np.array([column, row]), radius)
        if obstacle is None or not radius_cm[0] <= obstacle.radius_cm <= radius_cm[1]:
            continue
        reach = 0.9 * obstacle.radius_cm
        twins = [o for o in obstacles if o.distance_cm(obstacle) < reach + 0.9 * o.radius_cm]
        if all(twin.rim < obstacle.rim for twin in twins):
            obstacles = [previous for previous in obstacles if previous not in twins] + [obstacle]
    return sorted(obstacles, key=lambda o: -o.rim)


def _channels(flat: Flat) -> list[NDArray[np.uint8]]:
    """Brightness and two colour differences, contrast stretched."""
    smooth = cv2.GaussianBlur(flat.image, (0, 0), 1.5)
    lab = cv2.cvtColor(smooth, cv2.COLOR_BGR2LAB).astype(np.float32)
    stretched = [lab[..., 0], 3 * (lab[..., 1] - 128) + 128, 3 * (lab[..., 2] - 128) + 128]
    return [np.clip(channel, 0, 255).astype(np.uint8) for channel in stretched]


def _refine(
    channels: Sequence[NDArray[np.uint8]], flat: Flat, center: Array, radius: float
) -> Obstacle | None:
    """A robust circle through edge points along rays from the centre; None if rim is missing."""
    angles = np.linspace(0, 2 * np.pi, _RAYS, endpoint=False)
    toward = np.column_stack([np.cos(angles), np.sin(angles)])
    best: Obstacle | None = None
    for channel in channels:
        middle, size = center.copy(), float(radius)
        for width in (0.45, 0.2):
            reach = np.arange((1 - width) * size, (1 + width) * size, 0.25)
            points = (middle + reach[:, None, None] * toward).astype(np.float32)
            light = channel.astype(np.float32)
            profile = cv2.remap(light, points[..., 0], points[..., 1], cv2.INTER_LINEAR)
            slope = np.gradient(cv2.GaussianBlur(profile, (1, 9), 0), axis=0)
            # All round a dowel's rim, the change from inside to outside has the same sign.
            for sign in (1.0, -1.0):
                strength = sign * slope
                # The innermost strong edge: outside it is the dowel's wall.
                noted = strength >= 0.5 * strength.max(axis=0)
                crest = np.ones_like(noted)
                crest[1:-1] = (strength[1:-1] >= strength[:-2]) & (strength[1:-1] >= strength[2:])
                peak = np.argmax(noted & crest, axis=0)
                steep = strength[peak, np.arange(_RAYS)]
                good = steep > max(1.0, 0.4 * float(np.median(steep)))
                rim_points = middle + reach[peak][:, None] * toward
                if good.sum() < _LEAST_RIM * _RAYS:
                    continue
                circle = _circle(rim_points[good], middle, size)
                distance = np.hypot(*(rim_points - circle[:2]).T) - circle[2]
                near = good & (np.abs(distance) < max(1.0, 0.07 * circle[2]))
                rim = float(near.mean())
                if rim < _LEAST_RIM or (best is not None and rim <= best.rim and width > 0.3):
                    continue
                if (best is None or rim >= best.rim) and _solid(channels, circle):
                    x, y = flat.places(circle[:2]).tolist()
                    middle, size = circle[:2].copy(), float(circle[2])
                    best = Obstacle(x, y, size / flat.px_per_cm, rim)
    return best


def _solid(channels: Sequence[NDArray[np.uint8]], circle: Array) -> bool:
    """Whether inside and outside differ in some channel; in a loop of cable they do not."""
    radius = circle[2]
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    toward = np.column_stack([np.cos(angles), np.sin(angles)])
    shares = np.array([0.3, 0.6, 1.3, 1.6, 1.9])[:, None, None]
    rings = (circle[:2] + radius * shares * toward).astype(np.float32)
    for channel in channels:
        sampled = cv2.remap(channel, rings[..., 0], rings[..., 1], cv2.INTER_LINEAR)
        brightness = sampled.astype(float)
        core = brightness[:2]
        gap = np.abs(np.median(core) - np.median(brightness[2:], axis=1)).min()
        if gap > 8.0 + 2.0 * float(core.std()):
            return True
    return False


def _circle(points: Array, center: Array, radius: float) -> Array:
    """Robust circle (column, row, radius) through points."""

    def residuals(p: Array) -> Array:
        return np.asarray(np.hypot(points[:, 0] - p[0], points[:, 1] - p[1]) - p[2])

    start = np.array([*center, radius])
    return np.asarray(least_squares(residuals, start, loss="cauchy", f_scale=0.7).x, float)
