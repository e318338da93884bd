"""An exploration with a map: it knows its obstacles again, and a wrong one does no harm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from emulated import room_file, scene_at

from thigmo.errors import DataError
from thigmo.exploration import ExplorationResult, explore, replay
from thigmo.record import OBSTACLES_FILE, OccupancyGrid, read_obstacles, write_ros_map

pytestmark = pytest.mark.ci

SEED = 2


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The scene mid_body, from 38 cm on: three stages, and a contact at each."""
    return room_file(tmp_path_factory.mktemp("room"), scene_at(38.0, "mid_body"))


@pytest.fixture(scope="module")
def first(room: str, tmp_path_factory: pytest.TempPathFactory) -> ExplorationResult:
    """Explored without a map."""
    return explore(room, seed=SEED, out=tmp_path_factory.mktemp("first"))


def _grid(path: Path, *blocks: tuple[float, float]) -> Path:
    """A ROS map of 1 cm cells with 2 cm blocks at these places (cm)."""
    cells = np.full((80, 80), -1, dtype=np.int8)
    for x, y in blocks:
        column, row = int(x + 10), int(y + 40)
        cells[row - 1 : row + 1, column - 1 : column + 1] = 100
    write_ros_map(OccupancyGrid(cells, 1.0, (-10.0, -40.0, 0.0)), path)
    return path


def _arc_is_held(result: ExplorationResult) -> None:
    (contact,) = result.document.contacts
    truth = result.document.truth
    assert truth is not None
    true = truth.contacts[-1]
    low, high = contact.interval_cm
    assert low - 0.5 <= true.arc_cm <= high + 0.5
    assert result.document.error_x_cm is not None
    assert result.document.error_x_cm < 4.5


def test_a_second_run_knows_the_firsts_obstacle_again(
    room: str, first: ExplorationResult, tmp_path: Path
) -> None:
    assert first.document.contacts[0].known is None
    again = explore(room, seed=9, out=tmp_path, prior=first.folder)
    (contact,) = again.document.contacts
    assert contact.known == 0
    _arc_is_held(again)
    assert again.document.missed == []
    (obstacle,) = read_obstacles(again.folder / OBSTACLES_FILE).obstacles
    assert obstacle.source == "felt, prior"
    repeated = replay(again.folder).document
    assert repeated.contacts == again.document.contacts


def test_a_map_of_the_true_peg_saves_the_second_sweep_of_it(
    room: str, first: ExplorationResult, tmp_path: Path
) -> None:
    truth = first.document.truth
    assert truth is not None
    (peg,) = truth.pegs
    given = _grid(tmp_path / "room.yaml", (peg.x_cm, peg.y_cm))
    result = explore(room, seed=SEED, out=tmp_path, prior=given)
    (contact,), (before,) = result.document.contacts, first.document.contacts
    assert contact.known == 0
    _arc_is_held(result)
    assert contact.status == before.status == "localized"
    time_s, unaided_s = (run.document.robot_time_s for run in (result, first))
    print(f"{time_s:.0f} s instead of {unaided_s:.0f} s")
    assert time_s < 0.95 * unaided_s


@pytest.mark.parametrize(
    "blocks",
    [
        pytest.param([(28.0, -7.5)], id="a peg where the same bend would have met it sooner"),
        pytest.param(
            [(40.0, -14.0), (48.0, 20.0)], id="pegs that are not there", marks=pytest.mark.ci
        ),
    ],
)
def test_a_wrong_map_does_not_break_the_run(
    room: str, tmp_path: Path, blocks: list[tuple[float, float]]
) -> None:
    given = _grid(tmp_path / "room.yaml", *blocks)
    result = explore(room, seed=SEED, out=tmp_path, prior=given)
    assert result.document.outcome == "full length"
    _arc_is_held(result)


def test_a_mapped_peg_ahead_is_stopped_short_of_and_said(tmp_path: Path) -> None:
    first = explore("emulator://ahead", seed=1, out=tmp_path)
    again = explore("emulator://ahead", seed=2, out=tmp_path, prior=first.folder).document
    (peg,) = again.truth.pegs if again.truth else ()
    assert again.outcome == "peg ahead"
    assert again.stall is None  # it never met the peg
    assert again.length_cm < peg.x_cm - peg.radius_cm
    assert again.stages
    assert "short of what the map has in its path" in again.skips


def test_a_map_with_an_obstacle_at_the_base_is_refused(tmp_path: Path) -> None:
    given = _grid(tmp_path / "room.yaml", (9.0, 0.0))
    with pytest.raises(DataError, match="leave --map out"):
        explore("emulator://empty", seed=1, out=tmp_path, prior=given)


def test_an_empty_room_stays_empty_whatever_the_map_says(tmp_path: Path) -> None:
    given = _grid(tmp_path / "room.yaml", (30.0, 8.0), (44.0, 24.0))
    document = explore(
        room_file(tmp_path, scene_at(38.0)), seed=1, out=tmp_path, prior=given
    ).document
    assert document.contacts == []
    assert document.missed is not None
    assert (30.0, 8.0) in {(round(m.x_cm), round(m.y_cm)) for m in document.missed}
    assert all(m.source == "prior" for m in document.missed)
