"""The image keeps its budgets, and gets no worse than the committed figures say."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.ci

ROOT = Path(__file__).resolve().parents[3]


def test_the_image_is_no_worse_than_the_committed_figures() -> None:
    done = subprocess.run(
        [sys.executable, "tools/budgets.py", "--check"],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
