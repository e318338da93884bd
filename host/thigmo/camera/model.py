"""The camera as a map between pixels and the workspace: lens, pose, and how well both are known.

`calibrate_lens` takes pictures of the ChArUco board; `thigmo.camera.pose` finds the `CameraModel`
from one picture of the cards; `judge_still` raises if the camera has moved since. Heights matter:
seen from 1 m, the middle of the robot (1.75 cm above the table) appears up to 0.8 cm away from its
place on the table's plane, so every conversion takes a height.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PlainSerializer, PlainValidator, TypeAdapter, ValidationError

from thigmo.camera.exceptions import CameraError, CameraMovedError, SheetHiddenError
from thigmo.camera.sheet import Sheet, board, dictionary
from thigmo.files import CONFIG_BYTES, read_file, why_unreadable, write_whole
from thigmo.toml_model import invalid_entry

Picture = NDArray[np.uint8]
Points = Annotated[
    NDArray[np.float64],
    PlainValidator(lambda values: np.array(values, float)),
    PlainSerializer(np.ndarray.tolist),
]

_PERIMETER_PX = 38.0  # perimeter of the smallest marker whose cells can be distinguished
_MOVED_PX = 2.0  # median shift of the cards' corners that counts as a moved camera
_LARGEST = (
    *(f"DICT_{n}X{n}_1000" for n in range(4, 8)), "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_36h11",
)  # fmt: skip
_UNDISTORT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 60, 1e-9)


class JsonFile:
    """A dataclass with a JSON file; a camera's file also has the entries of its lens."""

    content: ClassVar[str]  # what the file holds, for messages
    cure: ClassVar[str]  # how to make one

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file. Raises CameraError if the folder cannot be written."""
        data = TypeAdapter(type(self)).dump_python(self, by_alias=True)
        with CameraError.from_os(f"cannot write {path}", "choose a folder that you may write to"):
            write_whole(path, json.dumps(data.pop("lens", {}) | data, indent=1))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file of `save` (a camera's has a lens too); CameraError if missing or damaged."""
        with CameraError.from_os(f"cannot read {path}", f"{cls.cure} first"):
            text = read_file(path, CONFIG_BYTES)
        try:
            data = json.loads(text)
            return TypeAdapter(cls).validate_python({"lens": data, **data})
        except ValidationError as error:
            entry = invalid_entry(cls.content, error)
            raise CameraError(f"{path} is not a {entry}", f"{cls.cure} again") from error
        except (ValueError, TypeError, RecursionError) as error:
            raise CameraError(
                f"{path} is not a {cls.content}: {why_unreadable(error)}", f"{cls.cure} again"
            ) from error


@dataclass(frozen=True)
class Lens(JsonFile):
    """Pinhole and distortion (OpenCV's five-parameter model), px."""

    content = "lens calibration"
    cure = "run `thigmo camera lens`"
    matrix: Points  # (3, 3) camera matrix
    distortion: Points  # (5,) k1, k2, p1, p2, k3
    size: tuple[int, int]  # picture width and height
    rms_px: Annotated[float, Field(alias="lens_rms_px")] = 0.0  # residual of its calibration
    version: Literal[1] = 1  # of its file

    def require(self, picture: Picture) -> None:
        """Raise CameraError if a picture has another size."""
        height, width = picture.shape[:2]
        if (width, height) != tuple(self.size):
            raise CameraError(
                f"the picture has {width} x {height} px, the camera was calibrated at "
                f"{self.size[0]} x {self.size[1]}",
                "take pictures of one size, or calibrate the camera again",
            )


