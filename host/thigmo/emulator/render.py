"""Renders the picture that an overhead camera would take of the emulated room.

Takes plain shapes (the body's axis, pegs, printed patches) and a true camera, and paints a
1920 x 1080 colour picture with perspective, lens distortion, heights, occlusion, shadows, uneven
light, clutter, blur and sensor noise. Calibration and the camera's tests use these pictures, never
the truth behind them. Lengths are in cm, z up from the table, angles in rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import tan
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from thigmo.camera.model import CameraModel, Lens, Picture
from thigmo.camera.sheet import Decal

Array = NDArray[np.float64]
Canvas = NDArray[np.float32]
Color = tuple[float, float, float]  # blue, green, red, 0..255

_SHIFT = 6  # fractional bits of OpenCV's polygon vertices
_TABLE_PX_CM = 12
_SIZE = (1920, 1080)
# Robots longer than this multiple of 53 cm are seen with 1440 lines, for the tip's marker.
_FINE, _FINER = 1.3, 4 / 3
# The table of a robot of 53 cm is painted within this distance of the picture's middle.
_LIVE_CM, _LENGTH_CM, _HEIGHT_CM = 90.0, 53.0, 105.0


@dataclass(frozen=True)
class BodyShape:
    """The robot as a tube on the table."""

    x_cm: Array  # (n,) axis, base to tip
    y_cm: Array  # (n,) axis
    radius_cm: float = 1.75  # tube radius
    color: Color = (40.0, 90.0, 215.0)  # of the fabric


@dataclass(frozen=True)
class PegShape:
    """A standing dowel."""

    x_cm: float
    y_cm: float
    radius_cm: float = 1.0
    height_cm: float = 6.0
    color: Color = (120.0, 170.0, 205.0)


@dataclass(frozen=True)
class Look:
    """Quality of light, room and camera sensor."""

    blur_px: float = 0.8  # sigma of lens blur
    noise: float = 3.0  # sigma of the sensor, gray levels
    shadow: float = 0.35  # how dark a shadow is, 0..1
    light: tuple[float, float] = (0.35, -0.25)  # (2,) shadow displacement per height
    falloff: float = 0.25  # darkening towards one side and the corners, 0..1
    clutter: int = 25  # number of objects on the table
    jpeg: int = 90  # quality of the camera's compression; 0 = none
    table: Color = (190.0, 200.0, 205.0)  # colour of the table
    wrinkle: float = 0.12  # unevenness of the fabric, 0..1


@dataclass(frozen=True)
class View:
    """Contents of the room when the picture is taken."""

    body: BodyShape | None = None  # the robot; None = not there
    pegs: Sequence[PegShape] = ()  # dowels
    patches: Sequence[Decal] = ()  # printed things; those above the table lie on the robot
    housing: bool = True  # whether the base's box stands behind x = 0


def overhead_camera(
    rng: np.random.Generator | None = None, length_cm: float = _LENGTH_CM
) -> CameraModel:
    """A camera above a robot's workspace, long side across the robot; varied by `rng`.

    Height 95..120 cm for 53 cm of robot, and in proportion, tilt to 6 degrees, roll to 4, barrel
    distortion to -0.12, focal length such that the cards stay in the picture. A longer robot
    has a camera of more pixels.
    """
    pick = rng or np.random.default_rng(0)
    vary = 0.0 if rng is None else 1.0
    share = length_cm / _LENGTH_CM
    size = np.array(_SIZE) * (_FINER if share > _FINE else 1.0)
    height = share * (_HEIGHT_CM + vary * pick.uniform(-10, 12))
    # The picture's columns run along -y and its rows along -x: the robot grows upwards.
    down = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    tilt = vary * pick.uniform(-1, 1, 2) * np.radians(6)
    roll = vary * pick.uniform(-1, 1) * np.radians(4)
    spin = cv2.Rodrigues(np.array([tilt[0], tilt[1], roll]))[0]
    turn = spin @ down
    target = share * (np.array([27.0, 0.0, 0.0]) + vary * np.append(pick.uniform(-2, 2, 2), 0.0))
    eye = target - height * turn[2]
    k1 = -0.06 + vary * pick.uniform(-0.06, 0.05)
    k2 = 0.01 + vary * pick.uniform(-0.01, 0.02)
    half_view = np.arctan(64.0 * share / height)
    middle = size / 2
    focal = middle[0] / tan(half_view) * (1 - 0.3 * k1)
    middle = middle + vary * pick.uniform(-12, 12, 2)
    matrix = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]])
    distortion = np.array([k1, k2, vary * pick.normal(0, 4e-4), vary * pick.normal(0, 4e-4), 0.0])
    lens = Lens(matrix, distortion, (int(size[0]), int(size[1])))
    return CameraModel(lens, np.ravel(cv2.Rodrigues(turn)[0]), -turn @ eye)


def random_look(rng: np.random.Generator, length_cm: float = _LENGTH_CM) -> Look:
    """A random room like a lab's for a robot of this length, from good light to poor."""
    tint = rng.uniform(-18, 18, 3)
    blue, green, red = (rng.uniform(140, 225) + tint).tolist()
    return Look(
        blur_px=float(rng.uniform(0.5, 1.4)),
        noise=float(rng.uniform(1.5, 6.0)),
        shadow=float(rng.uniform(0.1, 0.5)),
        light=(float(rng.uniform(-0.5, 0.5)), float(rng.uniform(-0.5, 0.5))),
        falloff=float(rng.uniform(0.05, 0.4)),
        clutter=round(rng.integers(5, 40) * (length_cm / _LENGTH_CM) ** 2),
        jpeg=int(rng.integers(75, 96)),
        table=(blue, green, red),
        wrinkle=float(rng.uniform(0.05, 0.2)),
    )


