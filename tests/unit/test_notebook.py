"""Results in a notebook: one line, an HTML table, a figure; and all of it from `thigmo` itself."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from command import run_python
from contacts import CONTACT

import thigmo
from thigmo.record import NamedMuscle, RunFolder, Shape, Stage, write_obstacles, write_ros_map

mpl.use("agg")

X = [5.0, 15.0, 25.0, 35.0, 45.0]
TOUCHED = [0.0104, 0.0083, 0.0060, 0.0041, 0.0017]
NAME = "<b>run & co</b>"


class _Page(HTMLParser):
    """Checks that every element is closed, and gathers the words."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.words: list[str] = []
        self.elements: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)
        self.elements.append(tag)

    def handle_startendtag(self, tag: str, attrs: object) -> None:
        self.elements.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def _page(shown: object) -> _Page:
    page = _Page()
    page.feed(shown._repr_html_())  # type: ignore[attr-defined]
    page.close()
    assert page.open == []
    return page


@pytest.fixture(scope="module")
def felt() -> thigmo.LocalizeResult:
    return thigmo.localize(TOUCHED, X, length=53, span=5.5, noise=6e-4)


@pytest.fixture
def grid() -> thigmo.OccupancyGrid:
    cells = np.full((3, 4), -1, dtype=np.int8)
    cells[0, :2], cells[2, 3] = 0, 100
    return thigmo.OccupancyGrid(cells, 2.0, (10.0, -5.0, 0.0))


@pytest.fixture
def contact() -> thigmo.MapContact:
    return replace(
        CONTACT, arc_cm=31.0, x_cm=29.5, y_cm=7.8, interval_cm=(29.0, 34.0), everted_length_cm=53.0
    )


@pytest.fixture
def run(
    tmp_path: Path, grid: thigmo.OccupancyGrid, contact: thigmo.MapContact
) -> thigmo.ExplorationResult:
    folder = RunFolder(tmp_path)
    folder.write_document(
        thigmo.RunDocument(
            thigmo="0",
            name=NAME,
            url="emulator://default",
            started="2026-01-01T00:00:00",
            outcome="full length",
            contacts=[contact],
            length_cm=53.0,
            robot_time_s=177.0,
        )
    )
    write_ros_map(grid, tmp_path / "map.yaml")
    write_obstacles(thigmo.ObstacleMap(NAME, "", "", 1.75), tmp_path / "obstacles.json")
    thigmo.RobotConfig().save(tmp_path / "robot.toml")
    return thigmo.open_run(tmp_path)


def test_every_exported_name_exists_and_is_listed() -> None:
    assert set(thigmo._HOME) | {"__version__"} == set(thigmo.__all__) == set(dir(thigmo))
    for name in thigmo.__all__:
        assert getattr(thigmo, name) is not None


def test_importing_thigmo_imports_nothing_heavy() -> None:
    script = (
        "import sys, thigmo; "
        "print([m for m in ('numpy', 'scipy', 'matplotlib', 'cv2') if m in sys.modules])"
    )
    assert run_python(script).out.strip() == "[]"


def test_a_result_is_one_line(felt: thigmo.LocalizeResult) -> None:
    (touch,) = felt.contacts
    low, high = touch.interval
    place = f"arc {touch.arc:.4g}, {low:.4g} to {high:.4g}"
    assert repr(felt) == f"LocalizeResult(localized, one contact: {place}; body of 53)"
    assert repr(touch) == f"Contact({place}, localized)"
    free = thigmo.localize(np.zeros(5), X, length=53, span=5.5, noise=6e-4)
    assert repr(free) == "LocalizeResult(no contact, free body; body of 53)"
    rows = thigmo.localize_batch([TOUCHED, TOUCHED, [0.0] * 5], X, length=53, span=5.5, noise=6e-4)
    assert repr(rows) == "BatchResult(3 rows: 1 no contact, 2 localized)"


def test_a_result_in_a_notebook_draws_body_and_contact(felt: thigmo.LocalizeResult) -> None:
    page = _page(felt)
    words = " ".join(page.words)
    assert felt.message in words
    assert f"{felt.contacts[0].arc:.4g}" in words
    assert {"svg", "path", "circle", "table"} <= set(page.elements)
    point = thigmo.localize(TOUCHED, X, length=53, span=5.5, method="thesis")
    assert "path" not in _page(point).elements  # a point fit has no posterior
    free = thigmo.localize(np.zeros(5), X, length=53, span=5.5, noise=6e-4)
    assert "svg" not in _page(free).elements
    assert "table" in _page(felt.contacts[0]).elements


def test_the_posterior_of_the_figure_is_the_result_s(felt: thigmo.LocalizeResult) -> None:
    axes = felt.plot(unit="cm")
    assert axes.get_xlabel() == "arc along the body (cm)"
    assert axes.get_ylabel() == "probability density (1/cm)"
    values, edges, _ = axes.patches[0].get_data()  # type: ignore[attr-defined]
    assert np.sum(values * np.diff(edges)) == pytest.approx(1.0)
    assert edges[-1] == pytest.approx(53.0)
    # The contact is drawn where it is, and the axes given are the axes used.
    assert any(line.get_xdata()[0] == felt.contacts[0].arc for line in axes.lines)  # type: ignore[index]
    assert felt.plot(axes) is axes
    assert "cm" not in axes.get_xlabel()


def test_the_grid_of_the_figure_lies_in_the_robot_s_frame(grid: thigmo.OccupancyGrid) -> None:
    axes = grid.plot()
    assert axes.get_xlabel().endswith("(cm)")
    assert axes.get_xlim() == pytest.approx((10.0, 18.0))
    assert axes.get_ylim() == pytest.approx((-5.0, 1.0))
    shade = np.asarray(axes.images[0].get_array())
    assert (shade == 0).sum() == 2
    assert shade[2, 3] == 2


