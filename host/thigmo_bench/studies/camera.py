"""Errors of the camera in random rendered rooms, for which the truth is known.

Every rendering has its own camera (height, tilt, lens), light, clutter, robot shape, dowels, and
errors of the cards' places. The lens is known in four ways (`WAYS`). The errors are those of
places at the robot's height, of the tip by its marker, of the axis's end and of dowels, in cm.
Errors of curvature are also in units of the stated error.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from math import nan

import cv2
import numpy as np

from thigmo.camera import CameraModel, DetectionRequest, Lens, Sheet, calibrate_lens, detect, locate
from thigmo.camera.model import Picture
from thigmo.camera.sheet import Decal, board, card_decals, tip_decal
from thigmo.emulator.render import BodyShape, PegShape, View, overhead_camera, random_look, render
from thigmo.mechanics import heading_along, traced
from thigmo_bench.studies.engine import Claim, Context, Outcome, share
from thigmo_bench.studies.rod import Floats
from thigmo_bench.studies.scenes import COLUMN, RADIUS, SPAN

_BOX_CM = 8.0  # height of the box under one card


# Knowledge of the camera in addition to the cards: none; one card is on a box; the camera's height
# by tape measure (0.7 cm); the lens, from the board (then it is the default camera).
CARDS, BOX, TAPE, LENS = WAYS = (
    "cards only", "a card on a box", "height measured", "lens board",
)  # fmt: skip
_DOWELS = (TAPE, LENS)  # ways in which dowels are detected and counted


@dataclass
class Glimpse:
    """Errors of the camera in one rendering (nan = not seen)."""

    place_cm: float  # largest error of a place at the robot's height, over the workspace
    accuracy_cm: float  # standard error that the camera model states
    free: bool  # whether it was a free bend
    tip_cm: float = nan  # error of the tip by its marker
    end_cm: float = nan  # error of the fitted axis's end
    pegs_cm: list[float] = field(default_factory=list)  # error of each dowel's place; nan = missed
    false_pegs: int = 0  # circles that are no dowels
    # error of curvature and its stated error, 1/cm: one pair for a free bend, else one a span
    bend: list[tuple[float, float]] = field(default_factory=list)


def axis_of(curvature: Floats, length: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Arc, heading, x and y of a body with that curvature, evenly spaced over its length."""
    s = np.linspace(0.0, length, len(curvature))
    step = np.diff(s)
    heading = heading_along(curvature, step)
    return s, heading, *traced(heading, step)


