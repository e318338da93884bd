"""Where the camera stands: lens and pose from one picture of the workspace cards.

Calibration and the command line call `locate`. With a calibrated lens, only the pose is fitted.
Without one, focal length, principal point and two radial terms are fitted as well. The sixteen
markers of the cards determine all of them except for one ambiguity: a plane seen from above looks
the same to a long lens far away and to a short lens nearby. Places on the table are right in both
cases, places above it are not. Any of three things resolves it: a lens board (`thigmo camera
lens`), the camera's height by tape (`camera_height_cm`), or one card on a box (`z_cm` of that
card). `accuracy_cm` shows whether it is resolved.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from scipy.optimize import least_squares

from thigmo.camera.exceptions import PlaneFitError, SheetHiddenError
from thigmo.camera.model import (
    CameraModel,
    Lens,
    Picture,
    Points,
    detect_markers,
    dictionary_in_view,
)
from thigmo.camera.sheet import Sheet

GOOD_CM = 0.15  # sufficient standard error of a place at the robot's height: 0.3 cm at 95 %

_CORNER_PX = 0.25  # standard error of a refined marker corner, with blur and noise
_TURN_SE = 0.03  # standard error of a card's direction, rad
# Angle across the picture of webcams and phones: 70 degrees; four in five have 52 to 88.
_VIEW_DEG = 70.0
_FOCAL_SPREAD = 0.25
_LENS_SPREAD = 0.4  # prior standard deviation of k1 and k2
_CENTER_SPREAD = 0.01  # the same of the principal point, as a share of the picture's width


def locate(picture: Picture, sheet: Sheet, lens: Lens | None = None) -> CameraModel:
    """Camera model from one picture of the workspace cards.

    The cards' places are fitted within their stated error, so that errors of the tape measure do
    not distort the camera model.

    Raises:
        CameraError: the lens was calibrated at another picture size.
        SheetHiddenError: fewer than three cards are seen.
        PlaneFitError: corners and sheet disagree (cards swapped, turned, or misplaced).
    """
    if lens is not None:
        lens.require(picture)
    markers = detect_markers(picture, sheet.dictionary)
    card_markers = {k: v for k, v in markers.items() if k in sheet.marker_ids()}
    seen_cards = [c for c in sheet.cards if any(c.first_id + k in card_markers for k in range(4))]
    hidden = tuple(c.name for c in sheet.cards if c not in seen_cards)
    if len(seen_cards) < 3:
        in_view = "" if seen_cards else dictionary_in_view(picture, sheet.dictionary)
        raise SheetHiddenError(hidden, len(seen_cards), in_view)
    size = (picture.shape[1], picture.shape[0])
    return fit_pose(card_markers, sheet, size, lens, hidden)


def fit_pose(
    markers: dict[int, Points],
    sheet: Sheet,
    size: tuple[int, int],
    lens: Lens | None = None,
    hidden: tuple[str, ...] = (),
) -> CameraModel:
    """As `locate`, from marker corners found before: (4, 2) px by id."""
    problem = PoseFit(markers, sheet, size, lens)
    fits = []
    for view_deg in (_VIEW_DEG,) if lens is not None else (50.0, _VIEW_DEG, 95.0):
        fit = least_squares(
            problem.residuals, problem.start(view_deg), jac=problem.jacobian, loss="soft_l1",
            x_scale="jac", max_nfev=80,
        )  # fmt: skip
        fits.append(fit)
    best = min(fits, key=lambda fit: fit.cost)
    corners = problem.residuals(best.x)[: 2 * len(problem.pixels)] * _CORNER_PX
    rms = float(np.sqrt(np.mean(corners**2) * 2))
    camera, slips = problem.split(best.x)
    worst = np.abs(slips[:, :2]).max(axis=1)
    if rms > 3.0 or worst.max() > 8 * sheet.placement_se_cm + 0.5:
        card = problem.cards[int(np.argmax(worst))].name
        raise PlaneFitError(
            f"the cards do not lie where the sheet file says (off by {rms:.1f} px; "
            f"'{card}' by {worst.max():.1f} cm)",
            "measure the crosses again, check that no card is swapped or turned, and the 10 cm bar",
        )
    accuracy = _accuracy(problem, best.x, np.asarray(best.jac, float))
    return replace(camera, corners=markers, rms_px=rms, accuracy_cm=accuracy, hidden=hidden)


def what_helps(model: CameraModel, sheet: Sheet, lens_known: bool) -> str:
    """Advice that brings a camera's places within `GOOD_CM`; "" if they are."""
    if model.accuracy_cm <= GOOD_CM:
        return ""
    ways = []
    if model.hidden:
        ways.append(f"uncover {', '.join(model.hidden)}")
    if not lens_known:
        ways.append("show the lens board to `thigmo camera lens`")
        if sheet.camera_height_cm is None:
            ways.append("or measure the lens's height above the table (camera_height_cm)")
        if not any(card.z_cm for card in sheet.cards):
            ways.append("or put one card on a box of 5 to 15 cm (z_cm of that card)")
    if not ways:
        ways.append("measure the cards' places again (placement_se_cm), and use a sharper picture")
    return ", ".join(ways)


