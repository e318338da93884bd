"""The printed sheet: true to scale, and decoded by the detector that will look at it."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo.camera import CameraError, Sheet, print_sheet
from thigmo.camera.model import detect_markers
from thigmo.camera.sheet import card_image, pages, place, tip_image
from thigmo.errors import ConfigError


def test_a_cards_markers_are_where_the_sheet_says():
    sheet = Sheet()
    card = sheet.cards[2]
    picture = card_image(sheet, card)
    markers = detect_markers(picture, "DICT_4X4_50")
    assert sorted(markers) == [8, 9, 10, 11]
    middle = picture.shape[0] / 2
    for k in range(4):
        expected = sheet.local_corners(k) * [40, -40] + middle
        assert markers[8 + k] == pytest.approx(expected, abs=1.0)


def test_turned_and_shrunk_cards_move_their_corners():
    sheet = Sheet()
    sheet.print_scale = 0.95
    sheet.cards[0].turn_deg = 90
    corners = place(
        sheet.local_corners(0), sheet.cards[0]
    )  # upper left of a card that is turned to the left
    assert corners.mean(axis=0) == pytest.approx(
        [sheet.cards[0].x_cm - 3.1 * 0.95, sheet.cards[0].y_cm - 3.1 * 0.95]
    )
    assert np.linalg.norm(corners[0] - corners[1]) == pytest.approx(4.4 * 0.95)


def test_pages_hold_every_marker_and_the_scale_bar():
    sheet = Sheet()
    made = pages(sheet)
    assert [picture.shape for picture in made] == [(1188, 840)] * 4
    ids = set()
    for picture in made[:2]:
        ids |= set(detect_markers(picture, "DICT_4X4_50"))
    assert ids == set(range(16))
    bar = made[0][1188 - 60]
    dark = np.flatnonzero(bar < 128)
    assert dark[-1] - dark[0] == pytest.approx(400, abs=2)


def test_tip_marker_reads():
    assert list(detect_markers(tip_image(Sheet()), "DICT_4X4_50")) == [40]


def test_pdf_has_true_a4_pages_and_png_its_resolution(tmp_path):
    (pdf,) = print_sheet(Sheet(), tmp_path / "sheet.pdf")
    data = pdf.read_bytes()
    assert data.count(b"/MediaBox [ 0 0 595.27") == 4  # A4 in points
    first = print_sheet(Sheet(), tmp_path / "sheet.png")[0]
    assert first.name == "sheet-1.png"
    with pytest.raises(CameraError, match="end the name"):
        print_sheet(Sheet(), tmp_path / "sheet.bmp")
    with pytest.raises(CameraError, match="choose a folder"):
        print_sheet(Sheet(), tmp_path / "none" / "sheet.pdf")


def test_sheet_file_round_trip_and_slips(tmp_path):
    sheet = Sheet(camera_height_cm=101.0)
    sheet.save(tmp_path / "sheet.toml")
    assert Sheet.load(tmp_path / "sheet.toml") == sheet
    (tmp_path / "bad.toml").write_text("marker_mm = 4\n")
    with pytest.raises(ConfigError, match="marker_mm"):
        Sheet.load(tmp_path / "bad.toml")
