"""Where the camera stands: lens and pose from one picture of the workspace cards.

`locate` is what the command line and the guided steps call. With a calibrated lens only the pose is
fitted. Without, focal length, principal point and two radial terms are fitted too, which the cards'
sixteen markers tell well but for one thing: a plane seen from above looks alike to a long lens far
away and to a short one near by. Places on the table are right either way, places above it are not.
One of three things settles it: a lens board (`thigmo camera lens`), the camera's height by tape
(`camera_height_cm`), or one card on a box (`z_cm` of that card). `accuracy_cm` says which holds.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares

from thigmo.camera.errors import PlaneFitError, SheetHiddenError
from thigmo.camera.model import CameraModel, Lens, Picture, detect_markers, other_dictionary
from thigmo.camera.sheet import Points, Sheet

GOOD_CM = 0.15  # one sigma of a place at the robot's height: 0.3 cm at 95 %

_CORNER_PX = 0.25  # one sigma of a refined marker corner, blur and noise included
_TURN_SE = 0.03  # rad, of a laid card
# Webcams and phones: 70 degrees across the picture, four in five between 52 and 88.
_VIEW_DEG = 70.0
_FOCAL_SPREAD = 0.25
_LENS_SPREAD = 0.4  # k1 and k2
_CENTER_SPREAD = 0.01  # principal point, of the picture's width


def locate(picture: Picture, sheet: Sheet, lens: Lens | None = None) -> CameraModel:
    """Camera model from one picture of the workspace cards.

    The cards' places float within their stated placement error, so that a tape measure's slips are
    shared out instead of bending the picture.

    Raises:
        CameraError: the lens was calibrated at another picture size.
        SheetHiddenError: fewer than three cards are seen.
        PlaneFitError: corners and sheet disagree (cards swapped, turned, or misplaced).
    """
    if lens is not None:
        lens.require(picture)
    markers = detect_markers(picture, sheet.dictionary)
    found = {k: v for k, v in markers.items() if k in sheet.marker_ids()}
    seen_cards = [c for c in sheet.cards if any(c.first_id + k in found for k in range(4))]
    hidden = tuple(c.name for c in sheet.cards if c not in seen_cards)
    if len(seen_cards) < 3:
        other = "" if seen_cards else other_dictionary(picture, sheet.dictionary)
        raise SheetHiddenError(hidden, len(seen_cards), other)
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
    problem = Problem(found, sheet, size, lens)
    best: Any = None
    for view_deg in (_VIEW_DEG,) if lens is not None else (50.0, _VIEW_DEG, 95.0):
        fit = least_squares(
            problem.residuals,
            problem.start(view_deg),
            loss="soft_l1",
            x_scale="jac",
            max_nfev=80,
        )
        if best is None or fit.cost < best.cost:
            best = fit
    whole = problem.residuals(best.x)[: 2 * len(problem.pixels)] * _CORNER_PX
    rms = float(np.sqrt(np.mean(whole**2) * 2))
    used, turn, move, shifts = problem.split(best.x)
    worst = np.abs(shifts[:, :2]).max(axis=1)
    if rms > 3.0 or worst.max() > 8 * sheet.placement_se_cm + 0.5:
        card = problem.cards[int(np.argmax(worst))].name
        raise PlaneFitError(
            f"the cards do not lie where the sheet file says (off by {rms:.1f} px; "
            f"'{card}' by {worst.max():.1f} cm)",
            "measure the crosses again, check that no card is swapped or turned, and the 10 cm bar",
        )
    accuracy = _accuracy(problem, best.x, np.asarray(best.jac, float))
    return CameraModel(used, turn.copy(), move.copy(), dict(found), rms, accuracy, hidden)


def what_helps(model: CameraModel, sheet: Sheet, lens_known: bool) -> str:
    """What brings a camera's places within `GOOD_CM`; empty where they are."""
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