class PoseFit:
    """Fits corners to the sheet: the lens (unless known), the pose, and the cards' slips.

    A slip is x, y and turn. All residuals are in units of their standard deviation.
    """

    def __init__(
        self, corners: dict[int, Points], sheet: Sheet, size: tuple[int, int], lens: Lens | None
    ) -> None:
        self.sheet, self.size, self.lens = sheet, size, lens
        card_of, markers = sheet.marker_ids(), sorted(corners)
        self.cards = [c for c in sheet.cards if any(card_of[m] is c for m in markers)]
        self.pixels = np.concatenate([corners[m] for m in markers])  # (n, 2)
        # Card of each corner (n,), and its place (n, 2) in the card's frame, from the card's cross.
        self.owner = np.repeat([self.cards.index(card_of[m]) for m in markers], 4)
        self.local = np.concatenate([sheet.local_corners(m - card_of[m].first_id) for m in markers])
        # x, y, z in cm and turn in rad of each card (c, 4), by the sheet file.
        self.laid = np.array([[c.x_cm, c.y_cm, c.z_cm, np.radians(c.turn_deg)] for c in self.cards])
        # The lens's prior, unless it is known: log focal length, principal point, k1, k2.
        width, place = size[0], sheet.placement_se_cm
        middle = _CENTER_SPREAD * width
        center = [_log_focal(width, _VIEW_DEG), width / 2, size[1] / 2, 0.0, 0.0]
        spread = [_FOCAL_SPREAD, middle, middle, _LENS_SPREAD, _LENS_SPREAD]
        self._head = 0 if lens is not None else len(center)
        self.center = np.array(center[: self._head])
        slips = [place, place, _TURN_SE] * len(self.cards)
        self.spread = np.array([*spread[: self._head], *slips])

    def start(self, view_deg: float) -> Points:
        """Initial values of the unknowns: a pinhole of this angle, the plane's pose, no slips."""
        x = np.concatenate([self.center, np.zeros(6 + 3 * len(self.cards))])
        if self.lens is None:
            x[0] = _log_focal(self.size[0], view_deg)
        camera, slips = self.split(x)
        flat = self._solid(slips)
        flat[:, 2] = 0.0
        _, turn, move = cv2.solvePnP(
            flat, self.pixels, camera.lens.matrix, camera.lens.distortion,
            flags=cv2.SOLVEPNP_IPPE,
        )  # fmt: skip
        x[self._head :][:6] = np.ravel([turn, move])
        return x

    def split(self, x: Points) -> tuple[CameraModel, Points]:
        """Camera, and slips (c, 3), of the unknowns."""
        head, pose, slips = np.split(x, [self._head, self._head + 6])
        lens = self.lens
        if lens is None:
            focal = float(np.exp(head[0]))
            matrix = np.array([[focal, 0, head[1]], [0, focal, head[2]], [0, 0, 1]])
            lens = Lens(matrix, np.array([*head[3:], 0.0, 0.0, 0.0]), self.size)
        return CameraModel(lens, pose[:3], pose[3:]), slips.reshape(-1, 3)

    def _solid(self, slips: Points) -> Points:
        """Corners (n, 3) in the workspace."""
        turn = (self.laid[:, 3] + slips[:, 2])[self.owner]
        u, v = self.local.T
        place = (self.laid[:, :2] + slips[:, :2])[self.owner]
        x = place[:, 0] + np.cos(turn) * u - np.sin(turn) * v
        y = place[:, 1] + np.sin(turn) * u + np.cos(turn) * v
        return np.column_stack([x, y, self.laid[self.owner, 2]])

    def residuals(self, x: Points) -> Points:
        """Corners, priors of lens and slips, height by tape."""
        camera, slips = self.split(x)
        corners = (camera.project(self._solid(slips)) - self.pixels).ravel() / _CORNER_PX
        priors = np.append(x[: self._head] - self.center, slips) / self.spread
        if (tape_cm := self.sheet.camera_height_cm) is None:
            return np.append(corners, priors)
        height = (camera.eye_cm[2] - tape_cm) / self.sheet.camera_height_se_cm
        return np.concatenate([corners, priors, [height]])

    def jacobian(self, x: Points) -> Points:
        """Derivatives of `residuals`."""
        camera, slips = self.split(x)
        lens, head, n = camera.lens, self._head, len(self.pixels)
        # OpenCV's columns: rotation, translation, fx, fy, cx, cy, k1, k2, ...
        slopes = np.asarray(cv2.projectPoints(
            self._solid(slips), camera.rotation, camera.translation, lens.matrix, lens.distortion
        )[1], float)  # fmt: skip
        rotation, by_turn = cv2.Rodrigues(camera.rotation)
        jacobian = np.zeros((2 * n + len(self.spread), len(x)))
        if self.lens is None:
            jacobian[: 2 * n, 0] = (slopes[:, 6] + slopes[:, 7]) * lens.matrix[0, 0]
            jacobian[: 2 * n, 1:5] = slopes[:, 8:12]
        jacobian[: 2 * n, head : head + 6] = slopes[:, :6]
        # A corner that moves in the workspace moves as the rotation carries it.
        by_place = (slopes[:, 3:6] @ rotation).reshape(n, 2, 3)[:, :, :2]
        angle = (self.laid[:, 3] + slips[:, 2])[self.owner]
        u, v = self.local.T
        swing = np.column_stack([-np.sin(angle) * u - np.cos(angle) * v,
                                 np.cos(angle) * u - np.sin(angle) * v])  # fmt: skip
        by_swing = np.einsum("nij,nj->ni", by_place, swing)
        for card in range(len(self.cards)):
            of_card = self.owner == card
            rows, column = np.nonzero(np.repeat(of_card, 2))[0], head + 6 + 3 * card
            jacobian[rows, column : column + 2] = by_place[of_card].reshape(-1, 2)
            jacobian[rows, column + 2] = by_swing[of_card].ravel()
        jacobian[: 2 * n] /= _CORNER_PX
        columns = np.r_[np.arange(head), np.arange(head + 6, len(x))]
        jacobian[2 * n + np.arange(len(columns)), columns] = 1 / self.spread
        if self.sheet.camera_height_cm is None:
            return jacobian
        # height = -(R^T t)_z; by_turn holds dR / d turn, R row by row.
        row = np.zeros((1, len(x)))
        row[0, head : head + 3] = -(by_turn.reshape(3, 3, 3)[:, :, 2] @ camera.translation)
        row[0, head + 3 : head + 6] = -rotation[:, 2]
        return np.vstack([jacobian, row / self.sheet.camera_height_se_cm])