def render(
    camera: CameraModel,
    view: View,
    look: Look | None = None,
    rng: np.random.Generator | None = None,
    sensor_rng: np.random.Generator | None = None,
) -> Picture:
    """The picture (height, width, 3), BGR.

    `rng` draws grain, clutter and light, so its state determines the room; it also draws the
    sensor's noise, unless `sensor_rng` is given.
    """
    look = look or Look()
    rng = rng or np.random.default_rng(0)
    body = view.body
    canvas = _table(camera, view, look, rng)
    for patch in view.patches:
        if patch.corners_cm[:, 2].max() < 0.1:
            _paste(canvas, camera, patch)
    # A body hides the foot of a peg behind it; a peg's upper part hides the body behind that.
    split = 2 * body.radius_cm if body is not None else 0.0
    for peg in view.pegs:
        _peg(canvas, camera, peg, 0.0, min(split, peg.height_cm))
    if view.housing:
        _housing(canvas, camera)
    if body is not None:
        _tube(canvas, camera, body, look, rng)
    for patch in view.patches:
        if patch.corners_cm[:, 2].max() >= 0.1:
            _paste(canvas, camera, patch)
    for peg in view.pegs:
        top = _peg(canvas, camera, peg, min(split, peg.height_cm), peg.height_cm)
        _fill(canvas, top, peg.color)
    return _sensor(canvas, look, rng, sensor_rng or rng)


