"""What goes wrong at the command line: each prints one clear line with the next step and no more.

Ports that are no robot, records that are none. Files and arguments are in tests/unit/test_cli.py.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from command import Ran, Thigmo
from emulated import Serve

from thigmo.config import RobotConfig
from thigmo.emulator.scene import Scene
from thigmo.link import client as client_module
from thigmo.link import protocol as wire
from thigmo.link.framing import encode

LINE = r"thigmo: [^\n]+; [^\n]+"  # what happened; what to do
THIGMO = [sys.executable, "-m", "thigmo"]


def one_line(ran: Ran, named: str) -> None:
    assert ran.code == 1
    assert ran.out == ""
    assert re.fullmatch(LINE, ran.err.strip()), ran.err
    assert re.search(named, ran.err), ran.err


# Ports.


class Speaker:
    """The far end of a port, which says the same over and over and hears nothing."""

    def __init__(self, says: Callable[[], bytes]) -> None:
        import tty

        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._says = says
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        os.set_blocking(self._master, False)
        while not self._end.wait(0.02):
            try:
                os.write(self._master, self._says())
                os.read(self._master, 4096)
            except BlockingIOError:
                continue

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)


def gps() -> bytes:
    return b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"


def another_schema() -> bytes:
    announce = wire.Announce(
        protocol=wire.PROTOCOL,
        schema_hash=wire.SCHEMA_HASH ^ 1,
        firmware_version=(0, 0, 9),
        board=wire.BoardKind.MEGA,
        boot_nonce=7,
        reset_cause=wire.ResetCause.POWER_ON,
    )
    return encode(announce, 0, 0)


@pytest.mark.parametrize(
    ("says", "named"),
    [
        (lambda: b"", "nothing|no answer|silent|nobody"),
        (gps, "not from a robot"),
        (lambda: os.urandom(64), "not from a robot"),
        (lambda: bytes(64), "no robot|nothing|nobody|no answer"),
        (another_schema, r"schema.*thigmo flash"),
    ],
    ids=["silence", "gps", "noise", "zeros", "another schema"],
)
def test_a_port_that_is_no_robot_of_ours(
    thigmo: Thigmo,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    says: Callable[[], bytes],
    named: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(client_module, "BOOT_LOADER_S", 0.6)
    monkeypatch.setattr(client_module, "SILENCE_S", 0.2)
    monkeypatch.setattr(wire.Hello, "DEADLINE_S", 0.3)
    speaker = Speaker(says)
    try:
        for command in (["info", "--robot", speaker.port], ["explore", "--robot", speaker.port]):
            one_line(thigmo(*command), named)
    finally:
        speaker.close()
    assert not (tmp_path / "runs").exists()


def test_a_robot_whose_constants_nobody_gave_is_not_explored(
    thigmo: Thigmo, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, serve: Serve
) -> None:
    """With the defaults it would report contacts that are none."""
    monkeypatch.chdir(tmp_path)
    port = serve(Scene.load("empty")).port
    one_line(thigmo("explore", "--robot", port), f"calibrate all --robot {port}")
    Path("calibration").mkdir()
    Path("calibration/actuator.json").touch()
    one_line(thigmo("explore", "--robot", port), r"--config calibration/robot\.toml")
    assert not Path("runs").exists()


# Files.


def test_a_run_folder_whose_record_is_garbage(thigmo: Thigmo, tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (run / "run.mcap").write_bytes(os.urandom(500))
    (run / "contacts.json").write_text("{")
    (run / "robot.toml").write_text("")
    for command in ("info", "replay"):
        one_line(thigmo(command, run), r"run\.mcap|contacts\.json")


def test_a_parameter_that_is_set_and_not_stored_is_said_to_be_lost(thigmo: Thigmo) -> None:
    command = ("params", "--robot", "emulator://default", "settle_ms", 2000)
    for stored, said in (((), LINE), (("--save",), "")):
        ran = thigmo(*command, "--json", *stored)
        assert (ran.code, json.loads(ran.out)["settle_ms"]["value"]) == (0, 2000)
        assert re.fullmatch(said, ran.err.strip()), ran.err


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_emulated_robot_is_served_until_it_is_told_to_end(
    tmp_path: Path, number: signal.Signals
) -> None:
    link = tmp_path / "robot"
    command = [*THIGMO, "emulate", "empty", "--link", str(link)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path
    ) as server:
        assert server.stdout is not None
        assert str(link).encode() in server.stdout.readline()
        constants = server.stdout.readline().decode().rpartition(" --config ")[2].strip()
        assert RobotConfig.load(tmp_path / constants) == Scene.load("empty").believed()
        assert link.is_symlink()
        server.send_signal(number)
        out, err = server.communicate()
    assert (out, err) == (b"", b"")
    assert server.returncode == 0
    assert not link.is_symlink()