def test_a_grid_counts_its_cells(grid: thigmo.OccupancyGrid) -> None:
    assert repr(grid) == "OccupancyGrid(4 x 3 cells of 2 cm: 2 free, 1 occupied, 9 unknown)"
    words = _page(grid).words
    assert "0.0008 m²" in words  # two cells of 2 cm
    assert "75 %" in words


def test_a_run_folder_opens_as_what_explore_returned(
    run: thigmo.ExplorationResult, grid: thigmo.OccupancyGrid, contact: thigmo.MapContact
) -> None:
    assert run.contacts == [contact]
    assert run.length_cm == 53.0
    assert (run.map.cells == grid.cells).all()
    assert run.obstacles.name == NAME
    assert run.config == thigmo.RobotConfig()
    assert repr(run) == (
        f"ExplorationResult({NAME}: full length; 1 contact, no stages, 177 s of robot time; "
        f"{run.folder})"
    )
    assert repr(contact) == (
        "MapContact(x 29.5, y 7.8 cm; arc 31.0 of 53.0 cm, 95 % 29.0 to 34.0 cm; localized)"
    )
    assert len(repr(run.obstacles)) < 100


def test_a_run_s_name_is_text_and_no_markup(run: thigmo.ExplorationResult) -> None:
    page = _page(run)
    assert NAME in page.words
    assert "b" not in page.elements


def test_a_run_draws_its_map_on_the_axes_given(run: thigmo.ExplorationResult) -> None:
    axes = run.plot()
    assert axes.get_title(loc="left") == f"{NAME}: 1 contact"
    assert axes.get_xlabel().endswith("(cm)")
    other = axes.figure.add_axes((0.7, 0.7, 0.2, 0.2))
    assert run.plot(other) is other
    assert other.get_title(loc="left")


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(thigmo.ThigmoError, match="give a run folder"):
        thigmo.open_run(tmp_path)


@pytest.mark.parametrize("method", ["posterior", "thesis"])
def test_a_result_survives_pickle_and_is_plain_data(method: str) -> None:
    felt = thigmo.localize(TOUCHED, X, length=53, span=5.5, method=method)
    again = pickle.loads(pickle.dumps(felt))
    assert repr(again) == repr(felt)
    assert again.edges.tolist() == felt.edges.tolist()
    assert again.mass.tolist() == felt.mass.tolist()
    assert again.bend.tolist() == felt.bend.tolist()
    plain = json.loads(json.dumps(felt.to_dict()))
    assert plain["contacts"][0]["arc"] == felt.contacts[0].arc
    assert plain["status"] == felt.status


def test_frames_have_a_row_for_each_contact() -> None:
    position = np.array([5.0, 15.0, 25.0, 35.0, 45.0])
    touched = -8e-4 * np.maximum(40.0 - position, 0.0)
    options = {"length": 53.0, "span": 5.5, "noise": 6e-4}
    answer = thigmo.localize(touched, position, **options)
    assert answer.to_frame()["arc"].tolist() == [contact.arc for contact in answer.contacts]
    many = thigmo.localize_batch([touched, 0.0 * touched], position, **options).to_frame()
    assert many["row"].tolist() == [0, 1]
    assert many["status"].tolist() == [answer.status, "no contact"]
    assert many["arc"][0] == pytest.approx(answer.contacts[0].arc)
    assert np.isnan(many["arc"][1])


@pytest.fixture
def known_wall(contact: thigmo.MapContact) -> thigmo.ExplorationResult:
    """A wall that three lengths felt, on a robot whose muscles have names."""
    wall = replace(
        contact, side="right", kind="wall", merged=[40.0, 46.5], surface=[(1.0, 2.0)] * 3,
        force_n=0.8, force_interval_n=[0.5, 1.1],
    )  # fmt: skip
    document = thigmo.RunDocument(
        thigmo="0", name="n", url="u", started="", contacts=[wall, replace(contact, side="")],
        stages=[Stage(40.0, 1.5, 9.0, [Shape("left", 8.0, [(0.0, 0.0, 0.0)])])],
        muscles=[NamedMuscle("left", "upper", 90.0), NamedMuscle("right", "lower", 270.0)],
    )  # fmt: skip
    return thigmo.ExplorationResult(document, Path("runs/n"))


def test_a_run_is_plain_data(known_wall: thigmo.ExplorationResult) -> None:
    plain = json.loads(json.dumps(known_wall.to_dict()))
    wall, _ = plain["contacts"]
    assert (wall["first_felt_cm"], wall["everted_length_cm"]) == (40.0, 53.0)
    assert "track" not in wall
    assert "shapes" not in plain["stages"][0]
    assert plain["run"] == str(Path("runs/n"))


def test_a_run_s_frame_has_a_row_for_each_contact(known_wall: thigmo.ExplorationResult) -> None:
    frame = known_wall.to_frame()
    assert frame["muscle"].tolist() == ["lower", ""]
    assert frame["merged_cm"].tolist() == ["40 46.5", ""]
    assert frame["interval_low_cm"].tolist() == [29.0, 29.0]
    assert frame["force_high_n"][0] == 1.1
    assert np.isnan(frame["force_high_n"][1])
    # Each column has one number or word in a cell, as CSV and Parquet need.
    assert all(np.isscalar(cell) or cell is None for cell in frame.to_numpy().ravel())


def test_a_run_survives_pickle(run: thigmo.ExplorationResult) -> None:
    again = pickle.loads(pickle.dumps(run))
    assert again == run
    assert again.to_frame().equals(run.to_frame())
