"""The map for planners: what a run's document becomes, read back by independent readers."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from math import pi
from pathlib import Path

import numpy as np
import pytest
import yaml
from contacts import CONTACT
from PIL import Image

from thigmo.config import RobotConfig
from thigmo.errors import RunFolderError
from thigmo.exploration.obstacles import SIGMAS, export_obstacles, occupancy
from thigmo.exploration.prior import KnownPlaces, match, read_prior, within_reach
from thigmo.exploration.scoring import judged
from thigmo.exploration.workspace import Bend, centreline, place_contact, ramp_knots
from thigmo.record import (
    Ellipse,
    MapContact,
    Obstacle,
    OccupancyGrid,
    RunDocument,
    RunFolder,
    Shape,
    Stage,
    TrueContact,
    TruePeg,
    Truth,
    read_obstacles,
    read_ros_map,
    write_ros_map,
)
from thigmo.record.occupancy import OCCUPIED as OCCUPIED_CELL

CONFIG = RobotConfig()
RADIUS = CONFIG.body.radius_cm
FREE, UNKNOWN, OCCUPIED = 254, 205, 0  # map_saver's grey values


def _contact(arc: float = 40.0, length: float = 50.0, width: float = 3.0) -> MapContact:
    """A peg on the left of a robot that bends to the left with 0.02 1/cm."""
    bend = Bend(length, 0.02, ramp_knots([(arc, -2e-4)]), curvature_se=5e-4)
    placed = place_contact(bend, arc, -2e-4, (arc - width, arc + width), radius_cm=RADIUS)
    return replace(
        CONTACT,
        arc_cm=arc,
        x_cm=placed.x_cm,
        y_cm=placed.y_cm,
        force_per_cm2=-2e-4,
        interval_cm=(arc - width, arc + width),
        everted_length_cm=length,
        normal_rad=placed.normal_rad,
        covariance_cm2=placed.covariance_cm2,
        track=placed.track,
    )


def _document(
    *contacts: MapContact, top: float = 0.015, curvature_se: float | None = 3e-4
) -> RunDocument:
    """One stage, 50 cm long, swept to both sides."""
    shapes = [
        Shape(side, 10 * share, centreline(Bend(50.0, sign * top * share)).poses(1.0), curvature_se)
        for side, sign in (("left", 1.0), ("right", -1.0))
        for share in (0.25, 0.5, 0.75, 1.0)
    ]
    stage = Stage(50.0, 0.49, 1.0, shapes, [], {"left": 0.006, "right": 0.001})
    return RunDocument("0", "n", "u", "s", "full length", None, list(contacts), [stage])


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return RunFolder.create(tmp_path, "room", datetime(2024, 5, 17))


def _grey(folder: RunFolder, x: float, y: float) -> int:
    """Pixel under a point (cm), by map_server's convention, with a reader that is not ours."""
    described = yaml.safe_load((folder.path / "map.yaml").read_text())
    picture = np.array(Image.open(folder.path / described["image"]))
    low_x, low_y, _ = described["origin"]
    column = int((x / 100 - low_x) / described["resolution"])
    row = picture.shape[0] - 1 - int((y / 100 - low_y) / described["resolution"])
    return int(picture[row, column])


def test_the_grid_is_what_map_server_reads(folder: RunFolder) -> None:
    contact = _contact()
    export_obstacles(folder, _document(contact), radius_cm=RADIUS)
    described = yaml.safe_load((folder.path / "map.yaml").read_text())
    assert described["negate"] == 0
    picture = Image.open(folder.path / described["image"])
    assert picture.format == "PPM"
    assert picture.mode == "L"
    data = (folder.path / "map.pgm").read_bytes()
    assert data.startswith(b"P5\n%d %d\n255\n" % picture.size)
    # Occupancy (255 - x) / 255 of the three greys, against the file's own thresholds.
    occupancy = {grey: (255 - grey) / 255 for grey in np.unique(np.array(picture)).tolist()}
    assert set(occupancy) == {FREE, UNKNOWN, OCCUPIED}
    assert occupancy[FREE] < described["free_thresh"] < occupancy[UNKNOWN]
    assert occupancy[UNKNOWN] < described["occupied_thresh"] < occupancy[OCCUPIED]


