"""The first minute of a new installation: the first commands, with nothing cached.

Each command runs in a process of its own with empty cache folders, on one core, as on a small
laptop. Times are wall times; the machine should have nothing else to do.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

from thigmo.errors import DataError
from thigmo.studies.engine import Claim, Context, Outcome
from thigmo.studies.scaling import one_core
from thigmo.studies.scenes import LENGTH, SIGMA, SPAN, one_contact

PROMISED_S = {"localize": 12.0, "explore": 45.0}


def first_run_s(arguments: list[str], folder: Path) -> float:
    """Seconds of a `thigmo` command whose caches are empty folders below `folder`.

    Raises:
        DataError: the command fails.
    """
    folder.mkdir()
    homes = dict.fromkeys(("XDG_CACHE_HOME", "HOME", "LOCALAPPDATA"), str(folder))
    command, environment = [sys.executable, "-m", "thigmo", *arguments], {**os.environ, **homes}
    start = perf_counter()
    done = subprocess.run(
        command, cwd=folder, env=environment, check=False, capture_output=True, text=True
    )
    elapsed = perf_counter() - start
    if done.returncode != 0:
        raise DataError(f"thigmo {arguments[0]} failed: {done.stderr.strip()}", "run it by hand")
    return elapsed


def run(context: Context) -> Outcome:
    """First `thigmo localize`, first `thigmo explore`."""
    case = one_contact(context.rng(0))
    times: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name, one_core():
        folder = Path(name)
        table = folder / "readings.csv"
        lines = [f"{x},{k}" for x, k in zip(case.position, case.curvature, strict=True)]
        table.write_text("\n".join(["position,curvature", *lines, ""]))
        known = ["--length", f"{LENGTH}", "--span", f"{SPAN}", "--noise", f"{SIGMA}"]
        commands = (
            ["localize", str(table), *known],
            ["explore", "--seed", "1", "--out", str(folder / "runs")],
        )
        for done, command in enumerate(commands):
            context.progress("first commands", done, len(commands))
            times[command[0]] = first_run_s(command, folder / command[0])
        context.progress("first commands", len(commands), len(commands))
    claims = [
        Claim(f"first `thigmo {what}`, nothing cached, one core", time, PROMISED_S[what], unit="s")
        for what, time in times.items()
    ]
    return Outcome(claims=claims)
