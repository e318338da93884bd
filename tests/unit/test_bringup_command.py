"""`thigmo bringup`, `jog` and `press`: what is asked, what is printed, how it ends."""

from __future__ import annotations

import json
from dataclasses import astuple
from pathlib import Path

import pytest
from command import Thigmo

from thigmo.bringup import STAGES
from thigmo.cli.bringup import _TerminalAttendant
from thigmo.cli.console import Console


class AnsweringConsole(Console):
    """Keeps the questions and gives prepared answers."""

    def __init__(self, *answers: str) -> None:
        super().__init__(quiet=True)
        self.asked: list[str] = []
        self._answers = list(answers)

    def _answer(self, question: str, at_terminal: str, unit: str) -> str:
        self.asked.append(at_terminal)
        return self._answers.pop(0)


def test_the_person_is_asked_until_the_answer_is_one() -> None:
    console = AnsweringConsole("", "", "", "perhaps", "In")
    attendant = _TerminalAttendant(console)
    attendant.press_emergency_stop(True)
    attendant.press_emergency_stop(False)
    assert attendant.spool_turned() == "not"  # nothing was driven yet
    assert attendant.spool_turned() == "in"
    assert console.asked[0] == "Press the emergency stop. Then press Enter."
    assert console.asked[1] == "Release the emergency stop. Then press Enter."


def test_the_help_names_the_stages_in_their_order(thigmo: Thigmo) -> None:
    words = " ".join(thigmo("bringup", "--help").out.split())
    assert f"Stages: {', '.join(STAGES)}." in words


def test_json_says_what_was_found(thigmo: Thigmo) -> None:
    ran = thigmo("bringup", "--robot", "emulator://empty", "--json")
    assert ran.code == 0
    report = json.loads(ran.out)
    assert report["good"] is True
    assert {finding["stage"] for finding in report["findings"]} >= {"estop", "valves", "home"}


def test_a_later_stage_can_be_tried_on_the_emulator_whose_board_is_new_each_time(
    thigmo: Thigmo,
) -> None:
    code, out, _ = astuple(thigmo("bringup", "--robot", "emulator://empty", "--from", "motor"))
    assert code == 0
    assert "valves" not in out
    assert "good  home: the spool stalls twice at one place; length 0.0 cm" in out


def test_it_ends_with_what_is_built(thigmo: Thigmo) -> None:
    robot = ("bringup", "--robot", "emulator://empty")
    code, out, _ = astuple(thigmo(*robot, "--to", "estop"))
    assert code == 0
    assert "emergency stop: seen pressed and released" in out
    assert "good  pressure" not in out
    assert out.endswith("Next: thigmo bringup --robot emulator://empty --from pressure\n")
    wrong = thigmo(*robot, "--from", "flex", "--to", "estop")
    assert wrong.code == 1
    assert "stage estop comes before flex; the order is board, supply" in wrong.err


def test_what_is_wrong_ends_with_1_and_the_way_on(thigmo: Thigmo, tmp_path: Path) -> None:
    scene = tmp_path / "cut.toml"
    scene.write_text('extends = "empty"\n[[faults]]\nkind = "flex_wire_cut"\nat_s = 0.0\n')
    url = f"emulator://{scene}"
    code, out, _ = astuple(thigmo("bringup", "--robot", url))
    assert code == 1
    assert "WRONG flex left 0: open; plug it in, check J6.2" in out
    assert f"thigmo bringup --robot {url} --from flex" in out


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (
            ("bringup", "--robot", "emulator://empty", "--from", "x"),
            "no stage 'x'; name one of board",
        ),
        (("jog", "--robot", "emulator://empty"), "needs one direction; give --out CM or --in CM"),
        (("jog", "--robot", "emulator://empty", "--out", "6"), "give more than 0 and at most 5 cm"),
        (
            ("press", "--robot", "emulator://empty", "up", "3"),
            "no muscle up; use left (90) or right (270)",
        ),
        (("press", "--robot", "emulator://empty", "left", "6"), "at most 5 psi and 60 s"),
    ],
)
def test_a_bad_request_is_one_line(thigmo: Thigmo, arguments: tuple[str, ...], line: str) -> None:
    ran = thigmo(*arguments)
    assert ran.code == 1
    assert line in ran.err
    assert ran.err.count("\n") == 1