def test_rows_run_downwards_from_the_left_of_the_robot(folder: RunFolder) -> None:
    contact = _contact()
    assert contact.y_cm > 10  # on the left, so in the picture's upper half
    export_obstacles(folder, _document(contact), radius_cm=RADIUS)
    assert _grey(folder, contact.x_cm, contact.y_cm) == OCCUPIED
    assert _grey(folder, contact.x_cm, -contact.y_cm) != OCCUPIED
    assert _grey(folder, *contact.track[12]) == OCCUPIED
    for x, y in contact.track:  # the rest of the interval is not sure to hold it, and not free
        assert _grey(folder, x, y) in (OCCUPIED, UNKNOWN)
    assert _grey(folder, *contact.track[0]) == UNKNOWN


def test_what_was_swept_is_free_and_what_was_not_is_unknown(folder: RunFolder) -> None:
    export_obstacles(folder, _document(), radius_cm=RADIUS)
    swept = centreline(Bend(50.0, 0.0075))
    for arc in (5.0, 20.0, 35.0, 49.0):
        x, y, _ = swept.pose(arc)
        assert _grey(folder, x, y) == FREE
        assert _grey(folder, x, -y) == FREE
    for arc in (10.0, 30.0, 49.0):
        assert _grey(folder, arc, 0.0) == FREE
    beyond, side, _ = centreline(Bend(50.0, 0.025)).pose(49.0)
    assert _grey(folder, beyond, side) == UNKNOWN
    known = read_obstacles(folder.path / "obstacles.json")
    assert known.obstacles == []
    (area,) = known.free
    x, y = np.array(area.outline).T
    # The polygon holds what the grid does: area by the shoelace formula.
    shoelace = abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2
    grid = read_ros_map(folder.path / "map.yaml")
    cells = int((grid.cells == 0).sum()) * grid.resolution_cm**2
    assert shoelace == pytest.approx(cells, rel=0.1)


def _reach(curvature_se: float | None) -> float:
    """Largest y of a free cell near the tip of a body that swept to 0.015 1/cm."""
    document = _document(curvature_se=curvature_se)
    grid, _ = occupancy(document, RADIUS)
    x, y = grid.centers()
    tip, _, _ = centreline(Bend(50.0, 0.015)).pose(49.0)
    return float(y[(grid.cells == 0) & (np.abs(x - tip) < 1.0)].max(initial=-np.inf))


def test_free_space_ends_where_the_shapes_error_begins() -> None:
    sharp, blunt = _reach(1e-6), _reach(4e-4)
    # The tip is s^2/2 of the error aside; it moves along its own normal.
    heading = 0.015 * 50.0
    assert sharp - blunt == pytest.approx(SIGMAS * 4e-4 * 50**2 / 2 * np.cos(heading), abs=0.75)
    assert _reach(None) == -np.inf  # a shape of unknown error makes nothing free


def test_a_bend_within_its_error_makes_nothing_free() -> None:
    grid, _ = occupancy(_document(top=1e-3, curvature_se=8e-4), RADIUS)
    assert not (grid.cells == 0).any()


def test_near_a_contact_nothing_is_free() -> None:
    contact = _contact()
    grid, _ = occupancy(_document(contact, top=0.03), RADIUS)
    x, y = grid.centers()
    near = np.hypot(x - contact.x_cm, y - contact.y_cm) < 1.2
    assert near.any()
    assert (grid.cells[near] != 0).all()


