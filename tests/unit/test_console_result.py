"""What a command says at its end of a robot that goes on, and of one that has ended with it."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer

from thigmo.cli.console import Console
from thigmo.exploration import ExplorationResult
from thigmo.record import RunDocument

URLS = [("/dev/ttyACM0", True), ("emulator://default", False), ("mega-sim://default", False)]


@pytest.mark.parametrize(("url", "remains"), URLS)
def test_only_a_robot_that_remains_is_said_to_wait_for_its_retraction(
    url: str, remains: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = RunDocument(
        thigmo="0", name="run", url=url, started="", seed=None, outcome="full length"
    )
    Console(quiet=True).result(ExplorationResult(document, tmp_path))
    out = capsys.readouterr().out
    assert "Ended: full length." in out
    assert (f"To retract it: thigmo retract --robot {url}" in out) == remains


@pytest.mark.parametrize(("url", "remains"), URLS)
def test_an_interrupt_says_how_the_robot_is_left(
    url: str, remains: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(typer.Exit), Console(quiet=True).interruptible(url):
        raise KeyboardInterrupt
    said = capsys.readouterr().err
    assert ("`thigmo retract` winds it in" in said) == remains
    assert ("the emulated robot has ended with this command" in said) != remains
