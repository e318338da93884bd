"""The camera as a map between pixels and the workspace: lens, pose, and how well both are known.

`calibrate_lens` takes pictures of the ChArUco board; `locate` takes one picture of the cards and
gives the whole `CameraModel`, with the lens fitted to the same picture when none was calibrated.
Heights matter: seen from 1 m, the middle of the robot (1.75 cm above the table) stands up to
0.8 cm away from where the table's plane would have it, so every look-up names its height.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from thigmo.camera.errors import CameraError, CameraMovedError, PlaneFitError, SheetHiddenError
from thigmo.camera.sheet import BOARD_DICTIONARY, Points, Sheet, board, dictionary, place

Picture = NDArray[np.uint8]

_CORNER_PX = 0.25  # one sigma of a refined marker corner, blur and noise included
_MOVED_PX = 2.0  # median shift of the cards' corners that counts as a moved camera
_UNDISTORT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 60, 1e-9)


@dataclass(frozen=True)
class Lens:
    """Pinhole and distortion (OpenCV's five-parameter model), px.

    Attributes:
        matrix: (3, 3) camera matrix.
        distortion: (5,) k1, k2, p1, p2, k3.
        size: picture width and height.
        rms_px: residual of its calibration.
    """

    matrix: Points
    distortion: Points
    size: tuple[int, int]
    rms_px: float = 0.0

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the lens as JSON."""
        Path(path).write_text(json.dumps({"version": 1, **self.as_data()}, indent=1))

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "matrix": self.matrix.tolist(),
            "distortion": self.distortion.tolist(),
            "size": list(self.size),
            "lens_rms_px": self.rms_px,
        }

    @classmethod
    def from_data(cls, data: dict[str, Any]) -> Lens:
        """From plain data."""
        return cls(
            np.array(data["matrix"], float),
            np.array(data["distortion"], float),
            (int(data["size"][0]), int(data["size"][1])),
            float(data["lens_rms_px"]),
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Lens:
        """Read a lens written by `save` (a camera model's file will do as well).

        Raises:
            CameraError: missing or damaged file.
        """
        try:
            return cls.from_data(json.loads(Path(path).read_text()))
        except OSError as error:
            raise CameraError(
                f"cannot read {path}: {error.strerror}", "run `thigmo camera lens` first"
            ) from error
        except (KeyError, ValueError, TypeError, IndexError) as error:
            raise CameraError(
                f"{path} is no lens calibration ({error})", "run `thigmo camera lens` again"
            ) from error


@dataclass(frozen=True)
class CameraModel:
    """A lens in its place above the workspace.

    Attributes:
        lens: pinhole and distortion.
        rotation: (3,) Rodrigues vector, workspace to camera.
        translation: (3,) cm, workspace to camera.
        corners: (4, 2) px of each card marker when located: the reference for `check_still`.
        rms_px: residual of the cards' corners.
        accuracy_cm: one sigma of a place on the table (the worst over the workspace).
        hidden: cards that were not seen.
    """

    lens: Lens
    rotation: Points
    translation: Points
    corners: dict[int, Points] = field(default_factory=dict)
    rms_px: float = 0.0
    accuracy_cm: float = 0.0
    hidden: tuple[str, ...] = ()

    def project(self, points_cm: NDArray[np.float64]) -> Points:
        """Workspace points (n, 3) in cm to pixels (n, 2)."""
        seen, _ = cv2.projectPoints(
            np.asarray(points_cm, float).reshape(-1, 1, 3),
            self.rotation,
            self.translation,
            self.lens.matrix,
            self.lens.distortion,
        )
        return np.asarray(seen, float).reshape(-1, 2)

    def to_plane(self, pixels: NDArray[np.float64], height_cm: float = 0.0) -> Points:
        """Pixels (n, 2) to workspace x, y (n, 2) in cm at a height above the table."""
        rays = cv2.undistortPoints(
            np.asarray(pixels, float).reshape(-1, 1, 2),
            self.lens.matrix,
            self.lens.distortion,
            None,
            None,
            None,
            _UNDISTORT,
        ).reshape(-1, 2)
        turn, _ = cv2.Rodrigues(self.rotation)
        directions = np.column_stack([rays, np.ones(len(rays))]) @ turn
        eye = self.eye_cm
        reach = (height_cm - eye[2]) / directions[:, 2]
        return np.asarray(eye[:2] + reach[:, None] * directions[:, :2], float)

    @property
    def eye_cm(self) -> Points:
        """Place (3,) of the camera in the workspace, cm."""
        turn, _ = cv2.Rodrigues(self.rotation)
        return np.asarray(-turn.T @ self.translation.reshape(3), float)

    @property
    def cm_per_px(self) -> float:
        """Size of a pixel on the table under the camera."""
        return float(abs(self.eye_cm[2]) / self.lens.matrix[0, 0])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model as JSON."""
        data = {
            "version": 1,
            **self.lens.as_data(),
            "rotation": self.rotation.tolist(),
            "translation": self.translation.tolist(),
            "rms_px": self.rms_px,
            "accuracy_cm": self.accuracy_cm,
            "hidden": list(self.hidden),
            "corners": {str(k): v.tolist() for k, v in self.corners.items()},
        }
        Path(path).write_text(json.dumps(data, indent=1))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> CameraModel:
        """Read a model written by `save`.

        Raises:
            CameraError: missing or damaged file.
        """
        try:
            data = json.loads(Path(path).read_text())
            return cls(
                Lens.from_data(data),
                np.array(data["rotation"], float),
                np.array(data["translation"], float),
                {int(k): np.array(v, float) for k, v in data["corners"].items()},
                float(data["rms_px"]),
                float(data["accuracy_cm"]),
                tuple(data["hidden"]),
            )
        except OSError as error:
            raise CameraError(
                f"cannot read {path}: {error.strerror}", "run `thigmo camera locate` first"
            ) from error
        except (KeyError, ValueError, TypeError, IndexError) as error:
            raise CameraError(
                f"{path} is no camera calibration ({error})", "run `thigmo camera locate` again"
            ) from error


def gray(picture: Picture) -> Picture:
    """Brightness of a colour (BGR) or gray picture."""
    if picture.ndim == 2:
        return picture
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8)


def detect_markers(picture: Picture) -> dict[int, Points]:
    """Corners (4, 2) px of every marker seen, by id; sub-pixel. A doubled id is dropped."""
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.cornerRefinementWinSize = 4
    settings.cornerRefinementMaxIterations = 50
    settings.cornerRefinementMinAccuracy = 0.01
    settings.errorCorrectionRate = 0.34
    settings.minMarkerPerimeterRate = 0.02
    finder = cv2.aruco.ArucoDetector(dictionary(), settings)
    corners, ids, _ = finder.detectMarkers(gray(picture))
    found: dict[int, Points] = {}
    doubled: set[int] = set()
    if ids is None:
        return found
    for marker, four in zip(np.ravel(ids), corners, strict=True):
        if int(marker) in found:
            doubled.add(int(marker))
        found[int(marker)] = np.asarray(four, float).reshape(4, 2)
    return {marker: four for marker, four in found.items() if marker not in doubled}


def calibrate_lens(pictures: Sequence[Picture], sheet: Sheet) -> Lens:
    """Lens from pictures of the ChArUco board in several poses (ten are good, tilted ones best).

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
        corners, ids, _, _ = finder.detectBoard(gray(picture))
        if ids is None or len(ids) < 12:
            continue
        shape, seen = charuco.matchImagePoints(corners, ids)
        objects.append(shape)
        images.append(seen)
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


def _lens_of(parameters: Points, size: tuple[int, int]) -> Lens:
    focal = float(np.exp(parameters[0]))
    matrix = np.array([[focal, 0, parameters[1]], [0, focal, parameters[2]], [0, 0, 1]])
    return Lens(matrix, np.array([parameters[3], parameters[4], 0.0, 0.0, 0.0]), size)


def locate(picture: Picture, sheet: Sheet, lens: Lens | None = None) -> CameraModel:
    """Camera model from one picture of the workspace cards.

    With `lens` only the pose is fitted; without, focal length and radial distortion too (a plane
    seen from above tells the distance poorly: give the sheet's `camera_height_cm`). The cards'
    places float within their stated placement error, so that a tape measure's slips are shared out
    instead of bending the picture.

    Raises:
        SheetHiddenError: fewer than three cards are seen.
        PlaneFitError: corners and sheet disagree (cards swapped, turned, or misplaced).
    """
    found = {k: v for k, v in detect_markers(picture).items() if k in sheet.marker_ids()}
    seen_cards = [c for c in sheet.cards if any(c.first_id + k in found for k in range(4))]
    hidden = tuple(c.name for c in sheet.cards if c not in seen_cards)
    if len(seen_cards) < 3:
        raise SheetHiddenError(hidden, len(seen_cards))
    size = (picture.shape[1], picture.shape[0])
    return fit_pose(found, sheet, size, lens, hidden)


def fit_pose(
    found: dict[int, Points],
    sheet: Sheet,
    size: tuple[int, int],
    lens: Lens | None = None,
    hidden: tuple[str, ...] = (),
) -> CameraModel:
    """`locate` from corners that are already found (or clicked): (4, 2) px by marker id.

    Raises:
        PlaneFitError: corners and sheet disagree.
    """
    card_of = sheet.marker_ids()
    markers = sorted(found)
    cards = [c for c in sheet.cards if any(card_of[m] is c for m in markers)]
    pixels = np.concatenate([found[m] for m in markers])
    flat = np.concatenate([sheet.corners(m) for m in markers])
    solid = np.column_stack([flat, np.zeros(len(flat))])
    center = (size[0] / 2, size[1] / 2)

    def guess(focal: float) -> Points:
        matrix = np.array([[focal, 0, center[0]], [0, focal, center[1]], [0, 0, 1]])
        known = lens or Lens(matrix, np.zeros(5), size)
        _, turn, move = cv2.solvePnP(
            solid, pixels, known.matrix, known.distortion, flags=cv2.SOLVEPNP_IPPE
        )
        return np.concatenate([np.ravel(turn), np.ravel(move)])

    offsets = 3 * len(cards)
    owner = np.repeat([cards.index(card_of[m]) for m in markers], 4)
    local = np.concatenate([sheet.local_corners(m - card_of[m].first_id) for m in markers])
    spread = np.tile([sheet.placement_se_cm, sheet.placement_se_cm, 0.03], len(cards))
    lens_spread = np.array([0.4, 0.01 * size[0], 0.01 * size[0], 0.4, 0.4])

    def split(p: Points) -> tuple[Lens, Points, Points]:
        if lens is not None:
            return lens, p[:6], p[6:]
        return _lens_of(p[:5], size), p[5:11], p[11:]

    def residuals(p: Points, start: Points) -> Points:
        used, pose, shifts = split(p)
        shift = shifts.reshape(-1, 3)
        turned = np.concatenate(
            [
                place(
                    local[owner == k],
                    card.model_copy(update={"turn_deg": card.turn_deg + np.degrees(shift[k, 2])}),
                )
                + shift[k, :2]
                for k, card in enumerate(cards)
            ]
        )
        seen, _ = cv2.projectPoints(
            np.column_stack([turned, np.zeros(len(turned))])[order],
            pose[:3],
            pose[3:],
            used.matrix,
            used.distortion,
        )
        parts = [(seen.reshape(-1, 2) - pixels).ravel() / _CORNER_PX, shifts / spread]
        if lens is None:
            parts.append((p[:5] - start) / lens_spread)
        if sheet.camera_height_cm is not None:
            height = -(cv2.Rodrigues(pose[:3])[0].T @ pose[3:])[2]
            miss = (height - sheet.camera_height_cm) / sheet.camera_height_se_cm
            parts.append(np.array([miss]))
        return np.concatenate(parts)

    # `turned` above runs card by card; back to marker order.
    order = np.argsort(np.argsort(owner, kind="stable"), kind="stable")
    best: Any = None
    for view_deg in (60.0,) if lens is not None else (50.0, 75.0, 95.0):
        focal = size[0] / 2 / np.tan(np.radians(view_deg / 2))
        start = np.array([np.log(focal), center[0], center[1], 0.0, 0.0])
        head = np.zeros(0) if lens is not None else start
        begin = np.concatenate([head, guess(focal), np.zeros(offsets)])
        fit = least_squares(
            residuals, begin, args=(start,), loss="soft_l1", x_scale="jac", max_nfev=80
        )
        if best is None or fit.cost < best[0].cost:
            best = (fit, start)
    fit, start = best
    used, pose, shifts = split(fit.x)
    whole = residuals(fit.x, start)[: 2 * len(pixels)] * _CORNER_PX
    rms = float(np.sqrt(np.mean(whole**2) * 2))
    worst = np.abs(shifts.reshape(-1, 3)[:, :2]).max(axis=1)
    if rms > 3.0 or worst.max() > 8 * sheet.placement_se_cm + 0.5:
        card = cards[int(np.argmax(worst))].name
        raise PlaneFitError(
            f"the cards do not lie where the sheet file says (off by {rms:.1f} px; "
            f"'{card}' by {worst.max():.1f} cm)",
            "measure the crosses again, check that no card is swapped or turned, and the 10 cm bar",
        )
    model = CameraModel(used, pose[:3].copy(), pose[3:].copy(), dict(found), rms, 0.0, hidden)
    accuracy = _accuracy(fit.x, fit.jac, split, sheet)
    return CameraModel(
        used, model.rotation, model.translation, model.corners, rms, accuracy, hidden
    )


def _accuracy(best: Points, jacobian: Points, split: Any, sheet: Sheet) -> float:
    """Worst one-sigma error of a place at the robot's height, from the parameters' spread."""
    covariance = np.linalg.pinv(jacobian.T @ jacobian)
    places = np.array([[c.x_cm, c.y_cm] for c in sheet.cards])
    low, high = places.min(axis=0), places.max(axis=0)
    across = np.meshgrid(np.linspace(low[0], high[0], 4), np.linspace(low[1], high[1], 4))
    grid = np.column_stack([across[0].ravel(), across[1].ravel(), np.full(16, 1.75)])

    def model(p: Points) -> CameraModel:
        lens, pose, _ = split(p)
        return CameraModel(lens, pose[:3], pose[3:])

    pixels = model(best).project(grid)
    steps = 1e-3 * np.sqrt(np.maximum(np.diag(covariance), 1e-16))
    slopes = np.array(
        [
            (model(best + step).to_plane(pixels, 1.75) - model(best - step).to_plane(pixels, 1.75))
            / (2 * step.max())
            for step in np.diag(steps)
        ]
    )
    spread = np.einsum("pgk,pq,qgk->gk", slopes, covariance, slopes)
    return float(np.sqrt(spread.sum(axis=1)).max())


def check_still(picture: Picture, model: CameraModel, sheet: Sheet) -> tuple[str, ...]:
    """Whether the camera stands where it was located; returns the names of hidden cards.

    Raises:
        SheetHiddenError: no card at all is seen.
        CameraMovedError: the cards stand elsewhere in the picture.
    """
    return judge_still(detect_markers(picture), model, sheet)


def judge_still(found: dict[int, Points], model: CameraModel, sheet: Sheet) -> tuple[str, ...]:
    """`check_still` on markers that are already detected."""
    both = [m for m in model.corners if m in found]
    card_of = sheet.marker_ids()
    hidden = tuple(c.name for c in sheet.cards if not any(card_of.get(m) is c for m in found))
    if not both:
        raise SheetHiddenError(hidden, 0)
    shifts = np.concatenate([found[m] - model.corners[m] for m in both])
    moved = float(np.median(np.linalg.norm(shifts, axis=1)))
    if moved > _MOVED_PX:
        raise CameraMovedError(moved, moved * model.cm_per_px)
    return hidden


__all__ = [
    "BOARD_DICTIONARY",
    "CameraModel",
    "Lens",
    "Picture",
    "calibrate_lens",
    "check_still",
    "detect_markers",
    "fit_pose",
    "gray",
    "judge_still",
    "locate",
]