def test_obstacles_json_says_all_of_a_contact(folder: RunFolder) -> None:
    contact = replace(_contact(), merged=[40.0])
    export_obstacles(folder, _document(contact), radius_cm=RADIUS)
    known = read_obstacles(folder.path / "obstacles.json")
    assert known.units["length"] == "cm"
    assert "base" in known.frame
    (obstacle,) = known.obstacles
    assert (obstacle.x_cm, obstacle.y_cm) == (contact.x_cm, contact.y_cm)
    assert obstacle.status == "localized"
    assert obstacle.body_side == "left"
    assert obstacle.normal_rad == pytest.approx(contact.normal_rad)
    assert obstacle.interval_cm == contact.interval_cm
    assert obstacle.felt_at_cm == [40.0, 50.0]
    assert obstacle.source == "felt"
    values = np.linalg.eigvalsh(np.asarray(contact.covariance_cm2))
    axes = (obstacle.ellipse_95.semi_minor_cm, obstacle.ellipse_95.semi_major_cm)
    assert axes == pytest.approx(tuple(2.4477 * np.sqrt(values)), rel=1e-3)


def test_an_ellipses_angle_is_that_of_its_long_axis() -> None:
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    covariance = turn @ np.diag([9.0, 1.0]) @ turn.T
    ellipse = Ellipse.of(
        ((covariance[0, 0], covariance[0, 1]), (covariance[1, 0], covariance[1, 1]))
    )
    assert ellipse.angle_rad % pi == pytest.approx(0.5)
    assert ellipse.semi_major_cm == pytest.approx(3 * ellipse.semi_minor_cm)


def test_a_run_that_knows_nothing_yet_exports_an_unknown_room(folder: RunFolder) -> None:
    export_obstacles(folder, RunDocument("0", "n", "u", "s"), radius_cm=RADIUS)
    assert (read_ros_map(folder.path / "map.yaml").cells == -1).all()
    assert read_obstacles(folder.path / "obstacles.json").free == []


def test_a_grid_is_read_with_its_orientation_and_yaw(tmp_path: Path) -> None:
    picture = np.full((3, 4), 254, np.uint8)
    picture[0, 3] = 0  # top right: high x, high y
    Image.fromarray(picture).save(tmp_path / "room.png")
    text = "image: room.png\nresolution: 0.1\norigin: [1.0, 2.0, 0.0]\nnegate: 0\n"
    text += "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "room.yaml").write_text(text)
    (obstacle,) = read_prior(tmp_path / "room.yaml")
    assert (obstacle.x_cm, obstacle.y_cm) == pytest.approx((135.0, 225.0))
    (tmp_path / "room.yaml").write_text(text.replace("0.0]", f"{pi / 2}]"))
    (turned,) = read_prior(tmp_path / "room.yaml")
    assert (turned.x_cm, turned.y_cm) == pytest.approx((100.0 - 25.0, 200.0 + 35.0))
    (tmp_path / "room.yaml").write_text(text.replace("negate: 0", "negate: 1"))
    (inverted,) = read_prior(tmp_path / "room.yaml")
    assert inverted.x_cm < 135.0  # now all the others are occupied


DESCRIBED = {"image": "room.pgm", "resolution": 0.05, "origin": [0.0, 0.0, 0.0]}


def _ros_map(folder: Path, picture: bytes, **described: object) -> Path:
    path = folder / "room.yaml"
    path.write_text(yaml.safe_dump(DESCRIBED | described))
    (folder / str((DESCRIBED | described)["image"])).write_bytes(picture)
    return path


@pytest.mark.parametrize(
    ("header", "pixels"),
    [
        pytest.param(b"P5\n3 1\n255\n", bytes([254, 205, 0]), id="as map_saver writes it"),
        pytest.param(b"P5\r\n3 1\r\n255\r\n", bytes([254, 205, 0]), id="Windows line ends"),
        pytest.param(b"P5 # a\n3 # b\n1 255 ", bytes([254, 205, 0]), id="comments"),
        pytest.param(b"P5\n3 1\n100\n", bytes([100, 80, 0]), id="white is 100"),
        pytest.param(b"P5\n3 1\n1000\n", np.array([1000, 800, 0], ">u2").tobytes(), id="16 bits"),
    ],
)
def test_a_pgm_is_read_by_its_own_rules(tmp_path: Path, header: bytes, pixels: bytes) -> None:
    grid = read_ros_map(_ros_map(tmp_path, header + pixels))
    assert grid.cells.tolist() == [[0, -1, 100]]


