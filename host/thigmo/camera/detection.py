"""Detects tip, axis and obstacles in one picture, and lists what is wrong with it.

Calibration and the command line call `detect`. Every failure is either raised (no cards, moved
camera) or listed in the detection.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from thigmo.camera.body import COVER_RIM_PX, Track, bodyness, flatten, follow
from thigmo.camera.centerline import Centerline, fit_centerline
from thigmo.camera.exceptions import (
    AxisDoubtfulError,
    BodyNotSeenError,
    CameraError,
    MarkerAstrayError,
    MarkerMissingError,
    TooCoarseError,
)
from thigmo.camera.model import CameraModel, Picture, detect_markers, judge_still
from thigmo.camera.obstacles import OBSTACLE_PX_CM, Obstacle, find_obstacles
from thigmo.camera.sheet import Sheet
from thigmo.errors import DataError
from thigmo.files import write_whole

Array = NDArray[np.float64]

# Below these sizes, tip markers are no longer detected in rendered rooms of decreasing resolution.
_CELL_PX = 2.0  # cell of a marker
_TUBE_PX = 14.0  # diameter of the tube
_GOOD_SHARE = 0.6
_FLANK = (255, 200, 120)
_CURE = (
    "look at it with `thigmo camera check`; give it a picture of the empty table (`--background`)"
)


@dataclass(frozen=True)
class TipDetection:
    """The tip marker, and the tip behind it."""

    x_cm: float  # the robot's tip itself
    y_cm: float
    heading: float  # heading of the marker, rad
    center_cm: Array  # (2,) centre of the marker


@dataclass(frozen=True)
class Detection:
    """What was detected in a picture."""

    tip: TipDetection | None  # tip, if seen
    axis: Centerline | None  # fitted axis, if the body was seen
    obstacles: list[Obstacle]  # dowels
    hidden: tuple[str, ...]  # names of cards that were not seen
    problems: tuple[CameraError, ...]  # what failed, each with its next step
    markers: dict[int, Array]  # corners px of all markers, for drawing


@dataclass(frozen=True)
class DetectionRequest:
    """What to detect in a picture, and the sizes to expect."""

    diameter_cm: float = 3.5  # diameter of the tube
    obstacle_height_cm: float = 6.0  # height of the dowels' tops above the table
    obstacle_radius_cm: tuple[float, float] = (0.65, 2.5)  # least and largest radius
    tip: bool = True  # look for the tip marker
    body: bool = True  # look for the body
    obstacles: bool = True  # look for dowels
    constant: bool = False  # the body is a free bend (one curvature)
    length_cm: float | None = None  # length of the body, if it is known
    full_cm: float | None = None  # full length of the robot; None = that which the cards are for

    def __post_init__(self) -> None:
        low, high = self.obstacle_radius_cm
        if not (0 < self.diameter_cm < 20 and 0 <= self.obstacle_height_cm < 60):
            raise DataError(
                f"a tube of {self.diameter_cm:g} cm and dowels {self.obstacle_height_cm:g} cm high",
                "give sizes in cm: a tube below 20, dowels below 60",
            )
        if not 0 < low < high < 20:
            raise DataError(
                f"dowels of {low:g} to {high:g} cm radius", "give a radius above 0 and below 16 cm"
            )


def detect(
    picture: Picture,
    camera: CameraModel,
    sheet: Sheet,
    request: DetectionRequest | None = None,
    *,
    background: Picture | None = None,
) -> Detection:
    """Read one picture, (h, w, 3) BGR.

    `background` is the empty table from the same camera.

    Raises:
        CameraError: the picture has another size than the camera's.
        TooCoarseError: it has too few pixels per cm.
        SheetHiddenError: no card at all is seen.
        CameraMovedError: the camera moved since it was located.
    """
    camera.lens.require(picture)
    markers = detect_markers(picture, sheet.dictionary)
    detector = _Detector(picture, camera, sheet, request or DetectionRequest(), markers)
    detector.require_fine()
    hidden = judge_still(markers, camera, sheet)
    problems: list[CameraError] = []
    tip: TipDetection | None = None
    if detector.request.tip:
        try:
            tip = detector.tip()
        except MarkerMissingError as error:
            problems.append(error)
    axis: Centerline | None = None
    if detector.request.body:
        try:
            axis, doubts = detector.axis(tip, background)
            problems += [AxisDoubtfulError(doubt, _CURE) for doubt in doubts]
        except (BodyNotSeenError, MarkerAstrayError) as error:
            problems.append(error)
            tip = None if isinstance(error, MarkerAstrayError) else tip
        except DataError as error:
            problems.append(BodyNotSeenError(error.problem, error.next_step))
    obstacles = detector.obstacles() if detector.request.obstacles else []
    return Detection(tip, axis, obstacles, hidden, tuple(problems), markers)


@dataclass(frozen=True)
class _Detector:
    """A picture, and what is needed to read it."""

    picture: Picture
    camera: CameraModel
    sheet: Sheet
    request: DetectionRequest
    markers: dict[int, Array]  # corners px by id

    def require_fine(self) -> None:
        """Raise TooCoarseError if markers and flanks have too few pixels."""
        px_per_cm = 1 / self.camera.cm_per_px
        request, marker_cm = self.request, self.sheet.tip_marker_cm
        needs = []
        if request.tip:
            cell_cm = marker_cm * self.sheet.print_scale / self.sheet.modules
            needs.append((_CELL_PX / cell_cm, f"a tip marker of {marker_cm:g} cm"))
        if request.body:
            needs.append((_TUBE_PX / request.diameter_cm, f"a tube of {request.diameter_cm:g} cm"))
        needed, reason = max(needs, default=(0.0, ""))
        if px_per_cm < needed:
            raise TooCoarseError(
                f"the picture has {px_per_cm:.1f} px per cm, and {reason} needs {needed:.1f}",
                f"take one {needed / px_per_cm:.1f} times as large, or bring the camera nearer",
            )

    @property
    def _full_cm(self) -> float:
        return self.request.full_cm or self.sheet.length_cm

    def tip(self) -> TipDetection:
        """The tip, by its marker."""
        diameter, marker = self.request.diameter_cm, self.sheet.tip_marker_id
        if marker not in self.markers:
            raise MarkerMissingError(
                f"the tip marker (id {marker}) is not seen", "turn it face up and clear the view"
            )
        flat = self.camera.to_plane(self.markers[marker], diameter)
        forward = (flat[1] + flat[2] - flat[0] - flat[3]) / 2
        heading = float(np.arctan2(forward[1], forward[0]))
        center = flat.mean(axis=0)
        tip = center + self.sheet.tip_offset_cm * np.array([np.cos(heading), np.sin(heading)])
        return TipDetection(float(tip[0]), float(tip[1]), heading, center)

    def axis(
        self, tip: TipDetection | None, background: Picture | None
    ) -> tuple[Centerline, list[str]]:
        """The axis, and reasons to doubt it."""
        camera, request = self.camera, self.request
        radius = request.diameter_cm / 2
        end = None if tip is None else np.array([tip.x_cm, tip.y_cm])
        flat = flatten(self.picture, camera, radius, self._full_cm)
        empty = None if background is None else flatten(background, camera, radius, self._full_cm)
        cover = None
        if (corners := self.markers.get(self.sheet.tip_marker_id)) is not None:
            # The white margin belongs to the marker: one more cell on each side.
            center = corners.mean(axis=0)
            # It may be wider than the tube, as which it counts with the rim drawn around it.
            wider = 1.02 * (1 + 2 / self.sheet.modules)
            side_cm = wider * self.sheet.tip_marker_cm * self.sheet.print_scale
            covered_cm = max(request.diameter_cm - COVER_RIM_PX / flat.px_per_cm, 0.0)
            height_px = (corners[0] + corners[1] - corners[2] - corners[3]) / 4
            too_wide = max(0.0, wider * (1 - covered_cm / side_cm)) * height_px
            margin = wider * (corners - center) - np.outer([1, 1, -1, -1], too_wide)
            cover = camera.to_plane(center + margin, radius)
        track = follow(flat, bodyness(flat, radius, cover, empty), radius)
        middle, good = track.middle, track.good
        # Perspective shifts the end's upper or lower edge by its height, by half if it is rounded.
        forward = middle[-1] - middle[-min(4, len(middle))]
        forward /= max(float(np.linalg.norm(forward)), 1e-9)
        distance = float(abs((track.tip - camera.eye_cm[:2]) @ forward))
        seen_end = track.tip - 0.5 * radius * distance / float(camera.eye_cm[2]) * forward
        if cover is not None and tip is not None:
            gap_cm = float(np.hypot(*(seen_end - end)))
            if gap_cm > radius:
                raise MarkerAstrayError(
                    f"the tip marker (id {self.sheet.tip_marker_id}) lies {gap_cm:.1f} cm from "
                    "where the body ends",
                    "stick it back on the tip, and clear the view of the body",
                )
            # It hides the flanks under it; its own centre, at its own height, is on the axis.
            center = cover.mean(axis=0)
            reach = float(np.linalg.norm(cover - center, axis=1).max()) + 0.3
            covered = np.linalg.norm(middle - center, axis=1) <= reach
            last = int(np.argmax(covered)) if covered.any() else len(middle)
            middle = np.vstack([middle[:last], tip.center_cm])
            good = np.append(good[:last], True)
        line = fit_centerline(
            middle, seen_end if end is None else end, constant=request.constant, good=good
        )
        # A marker that is not seen hides the end of the body.
        tolerance_cm = request.diameter_cm + (self.sheet.tip_hides_cm if tip is None else 0.0)
        return line, _doubts(track, middle, good, line, request, tolerance_cm)

    def obstacles(self) -> list[Obstacle]:
        """The dowels that are seen."""
        camera, height = self.camera, self.request.obstacle_height_cm
        flat = flatten(self.picture, camera, height, self._full_cm, OBSTACLE_PX_CM)
        ignore = [camera.to_plane(corners, height) for corners in self.markers.values()]
        return find_obstacles(flat, self.request.obstacle_radius_cm, ignore)


def _doubts(
    track: Track,
    middle: Array,
    good: NDArray[np.bool_],
    line: Centerline,
    request: DetectionRequest,
    tolerance_cm: float,
) -> list[str]:
    """Reasons why an axis may not be the body's, or not all of it."""
    doubts = []
    if track.flanks_lost:
        doubts.append(f"the body was lost sight of {line.length_cm:.0f} cm from its base")
    if np.mean(good) < _GOOD_SHARE:
        doubts.append(f"both flanks were seen at only {np.mean(good):.0%} of the axis")
    axis = np.column_stack([line.x_cm, line.y_cm])
    gap_cm = float(
        np.linalg.norm(middle[:, None] - axis, axis=2).min(axis=1)[good].max(initial=0.0)
    )
    if gap_cm > request.diameter_cm / 2:
        doubts.append(
            f"the axis passes the body's own middle by {gap_cm:.1f} cm: the body is kinked, or "
            "something beside it was taken for it"
        )
    if request.length_cm is not None and abs(line.length_cm - request.length_cm) > tolerance_cm:
        doubts.append(
            f"the axis that was seen is {line.length_cm:.1f} cm long, and the body is "
            f"{request.length_cm:.1f} cm"
        )
    return doubts


