"""An exploration that is cut short in mid-sweep or growth, in real time over a pseudo-terminal.

A host in a process of its own explores the emulated robot on a port, as it would a real one. When
the valve is open or the motor runs, it is interrupted or killed, or its cable is pulled: the robot
must be vented and braked, and the folder readable.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from command import Thigmo
from emulated import Serve, last_stages
from served import ServedRobot, comes

from thigmo.emulator.scene import Scene
from thigmo.exploration import replay
from thigmo.link import protocol as wire
from thigmo.link.framing import decode
from thigmo.record import OBSTACLES_FILE, RunFolder, read_obstacles, read_ros_map

pytestmark = pytest.mark.realtime
LIMIT_S = 0.6  # of silence, and one period of the heart


@pytest.fixture
def room() -> Scene:
    """The robot 20 cm out, with sensors that settle at once: real time is dear."""
    return last_stages(20.0, "empty")


@contextmanager
def exploring(served: ServedRobot, folder: Path, room: Scene) -> Iterator[subprocess.Popen[str]]:
    """A host that explores it, in a process of its own, with an operator at its terminal."""
    room.robot.save(folder / "robot.toml")
    operator, terminal = os.openpty()
    os.write(operator, f"{room.start_length_cm}\n\n\n\n".encode())  # and Enter at each pressure
    command = [
        sys.executable, "-m", "thigmo", "explore", "--robot", served.port,
        "--config", str(folder / "robot.toml"), "--out", str(folder), "--name", "cut short",
    ]  # fmt: skip
    with subprocess.Popen(
        command, stdin=terminal, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as host:
        yield host
    os.close(operator)
    os.close(terminal)


@pytest.mark.parametrize(
    ("number", "outcome"),
    [
        (signal.SIGINT, "aborted: interrupted by the operator"),
        (signal.SIGTERM, "aborted: terminated"),
        (signal.SIGKILL, "killed"),
    ],
)
def test_a_run_cut_short_in_mid_sweep_leaves_a_safe_robot_and_a_readable_folder(
    tmp_path: Path, room: Scene, serve: Serve, thigmo: Thigmo, number: signal.Signals, outcome: str
) -> None:
    served = serve(room)
    with exploring(served, tmp_path, room) as host:
        _await(host, lambda: served.energised, "the sweep never opened a valve")
        length_cm = served.plant.length_cm
        host.send_signal(number)
        assert served.off_within(LIMIT_S), "a valve is still open"
        out, said = host.communicate()
    assert comes(lambda: max(served.plant.muscle_psi) < 0.5)
    assert served.off
    assert served.plant.length_cm == pytest.approx(length_cm, abs=1e-3)  # never a retraction
    assert out == ""
    killed = number == signal.SIGKILL
    assert host.returncode == (-number if killed else 128 + number)
    if not killed:
        assert "cut-short" in _last_line(said, "thigmo: interrupted; the robot is vented")
    folder = _folder(tmp_path, outcome)
    if not killed:
        assert read_obstacles(folder.path / OBSTACLES_FILE).outcome == outcome
        assert read_ros_map(folder.path / "map.yaml").cells.size
        assert folder.map_path.read_bytes().startswith(b"\x89PNG")
    log = folder.read_log()
    assert log.truncated == killed
    sent = {decode(entry.frame).id for entry in log.entries if entry.direction == "tx"}
    assert (wire.Stop.ID in sent) != killed  # it got the command, it did not just fall silent
    facts = json.loads(thigmo("info", folder.path, "--json").out)
    assert facts["outcome"].startswith(outcome)
    assert facts["truncated"] == killed
    again = replay(folder.path)
    assert again.sweeps <= 1
    assert again.document.contacts == []


def test_an_interrupt_during_growth_stops_the_motor_and_leaves_a_readable_folder(
    tmp_path: Path, room: Scene, serve: Serve
) -> None:
    room.start_length_cm = 12.0  # it must grow before it may sweep
    served = serve(room)
    with exploring(served, tmp_path, room) as host:
        _await(host, lambda: served.board.motor != 0, "the spool never turned")
        host.send_signal(signal.SIGINT)
        assert served.off_within(LIMIT_S), "the motor still runs"
        _, said = host.communicate()
    assert host.returncode == 128 + signal.SIGINT
    _last_line(said, "thigmo: interrupted; the robot is vented")
    assert served.lockstep.plant.length_cm < 19.9
    folder = _folder(tmp_path, "aborted: interrupted by the operator")
    assert not folder.read_log().truncated


def test_a_cable_pulled_in_mid_sweep_vents_the_robot_and_leaves_a_readable_folder(
    tmp_path: Path, room: Scene, serve: Serve
) -> None:
    served = serve(room)
    with exploring(served, tmp_path, room) as host:
        _await(host, lambda: served.energised, "the sweep never opened a valve")
        served.close()
        assert not served.off
        for _ in range(round(LIMIT_S * 100)):  # of the robot's own time
            served.lockstep.advance()
        assert served.off
        _, said = host.communicate()
    assert host.returncode not in (0, -signal.SIGKILL)
    assert "cable" in _last_line(said, "thigmo: ")
    _folder(tmp_path, "aborted")


def _last_line(said: str, begins: str) -> str:
    """What ends the progress: one line."""
    *progress, line = said.splitlines()
    assert line.startswith(begins), said
    assert not any(word in before for before in progress for word in ("thigmo:", "Traceback"))
    return line


def _await(host: subprocess.Popen[str], condition: Callable[[], bool], otherwise: str) -> None:
    assert comes(lambda: condition() or host.poll() is not None), otherwise
    assert host.poll() is None, host.stderr and host.stderr.read()


def _folder(where: Path, outcome: str) -> RunFolder:
    """The run's folder, whose record can be read and whose outcome begins so."""
    (path,) = where.glob("*-cut-short")
    folder = RunFolder(path)
    assert folder.read_document().outcome.startswith(outcome)
    assert len(folder.read_log().entries) > 200
    return folder