def glimpse(seed: int, method: str = TAPE, lens: Lens | None = None) -> Glimpse:
    """Render one random room and detect it in a way of `WAYS`, with a lens of `board_lens`."""
    rng = np.random.default_rng([seed, 0x6115])
    camera = overhead_camera(rng)
    if method == LENS:
        camera = replace(camera, lens=overhead_camera(None).lens)
    sheet = Sheet()
    tape = float(camera.eye_cm[2] + rng.normal(0, 0.7))
    if method == TAPE:
        sheet.camera_height_cm = tape
    if method == BOX:
        sheet.cards[1].z_cm = _BOX_CM
    laid = sheet.model_copy(deep=True)
    for card in laid.cards:
        card.x_cm += float(rng.normal(0, sheet.placement_se_cm))
        card.y_cm += float(rng.normal(0, sheet.placement_se_cm))
        card.turn_deg += float(rng.normal(0, 0.5))
    free = bool(rng.random() < 0.4)
    s, heading, x, y = _body(rng, free)
    pegs = _pegs(rng, heading, x, y)
    patches = [*card_decals(laid), tip_decal(sheet, x, y, 3.5)]
    picture = render(camera, View(BodyShape(x, y), pegs, patches), random_look(rng), rng)
    model = locate(picture, sheet, lens)
    request = DetectionRequest(constant=free, obstacles=method in _DOWELS, length_cm=float(s[-1]))
    detection = detect(picture, model, sheet, request)
    grid = np.array([[gx, gy, RADIUS] for gx in (0, 14, 27, 40, 54) for gy in range(-40, 41, 20)])
    place_error = model.to_plane(camera.project(grid), RADIUS) - grid[:, :2]
    errors = Glimpse(float(np.linalg.norm(place_error, axis=1).max()), model.accuracy_cm, free)
    if detection.tip is not None:
        errors.tip_cm = float(np.hypot(detection.tip.x_cm - x[-1], detection.tip.y_cm - y[-1]))
    if detection.axis is not None:
        axis = detection.axis
        errors.end_cm = float(np.hypot(axis.tip_cm[0] - x[-1], axis.tip_cm[1] - y[-1]))
        if free:
            bend = float(axis.coefficients[2] - heading[-1] / s[-1])
            errors.bend = [(bend, float(np.sqrt(axis.covariance[2, 2])))]
        else:
            for centre in (c for c in COLUMN if c + SPAN / 2 < s[-1] - 2):
                mean, error = axis.mean_curvature(centre, SPAN)
                turn = np.diff(np.interp([centre - SPAN / 2, centre + SPAN / 2], s, heading))[0]
                errors.bend.append((mean - float(turn) / SPAN, error))
    for peg in pegs if method in _DOWELS else ():
        gaps = (float(np.hypot(o.x_cm - peg.x_cm, o.y_cm - peg.y_cm)) for o in detection.obstacles)
        errors.pegs_cm.append(min((gap for gap in gaps if gap < 1.0), default=nan))
    errors.false_pegs = len(detection.obstacles) - int(np.isfinite(errors.pegs_cm).sum())
    return errors


def _body(rng: np.random.Generator, free: bool) -> tuple[Floats, Floats, Floats, Floats]:
    """A free bend, or a body with a contact, that stays inside the workspace."""
    while True:
        length = float(rng.uniform(20, 53))
        s = np.linspace(0, length, 300)
        k = np.full(300, rng.uniform(-0.035, 0.035))
        if not free:
            force = rng.choice([-1, 1]) * rng.uniform(1e-4, 8e-4)
            k = 0.6 * k + force * np.clip(rng.uniform(15, length) - s, 0, None)
        axis = axis_of(k, length)
        if np.abs(axis[3]).max() < 36 and axis[2].min() > -1:
            return axis


def _pegs(rng: np.random.Generator, heading: Floats, x: Floats, y: Floats) -> list[PegShape]:
    """One dowel that touches the body, one elsewhere."""
    i, radius = int(rng.integers(90, 260)), float(rng.uniform(0.8, 1.6))
    side = rng.choice([-1, 1])
    normal = np.array([-np.sin(heading[i]), np.cos(heading[i])])
    center = np.array([x[i], y[i]]) + side * (1.75 + radius) * normal
    touching = PegShape(float(center[0]), float(center[1]), radius)
    while True:
        px, py = float(rng.uniform(8, 48)), float(rng.uniform(-32, 32))
        second = PegShape(px, py, float(rng.uniform(0.8, 1.6)))
        clear_of_body = np.hypot(x - px, y - py).min() > 5.5
        if clear_of_body and np.hypot(px - center[0], py - center[1]) > 5:
            return [touching, second]


def board_lens(poses: int = 10) -> Lens:
    """Lens of the default camera, calibrated from rendered pictures of the board."""
    sheet = Sheet()
    camera = overhead_camera(None)
    rng = np.random.default_rng([0, 0xB0A2D])
    return calibrate_lens([board_picture(camera, sheet, rng) for _ in range(poses)], sheet)