def test_a_line_feed_that_is_a_pixel_is_kept(tmp_path: Path) -> None:
    """The header ends with one white-space character, here a carriage return; then a dark pixel."""
    grid = read_ros_map(_ros_map(tmp_path, b"P5\n2 1\n255\r" + bytes([10, 254])))
    assert grid.cells.tolist() == [[100, 0]]


def test_raw_pixels_are_percent(tmp_path: Path) -> None:
    picture = b"P5\n5 1\n255\n" + bytes([0, 19, 50, 100, 255])
    grid = read_ros_map(_ros_map(tmp_path, picture, mode="raw"))
    assert grid.cells.tolist() == [[0, 0, -1, 100, -1]]


@pytest.mark.parametrize(("mode", "cells"), [("scale", [0, -1]), ("trinary", [0, 100])])
def test_transparent_pixels_are_unknown_in_mode_scale(
    tmp_path: Path, mode: str, cells: list[int]
) -> None:
    picture = np.array([[[255, 255], [0, 0]]], np.uint8)  # white and opaque, black and transparent
    Image.fromarray(picture, "LA").save(tmp_path / "room.png")
    bytes_of_it = (tmp_path / "room.png").read_bytes()
    grid = read_ros_map(_ros_map(tmp_path, bytes_of_it, image="room.png", mode=mode))
    assert grid.cells.tolist() == [cells]


def _walls(grid: str, resolution_cm: float, origin: tuple[float, float, float]) -> OccupancyGrid:
    rows = [[OCCUPIED_CELL if mark == "#" else 0 for mark in row] for row in grid.split()][::-1]
    return OccupancyGrid(np.array(rows, np.int8), resolution_cm, origin)


@pytest.mark.parametrize("yaw", [0.0, 0.4])
@pytest.mark.parametrize(
    "drawn",
    [
        pytest.param("#######\n#.....#\n#.....#\n#######", id="a closed room"),
        pytest.param("#......\n#......\n#......\n#######", id="an L"),
        pytest.param("#..\n.#.\n..#", id="a diagonal"),
    ],
)
def test_the_walls_of_a_map_are_occupied_as_drawn(tmp_path: Path, drawn: str, yaw: float) -> None:
    """Every point of the plane is occupied where the map's own cell is, and nowhere else."""
    given = _walls(drawn, 10.0, (20.0, 60.0, yaw))
    write_ros_map(given, tmp_path / "room.yaml")
    grid, _ = occupancy(_document(), RADIUS, read_prior(tmp_path / "room.yaml"))
    x, y = grid.centers()
    along = np.cos(yaw) * (x - 20.0) + np.sin(yaw) * (y - 60.0)
    up = np.cos(yaw) * (y - 60.0) - np.sin(yaw) * (x - 20.0)
    column, row = np.floor(along / 10.0).astype(int), np.floor(up / 10.0).astype(int)
    rows, columns = given.cells.shape
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    wall = np.zeros(grid.cells.shape, dtype=bool)
    wall[inside] = given.cells[row[inside], column[inside]] == OCCUPIED_CELL
    assert wall.any()
    assert ((grid.cells == OCCUPIED_CELL) == wall).all()


