"""The help of every command at 80 columns: whole names, no ragged lines."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import pytest
import typer

from thigmo.calibrate.steps import STEPS
from thigmo.cli.main import app, main


def walk(command: Any, *path: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command and group, with the words that call it."""
    yield path, command
    for name, subcommand in getattr(command, "commands", {}).items():
        yield from walk(subcommand, *path, name)


def options(command: Any) -> dict[str, str | None]:
    """Names of what is shown, and what is said of it."""
    shown = [param for param in command.params if not getattr(param, "hidden", False)]
    return {name: param.help for param in shown for name in param.opts if name.startswith("-")}


COMMANDS = dict(walk(typer.main.get_command(app)))


@pytest.mark.parametrize("path", COMMANDS, ids=lambda path: " ".join(path) or "thigmo")
def test_help_fits_80_columns_with_whole_names(
    path: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(sys, "argv", ["thigmo", *path, "--help"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert max(map(len, lines)) <= 80
    shown = "\n".join(lines)
    assert "…" not in shown
    for name in (*options(COMMANDS[path]), *getattr(COMMANDS[path], "commands", {})):
        assert name in shown.replace(",", " ").split(), name
    prose = [line.strip() for line in lines[: next(i for i, s in enumerate(lines) if "╭" in s)]]
    for line, following in pairwise(prose):
        if line and following:
            assert len(line) + 1 + len(following.split()[0]) > 77, line


def test_every_option_says_what_it_is() -> None:
    for path, command in COMMANDS.items():
        for name, said in options(command).items():
            assert said, (path, name)


def test_the_help_of_calibrate_has_a_line_for_every_step() -> None:
    shown = COMMANDS["calibrate",].help
    assert [step for step in STEPS if f"\n\n{step}: " not in shown] == []
