"""Pixels to centimetres without pictures: pose, axis fits, files."""

from __future__ import annotations

import json

import numpy as np
import pytest

from thigmo.camera import (
    CameraModel,
    CameraMovedError,
    DetectionRequest,
    Lens,
    PictureError,
    PlaneFitError,
    Sheet,
    SheetHiddenError,
    fit_centerline,
    open_source,
)
from thigmo.camera.exceptions import CameraError
from thigmo.camera.model import judge_still
from thigmo.camera.pose import fit_pose, what_helps
from thigmo.camera.sheet import place
from thigmo.emulator.render import overhead_camera
from thigmo.errors import DataError
from thigmo_bench.studies.camera import axis_of


def corners_seen(camera: CameraModel, sheet: Sheet, rng: np.random.Generator) -> dict:
    """Every card's corners as that camera sees them, 0.1 px of noise."""
    pixels = {}
    for marker, card in sheet.marker_ids().items():
        flat = place(sheet.local_corners(marker - card.first_id), card)
        corners = camera.project(np.column_stack([flat, np.full(4, card.z_cm)]))
        pixels[marker] = corners + rng.normal(0, 0.1, (4, 2))
    return pixels


def places(camera: CameraModel, model: CameraModel, height: float) -> float:
    grid = np.array([[x, y, height] for x in (0, 27, 54) for y in (-40, 0, 40)], float)
    return float(np.abs(model.to_plane(camera.project(grid), height) - grid[:, :2]).max())


def test_model_inverts_itself_exactly():
    camera = overhead_camera(np.random.default_rng(1))
    assert places(camera, camera, 0.0) < 1e-6
    assert places(camera, camera, 6.0) < 1e-6


@pytest.mark.parametrize("known_lens", [True, False])
def test_pose_from_corners_is_right_within_its_stated_accuracy(known_lens):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        camera = overhead_camera(rng)
        sheet = Sheet(camera_height_cm=float(camera.eye_cm[2] + rng.normal(0, 0.7)))
        lens = camera.lens if known_lens else None
        model = fit_pose(corners_seen(camera, sheet, rng), sheet, camera.lens.size, lens)
        assert places(camera, model, 1.75) < max(0.03, 2.5 * model.accuracy_cm)
        assert places(camera, model, 1.75) < 0.15


def test_what_helps_is_said_where_cards_alone_do_not_suffice():
    rng = np.random.default_rng(0)
    camera, sheet = overhead_camera(None), Sheet()  # looks straight down
    alone = fit_pose(
        corners_seen(camera, sheet, rng), sheet, camera.lens.size, hidden=("tip left",)
    )
    advice = what_helps(alone, sheet, lens_known=False)
    for way in ("uncover tip left", "thigmo camera lens", "camera_height_cm", "card on a box"):
        assert way in advice
    sheet.cards[0].z_cm = 9.0
    boxed = fit_pose(corners_seen(camera, sheet, rng), sheet, camera.lens.size)
    assert what_helps(boxed, sheet, lens_known=False) == ""
    assert boxed.eye_cm[2] == pytest.approx(camera.eye_cm[2], abs=8.0)
    assert places(camera, boxed, 6.0) < 0.2


def test_misplaced_card_is_named():
    rng = np.random.default_rng(2)
    camera = overhead_camera(rng)
    pixels = corners_seen(camera, Sheet(), rng)
    said = Sheet()
    said.cards[3].x_cm += 5.0
    with pytest.raises(PlaneFitError, match="sheet file"):
        fit_pose(pixels, said, camera.lens.size)


def test_moved_camera_and_hidden_cards_are_told_apart():
    rng = np.random.default_rng(3)
    camera, sheet = overhead_camera(rng), Sheet()
    pixels = corners_seen(camera, sheet, rng)
    model = fit_pose(pixels, sheet, camera.lens.size)
    assert judge_still(pixels, model, sheet) == ()
    fewer = {k: v for k, v in pixels.items() if k >= 4}
    assert judge_still(fewer, model, sheet) == ("base left",)
    with pytest.raises(SheetHiddenError, match="base left, base right"):
        judge_still({}, model, sheet)
    moved = {k: v + np.array([9.0, -4.0]) for k, v in pixels.items()}
    said = r"cards stand 9\.\d px .* from where it was calibrated; .*locate` again"
    with pytest.raises(CameraMovedError, match=said):
        judge_still(moved, model, sheet)


