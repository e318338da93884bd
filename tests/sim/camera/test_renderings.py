"""From rendered pictures to numbers: the whole path from pixels, against truth."""

from __future__ import annotations

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from thigmo.camera import (
    AxisDoubtfulError,
    BodyNotSeenError,
    CameraError,
    CameraMovedError,
    DetectionRequest,
    MarkerAstrayError,
    MarkerMissingError,
    Sheet,
    SheetHiddenError,
    TooCoarseError,
    detect,
    draw,
    locate,
    open_source,
)
from thigmo.camera.pose import GOOD_CM
from thigmo.camera.sheet import card_decals, tip_decal
from thigmo.emulator.render import BodyShape, Look, PegShape, View, overhead_camera, render
from thigmo.errors import ConfigError
from thigmo_bench.studies.camera import axis_of, board_lens, glimpse, summarise

pytestmark = pytest.mark.ci

SHEET = Sheet(camera_height_cm=105.0)


class Room:
    """One room whose parts can be left out."""

    def __init__(self, curvature: float = 0.02) -> None:
        self.camera = overhead_camera(None)
        self.s, self.heading, self.x, self.y = axis_of(np.full(400, curvature), 53.0)
        self.pegs = [PegShape(30.0, -8.0, 1.0), PegShape(20.0, 14.0, 1.4)]

    def picture(self, *, cards=(0, 1, 2, 3), tip=True, body=True, camera=None):
        patches = [d for n, d in enumerate(card_decals(SHEET)) if n in cards]
        if tip:
            patches.append(tip_decal(SHEET, self.x, self.y, 3.5))
        shape = BodyShape(self.x, self.y) if body else None
        return render(
            camera or self.camera, View(shape, self.pegs, patches), Look(),
            np.random.default_rng(5),
        )  # fmt: skip


@pytest.fixture(scope="module")
def room() -> Room:
    return Room()


@pytest.fixture(scope="module")
def picture(room):
    return room.picture()


@pytest.fixture(scope="module")
def model(picture):
    return locate(picture, SHEET)


def test_random_rooms_are_seen_within_three_millimetres(many):
    summary = summarise([glimpse(seed) for seed in range(1000, 1000 + many(3))])
    assert summary["place_worst_cm"] < 0.3
    assert summary["tip_p95_cm"] < 0.3
    assert summary["tip_missed"] == 0
    assert summary["axis_end_p95_cm"] < 0.3
    assert summary["peg_p95_cm"] < 0.3
    assert summary["peg_missed"] <= 0.13
    assert summary["free_bend_chi"] < 2.5
    assert summary["span_chi"] < 1.6


@pytest.mark.ci
def test_cards_alone_suffice_for_three_millimetres_and_a_box_makes_them_sure():
    alone = [glimpse(seed, "cards only") for seed in range(1000, 1006)]
    boxed = [glimpse(seed, "a card on a box") for seed in range(1000, 1006)]
    assert summarise(alone)["place_p95_cm"] < 0.3
    assert summarise(boxed)["place_p95_cm"] < 0.2
    # Alone they cannot know it where the camera looks straight down, and say so.
    assert max(g.accuracy_cm for g in alone) > GOOD_CM
    assert max(g.accuracy_cm for g in boxed) < GOOD_CM
    assert summarise(alone)["place_chi"] < 2
    assert summarise(boxed)["place_chi"] < 2


@pytest.mark.ci
def test_lens_board_gives_the_lens():
    lens = board_lens(poses=7)
    true = overhead_camera(None)
    assert lens.rms_px < 0.3
    assert lens.matrix[0, 0] == pytest.approx(true.lens.matrix[0, 0], rel=0.005)
    assert lens.distortion[0] == pytest.approx(true.lens.distortion[0], abs=0.01)
    assert glimpse(3, "lens board", lens).place_cm < 0.3


@pytest.mark.parametrize("diameter_cm", [1.0, 1.2, 2.0])
def test_a_tube_thinner_than_its_marker_is_followed_to_its_tip(room, model, diameter_cm):
    marked = [*card_decals(SHEET), tip_decal(SHEET, room.x, room.y, diameter_cm)]
    view = View(BodyShape(room.x, room.y, diameter_cm / 2), [], marked)
    picture = render(room.camera, view, Look(), np.random.default_rng(5))
    bend, shape = (
        detect(picture, model, SHEET, DetectionRequest(diameter_cm, constant=constant))
        for constant in (True, False)
    )
    assert bend.problems == shape.problems == ()
    assert bend.axis.length_cm == pytest.approx(53.0, abs=0.3)
    assert shape.axis.length_cm == pytest.approx(53.0, abs=0.3)
    assert bend.axis.coefficients[2] == pytest.approx(0.02, abs=1e-4)


