"""The fuzz targets, built and run for a while over the committed corpus; any finding fails.

More: `make -C tests/protocol/fuzz run RUNS=1000000`, then `make keep`.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

HERE = Path(__file__).parent
BUILD = HERE.parents[2] / "build" / "fuzz"
RUNS = {"decoder": 30_000, "commands": 3_000}  # many times that in `make nightly`


def missing() -> str:
    if shutil.which("clang++") is None or shutil.which("make") is None:
        return "clang or make is not installed"
    probe = subprocess.run(
        ["clang++", "-fsanitize=fuzzer,address", "-x", "c++", "-", "-o", "/dev/null"],
        input='extern "C" int LLVMFuzzerTestOneInput(const char*, unsigned long) { return 0; }',
        capture_output=True,
        text=True,
        check=False,
    )
    return "libFuzzer (libclang-rt-dev) is not installed" if probe.returncode else ""


@pytest.fixture
def program(target: str) -> Path:
    """The target, built for it alone: another worker builds the other one."""
    reason = missing()
    if reason:
        pytest.skip(f"fuzzing: {reason}")
    made = BUILD / target
    subprocess.run(["make", "-s", "-C", str(HERE), f"BUILD={BUILD}", str(made)], check=True)
    return made


@pytest.mark.parametrize("target", RUNS)
def test_nothing_is_found(
    program: Path, target: str, tmp_path: Path, many: Callable[[int], int]
) -> None:
    runs, crashes = many(RUNS[target]), tmp_path / "found"
    crashes.mkdir()
    command = [str(program), f"-runs={runs}", "-seed=1", "-max_len=600"]
    command += ["-timeout=300", f"-artifact_prefix={tmp_path}/", str(crashes)]
    result = subprocess.run(
        [*command, str(HERE / "corpus" / target)], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr[-4000:]
    assert f"Done {runs} runs" in result.stderr