def test_camera_file_round_trip_and_damage(tmp_path):
    rng = np.random.default_rng(4)
    camera, sheet = overhead_camera(rng), Sheet()
    model = fit_pose(corners_seen(camera, sheet, rng), sheet, camera.lens.size)
    model.save(tmp_path / "camera.json")
    again = CameraModel.load(tmp_path / "camera.json")
    assert places(camera, again, 1.0) == pytest.approx(places(camera, model, 1.0))
    assert again.corners.keys() == model.corners.keys()
    assert Lens.load(tmp_path / "camera.json").matrix == pytest.approx(model.lens.matrix)
    (tmp_path / "camera.json").write_text(json.dumps({"version": 1}))
    with pytest.raises(CameraError, match="not a camera calibration"):
        CameraModel.load(tmp_path / "camera.json")
    with pytest.raises(CameraError, match="locate` first"):
        CameraModel.load(tmp_path / "none.json")


@pytest.mark.sim
@pytest.mark.parametrize("constant", [True, False])
def test_axis_fit_tells_curvature_within_its_errors(constant):
    misses = []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        k = np.full(531, rng.uniform(-0.03, 0.03))
        if not constant:
            k = k + 5e-4 * np.clip(rng.uniform(20, 53) - np.linspace(0, 53, 531), 0, None)
        s, heading, x, y = axis_of(k, 53.0)
        points = np.column_stack([x, y])[5::5] + rng.normal(0, 0.03, (106, 2))
        axis = fit_centerline(points, np.array([x[-1], y[-1]]), constant=constant)
        assert axis.length_cm == pytest.approx(53.0, abs=0.1)
        for center in (15.0, 35.0):
            turn = np.interp([center - 2.75, center + 2.75], s, heading)
            value, se = axis.mean_curvature(center, 5.5)
            misses.append((value - (turn[1] - turn[0]) / 5.5) / se)
    assert 0.15 < np.mean(np.square(misses)) < 1.6


def test_axis_fit_survives_a_hidden_stretch_and_wild_points():
    rng = np.random.default_rng(0)
    _, _, x, y = axis_of(np.full(531, 0.02), 53.0)
    points = np.column_stack([x, y])[5::5] + rng.normal(0, 0.02, (106, 2))
    points[50:54] += [0.0, 1.0]
    axis = fit_centerline(points, constant=True)
    assert axis.coefficients[2] == pytest.approx(0.02, abs=1e-4)
    with pytest.raises(DataError, match="six or more"):
        fit_centerline(points[:4])
    with pytest.raises(DataError, match="not on the seen body"):
        axis.mean_curvature(52.0, 5.5)


def test_sizes_that_cannot_be_are_refused(tmp_path):
    with pytest.raises(DataError, match="tube of 0 cm"):
        DetectionRequest(diameter_cm=0.0)
    with pytest.raises(DataError, match="radius above 0"):
        DetectionRequest(obstacle_radius_cm=(-1.0, -2.0))
    with pytest.raises(CameraError, match="cannot write"):
        overhead_camera().save(tmp_path / "none" / "camera.json")


def test_sources_say_what_is_wrong(tmp_path):
    with pytest.raises(PictureError, match="does not exist"):
        open_source(tmp_path / "none.png")
    with pytest.raises(PictureError, match="holds no pictures"):
        open_source(tmp_path)
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(PictureError, match="not a readable picture"):
        open_source(tmp_path).read()
    (tmp_path / "b.avi").write_bytes(b"no video")
    with pytest.raises(PictureError, match="cannot be opened"):
        open_source(tmp_path / "b.avi")