@dataclass(frozen=True)
class CameraModel(JsonFile):
    """A lens in its place above the workspace."""

    content = "camera calibration"
    cure = "run `thigmo camera locate`"
    lens: Lens  # pinhole and distortion
    rotation: Points  # (3,) Rodrigues vector, workspace to camera
    translation: Points  # (3,) cm, workspace to camera
    # (4, 2) px of each card marker when located: the reference for `judge_still`
    corners: dict[int, Points] = field(default_factory=dict)
    rms_px: float = 0.0  # residual of the cards' corners
    accuracy_cm: float = 0.0  # standard error of a place on the table, the worst in the workspace
    hidden: tuple[str, ...] = ()  # cards that were not seen

    def project(self, points_cm: NDArray[np.float64]) -> Points:
        """Workspace points (n, 3) in cm to pixels (n, 2)."""
        pixels, _ = cv2.projectPoints(
            np.asarray(points_cm, float), self.rotation, self.translation, self.lens.matrix,
            self.lens.distortion,
        )  # fmt: skip
        return np.asarray(pixels, float).reshape(-1, 2)

    def to_plane(self, pixels: NDArray[np.float64], height_cm: float = 0.0) -> Points:
        """Pixels (n, 2) to workspace x, y (n, 2) in cm at a height above the table."""
        rays = self._undistorted(pixels)
        directions = np.column_stack([rays, np.ones(len(rays))]) @ self.turn
        eye = self.eye_cm
        reach = (height_cm - eye[2]) / directions[:, 2]
        return np.asarray(eye[:2] + reach[:, None] * directions[:, :2], float)

    @cached_property
    def turn(self) -> Points:
        """Rotation matrix (3, 3), workspace to camera."""
        return np.asarray(cv2.Rodrigues(self.rotation)[0], float)

    @cached_property
    def rays(self) -> NDArray[np.float32]:
        """Direction (h, w, 3) of every pixel's ray in the workspace."""
        step, (width, height) = 8, self.lens.size  # rays are smooth, so they are interpolated
        knots = (
            np.arange(-1.0, side // step + 2) * step + (step - 1) / 2 for side in (width, height)
        )
        grid = np.stack(np.meshgrid(*knots), axis=-1)
        coarse = self._undistorted(grid).reshape(grid.shape).astype(np.float32)
        fine = cv2.resize(coarse, None, fx=step, fy=step, interpolation=cv2.INTER_LINEAR)
        flat = fine[step : step + height, step : step + width]
        homogeneous = np.dstack([flat, np.ones((height, width), np.float32)])
        return np.asarray(homogeneous @ self.turn.astype(np.float32), np.float32)

    def _undistorted(self, pixels: NDArray[np.float64]) -> Points:
        """Pixels (..., 2) to the slopes (n, 2) of their rays in the camera's frame."""
        flat = cv2.undistortPoints(
            np.asarray(pixels, float).reshape(-1, 1, 2), self.lens.matrix, self.lens.distortion,
            None, None, None, _UNDISTORT,
        )  # fmt: skip
        return np.asarray(flat, float).reshape(-1, 2)

    @property
    def eye_cm(self) -> Points:
        """Place (3,) of the camera in the workspace, cm."""
        return np.asarray(-self.turn.T @ self.translation.reshape(3), float)

    @property
    def cm_per_px(self) -> float:
        """Size of a pixel on the table under the camera."""
        return float(abs(self.eye_cm[2]) / self.lens.matrix[0, 0])


def detect_markers(picture: Picture, name: str) -> dict[int, Points]:
    """Sub-pixel corners (4, 2) of a dictionary's markers, by id; an id seen twice is dropped."""
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.cornerRefinementWinSize = 4
    settings.cornerRefinementMaxIterations = 50
    settings.cornerRefinementMinAccuracy = 0.01
    settings.errorCorrectionRate = 0.34
    settings.minMarkerPerimeterRate = _PERIMETER_PX / max(picture.shape)
    finder = cv2.aruco.ArucoDetector(dictionary(name), settings)
    corners, ids, _ = finder.detectMarkers(picture)
    if ids is None:
        return {}
    named = [int(marker) for marker in np.ravel(ids)]
    return {
        marker: np.asarray(four, float).reshape(4, 2)
        for marker, four in zip(named, corners, strict=True)
        if named.count(marker) == 1
    }


def dictionary_in_view(picture: Picture, name: str) -> str:
    """The other dictionary with the most markers in view, if at least four; else "".

    The dictionaries in `_LARGEST` contain the smaller ones of their marker size.
    """
    marker_size = dictionary(name).markerSize
    families = [
        e
        for e in _LARGEST
        if e != name and (dictionary(e).markerSize != marker_size or "X" not in e)
    ]
    counts = {family: len(detect_markers(picture, family)) for family in families}
    best = max(counts, key=lambda family: counts[family])
    return best if counts[best] >= 4 else ""


def calibrate_lens(pictures: Sequence[Picture], sheet: Sheet) -> Lens:
    """Lens from pictures of the ChArUco board in several poses (about ten, best tilted).

    Raises:
        CameraError: fewer than four pictures show enough of the board, or the fit is poor.
    """
    charuco = board(sheet)
    finder = cv2.aruco.CharucoDetector(charuco)
    objects: list[Any] = []
    images: list[Any] = []
    size = (0, 0)
    for picture in pictures:
        size = (picture.shape[1], picture.shape[0])
        corners, ids, _, _ = finder.detectBoard(picture)
        if ids is None or len(ids) < 12:
            continue
        shape, pixels = charuco.matchImagePoints(corners, ids)
        objects.append(shape)
        images.append(pixels)
    if len(objects) < 4:
        raise CameraError(
            f"the lens board is seen in {len(objects)} of {len(pictures)} pictures, 4 are needed",
            "fill the picture with the board, hold it still, avoid glare",
        )
    rms, matrix, distortion, _, _ = cv2.calibrateCamera(
        objects, images, size, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3
    )
    if rms > 1.5:
        raise CameraError(
            f"the lens fit leaves {rms:.1f} px", "glue the board on something flat and repeat"
        )
    return Lens(np.asarray(matrix, float), np.ravel(distortion)[:5].astype(float), size, float(rms))


def judge_still(markers: dict[int, Points], model: CameraModel, sheet: Sheet) -> tuple[str, ...]:
    """Names of hidden cards, from the corners (4, 2) of the markers found, by id.

    Raises SheetHiddenError if no card is seen, CameraMovedError if they are not where the camera
    was located.
    """
    shared = [m for m in model.corners if m in markers]
    card_of = sheet.marker_ids()
    hidden = tuple(c.name for c in sheet.cards if not any(card_of.get(m) is c for m in markers))
    if not shared:
        raise SheetHiddenError(hidden, 0)
    shifts = np.concatenate([markers[m] - model.corners[m] for m in shared])
    moved = float(np.median(np.linalg.norm(shifts, axis=1)))
    if moved > _MOVED_PX:
        raise CameraMovedError(
            f"the camera has moved: the cards stand {moved:.1f} px "
            f"({moved * model.cm_per_px:.2f} cm) from where it was calibrated",
            "fix the camera and run `thigmo camera locate` again",
        )
    return hidden