def test_what_the_robot_cannot_reach_of_a_map_is_left_out(tmp_path: Path) -> None:
    cells = np.zeros((300, 400), np.int8)
    cells[150, :] = cells[::7, 0] = OCCUPIED_CELL  # a wall through the base's place, specks far off
    write_ros_map(OccupancyGrid(cells, 5.0, (-1000.0, -752.5, 0.0)), tmp_path / "room.yaml")
    near = within_reach(read_prior(tmp_path / "room.yaml"), CONFIG.body)
    (wall,) = near
    assert 53.0 < np.abs(np.asarray(wall.track)).max() < 65.0
    assert within_reach(_known(_contact()), CONFIG.body) == _known(_contact())


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        (
            "m.yaml",
            "image: m.yaml\nresolution: 1\norigin: [0, 0, 0]\nmode: other",
            "'trinary', 'scale' or 'raw'",
        ),
        (
            "m.yaml",
            "image: m.yaml\nresolution: 1\norigin: [0, 0, 0]\nfree_thresh: 0.9",
            "free_thresh must not be above",
        ),
        ("m.json", "{", "m.json"),
        ("m.json", '{"name": "n"}', "started"),
        ("m.yaml", "image: [", "not valid YAML"),
        ("m.yaml", "resolution: 0.1", "image"),
        ("m.yaml", "image: no.pgm\nresolution: 0.1\norigin: [0, 0, 0]", "no.pgm"),
        ("m.yaml", "image: m.yaml\nresolution: 0.1\norigin: [0, 0, 0]", "is not a picture"),
        ("m.yaml", "image: m.yaml\nresolution: -1\norigin: [0, 0, 0]", "resolution"),
        ("m.yaml", "image: m.yaml\nresolution: 1\norigin: [0, .nan, 0]", "origin"),
        ("m.yaml", "just words", "ROS map"),
        ("m.txt", "x", "no map"),
        (None, "", "obstacles.json"),
    ],
)
def test_a_bad_map_is_one_clear_line(
    tmp_path: Path, name: str | None, text: str, said: str
) -> None:
    path = tmp_path if name is None else tmp_path / name
    if name is not None:
        path.write_text(text)
    with pytest.raises(RunFolderError, match=said) as raised:
        read_prior(path)
    assert "\n" not in str(raised.value)


def _known(contact: MapContact) -> list[Obstacle]:
    return [
        Obstacle(
            contact.x_cm, contact.y_cm, contact.covariance_cm2,
            Ellipse.of(contact.covariance_cm2), contact.track, "felt", "localized",
            normal_rad=contact.normal_rad,
        )
    ]  # fmt: skip


def test_a_contact_at_a_known_obstacle_is_that_obstacle() -> None:
    prior = _known(_contact())
    assert match(prior, _contact(arc=41.0)) == 0
    assert match(prior, _contact(arc=20.0)) is None
    assert match([], _contact()) is None


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_map_makes_no_contact_likelier_than_it_is_without(count: int) -> None:
    """Its obstacles together are as likely as a new one: over the skin the mean is 1."""
    arcs = np.linspace(0.0, 53.0, 2001)
    skin = np.column_stack((arcs, np.full_like(arcs, RADIUS)))
    touched = np.linspace(12.0, 41.0, count)
    point = ((0.0, 0.0), (0.0, 0.0))
    prior = [
        replace(_known(_contact())[0], x_cm=float(x), y_cm=RADIUS, covariance_cm2=point)
        for x in touched
    ]
    density = KnownPlaces(prior).boost(skin, 53.0)
    assert density.mean() == pytest.approx(1.0, abs=0.01)
    assert density.min() == pytest.approx(0.5, abs=0.01)


def test_a_known_obstacle_that_is_met_is_one_with_the_contact(folder: RunFolder) -> None:
    contact = replace(_contact(), known=0)
    known = export_obstacles(
        folder, _document(contact), radius_cm=RADIUS, prior=_known(_contact(arc=41.0))
    )
    assert [o.source for o in known.obstacles] == ["felt, prior"]


def test_a_known_obstacle_that_was_swept_through_is_missed_and_free(folder: RunFolder) -> None:
    ahead, far = _contact(), replace(_contact(), x_cm=10.0, y_cm=30.0)
    ahead = replace(ahead, x_cm=47.0, y_cm=3.0, covariance_cm2=((0.2, 0.0), (0.0, 0.2)))
    prior = [*_known(ahead), *_known(far)]
    document = judged(_document(), CONFIG, prior)
    assert document.missed is not None
    (gone,) = document.missed
    assert (gone.source, gone.x_cm, gone.y_cm) == ("prior", 47.0, 3.0)
    known = export_obstacles(folder, document, radius_cm=RADIUS, prior=prior)
    assert [o.source for o in known.obstacles] == ["prior, not felt", "prior"]
    assert _grey(folder, 47.0, 3.0) == FREE
    assert _grey(folder, far.x_cm, far.y_cm) == OCCUPIED
    assert len(read_prior(folder.path)) == 1  # the next run does not expect it


