"""The command line, run in this process; and scripts in a process of their own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from thigmo.cli.main import main


@dataclass(frozen=True)
class Ran:
    """What a command printed, and how it ended."""

    code: int
    out: str
    err: str


Thigmo = Callable[..., Ran]


def thigmo_command(patch: pytest.MonkeyPatch, captured: pytest.CaptureFixture[str]) -> Thigmo:
    """A function that runs `thigmo` with the given words."""

    def run(*arguments: str | Path | float) -> Ran:
        patch.setattr(sys, "argv", ["thigmo", *map(str, arguments)])
        code = 0
        try:
            main()
        except SystemExit as ended:
            code = int(ended.code or 0)
        output = captured.readouterr()
        return Ran(code, output.out, output.err)

    return run


def run_python(script: str, *words: str) -> Ran:
    process = subprocess.run(
        [sys.executable, "-c", script, *words], capture_output=True, text=True, check=False
    )
    return Ran(process.returncode, process.stdout, process.stderr)