def _log_focal(width: int, view_deg: float) -> float:
    """Logarithm of the focal length (px) of a lens that sees that angle across the picture."""
    return float(np.log(width / 2 / np.tan(np.radians(view_deg / 2))))


def _accuracy(problem: PoseFit, best: Points, jacobian: Points) -> float:
    """Worst standard error (cm) of a place at the robot's height, from the fit's covariance."""
    covariance = np.linalg.pinv(jacobian.T @ jacobian)
    low, high = problem.laid[:, :2].min(axis=0), problem.laid[:, :2].max(axis=0)
    x, y = np.meshgrid(np.linspace(low[0], high[0], 4), np.linspace(low[1], high[1], 4))
    grid = np.column_stack([x.ravel(), y.ravel(), np.full(16, 1.75)])
    pixels = problem.split(best)[0].project(grid)

    def places(x: Points) -> Points:
        return problem.split(x)[0].to_plane(pixels, 1.75)

    steps = 1e-3 * np.sqrt(np.maximum(np.diag(covariance), 1e-16))
    slopes = np.array([
        (places(best + step) - places(best - step)) / (2 * step.max()) for step in np.diag(steps)
    ])  # fmt: skip
    spread = np.einsum("pgk,pq,qgk->gk", slopes, covariance, slopes)
    return float(np.sqrt(spread.sum(axis=1)).max())