def test_a_known_obstacle_without_a_normal_is_drawn_along_its_track() -> None:
    """Other programs write obstacles.json, in which a normal may be left out."""
    given = replace(_known(_contact())[0], normal_rad=None, track=[(10.0, 30.0), (20.0, 30.0)])
    grid, _ = occupancy(_document(), RADIUS, [given])
    x, y = grid.centers()
    line = (np.abs(y - 30.0) < 0.3) & (x > 11.0) & (x < 19.0)
    assert line.any()
    assert (grid.cells[line] == OCCUPIED_CELL).all()


def _truth(*contacts: TrueContact) -> Truth:
    return Truth([TruePeg(30.0, 20.0, 0.6)], list(contacts))


def test_missed_and_false_contacts_are_listed_with_reasons() -> None:
    contact = _contact()
    beside = TrueContact(contact.x_cm + 0.5, contact.y_cm, 40.5, 50.0, 0, "left")
    right = TrueContact(30.0, -10.0, 33.0, 50.0, 1, "right")
    near = TrueContact(1.0, -1.75, 1.0, 50.0, 2, "right")
    both = judged(replace(_document(contact), truth=_truth(beside, right, near)), CONFIG)
    assert both.false == []
    assert both.missed is not None
    assert [(m.arc_cm, m.source) for m in both.missed] == [(33.0, "truth"), (1.0, "truth")]
    assert "moment below threshold" in both.missed[0].reason
    assert "first sensor" in both.missed[1].reason
    alone = judged(replace(_document(contact), truth=_truth(right)), CONFIG)
    assert alone.false is not None
    assert [f.contact for f in alone.false] == [0]
    assert "nothing touched" in alone.false[0].reason
    assert judged(_document(contact), CONFIG).missed is None  # a real room: nobody knows


def test_two_pegs_of_one_sweep_that_were_not_told_apart_say_so() -> None:
    contact = _contact()
    beside = TrueContact(contact.x_cm, contact.y_cm, 40.0, 50.0, 0, "left")
    distant = TrueContact(20.0, 5.0, 20.0, 50.0, 1, "left")
    document = judged(replace(_document(contact), truth=_truth(beside, distant)), CONFIG)
    assert document.missed is not None
    assert "not separated" in document.missed[0].reason


def test_a_peg_that_was_taken_for_another_one_is_named_so() -> None:
    """Sweeps of two lengths touched two pegs, and the map has them as one, near the first."""
    contact = replace(_contact(), merged=[40.0])
    first = TrueContact(contact.x_cm, contact.y_cm, 38.0, 40.0, 0, "left")
    second = TrueContact(20.0, 15.0, 20.0, 50.0, 1, "left")
    document = judged(replace(_document(contact), truth=_truth(first, second)), CONFIG)
    assert document.missed is not None
    (missed,) = document.missed
    assert "taken for the peg that other stages felt" in missed.reason


def test_a_walls_face_is_occupied_where_it_is_localized_and_else_unknown(
    folder: RunFolder,
) -> None:
    face = [(20.0, 8.0), (40.0, 8.0)]
    wall = replace(_contact(), kind="wall", surface=face, normal_rad=pi / 2)
    for status, grey in (("localized", OCCUPIED), ("ambiguous", UNKNOWN)):
        export_obstacles(folder, _document(replace(wall, status=status)), radius_cm=RADIUS)
        assert _grey(folder, 25.0, 8.0) == grey
        assert _grey(folder, 35.0, 8.0) == grey
        (obstacle,) = read_obstacles(folder.path / "obstacles.json").obstacles
        assert (obstacle.kind, obstacle.surface) == ("wall", face)


def test_what_is_ambiguous_or_unlikely_is_unknown_and_never_free(folder: RunFolder) -> None:
    contact = _contact()
    for doubtful in (replace(contact, status="ambiguous"), replace(contact, probability=0.9)):
        export_obstacles(folder, _document(doubtful), radius_cm=RADIUS)
        assert _grey(folder, contact.x_cm, contact.y_cm) == UNKNOWN