def _table(camera: CameraModel, view: View, look: Look, rng: np.random.Generator) -> Canvas:
    """Table with grain, clutter and shadows, warped into the picture."""
    rays, eye = camera.rays, camera.eye_cm.astype(np.float32)
    x, y = (eye[axis] - eye[2] / rays[..., 2] * rays[..., axis] for axis in (0, 1))
    share = max(1.0, float(eye[2]) / _HEIGHT_CM)
    low = np.maximum(np.array([x.min(), y.min()]) - 2, -share * _LIVE_CM)
    high = np.minimum(np.array([x.max(), y.max()]) + 2, share * (_LIVE_CM + 40))
    px = _TABLE_PX_CM / share
    shape = (int((high[1] - low[1]) * px), int((high[0] - low[0]) * px))
    flat = np.empty((*shape, 3), np.float32)
    flat[:] = look.table
    coarse = rng.normal(0, 1, (shape[0] // 40 + 2, shape[1] // 40 + 2)).astype(np.float32)
    fine = rng.normal(0, 1, (shape[0] // 2 + 1, shape[1] // 16 + 1)).astype(np.float32)
    grain: Any = 5 * cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    grain += 3 * cv2.resize(fine, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
    flat = np.asarray(flat + grain[..., None], np.float32)
    _clutter(flat, look, rng, px)
    shade = np.zeros(shape, np.uint8)

    def shadow(points: Array, radius_cm: float) -> None:
        pixels = np.round((points - low) * px * 16).astype(np.int32).reshape(-1, 1, 2)
        thick = max(1, round(2 * radius_cm * px))
        cv2.polylines(shade, [pixels], False, 255, thick, cv2.LINE_AA, 4)

    light = np.array(look.light)
    if view.body is not None:
        axis = np.column_stack([view.body.x_cm, view.body.y_cm])
        shadow(axis + light * view.body.radius_cm, view.body.radius_cm)
    for peg in view.pegs:
        foot = np.array([peg.x_cm, peg.y_cm])
        shadow(np.stack([foot, foot + light * peg.height_cm]), peg.radius_cm)
    soft = cv2.GaussianBlur(shade, (0, 0), 0.35 * px)
    flat *= 1 - look.shadow * soft.astype(np.float32)[..., None] / 255
    column, row = (
        (place - np.float32(start)) * px - 0.5 for place, start in ((x, low[0]), (y, low[1]))
    )
    warped = cv2.remap(flat, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, np.float32)


def _clutter(flat: Canvas, look: Look, rng: np.random.Generator, px: float) -> None:
    """Pens, scraps of paper, coins and cables, anywhere on the table."""
    rows, columns = flat.shape[:2]
    for _ in range(look.clutter):
        place = rng.uniform((0, 0), (columns, rows))
        color = tuple(float(c) for c in rng.uniform(20, 235, 3))
        kind = rng.integers(4)
        turn = rng.uniform(0, np.pi)
        direction = np.array([np.cos(turn), np.sin(turn)])
        if kind == 0:
            end = place + direction * rng.uniform(6, 14) * px
            cv2.line(flat, _pair(place), _pair(end), color, max(1, int(0.8 * px)), cv2.LINE_AA)
        elif kind == 1:
            size = rng.uniform(2, 9, 2) * px
            box = cv2.boxPoints((_pair(place), (float(size[0]), float(size[1])), float(turn * 57)))
            cv2.fillPoly(flat, [box.astype(np.int32)], color, cv2.LINE_AA)
        elif kind == 2:
            radius = int(rng.uniform(0.3, 0.6) * px)
            cv2.circle(flat, _pair(place), radius, color, -1, cv2.LINE_AA)
        else:
            steps = np.cumsum(rng.normal(0, 0.35, 40)) + turn
            directions = np.column_stack([np.cos(steps), np.sin(steps)])
            points = place + np.cumsum(directions * 0.5 * px, axis=0)
            walk = points.astype(np.int32).reshape(-1, 1, 2)
            cv2.polylines(flat, [walk], False, color, max(1, int(0.3 * px)), cv2.LINE_AA)


def _pair(point: Array) -> tuple[int, int]:
    return int(point[0]), int(point[1])


def _fill(canvas: Canvas, outline: Array, color: Color) -> None:
    """Fill a polygon of sub-pixel vertices (n, 2)."""
    vertices = np.round(np.clip(outline, -4000, 8000) * (1 << _SHIFT)).astype(np.int32)
    cv2.fillPoly(canvas, [vertices.reshape(-1, 1, 2)], color, cv2.LINE_AA, _SHIFT)


def _tube(
    canvas: Canvas, camera: CameraModel, body: BodyShape, look: Look, rng: np.random.Generator
) -> None:
    """The inflated tube: strips along its length, from both flanks up to the crest."""
    axis = np.column_stack([body.x_cm, body.y_cm])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(axis, axis=0), axis=1))])
    fine = np.linspace(0.0, arc[-1], max(2, int(arc[-1] / 0.25)))
    axis = np.column_stack([np.interp(fine, arc, axis[:, k]) for k in (0, 1)])
    slope = np.gradient(axis, axis=0)
    slope /= np.linalg.norm(slope, axis=1)[:, None]
    normal = np.column_stack([-slope[:, 1], slope[:, 0]])
    # A rounded end: the last half centimetre narrows, the axis keeps its full length.
    end = np.clip((fine[-1] - fine) / 0.5, 0, 1)
    wide = body.radius_cm * np.sqrt(np.clip(1 - 0.25 * (1 - end) ** 2, 0.05, 1))
    angles = np.radians(np.linspace(105, 0, 16))
    sun = np.append(-np.array(look.light), 1.0)
    sun /= np.linalg.norm(sun)
    folds = 1 + look.wrinkle * cv2.GaussianBlur(rng.normal(0, 1, (1, len(fine))), (0, 0), 3).ravel()
    for outer, inner in pairwise(angles):
        for side in (1.0, -1.0):
            edges = []
            for angle in (outer, inner):
                sideways = side * np.sin(angle) * wide
                height = body.radius_cm + np.cos(angle) * wide
                points = np.column_stack([axis + sideways[:, None] * normal, height])
                edges.append(camera.project(points))
            middle = (outer + inner) / 2
            facing = side * np.sin(middle) * normal @ sun[:2] + np.cos(middle) * sun[2]
            lit = 0.35 + 0.65 * np.clip(facing, 0, 1)
            strip = np.concatenate([edges[0], edges[1][::-1]])
            _fill(canvas, strip, _scaled(body.color, float(lit.mean())))
            for start in range(0, len(fine) - 1, 3):
                stop = min(start + 4, len(fine))
                quad = np.concatenate([edges[0][start:stop], edges[1][start:stop][::-1]])
                bright = float(lit[start:stop].mean() * folds[start:stop].mean())
                _fill(canvas, quad, _scaled(body.color, bright))


def _housing(canvas: Canvas, camera: CameraModel) -> None:
    """The base's box: walls and lid."""
    around = np.array([[0.0, 5.0, 0], [0.0, -5.0, 0], [-10.0, -5.0, 0], [-10.0, 5.0, 0]])
    lid = camera.project(around + np.array([0, 0, 6.0]))
    hull = cv2.convexHull(np.concatenate([camera.project(around), lid]).astype(np.float32))
    _fill(canvas, hull.reshape(-1, 2).astype(float), (46.0, 42.0, 40.0))
    _fill(canvas, lid, (82.0, 76.0, 72.0))


def _scaled(color: Color, factor: float) -> Color:
    return color[0] * factor, color[1] * factor, color[2] * factor


def _peg(
    canvas: Canvas, camera: CameraModel, peg: PegShape, low_cm: float, high_cm: float
) -> Array:
    """A dowel's wall between two heights; returns the outline of its top face."""
    around = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    x, y = peg.x_cm + peg.radius_cm * np.cos(around), peg.y_cm + peg.radius_cm * np.sin(around)
    upper, lower = (
        camera.project(np.column_stack([x, y, np.full(72, height)])) for height in (high_cm, low_cm)
    )
    hull = cv2.convexHull(np.concatenate([upper, lower]).astype(np.float32)).reshape(-1, 2)
    _fill(canvas, hull.astype(float), _scaled(peg.color, 0.55))
    return upper


def _paste(canvas: Canvas, camera: CameraModel, patch: Decal) -> None:
    """Lay a printed patch, flat at any tilt, into the picture."""
    corners = np.asarray(patch.corners_cm, float)
    outline = camera.project(corners)
    rows, columns = canvas.shape[:2]
    near, upper = np.maximum(np.floor(outline.min(axis=0)).astype(int) - 2, 0)
    far, lower = np.ceil(outline.max(axis=0)).astype(int) + 3
    far, lower = min(int(far), columns), min(int(lower), rows)
    if far <= near or lower <= upper:
        return
    box = (slice(int(upper), lower), slice(int(near), far))
    side, height = corners[1] - corners[0], corners[3] - corners[0]
    normal = np.cross(side, height)
    rays = camera.rays[box].astype(float)
    from_corner = camera.eye_cm - corners[0]
    reach = -(from_corner @ normal) / (rays @ normal)
    points = from_corner + reach[..., None] * rays
    u = points @ side / (side @ side)
    v = points @ height / (height @ height)
    n_rows, n_columns = patch.image.shape
    # Texels per pixel, for the smoothing that sampling needs.
    wide = max(1.0, float(np.linalg.norm(outline[1] - outline[0])))
    ratio = n_columns / wide
    smooth = cv2.GaussianBlur(patch.image, (0, 0), max(0.3, 0.4 * ratio)).astype(np.float32)
    texels = ((u * n_columns - 0.5).astype(np.float32), (v * n_rows - 0.5).astype(np.float32))
    ink = cv2.remap(smooth, *texels, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    pixel_u = 1.0 / wide
    inside = np.clip(np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v)) / pixel_u + 0.5, 0, 1)
    # Paper white is not 255, ink is not 0.
    tone = 22 + ink * (228 - 22) / 255
    canvas[box] = canvas[box] * (1 - inside[..., None]) + (tone * inside)[..., None]


