"""Robots that do not explore are felt at rest: without muscles, of fixed length, and in space."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command import Thigmo
from emulated import armed, emulated, room_file

from thigmo.config import RobotConfig
from thigmo.emulator.reach import room_for
from thigmo.emulator.scene import WallTable
from thigmo.errors import CommandRefusedError, ConfigError
from thigmo.exploration import explore
from thigmo_bench.studies.exploration import LENGTH_CM
from thigmo_bench.studies.gallery import (
    EXPLORED,
    FELT,
    GALLERY,
    Calibrated,
    Room,
    gallery_robot,
    push,
    unmeasured,
    visit,
)
from thigmo_bench.studies.robots import Visited


@pytest.mark.ci
@pytest.mark.parametrize("name", FELT)
def test_a_robot_at_rest_feels_where_it_is_pushed(name: str) -> None:
    pushes = [push((name, seed)) for seed in (1, 2, 3)]
    assert not [load.status for load in pushes if load.status.startswith("aborted")]
    assert sum(not load.felt for load in pushes) <= 1
    assert not any(load.wrong for load in pushes)


def _explored(name: str, *, peg: bool) -> Visited:
    """A room that a robot of the gallery explores with its true maps."""
    measured = Calibrated(name, 1, config=unmeasured(name, 1))
    return visit(Room(measured, 1 if peg else 3, peg, gains_changed=False))


@pytest.mark.ci
@pytest.mark.parametrize("name", EXPLORED)
def test_a_robot_of_the_gallery_says_nothing_in_an_empty_room(name: str) -> None:
    assert _explored(name, peg=False).status == "silent"


@pytest.mark.ci
@pytest.mark.parametrize("name", ["catheter", "one-column"])
def test_a_robot_of_the_gallery_finds_a_peg(name: str) -> None:
    touched = _explored(name, peg=True)
    assert touched.status in ("localized", "ambiguous")
    assert not touched.missed
    assert not touched.wrong


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("whisker", "no muscles, so it cannot sweep"),
        ("tendon", "no muscles, so it cannot sweep"),
        ("preformed", "curved at rest"),
    ],
)
def test_explore_says_in_one_line_why_it_cannot(name: str, why: str, tmp_path: Path) -> None:
    robot = gallery_robot(name)
    url = room_file(tmp_path, room_for(robot, 1, peg=False))
    with pytest.raises(ConfigError, match=why):
        explore(url, out=tmp_path, seed=1)


def test_a_robot_of_fixed_length_knows_its_length_and_refuses_to_grow_by_name() -> None:
    finger = gallery_robot("finger")
    robot, transport = emulated(room_for(finger, 1, peg=False))
    robot.configure(transport.config)
    robot.arm()
    assert robot.known_length_cm() == pytest.approx(20.0)
    with pytest.raises(CommandRefusedError) as caught:
        robot.grow_to(20.0)
    assert caught.value.reason == "does_not_grow"
    assert "grows = false" in str(caught.value)


def test_a_muscleless_vine_grows() -> None:
    whisker = gallery_robot("whisker")
    robot, transport = armed(room_for(whisker, 1, peg=False))
    robot.pressurize(0)
    assert robot.grow_to(20.0) == pytest.approx(20.0, abs=0.1)
    assert transport.lockstep.plant.length_cm == pytest.approx(20.0, abs=0.3)
    assert robot.retract_to(10.0).length_cm == pytest.approx(10.0, abs=0.1)


def test_thigmo_feel_grows_a_muscleless_vine_and_answers(thigmo: Thigmo, tmp_path: Path) -> None:
    whisker = gallery_robot("whisker")
    url = room_file(tmp_path, room_for(whisker, 1, peg=False))
    said = thigmo("feel", "--robot", url, "--grow-to", "20", "--count", "1", "--json")
    (answer,) = json.loads(said.out)
    assert answer["length_cm"] == pytest.approx(20.0, abs=0.1)
    assert answer["status"] == "no contact"


def _grown_whisker(thigmo: Thigmo, tmp_path: Path, walls: list[WallTable]) -> dict[str, Any]:
    """The answer of `thigmo feel --grow-to 53` beside walls."""
    room = room_for(gallery_robot("whisker"), 1, peg=False)
    room.walls = walls
    url = room_file(tmp_path, room)
    ran = thigmo("feel", "--robot", url, "--grow-to", "53", "--count", "1", "--json")
    assert ran.code == 0, ran.err
    (answer,) = json.loads(ran.out)
    return answer


def test_a_muscleless_vine_feels_what_bends_it_while_it_grows(
    thigmo: Thigmo, tmp_path: Path
) -> None:
    aslant = WallTable(x=30.0, y=-6.0, end_x=60.0, end_y=10.0)
    answer = _grown_whisker(thigmo, tmp_path, [aslant])
    (contact,) = answer["contacts"]
    (truth,) = answer["truth"]
    assert answer["length_cm"] < 53.0
    low, high = contact["interval"]  # to the length by the encoder
    assert low <= truth["arc_cm"] <= high + LENGTH_CM
    free = _grown_whisker(thigmo, tmp_path, [])
    assert free["status"] == "no contact"
    assert free["length_cm"] == pytest.approx(53.0, abs=0.1)


def test_bring_up_leaves_out_the_spool_of_a_robot_that_has_none(
    thigmo: Thigmo, tmp_path: Path
) -> None:
    finger = GALLERY / "finger.toml"
    url = room_file(tmp_path, room_for(RobotConfig.load(finger), 1, peg=False))
    said = thigmo("bringup", "--robot", url, "--config", str(finger), "--from", "motor", "--json")
    assert [finding["observation"] for finding in json.loads(said.out)["findings"]] == [
        "none (grows = false in robot.toml)"
    ] * 3