def test_marker_that_fell_off_the_tip_is_not_taken_for_it(room, model):
    for dx, dy in ((-10.0, -9.0), (0.0, 6.0), (5.0, 8.0)):
        fallen = tip_decal(SHEET, room.x + dx, room.y + dy, 3.5)
        view = View(BodyShape(room.x, room.y), room.pegs, [*card_decals(SHEET), fallen])
        picture = render(room.camera, view, Look(), np.random.default_rng(5))
        detection = detect(picture, model, SHEET, DetectionRequest(constant=True))
        assert detection.tip is None
        assert detection.axis is None
        (problem,) = detection.problems
        assert isinstance(problem, MarkerAstrayError)
        away_cm = float(re.search(r"lies ([\d.]+) cm", str(problem))[1])
        assert away_cm == pytest.approx(np.hypot(dx, dy), abs=1.0)
        assert "stick it back" in str(problem)


def test_tip_axis_and_dowels_of_one_room(room, picture, model):
    detection = detect(picture, model, SHEET, DetectionRequest(constant=True))
    assert detection.problems == ()
    assert (detection.tip.x_cm, detection.tip.y_cm) == pytest.approx(
        (room.x[-1], room.y[-1]), abs=0.1
    )
    assert detection.axis.coefficients[2] == pytest.approx(0.02, abs=1e-4)
    for peg in room.pegs:
        nearest = min(
            detection.obstacles, key=lambda o: np.hypot(o.x_cm - peg.x_cm, o.y_cm - peg.y_cm)
        )
        assert (nearest.x_cm, nearest.y_cm) == pytest.approx((peg.x_cm, peg.y_cm), abs=0.15)
        assert nearest.radius_cm == pytest.approx(peg.radius_cm, abs=0.15)


def test_what_is_seen_is_drawn(picture, model):
    wanted = DetectionRequest()
    detection = detect(picture, model, SHEET, wanted)
    drawn = draw(picture, model, SHEET, detection, wanted)
    changed = (np.abs(drawn.astype(int) - picture).max(axis=2) > 40).mean()
    assert 0.005 < changed < 0.1
    axis = model.project(np.array([[detection.axis.x_cm[200], detection.axis.y_cm[200], 1.75]]))[0]
    column, row = np.round(axis).astype(int)
    patch = drawn[row - 2 : row + 3, column - 2 : column + 3].reshape(-1, 3)
    assert (np.abs(patch.astype(int) - [255, 255, 0]).max(axis=1) < 60).any()


def test_missing_tip_marker_is_a_problem_with_a_way_out(room, model):
    bare = room.picture(tip=False)
    detection = detect(bare, model, SHEET)
    assert isinstance(detection.problems[0], MarkerMissingError)
    assert str(detection.problems[0]).endswith("turn it face up and clear the view")
    # The body's own end is found without any marker.
    assert detection.axis.tip_cm == pytest.approx((room.x[-1], room.y[-1]), abs=0.3)


def test_no_robot_is_said(room, model):
    detection = detect(room.picture(tip=False, body=False), model, SHEET)
    assert detection.axis is None
    assert any(isinstance(p, BodyNotSeenError) for p in detection.problems)


def test_body_of_the_tables_colour_needs_a_background_picture(room, model):
    dull = replace(Look(), clutter=0)
    patches = card_decals(SHEET)
    shape = BodyShape(room.x, room.y, color=(235.0, 240.0, 243.0))

    def shot(body):
        return render(room.camera, View(body, (), patches), dull, np.random.default_rng(6))

    dark = detect(shot(shape), model, SHEET, DetectionRequest(constant=True, tip=False))
    helped = detect(
        shot(shape), model, SHEET, DetectionRequest(constant=True, tip=False), background=shot(None)
    )
    assert helped.axis is not None
    assert helped.axis.coefficients[2] == pytest.approx(0.02, abs=5e-4)
    if dark.axis is None:
        assert "cloth of another colour" in str(dark.problems[-1])


def test_moved_camera_is_detected_and_hidden_cards_named(room, model):
    shoved = replace(room.camera, translation=room.camera.translation + np.array([1.0, 0, 0]))
    with pytest.raises(CameraMovedError, match="locate` again"):
        detect(room.picture(camera=shoved), model, SHEET)
    assert detect(room.picture(cards=(0, 2, 3)), model, SHEET).hidden == ("base right",)
    with pytest.raises(SheetHiddenError, match="tip left"):
        locate(room.picture(cards=(0, 1)), SHEET)
    partly = locate(room.picture(cards=(0, 1, 3)), SHEET)
    assert partly.hidden == ("tip left",)


def test_a_picture_of_another_size_is_refused(picture, model):
    small = cv2.resize(picture, (1280, 720))
    with pytest.raises(CameraError, match="1280 x 720 px"):
        detect(small, model, SHEET)
    with pytest.raises(CameraError, match="of one size"):
        locate(small, SHEET, model.lens)


