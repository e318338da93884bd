"""An exploration whose disk is full, in real time over a pseudo-terminal.

A limit of the size of files stands for the disk: the system refuses what would pass it.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from emulated import Serve, last_stages
from served import EVER_S, ServedRobot, comes

from thigmo.link import protocol as wire
from thigmo.link.framing import Decoder
from thigmo.record import RunFolder

pytestmark = [
    pytest.mark.usefixtures("own_sockets"),
]
Explore = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def explore(tmp_path: Path) -> Explore:
    """Explores with files of so many bytes at most."""

    def run(most_bytes: int, *options: str) -> subprocess.CompletedProcess[str]:
        limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (most_bytes, most_bytes))
        command = [sys.executable, "-m", "thigmo", "explore", "--out", str(tmp_path), *options]
        return subprocess.run(
            command, capture_output=True, text=True, check=False, preexec_fn=limit, timeout=EVER_S
        )

    return run


def _line(run: subprocess.CompletedProcess[str]) -> str:
    """The one line that tells of it."""
    assert run.returncode == 1
    (line,) = [line_text for line_text in run.stderr.splitlines() if "%" not in line_text[:4]]
    assert line.startswith("thigmo: cannot write ")
    assert "File too large" in line
    return line


def test_a_record_that_grows_no_more_ends_the_run_with_a_safe_robot(
    explore: Explore, tmp_path: Path
) -> None:
    line = _line(explore(150_000))
    assert "run.mcap: File too large; it ends early; free some space" in line
    (path,) = tmp_path.iterdir()
    folder = RunFolder(path)
    assert folder.read_document().outcome.startswith("aborted: cannot write ")
    log = folder.read_log()
    assert log.truncated
    assert log.gaps == 0
    assert len(log.entries) > 200
    assert not list(path.glob("*.partial"))
    for picture in path.glob("*.png"):
        assert picture.read_bytes().endswith(b"IEND\xaeB`\x82")


def test_a_folder_that_takes_nothing_is_told_before_the_robot_moves(
    explore: Explore, tmp_path: Path
) -> None:
    assert "robot.toml" in _line(explore(100))
    (path,) = tmp_path.iterdir()
    assert not list(path.iterdir())


@pytest.mark.realtime
def test_a_full_disk_makes_the_robot_safe_first(serve: Serve, tmp_path: Path) -> None:
    room = last_stages(20.0, "empty")
    room.robot.save(tmp_path / "robot.toml")
    served = serve(room)
    operator, terminal = os.openpty()
    try:
        heard = _heard(served)
        os.write(operator, b"20\n\n\n\n")
        limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (60_000, 60_000))
        words = [sys.executable, "-m", "thigmo", "explore", "--robot", served.port]
        words += ["--config", str(tmp_path / "robot.toml"), "--out", str(tmp_path / "runs")]
        run = subprocess.run(
            words,
            stdin=terminal,
            capture_output=True,
            text=True,
            check=False,
            preexec_fn=limit,
            timeout=EVER_S,
        )
        assert "run.mcap: File too large" in run.stderr
        assert wire.Disarm.ID in heard()  # it got the command, its host did not just fall silent
        assert comes(lambda: served.off, 5.0)
    finally:
        os.close(operator)
        os.close(terminal)


def _heard(served: ServedRobot) -> Callable[[], set[int]]:
    """Listen to what the robot is sent: the messages' numbers so far."""
    server, sent = served._server, Decoder()
    take, names = server._take, set()

    def listen() -> bytes:
        data = take()
        names.update(frame.id for frame in sent.feed(data))
        return data

    server._take = listen  # type: ignore[method-assign]
    return lambda: names
