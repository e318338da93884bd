"""`pytest --robot PORT`: the conformance suite against a port, here an emulated one, or none."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.scene import Scene

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.realtime


@pytest.fixture
def port() -> Iterator[str]:
    from served import ServedRobot  # has no import where there are no terminals

    robot = ServedRobot(Lockstep(Scene.load("empty"), VirtualBoard(1), seed=1))
    robot.alone()  # the suite falls silent on purpose, and waits in the computer's time
    yield robot.port
    robot.close()


def run(port: str, tests: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--robot", port]
    command += [str(ROOT / "tests/protocol/test_conformance.py"), "-k", f"{port} and ({tests})"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_the_suite_runs_against_a_port(port: str) -> None:
    done = run(port, "hello_tells or hears_its_own or one_activity or refus")
    assert done.returncode == 0, done.stdout
    last = done.stdout.strip().splitlines()[-1]
    assert int(last.split()[0]) >= 5, last
    assert "failed" not in last


def test_a_port_that_is_not_there_is_one_line() -> None:
    done = run("/dev/thigmo-nowhere", "hello_tells")
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    said = [line for line in done.stdout.splitlines() if "/dev/thigmo-nowhere" in line]
    assert len(said) == 1
    assert "--robot: there is no port /dev/thigmo-nowhere; " in said[0]
    assert "Traceback" not in done.stdout + done.stderr