def test_a_picture_of_too_few_pixels_is_refused_with_the_number_needed(picture):
    for share, fine in ((0.34, True), (0.3, False)):
        small = cv2.resize(picture, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
        model = locate(small, SHEET)
        if fine:
            detection = detect(
                small, model, SHEET, DetectionRequest(constant=True, obstacles=False)
            )
            assert detection.problems == ()
            continue
        with pytest.raises(TooCoarseError, match=r"4\.6 px per cm, and a tip .* needs 5\.0; "):
            detect(small, model, SHEET)


def test_a_body_of_which_a_part_is_not_seen_is_doubted(room, model):
    """As of a transparent tube."""
    part = BodyShape(room.x[:230], room.y[:230])
    view = View(part, (), card_decals(SHEET))
    picture = render(room.camera, view, Look(), np.random.default_rng(5))
    wanted = DetectionRequest(constant=True, tip=False, obstacles=False, length_cm=53.0)
    (problem,) = detect(picture, model, SHEET, wanted).problems
    assert isinstance(problem, AxisDoubtfulError)
    assert re.search(r"is 30\.\d cm long, and the body is 53\.0 cm", str(problem))
    whole = detect(room.picture(tip=False), model, SHEET, wanted)
    assert whole.problems == ()


@pytest.mark.parametrize("turn", [0.7, 1.2])
def test_a_kinked_body_is_doubted(room, model, turn):
    """A smooth axis cannot follow it, and its tip would be off by centimetres."""
    s = np.linspace(0, 53, 400)
    heading = np.where(s < 25, 0.0, turn)
    step = s[1]
    kinked = BodyShape(np.cumsum(np.cos(heading)) * step, np.cumsum(np.sin(heading)) * step)
    picture = render(
        room.camera, View(kinked, (), card_decals(SHEET)), Look(), np.random.default_rng(5)
    )
    detection = detect(
        picture, model, SHEET, DetectionRequest(constant=True, tip=False, obstacles=False)
    )
    assert any(isinstance(problem, AxisDoubtfulError) for problem in detection.problems)


def test_an_axis_whose_flanks_are_hidden_is_doubted(room, model):
    # Things as wide as the robot's surroundings, of its own colour, lie along it.
    heap = [PegShape(x, side * 4.2, 2.4, color=BodyShape.color) for x in range(8, 50, 4)
            for side in (-1, 1)]  # fmt: skip
    straight = BodyShape(np.linspace(0, 53, 400), np.zeros(400))
    picture = render(
        room.camera, View(straight, heap, card_decals(SHEET)), Look(), np.random.default_rng(5)
    )
    detection = detect(
        picture, model, SHEET, DetectionRequest(constant=True, tip=False, obstacles=False)
    )
    assert detection.axis is None or any(
        isinstance(p, AxisDoubtfulError) for p in detection.problems
    )


@pytest.mark.parametrize("name", ["DICT_6X6_250", "DICT_APRILTAG_36h11"])
def test_markers_may_be_of_any_dictionary(room, name):
    sheet = SHEET.model_copy(update={"dictionary": name})
    patches = [*card_decals(sheet), tip_decal(sheet, room.x, room.y, 3.5)]
    view = View(BodyShape(room.x, room.y), (), patches)
    picture = render(room.camera, view, Look(), np.random.default_rng(5))
    detection = detect(picture, locate(picture, sheet), sheet, DetectionRequest(constant=True))
    assert (detection.tip.x_cm, detection.tip.y_cm) == pytest.approx(
        (room.x[-1], room.y[-1]), abs=0.1
    )
    said = "DICT_6X6_1000" if "6X6" in name else name
    with pytest.raises(SheetHiddenError, match=f'write dictionary = "{said}"'):
        locate(picture, SHEET)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('dictionary = "DICT_3X3"', "no 'DICT_3X3'; one of DICT_4X4_100"),
        ("tip_marker_id = 60", "no id 60"),
        ("tip_marker_id = 3", "share a marker's id"),
    ],
)
def test_a_sheet_of_markers_that_do_not_exist_is_refused(tmp_path, text, named):
    (tmp_path / "sheet.toml").write_text(text)
    with pytest.raises(ConfigError, match=named):
        Sheet.load(tmp_path / "sheet.toml")


def test_pictures_come_from_stills_and_videos(tmp_path, picture):
    cv2.imwrite(str(tmp_path / "1.png"), picture)
    assert open_source(tmp_path).read().shape == (1080, 1920, 3)
    path = str(tmp_path / "film.avi")
    film = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 10, (1920, 1080))
    for _ in range(3):
        film.write(picture)
    film.release()
    source = open_source(path)
    first = source.read()
    source.close()
    assert np.abs(first.astype(int) - picture).mean() < 12
    assert locate(first, SHEET).accuracy_cm < 0.2
