"""Questions to the person beside the robot: what goes on meanwhile, and what ends them."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from thigmo.cli.console import Console
from thigmo.errors import RobotFaultError


class Asked:
    """Viewers who give these answers, one to each question."""

    def __init__(self, *answers: str) -> None:
        self._answers = list(answers)
        self.questions: list[tuple[str, str]] = []

    def ask(self, question: str, unit: str = "") -> None:
        self.questions.append((question, unit))

    def answer(self) -> str | None:
        return self._answers.pop(0) if self._answers else None


def _console(viewers: Asked, meanwhile: Callable[[float], None] | None = None) -> Console:
    console = Console(quiet=True, asks_viewers=True)
    console.viewers, console.meanwhile = viewers, meanwhile
    return console


@pytest.fixture(autouse=True)
def no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: False)


def test_an_answer_that_is_no_length_is_said_to_be_none() -> None:
    viewers = Asked("", "long", "inf", "-3", "20,5 cm")
    assert _console(viewers).everted_length_cm() == 20.5
    measure = "Measure the everted length. How many cm?"
    assert [question for question in viewers.questions if question[0]] == [
        (measure, "cm"),
        (f"The number is missing. {measure}", "cm"),
        (f"'long' is not a length in cm. {measure}", "cm"),
        (f"'inf' is not a length in cm. {measure}", "cm"),
        (f"'-3' is not a length in cm. {measure}", "cm"),
    ]


def test_the_robot_is_read_while_nobody_answers() -> None:
    read: list[float] = []
    viewers = Asked()

    def meanwhile(seconds: float) -> None:
        read.append(seconds)
        if len(read) == 3:
            viewers._answers.append("")

    _console(viewers, meanwhile).set_body_pressure(1.5)
    assert len(read) == 3
    assert viewers.questions == [("Set the body pressure to 1.5 psi (10.3 kPa).", ""), ("", "")]


def test_a_stop_ends_a_question_and_takes_it_away() -> None:
    def meanwhile(seconds: float) -> None:
        raise RobotFaultError("stopped", faults=("stopped",))

    viewers = Asked()
    with pytest.raises(RobotFaultError):
        _console(viewers, meanwhile).everted_length_cm()
    assert viewers.questions[-1] == ("", "")
