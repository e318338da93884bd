"""A minute of the soak on the real image: every promise of `make soak` is kept."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.ci

ROOT = Path(__file__).resolve().parents[3]


def test_a_minute_of_everything_breaks_no_promise() -> None:
    done = subprocess.run(
        [
            sys.executable,
            "tools/soak.py",
            "--hours",
            "0.016",
            "--seed",
            "8",
            "--seeds",
            "1",
            "--json",
        ],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    figures = {name: figure["value"] for name, figure in json.loads(done.stdout).items()}
    assert figures["robot time"] >= 0.016
    assert figures["commands sent"] == figures["commands replied"] > 1000
    assert figures["commands refused, as they should be"] > 100
    assert figures["kinds of fault raised"] >= 3
    assert figures["EEPROM bytes written"] > 100
