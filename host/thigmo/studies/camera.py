"""How far the camera is off: random rooms are painted, looked at, and compared with the truth.

Every rendering draws its own camera (height, tilt, lens), light, clutter, robot shape, dowels, and
the slips of the hand that laid the cards. The lens is known in four ways (`WAYS`).
Errors are in cm on the table: of any place at the robot's height, of the tip by its marker, of the
axis's end, of dowels; and of curvature, in units of its own stated error too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thigmo.studies.engine import Claim, Context, Outcome

if TYPE_CHECKING:
    from thigmo.camera import CameraModel, Lens, Sheet
    from thigmo.camera.model import Picture
    from thigmo.camera.render import PegShape

Array = NDArray[np.float64]

_CENTERS = (5.0, 15.0, 25.0, 35.0, 45.0)
_SPAN = 5.5
_BOX_CM = 8.0  # one card stands on a box of that height


@dataclass(frozen=True)
class Way:
    """What is known of the camera beside the cards; dowels are looked for where they are counted.

    Attributes:
        tape: its height by tape measure (0.7 cm).
        box: one card stands on a box.
        lens: the lens board was shown; then the camera is that of `lens_camera`.
        dowels: dowels are looked for.
    """

    tape: bool = False
    box: bool = False
    lens: bool = False
    dowels: bool = False


WAYS = {
    "cards only": Way(),
    "a card on a box": Way(box=True),
    "height measured": Way(tape=True, dowels=True),
    "lens board": Way(lens=True, dowels=True),
}


@dataclass(frozen=True)
class Glimpse:
    """One rendering: its truth against what the camera made of it (nan = not seen).

    Attributes:
        place_cm: largest error of a place at the robot's height, over the workspace.
        tip_cm: of the tip by its marker.
        end_cm: of the fitted axis's end.
        length_cm: of the length along the axis, signed.
        pegs_cm: of each dowel; nan = missed.
        radius_cm: of each dowel's radius; nan = missed.
        false_pegs: circles that are no dowels.
        bend: error of curvature, 1/cm: of the one of a free bend, or of each span.
        bend_se: its stated errors.
        free: whether it was a free bend.
        accuracy_cm: what the camera model said of its own places.
    """

    place_cm: float
    tip_cm: float
    end_cm: float
    length_cm: float
    pegs_cm: tuple[float, ...]
    radius_cm: tuple[float, ...]
    false_pegs: int
    bend: tuple[float, ...]
    bend_se: tuple[float, ...]
    free: bool
    accuracy_cm: float


def axis_of(curvature: Array, length: float) -> tuple[Array, Array, Array, Array]:
    """Arc, heading, x and y of a body with that curvature, evenly spaced over its length."""
    s = np.linspace(0.0, length, len(curvature))
    step = np.diff(s)
    heading = np.concatenate([[0.0], np.cumsum((curvature[1:] + curvature[:-1]) / 2 * step)])
    middle = (heading[1:] + heading[:-1]) / 2
    x = np.concatenate([[0.0], np.cumsum(np.cos(middle) * step)])
    y = np.concatenate([[0.0], np.cumsum(np.sin(middle) * step)])
    return s, heading, x, y


def glimpse(seed: int, way: str = "height measured", lens: Lens | None = None) -> Glimpse:
    """Paint one random room and look at it.

    Args:
        seed: of everything.
        way: a key of `WAYS`.
        lens: of `board_lens`, where the way calls for one.
    """
    from thigmo.camera import Seen, Sheet, locate, look, render
    from thigmo.camera.sheet import card_decals, tip_decal

    rng = np.random.default_rng([seed, 0x6115])
    known = WAYS[way]
    camera = render.overhead_camera(rng)
    if known.lens:
        camera = lens_camera(camera)
    sheet = Sheet()
    tape = float(camera.eye_cm[2] + rng.normal(0, 0.7))
    if known.tape:
        sheet.camera_height_cm = tape
    if known.box:
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
    view = render.View(render.BodyShape(x, y), pegs, patches)
    picture = render.render(camera, view, render.random_look(rng), rng)
    model = locate(picture, sheet, lens)
    seen = look(picture, model, sheet, Seen(constant=free, obstacles=known.dowels))
    grid = np.array([[gx, gy, 1.75] for gx in (0, 14, 27, 40, 54) for gy in (-40, -20, 0, 20, 40)])
    back = model.to_plane(camera.project(grid), 1.75)
    place = float(np.linalg.norm(back - grid[:, :2], axis=1).max())
    no = float("nan")
    tip = no if seen.tip is None else float(np.hypot(seen.tip.x_cm - x[-1], seen.tip.y_cm - y[-1]))
    end = length = no
    bend: tuple[float, ...] = ()
    bend_se: tuple[float, ...] = ()
    axis = seen.axis
    if axis is not None:
        end = float(np.hypot(axis.tip_cm[0] - x[-1], axis.tip_cm[1] - y[-1]))
        length = axis.length_cm - float(s[-1])
        if free:
            bend = (float(axis.coefficients[2] - heading[-1] / s[-1]),)
            bend_se = (float(np.sqrt(axis.covariance[2, 2])),)
        else:
            spans = [c for c in _CENTERS if c + _SPAN / 2 < s[-1] - 2]
            found = [axis.mean_curvature(c, _SPAN) for c in spans]
            true = [
                float(np.diff(np.interp([c - _SPAN / 2, c + _SPAN / 2], s, heading))[0]) / _SPAN
                for c in spans
            ]
            bend = tuple(f[0] - t for f, t in zip(found, true, strict=True))
            bend_se = tuple(f[1] for f in found)
    gaps, radii = [], []
    for peg in pegs if known.dowels else ():
        near = sorted(
            (float(np.hypot(o.x_cm - peg.x_cm, o.y_cm - peg.y_cm)), o.radius_cm)
            for o in seen.obstacles
        )
        hit = near[0] if near and near[0][0] < 1.0 else (no, no)
        gaps.append(hit[0])
        radii.append(hit[1] - peg.radius_cm)
    false = len(seen.obstacles) - int(np.isfinite(gaps).sum())
    return Glimpse(
        place, tip, end, length, tuple(gaps), tuple(radii), false, bend, bend_se, free,
        model.accuracy_cm,
    )  # fmt: skip


def _body(rng: np.random.Generator, free: bool) -> tuple[Array, Array, Array, Array]:
    """A free bend, or a body with a contact, that stays inside the workspace."""
    while True:
        length = float(rng.uniform(20, 53))
        s = np.linspace(0, length, 300)
        k = np.full(300, rng.uniform(-0.035, 0.035))
        if not free:
            force = rng.choice([-1, 1]) * rng.uniform(1e-4, 8e-4)
            k = 0.6 * k + force * np.clip(rng.uniform(15, length) - s, 0, None)
        made = axis_of(k, length)
        if np.abs(made[3]).max() < 36 and made[2].min() > -1:
            return made


def _pegs(rng: np.random.Generator, heading: Array, x: Array, y: Array) -> list[PegShape]:
    """One dowel that touches the body, one elsewhere."""
    from thigmo.camera.render import PegShape

    i, radius = int(rng.integers(90, 260)), float(rng.uniform(0.8, 1.6))
    side = rng.choice([-1, 1])
    normal = np.array([-np.sin(heading[i]), np.cos(heading[i])])
    at = np.array([x[i], y[i]]) + side * (1.75 + radius) * normal
    touching = PegShape(float(at[0]), float(at[1]), radius)
    while True:
        px, py = float(rng.uniform(8, 48)), float(rng.uniform(-32, 32))
        other = PegShape(px, py, float(rng.uniform(0.8, 1.6)))
        apart = np.hypot(x - px, y - py).min() > 5.5
        if apart and np.hypot(px - at[0], py - at[1]) > 5:
            return [touching, other]


def lens_camera(camera: CameraModel) -> CameraModel:
    """The same place with the default camera's lens."""
    from thigmo.camera.render import overhead_camera

    return replace(camera, lens=overhead_camera(None).lens)


