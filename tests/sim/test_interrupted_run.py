"""An exploration that is interrupted or killed in mid-sweep, in real time over a pseudo-terminal.

A host in a process of its own explores the emulated robot on a port, as it would a real one. When
the valve is open it is interrupted or killed: the robot must be vented, and the folder readable.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.scene import Scene
from thigmo.emulator.serve import PtyServer
from thigmo.exploration import replay
from thigmo.record import OBSTACLES_FILE, RunFolder, read_obstacles, read_ros_map

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs pseudo-terminals")
HEARTBEAT_LIMIT_S = 0.5
SLACK_S = 1.0  # of a loaded computer's real time

HOST = """
import sys
from thigmo.cli.main import app
from thigmo.cli import console

class Operator(console.TerminalOperator):
    def everted_length_cm(self): return 20.0
    def set_body_pressure(self, pressure_psi): pass

console.TerminalOperator = Operator
from thigmo.cli.main import main
sys.argv = ["thigmo", "explore", "--robot", sys.argv[1], "--config", sys.argv[2], "--out",
            sys.argv[3], "--name", "cut short", "--json"]
main()
"""


@pytest.fixture
def room() -> Scene:
    """The robot 20 cm out, with sensors that settle at once: real time is dear."""
    scene = Scene.load("empty")
    scene.start_length_cm = 20.0
    scene.robot.sensors.settle_s = 0.2
    return scene


@pytest.fixture
def served(room: Scene) -> Iterator[tuple[str, VirtualBoard]]:
    """A port on which the robot answers, and its board."""
    board = VirtualBoard(1)
    lockstep = Lockstep(room, board, seed=1)
    for _ in range(100):
        lockstep.advance()  # compiled before real time begins
    server = PtyServer(lockstep)
    on = threading.Event()
    on.set()
    thread = threading.Thread(target=lambda: server.run(on.is_set))
    thread.start()
    yield server.path, board
    on.clear()
    thread.join()
    server.close()


def _within(condition: Callable[[], bool], seconds: float) -> bool:
    never = threading.Event()
    until = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > until:
            return False
        never.wait(0.01)
    return True


@pytest.mark.parametrize(
    ("number", "outcome"),
    [
        (signal.SIGINT, "aborted: interrupted by the operator"),
        (signal.SIGTERM, "aborted: terminated"),
        (signal.SIGKILL, "running"),
    ],
)
def test_a_run_cut_short_in_mid_sweep_leaves_a_vented_robot_and_a_readable_folder(
    tmp_path: Path,
    room: Scene,
    served: tuple[str, VirtualBoard],
    number: signal.Signals,
    outcome: str,
) -> None:
    port, board = served
    room.robot.save(tmp_path / "robot.toml")
    command = [sys.executable, "-c", HOST, port, str(tmp_path / "robot.toml"), str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as host:
        swept = _within(lambda: any(board.drive_enabled) or host.poll() is not None, 60.0)
        assert swept, "the sweep never opened a valve"
        assert host.poll() is None, host.stderr and host.stderr.read()
        host.send_signal(number)
        limit = HEARTBEAT_LIMIT_S + SLACK_S
        assert _within(lambda: not any(board.drive_enabled), limit), "a valve is still open"
        _, said = host.communicate(timeout=20)
    if number == signal.SIGKILL:
        assert host.returncode == -signal.SIGKILL
    else:
        assert host.returncode == 128 + number
        (line,) = said.decode().splitlines()
        assert line.startswith("thigmo: interrupted; the robot is vented")
        assert "cut-short" in line
    assert board.motor == 0
    assert board.braked
    (path,) = tmp_path.glob("*-cut-short")
    folder = RunFolder(path)
    assert folder.read_document().outcome == outcome
    if number != signal.SIGKILL:
        assert read_obstacles(path / OBSTACLES_FILE).outcome == outcome
        assert read_ros_map(path / "map.yaml").cells.size
    log = folder.read_log()
    assert log.truncated == (number == signal.SIGKILL)
    assert len(log.entries) > 500
    again = replay(path)
    assert again.sweeps <= 1
    assert again.document.contacts == []
