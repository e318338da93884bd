"""A row that the table of loads does not have is weighed by the same kernel, in compiled code."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).parent
HEADERS = HERE.parents[2] / "host" / "thigmo" / "localization"
COMPILER = shutil.which("c++") or shutil.which("g++")


@pytest.mark.skipif(COMPILER is None, reason="no C++ compiler")
def test_a_couple_anywhere_is_a_row_of_the_table(tmp_path: Path) -> None:
    program = tmp_path / "new_load"
    assert COMPILER is not None
    subprocess.run(
        [COMPILER, "-std=c++20", "-O1", "-I", HEADERS, HERE / "new_load.cpp", "-o", program],
        check=True,
    )
    said = subprocess.run([program], check=True, capture_output=True, text=True).stdout
    couple, contact = ([float(word) for word in line.split()] for line in said.splitlines())
    # Six sensors read 20 standard errors each: 1/2 * 6 * 20^2, less Occam's share.
    assert couple[0] == pytest.approx(1200.0, abs=15.0)
    assert 0.55 <= couple[1] <= 0.6
    assert couple[2] == pytest.approx(0.2, abs=0.01)
    assert contact[0] < couple[0] - 50.0