def _sensor(
    canvas: Canvas, look: Look, rng: np.random.Generator, noise: np.random.Generator
) -> Picture:
    """Uneven light, lens blur, noise, rounding, compression."""
    rows, columns = canvas.shape[:2]
    x = np.linspace(-1, 1, columns, dtype=np.float32)
    y = np.linspace(-1, 1, rows, dtype=np.float32)[:, None]
    turn = rng.uniform(0, 2 * np.pi)
    slope = np.float32(np.cos(turn)) * x + np.float32(np.sin(turn)) * y
    light = 1 - look.falloff * (0.3 * (1 + slope) / 2 + 0.35 * (x**2 + y**2))
    lit = canvas * light[..., None].astype(np.float32)
    if look.blur_px > 0:
        lit = np.asarray(cv2.GaussianBlur(lit, (0, 0), look.blur_px), np.float32)
    # One draw serves the three colours, far apart in the picture: three would triple the time.
    grain = noise.standard_normal((rows, columns), dtype=np.float32) * np.float32(look.noise)
    grains = np.dstack([grain, np.roll(grain, 371, axis=0), np.roll(grain, 613, axis=1)])
    # Truncation after adding a half is rounding.
    picture: Picture = np.clip(lit + grains + np.float32(0.5), 0, 255).astype(np.uint8)
    if look.jpeg:
        packed = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, look.jpeg])[1]
        picture = np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), np.uint8)
    return picture
