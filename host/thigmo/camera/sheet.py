"""The marker sheet: its printed pages, and the places of the cards in the workspace.

One A4 PDF (or PNGs) at true scale: workspace cards of four ArUco markers each, tip markers, and a
ChArUco board that is held before the lens to calibrate it. The cards are laid around the workspace
at measured places; `Sheet` records those places and is saved beside the camera's calibration. The
same drawing is printed and pasted into rendered pictures, so tests see what a lab sees.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import Field, model_validator

from thigmo.camera.exceptions import CameraError
from thigmo.files import whole_file
from thigmo.toml_model import Finite, Model, Positive, load_toml

Gray = NDArray[np.uint8]
Points = NDArray[np.float64]

DICTIONARY = "DICT_4X4_50"
BOARD_DICTIONARY = "DICT_5X5_50"
TIP_MARKER = 40
A4_CM = (21.0, 29.7)
PX_CM = 40  # resolution of the printed pages


class Card(Model):
    """One workspace card: four markers around a printed cross, which is its reference point."""

    name: str
    first_id: Annotated[int, Field(ge=0)]
    x_cm: Finite
    y_cm: Finite
    turn_deg: Finite = 0.0  # direction of the card's arrow from the x axis, counter-clockwise
    # Height above the table. A card on a box determines the camera's height; a plane alone hardly
    # does.
    z_cm: Annotated[Finite, Field(ge=0, le=40)] = 0.0


_LENGTH_CM = 53.0  # length of the robot that these cards are for
# Multiple of that length at which the usual tip marker is detected; enlargement that fits a page.
_MARKER_SEEN, _MARKER_LARGEST = 2.3, 1.8
_CARDS = [
    Card(name="base left", first_id=0, x_cm=0.0, y_cm=44.0),
    Card(name="base right", first_id=4, x_cm=0.0, y_cm=-44.0),
    Card(name="tip left", first_id=8, x_cm=54.0, y_cm=44.0),
    Card(name="tip right", first_id=12, x_cm=54.0, y_cm=-44.0),
]


class Sheet(Model):
    """Everything that is printed, and where the cards lie in the workspace (cm, robot's frame)."""

    version: Literal[1] = 1
    dictionary: str = DICTIONARY  # of the markers, as OpenCV names it; APRILTAG ones too
    cards: list[Card] = Field(default=_CARDS, min_length=3, max_length=10)
    marker_cm: Positive = 4.4
    marker_offset_cm: Positive = 3.1  # marker centres from the cross, in both directions
    placement_se_cm: Positive = 0.05  # how well the crosses' places are known (tape measure)
    tip_marker_cm: Positive = 2.4
    tip_marker_id: Annotated[int, Field(ge=0)] = TIP_MARKER
    # Arc from the tip marker's centre to the robot's very tip.
    tip_offset_cm: Finite = 2.0
    board_square_cm: Positive = 2.5
    board_columns: Annotated[int, Field(ge=4, le=12)] = 7
    board_rows: Annotated[int, Field(ge=4, le=16)] = 10
    # Height of the lens above the table by tape measure. Give it if there is neither a lens board
    # nor a card on a box: a plane seen from above hardly separates focal length from distance.
    camera_height_cm: Positive | None = None
    camera_height_se_cm: Positive = 1.0
    # Printed length of the 10 cm bar over 10 cm: printers shrink pages.
    print_scale: Annotated[float, Field(gt=0.5, lt=1.5)] = 1.0

    @model_validator(mode="after")
    def _markers_exist(self) -> Sheet:
        names = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
        if self.dictionary not in names:
            raise ValueError(f"dictionary: no {self.dictionary!r}; one of {', '.join(names)}")
        ids = [card.first_id + k for card in self.cards for k in range(4)] + [self.tip_marker_id]
        if len(set(ids)) < len(ids):
            raise ValueError("two cards, or a card and the tip, share a marker's id")
        count = len(dictionary(self.dictionary).bytesList)
        if max(ids) >= count:
            raise ValueError(f"{self.dictionary} has {count} markers, and no id {max(ids)}")
        return self

    @classmethod
    def of_length(cls, length_cm: float) -> Sheet:
        """The sheet for a robot of this length, with cards around the area that it can reach.

        A camera that sees all of a long robot has few pixels for the tip marker, so this is larger.
        """
        share = length_cm / _LENGTH_CM
        larger = min(max(share / _MARKER_SEEN, 1.0), _MARKER_LARGEST)
        laid = [
            card.model_copy(update={"x_cm": round(card.x_cm * share, 1),
                                    "y_cm": round(card.y_cm * share, 1)})
            for card in _CARDS
        ]  # fmt: skip
        return cls(
            cards=laid, tip_marker_cm=round(2.4 * larger, 1), tip_offset_cm=round(2.0 * larger, 1)
        )

    @property
    def length_cm(self) -> float:
        """Length of the robot that the cards are laid for."""
        return max(card.x_cm for card in self.cards) * _LENGTH_CM / _CARDS[-1].x_cm

    @property
    def tip_hides_cm(self) -> float:
        """How much of the body's end the tip's marker covers, with its margin."""
        return self.tip_offset_cm + self.tip_marker_cm * (0.5 + 1 / self.modules)

    @property
    def modules(self) -> int:
        """Cells along a marker's side, its black border included."""
        return int(dictionary(self.dictionary).markerSize) + 2

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Sheet:
        """Read a sheet file (TOML); raises ConfigError if it is missing, malformed or invalid."""
        return load_toml(cls, path)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the sheet file (TOML)."""
        self.write(path)

    @property
    def card_cm(self) -> float:
        """Side of a cut-out card as printed."""
        return (2 * self.marker_offset_cm + self.marker_cm + 1.4) * self.print_scale

    def marker_ids(self) -> dict[int, Card]:
        """Card of each workspace marker."""
        return {card.first_id + k: card for card in self.cards for k in range(4)}

    def local_corners(self, k: int) -> Points:
        """Corners (4, 2) of a card's k-th marker, cm from its cross, in the card's frame.

        Marker 0 is upper left (-u, +v), then 1 upper right, 2 lower left, 3 lower right; corners
        run upper left, upper right, lower right, lower left, as OpenCV reports them.
        """
        u = self.marker_offset_cm * (1 if k % 2 else -1)
        v = self.marker_offset_cm * (-1 if k >= 2 else 1)
        return (np.array([u, v]) + _square(self.marker_cm)) * self.print_scale


def _square(side: float) -> Points:
    half = side / 2
    return np.array([[-half, half], [half, half], [half, -half], [-half, -half]])


def place(points: Points, card: Card) -> Points:
    """Card coordinates (n, 2) to the robot's frame."""
    turn = np.radians(card.turn_deg)
    turned = _turned(points, np.cos(turn), np.sin(turn))
    return np.asarray(turned + np.array([card.x_cm, card.y_cm]))


def _turned(points: Points, cosine: float, sine: float) -> Points:
    """Points (n, 2) turned counter-clockwise."""
    return np.asarray(points @ np.array([[cosine, sine], [-sine, cosine]]))


def dictionary(name: str) -> Any:
    """OpenCV's predefined ArUco dictionary of this name."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def board(sheet: Sheet) -> Any:
    """The ChArUco board (cv2.aruco.CharucoBoard) in cm."""
    square = sheet.board_square_cm * sheet.print_scale
    squares = (sheet.board_columns, sheet.board_rows)
    return cv2.aruco.CharucoBoard(squares, square, square * 0.72, dictionary(BOARD_DICTIONARY))


@dataclass(frozen=True)
class Decal:
    """A printed patch as it lies in the workspace: picture and its corners."""

    image: Gray  # rows from the top
    corners_cm: Points  # (4, 3) upper left, upper right, lower right, lower left; cm, z up


def _marker_image(sheet: Sheet, marker: int, size: int) -> Gray:
    """A marker's picture (size, size) with black border, without the white margin."""
    size_px = sheet.modules * 8  # whole pixels a cell, so that all cells are of one size
    marker_picture = cv2.aruco.generateImageMarker(dictionary(sheet.dictionary), marker, size_px)
    return np.asarray(
        cv2.resize(marker_picture, (size, size), interpolation=cv2.INTER_NEAREST), np.uint8
    )


def card_image(sheet: Sheet, card: Card) -> Gray:
    """A card as printed (before the printer's scale): markers, cross, arrow."""
    side_cm = sheet.card_cm / sheet.print_scale
    n = round(side_cm * PX_CM)
    picture = np.full((n, n), 255, np.uint8)
    size = round(sheet.marker_cm * PX_CM)
    for k in range(4):
        left, top = sheet.local_corners(k)[0] / sheet.print_scale
        column, row = round((left + side_cm / 2) * PX_CM), round((side_cm / 2 - top) * PX_CM)
        marker = _marker_image(sheet, card.first_id + k, size)
        picture[row : row + size, column : column + size] = marker
    middle, arm = n // 2, round(0.7 * PX_CM)
    line = PX_CM // 20
    cv2.line(picture, (middle - arm, middle), (middle + arm, middle), 0, line)
    cv2.line(picture, (middle, middle - arm), (middle, middle + arm), 0, line)
    tail, head = (middle + round(cm * PX_CM) for cm in (0.9, 2.2))
    cv2.arrowedLine(picture, (tail, middle), (head, middle), 0, line, tipLength=0.3)
    return picture


def tip_image(sheet: Sheet) -> Gray:
    """The tip marker with its white margin of one module."""
    size = round(sheet.tip_marker_cm * PX_CM)
    marker = _marker_image(sheet, sheet.tip_marker_id, size)
    return np.pad(marker, round(size / sheet.modules), constant_values=255)


def _decal(image: Gray, flat: Points, height_cm: float) -> Decal:
    return Decal(image, np.column_stack([flat, np.full(4, height_cm)]))


def card_decals(sheet: Sheet) -> list[Decal]:
    """The workspace cards as they lie on the table."""
    outline = _square(sheet.card_cm)
    return [_decal(card_image(sheet, c), place(outline, c), c.z_cm) for c in sheet.cards]


def tip_decal(sheet: Sheet, x_cm: Points, y_cm: Points, height_cm: float) -> Decal:
    """The tip marker on a robot whose axis is x_cm, y_cm (n,), base to tip, at a height."""
    side = sheet.tip_marker_cm * (1 + 2 / sheet.modules) * sheet.print_scale
    axis = np.column_stack([x_cm, y_cm])
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(axis, axis=0), axis=1)))
    marker_arc = arc[-1] - sheet.tip_offset_cm
    piece = min(max(int(np.searchsorted(arc, marker_arc)), 1), len(axis) - 1)
    ahead = axis[piece] - axis[piece - 1]
    ahead /= np.linalg.norm(ahead)
    center = axis[piece] - (arc[piece] - marker_arc) * ahead
    return _decal(tip_image(sheet), _turned(_square(side), ahead[0], ahead[1]) + center, height_cm)