class Problem:
    """Corners against sheet: unknowns are the lens (unless known), the pose, and each card's slip.

    All residuals are in units of their one sigma.

    Attributes:
        cards: those seen.
        pixels: (n, 2) corners in the picture.
        laid: (c, 4) x, y, z in cm and turn in rad of each card, by the sheet file.
    """

    def __init__(
        self, found: dict[int, Points], sheet: Sheet, size: tuple[int, int], lens: Lens | None
    ) -> None:
        card_of, markers = sheet.marker_ids(), sorted(found)
        self.sheet, self.size, self.lens = sheet, size, lens
        self.cards = [c for c in sheet.cards if any(card_of[m] is c for m in markers)]
        self.pixels = np.concatenate([found[m] for m in markers])
        self.laid = np.array([[c.x_cm, c.y_cm, c.z_cm, np.radians(c.turn_deg)] for c in self.cards])
        self._card = np.repeat([self.cards.index(card_of[m]) for m in markers], 4)
        # From their card's cross, in the card's frame.
        self._local = np.concatenate(
            [sheet.local_corners(m - card_of[m].first_id) for m in markers]
        )
        # The priors' middle and one sigma: the lens, then each card's slip (x, y, turn).
        width, place = _CENTER_SPREAD * size[0], sheet.placement_se_cm
        middle = [np.log(self._focal(_VIEW_DEG)), size[0] / 2, size[1] / 2, 0.0, 0.0]
        spread = [_FOCAL_SPREAD, width, width, _LENS_SPREAD, _LENS_SPREAD]
        self._head = 0 if lens is not None else len(middle)
        slips = np.zeros(3 * len(self.cards))
        self._middle = np.append(middle[: self._head], slips)
        self._spread = np.append(
            spread[: self._head], np.tile([place, place, _TURN_SE], len(self.cards))
        )

    def _focal(self, view_deg: float) -> float:
        return float(self.size[0] / 2 / np.tan(np.radians(view_deg / 2)))

    def start(self, view_deg: float) -> Points:
        """Unknowns to begin with: a pinhole of that angle, the plane's pose, no slips."""
        head, slips = self._middle[: self._head].copy(), self._middle[self._head :]
        if self.lens is None:
            head[0] = np.log(self._focal(view_deg))
        lens = self._lens(head)
        flat = self._solid(slips.reshape(-1, 3))
        flat[:, 2] = 0.0
        _, turn, move = cv2.solvePnP(
            flat, self.pixels, lens.matrix, lens.distortion, flags=cv2.SOLVEPNP_IPPE
        )
        return np.concatenate([head, np.ravel(turn), np.ravel(move), slips])

    def split(self, x: Points) -> tuple[Lens, Points, Points, Points]:
        """Lens, rotation (3,), translation (3,), slips (c, 3) of the unknowns."""
        head, turn, move, slips = np.split(x, self._head + np.array([0, 3, 6]))
        return self._lens(head), turn, move, slips.reshape(-1, 3)

    def _lens(self, head: Points) -> Lens:
        if self.lens is not None:
            return self.lens
        focal = float(np.exp(head[0]))
        matrix = np.array([[focal, 0, head[1]], [0, focal, head[2]], [0, 0, 1]])
        return Lens(matrix, np.array([head[3], head[4], 0.0, 0.0, 0.0]), self.size)

    def _solid(self, slips: Points) -> Points:
        """Corners (n, 3) in the workspace."""
        x, y, z, turn = (self.laid + np.insert(slips, 2, 0.0, axis=1))[self._card].T
        u, v = self._local.T
        return np.column_stack([
            x + np.cos(turn) * u - np.sin(turn) * v, y + np.sin(turn) * u + np.cos(turn) * v, z,
        ])  # fmt: skip

    def residuals(self, x: Points) -> Points:
        """Corners, priors of lens and slips, height by tape."""
        lens, turn, move, slips = self.split(x)
        seen = CameraModel(lens, turn, move).project(self._solid(slips))
        priors = (np.delete(x, self._head + np.arange(6)) - self._middle) / self._spread
        parts = [(seen - self.pixels).ravel() / _CORNER_PX, priors]
        if self.sheet.camera_height_cm is not None:
            height = CameraModel(lens, turn, move).eye_cm[2]
            miss = (height - self.sheet.camera_height_cm) / self.sheet.camera_height_se_cm
            parts.append(np.array([miss]))
        return np.concatenate(parts)


def _accuracy(problem: Problem, best: Points, jacobian: Points) -> float:
    """Worst one-sigma error of a place at the robot's height, from the parameters' spread."""
    covariance = np.linalg.pinv(jacobian.T @ jacobian)
    low, high = problem.laid[:, :2].min(axis=0), problem.laid[:, :2].max(axis=0)
    across = np.meshgrid(np.linspace(low[0], high[0], 4), np.linspace(low[1], high[1], 4))
    grid = np.column_stack([across[0].ravel(), across[1].ravel(), np.full(16, 1.75)])

    def model(p: Points) -> CameraModel:
        lens, turn, move, _ = problem.split(p)
        return CameraModel(lens, turn, move)

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