def board_lens(poses: int = 10, seed: int = 0) -> Lens:
    """Lens of the default camera, calibrated from painted pictures of the board."""
    from thigmo.camera import Sheet, calibrate_lens
    from thigmo.camera.render import overhead_camera

    sheet = Sheet()
    camera = overhead_camera(None)
    rng = np.random.default_rng([seed, 0xB0A2D])
    return calibrate_lens([board_picture(camera, sheet, rng) for _ in range(poses)], sheet)


def board_picture(camera: CameraModel, sheet: Sheet, rng: np.random.Generator) -> Picture:
    """A picture of the lens board, held tilted before the camera."""
    import cv2

    from thigmo.camera.render import View, random_look, render
    from thigmo.camera.sheet import Decal, board

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
    margin = Decal(np.full((8, 8), 255, np.uint8), (solid - middle) * 1.12 + middle, "margin")
    patches = [margin, Decal(image, solid, "board")]
    return render(camera, View(None, (), patches, housing=False), random_look(rng), rng)


def summarise(glimpses: list[Glimpse]) -> dict[str, float]:
    """Means, 95th percentiles and worst values over renderings."""
    place, tip, end = (
        np.array([getattr(g, what) for g in glimpses]) for what in ("place_cm", "tip_cm", "end_cm")
    )
    pegs = np.array([v for g in glimpses for v in g.pegs_cm])
    bends = {
        free: np.array([
            (b, b / e)
            for g in glimpses
            if g.free == free
            for b, e in zip(g.bend, g.bend_se, strict=True)
        ]).reshape(-1, 2).T
        for free in (True, False)
    }  # fmt: skip

    def rms(values: Array) -> float:
        seen = values[np.isfinite(values)]
        return float(np.sqrt(np.mean(np.square(seen)))) if len(seen) else float("nan")

    def mean(values: Array) -> float:
        return float(np.nanmean(values)) if len(values) else float("nan")

    def high(values: Array) -> float:
        return float(np.nanquantile(values, 0.95)) if len(values) else float("nan")

    return {
        "renderings": float(len(glimpses)),
        "place_mean_cm": mean(place),
        "place_p95_cm": high(place),
        "place_worst_cm": float(place.max()),
        "place_chi": rms(place / [g.accuracy_cm for g in glimpses]),
        "tip_mean_cm": mean(tip),
        "tip_p95_cm": high(tip),
        "tip_missed": mean(np.isnan(tip)),
        "axis_end_p95_cm": high(end),
        "axis_missed": mean(np.isnan(end)),
        "length_rms_cm": rms(np.array([g.length_cm for g in glimpses])),
        "peg_mean_cm": mean(pegs),
        "peg_p95_cm": high(pegs),
        "peg_missed": mean(np.isnan(pegs)),
        "peg_false_per_picture": float(np.mean([g.false_pegs for g in glimpses])),
        "peg_radius_rms_cm": rms(np.array([v for g in glimpses for v in g.radius_cm])),
        "free_bend_rms_per_cm": rms(bends[True][0]),
        "free_bend_chi": rms(bends[True][1]),
        "span_rms_per_cm": rms(bends[False][0]),
        "span_chi": rms(bends[False][1]),
    }


def run(context: Context) -> Outcome:
    """Errors over many renderings, for every way to know the lens."""
    seeds = [context.seed * 100_000 + n for n in range(context.count(6, 24))]
    lens = board_lens()
    found, outcome = {}, Outcome()
    for way, known in WAYS.items():
        paint = partial(glimpse, way=way, lens=lens if known.lens else None)
        found[way] = errors = summarise(context.map(paint, seeds, f"pictures, {way}"))
        for what, text in (
            ("place_p95_cm", "95 % of places in the workspace"),
            ("tip_p95_cm", "95 % of tips"),
            *((("peg_p95_cm", "95 % of dowels"),) if known.dowels else ()),
        ):
            outcome.claims.append(Claim(f"{text} ({way})", errors[what], 0.3, unit="cm"))
        text = f"place error over the stated one sigma, rms ({way})"
        outcome.claims.append(Claim(text, errors["place_chi"], 2))
    outcome.tables["errors"] = [
        {"quantity": name, **{way: round(errors[name], 6) for way, errors in found.items()}}
        for name in found["cards only"]
    ]
    return outcome