def board_picture(camera: CameraModel, sheet: Sheet, rng: np.random.Generator) -> Picture:
    """A picture of the lens board, held tilted before the camera."""
    columns, rows = sheet.board_columns, sheet.board_rows
    flat = sheet.model_copy(update={"print_scale": 1.0})
    image = np.asarray(board(flat).generateImage((columns * 100, rows * 100)), np.uint8)
    # Held at arm's length, to fill much of the picture.
    height = float(rng.uniform(0.35, 0.6)) * float(camera.eye_cm[2])
    turn = cv2.Rodrigues(np.append(rng.uniform(-0.45, 0.45, 2), rng.uniform(-3, 3)))[0]
    half = sheet.board_square_cm * sheet.print_scale / 2 * np.array([columns, rows])
    corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * half
    reach = (camera.eye_cm[2] - height) / camera.eye_cm[2] * np.array([18.0, 32.0])
    middle = np.append(camera.eye_cm[:2] + rng.uniform(-1, 1, 2) * reach * 0.8, height)
    solid = np.column_stack([corners, np.zeros(4)]) @ turn.T + middle
    margin = Decal(np.full((8, 8), 255, np.uint8), (solid - middle) * 1.12 + middle)
    patches = [margin, Decal(image, solid)]
    return render(camera, View(None, (), patches, housing=False), random_look(rng), rng)


def summarise(glimpses: list[Glimpse]) -> dict[str, float]:
    """95th percentiles, worst values and errors over those stated, over renderings."""
    names = ("place_cm", "tip_cm", "end_cm", "accuracy_cm")
    place, tip, end, stated = np.array([[getattr(g, n) for n in names] for g in glimpses]).T
    pegs = np.array([gap for g in glimpses for gap in g.pegs_cm])
    free, spans = (
        np.array([bend for g in glimpses if g.free == kind for bend in g.bend]).reshape(-1, 2).T
        for kind in (True, False)
    )

    def rms(values: Floats) -> float:
        return float(np.sqrt(np.nanmean(np.square(values)))) if np.isfinite(values).any() else nan

    def high(values: Floats) -> float:
        return float(np.nanquantile(values, 0.95)) if len(values) else nan

    return {
        "renderings": float(len(glimpses)),
        "place_p95_cm": high(place),
        "place_worst_cm": float(place.max()),
        "place_chi": rms(place / stated),
        "tip_p95_cm": high(tip),
        "tip_missed": share(np.isnan(tip)),
        "axis_end_p95_cm": high(end),
        "axis_missed": share(np.isnan(end)),
        "peg_p95_cm": high(pegs),
        "peg_missed": share(np.isnan(pegs)),
        "peg_false_per_picture": share([g.false_pegs for g in glimpses]),
        "free_bend_rms_per_cm": rms(free[0]),
        "free_bend_chi": rms(free[0] / free[1]),
        "span_rms_per_cm": rms(spans[0]),
        "span_chi": rms(spans[0] / spans[1]),
    }


def run(context: Context) -> Outcome:
    """Errors over many renderings, for every way to know the lens."""
    seeds = [context.seed * 100_000 + n for n in range(context.count(6, 24))]
    lens = board_lens()
    errors_by_method, outcome = {}, Outcome()
    for method in WAYS:
        paint = partial(glimpse, method=method, lens=lens if method == LENS else None)
        errors_by_method[method] = errors = summarise(
            context.map(paint, seeds, f"pictures, {method}")
        )
        for quantity, text in (
            ("place_p95_cm", "95 % of places in the workspace"),
            ("tip_p95_cm", "95 % of tips"),
            *((("peg_p95_cm", "95 % of dowels"),) if method in _DOWELS else ()),
        ):
            outcome.claims.append(Claim(f"{text} ({method})", errors[quantity], 0.3, unit="cm"))
        text = f"place error over the stated one sigma, rms ({method})"
        outcome.claims.append(Claim(text, errors["place_chi"], 2))
    outcome.tables["errors"] = [
        {
            "quantity": name,
            **{method: round(errors[name], 6) for method, errors in errors_by_method.items()},
        }
        for name in errors_by_method[CARDS]
    ]
    return outcome