def draw(
    picture: Picture,
    camera: CameraModel,
    sheet: Sheet,
    detection: Detection,
    request: DetectionRequest,
) -> Picture:
    """The picture with the detections drawn over it."""
    canvas = picture.copy()
    card_of = sheet.marker_ids()
    for marker, corners in detection.markers.items():
        expected = marker in card_of or marker == sheet.tip_marker_id
        color = (0, 200, 0) if expected else (0, 0, 255)
        _lines(canvas, corners, color, closed=True)
    full_cm = request.full_cm or sheet.length_cm
    y_ticks, x_ticks = np.arange(0.0, 0.8 * full_cm, 10.0), np.arange(0.0, full_cm, 10.0)
    y_ticks = np.append(-y_ticks[:0:-1], y_ticks)
    y_line, x_line = (np.linspace(ticks[0], ticks[-1], 60) for ticks in (y_ticks, x_ticks))
    for x, y in [*((x, y_line) for x in x_ticks), *((x_line, y) for y in y_ticks)]:
        _lines(canvas, camera.project(_raised(x, y, 0.0)), (200, 160, 60))
    origin, *ends = camera.project(np.array([[0.0, 0, 0], [5, 0, 0], [0, 5, 0]]))
    for end, name in zip(ends, "xy", strict=True):
        cv2.arrowedLine(canvas, _pixel(origin), _pixel(end), (255, 0, 0), 3)
        _text(canvas, name, end, (255, 0, 0))
    if detection.axis is not None:
        axis = detection.axis
        radius = request.diameter_cm / 2
        for out, color in ((0.0, (255, 255, 0)), (radius, _FLANK), (-radius, _FLANK)):
            x = axis.x_cm - out * np.sin(axis.heading)
            y = axis.y_cm + out * np.cos(axis.heading)
            _lines(canvas, camera.project(_raised(x, y, radius)), color)
        middle = len(axis.arc_cm) // 2
        (point,) = camera.project(_raised(axis.x_cm[middle], axis.y_cm[middle] - 5.0, radius))
        caption = f"length {axis.length_cm:.1f} cm, mean curvature {axis.curvature:+.4f} /cm"
        _text(canvas, caption, point)
    if detection.tip is not None:
        tip = detection.tip
        (point,) = camera.project(_raised(tip.x_cm, tip.y_cm, request.diameter_cm / 2))
        cv2.drawMarker(canvas, _pixel(point), (0, 0, 255), cv2.MARKER_CROSS, 24, 2)
        _text(canvas, f"tip {tip.x_cm:.2f}, {tip.y_cm:.2f} cm", point + np.array([14, -14]))
    around = np.linspace(0, 2 * np.pi, 60)
    for o in detection.obstacles:
        x, y = o.x_cm + o.radius_cm * np.cos(around), o.y_cm + o.radius_cm * np.sin(around)
        rim = camera.project(_raised(x, y, request.obstacle_height_cm))
        _lines(canvas, rim, (255, 0, 255), closed=True)
        _text(canvas, f"({o.x_cm:.1f}, {o.y_cm:.1f}) r {o.radius_cm:.2f}", rim[0], (255, 0, 255))
    texts = [f"hidden cards: {', '.join(detection.hidden)}"] if detection.hidden else []
    for n, text in enumerate([*texts, *map(str, detection.problems)]):
        _text(canvas, text, np.array([20, 40 + 34 * n]), (0, 0, 255))
    return canvas


def _raised(x: Array | float, y: Array | float, height_cm: float) -> Array:
    """Points (n, 3) at one height."""
    return np.column_stack(np.broadcast_arrays(x, y, height_cm))


def write_picture(path: str | Path, picture: Picture) -> None:
    """Write a picture file; raises CameraError for an unknown suffix or an unwritable folder."""
    try:
        _, data = cv2.imencode(Path(path).suffix, picture)
    except cv2.error as error:
        raise CameraError(f"cannot write {path}", "end the name in .png or .jpg") from error
    with CameraError.from_os(f"cannot write {path}", "choose a folder that you may write to"):
        write_whole(path, data.tobytes())


def _pixel(point: Array) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def _lines(
    canvas: Picture, points: Array, color: tuple[int, int, int], *, closed: bool = False
) -> None:
    vertices = np.round(points * 16).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(canvas, [vertices], closed, color, 2, cv2.LINE_AA, 4)


def _text(
    canvas: Picture, text: str, point: Array, color: tuple[int, int, int] = (0, 0, 0)
) -> None:
    for shade, width in (((255, 255, 255), 5), (color, 2)):
        cv2.putText(canvas, text, _pixel(point), cv2.FONT_HERSHEY_SIMPLEX, 0.65, shade, width)