def _text(onto: Gray, text: str, column: int, row: int, size: float) -> None:
    cv2.putText(onto, text, (column, row), cv2.FONT_HERSHEY_SIMPLEX, size, 0, 1)


def pages(sheet: Sheet) -> list[Gray]:
    """A4 pages as pictures: two cards a page, tip markers, the lens board."""
    width, height = (round(side * PX_CM) for side in A4_CM)
    pages: list[Gray] = []

    def page(title: str) -> Gray:
        picture = np.full((height, width), 255, np.uint8)
        _text(picture, title, PX_CM * 3 // 2, PX_CM * 3 // 2, PX_CM / 55)
        left, row = (width - 10 * PX_CM) // 2, height - PX_CM * 3 // 2
        right = left + 10 * PX_CM
        cv2.line(picture, (left, row), (right, row), 0)
        for column in (left, right):
            cv2.line(picture, (column, row - 12), (column, row + 12), 0)
        note = "10.0 cm: measure this bar; print at 100 %, not 'fit to page'"
        _text(picture, note, left - PX_CM, row + PX_CM * 3 // 4, 0.8 * PX_CM / 55)
        pages.append(picture)
        return picture

    def paste(onto: Gray, picture: Gray, column: int, row: int, frame: bool = True) -> None:
        rows, columns = picture.shape
        onto[row : row + rows, column : column + columns] = picture
        if frame:
            cv2.rectangle(onto, (column, row), (column + columns, row + rows), 180, 1)

    for start in range(0, len(sheet.cards), 2):
        two = sheet.cards[start : start + 2]
        onto = page("thigmo workspace cards: " + ", ".join(card.name for card in two))
        for slot, card in enumerate(two):
            card_picture = card_image(sheet, card)
            row = round((2.2 + slot * (sheet.card_cm + 0.8)) * PX_CM)
            if row + card_picture.shape[0] > height - 2 * PX_CM:
                raise CameraError(
                    "two cards do not fit a page", "choose a smaller marker_cm in the sheet file"
                )
            paste(onto, card_picture, (width - card_picture.shape[1]) // 2, row)
            where = f"{card.name}: cross at x {card.x_cm:g}, y {card.y_cm:g} cm"
            _text(onto, where, PX_CM, row - PX_CM // 5, PX_CM / 70)
    onto = page("thigmo tip markers: glue one on the tip, arrow side ahead (spares)")
    for k in range(6):
        column, row = (round((start + n * 6.0) * PX_CM) for start, n in ((2, k % 3), (3, k // 3)))
        paste(onto, tip_image(sheet), column, row)
    onto = page("thigmo lens board: glue on something flat, show it in 10 poses")
    squares = (sheet.board_columns, sheet.board_rows)
    size = tuple(round(n * sheet.board_square_cm * PX_CM) for n in squares)
    unscaled = board(sheet.model_copy(update={"print_scale": 1.0}))
    drawn = np.asarray(unscaled.generateImage(size, marginSize=0, borderBits=1), np.uint8)
    if size[0] > width or size[1] > height - 4 * PX_CM:
        raise CameraError("the lens board does not fit a page", "choose a smaller board_square_cm")
    paste(onto, drawn, (width - size[0]) // 2, 2 * PX_CM, frame=False)
    return pages


def print_sheet(sheet: Sheet, path: str | os.PathLike[str]) -> list[Path]:
    """Write the pages at true scale: one PDF, or one PNG a page (`name-1.png` ...) with its dpi.

    Raises:
        CameraError: another suffix, or a folder that cannot be written.
    """
    target = Path(path)
    if target.suffix not in (".pdf", ".png"):
        raise CameraError(f"cannot print to {target.name}", "end the name in .pdf or .png")
    figures, (width, height) = [], A4_CM
    for picture in pages(sheet):
        figures.append(Figure(figsize=(width / 2.54, height / 2.54), dpi=PX_CM * 2.54))
        figures[-1].figimage(picture, cmap="gray", vmin=0, vmax=255)
    names = [target]
    with CameraError.from_os(f"cannot write {target}", "choose a folder that you may write to"):
        if target.suffix == ".pdf":
            with whole_file(target) as file, PdfPages(file) as book:
                for figure in figures:
                    book.savefig(figure)
        else:
            names = [target.with_name(f"{target.stem}-{n + 1}.png") for n in range(len(figures))]
            for name, figure in zip(names, figures, strict=True):
                with whole_file(name) as file:
                    figure.savefig(file, format="png")
    return names
