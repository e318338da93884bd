"""`thigmo stop` beside explorations that emulate their robot."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from command import Thigmo
from served import comes

from thigmo.errors import PortError
from thigmo.link import protocol as wire
from thigmo.link import stop_socket
from thigmo.link.client import Client
from thigmo.link.transport import open_transport
from thigmo.record import RunFolder
from thigmo.robot.stopping import Stopped, stop_robot

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("own_sockets")]
URL = "emulator://mid_body"
Explore = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def explore(tmp_path: Path) -> Iterator[Explore]:
    """Starts explorations at the clock's pace."""
    started: list[subprocess.Popen[str]] = []

    def start(*options: str) -> subprocess.Popen[str]:
        count = len(stop_socket.owners(URL))
        command = [sys.executable, "-m", "thigmo", "explore", "--realtime", "--robot", URL]
        started.append(
            subprocess.Popen(
                [*command, "--out", str(tmp_path), *options],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        )
        assert comes(lambda: len(stop_socket.owners(URL)) > count)
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("named", [True, False])
def test_an_emulated_run_is_stopped_and_its_board_has_confirmed_it(
    explore: Explore, thigmo: Thigmo, tmp_path: Path, named: bool
) -> None:
    run = explore()
    assert comes(lambda: any(tmp_path.glob("*/run.mcap")))
    answer = thigmo("stop", *(("--robot", URL) if named else ()))
    assert (answer.code, answer.err) == (0, "")
    by = (
        f"its board, through process {run.pid}",
        f"the end of process {run.pid}, which emulated it",
    )
    assert answer.out in [f"Stopped: {URL}, confirmed by {confirmer}.\n" for confirmer in by]
    _, said = run.communicate()
    assert run.returncode == 1
    assert "stopped" in said
    (folder,) = tmp_path.glob("*-mid_body")
    assert RunFolder(folder).read_document().outcome.startswith("aborted: ")
    assert "stopped" in RunFolder(folder).read_document().outcome


def test_all_runs_of_an_emulated_robot_are_stopped(explore: Explore, thigmo: Thigmo) -> None:
    runs = [explore("--seed", "1"), explore("--name", "other")]
    assert thigmo("stop", "--robot", URL).code == 0
    assert [run.wait() for run in runs] == [1, 1]


def test_nothing_that_runs_is_nothing_that_was_stopped(thigmo: Thigmo) -> None:
    answer = thigmo("stop", "--robot", URL)
    assert answer.code == 1
    assert answer.out == ""
    assert answer.err.startswith(
        f"thigmo: NOT stopped: no program of yours runs {URL}; use the emergency stop"
    )


def test_a_run_that_hangs_is_told(explore: Explore, thigmo: Thigmo) -> None:
    run = explore()
    os.kill(run.pid, signal.SIGSTOP)
    answer = thigmo("stop", "--robot", URL)
    os.kill(run.pid, signal.SIGCONT)
    assert answer.code == 1
    assert answer.err.startswith("thigmo: NOT stopped: the program behind ")
    assert answer.err.count("\n") == 1


def test_every_robot_is_listed_with_its_result(explore: Explore, thigmo: Thigmo) -> None:
    hangs, runs = explore(), explore("--name", "other")
    os.kill(hangs.pid, signal.SIGSTOP)
    answer = thigmo("stop", "--json")
    os.kill(hangs.pid, signal.SIGCONT)
    assert answer.code == 1
    robots = json.loads(answer.out)["robots"]
    assert sorted(bool(robot["failure"]) for robot in robots) == [False, True]
    assert json.loads(answer.out)["stopped"] == [URL]
    assert answer.err.startswith("thigmo: NOT stopped: emulator-mid_body: the program behind ")
    assert runs.wait() == 1


@pytest.mark.parametrize("scheme", ["emulator", "mega-sim", "micropython"])
def test_every_emulated_board_takes_a_stop(scheme: str) -> None:
    url = f"{scheme}://empty"
    results: list[Stopped] = []
    try:
        transport = open_transport(url)
    except PortError as error:  # its compiler or simulator is not installed
        pytest.skip(str(error))
    with Client(transport) as client:
        stopping = threading.Thread(target=lambda: results.extend(stop_robot(url)))
        stopping.start()
        while stopping.is_alive():
            client.poll(0.01)
        report = client.request(wire.GetStatus())
    assert [result.failure for result in results] == [""]
    assert wire.Fault.STOPPED in wire.Fault.from_mask(report.faults)
