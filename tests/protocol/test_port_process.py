"""The process that holds the port, in real time over a pseudo-terminal.

The heart must outlive a busy main thread, even one that holds the interpreter lock, and must not
outlive the host.
"""

from __future__ import annotations

import os
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import pytest
import serial
from pty_device import PtyDevice
from reference_device import ReferenceDevice
from served import EVER_S, comes
from typer.testing import CliRunner

from thigmo.cli.main import app
from thigmo.errors import LinkError, NotARobotError, PortError
from thigmo.link import client as client_module
from thigmo.link import port_process
from thigmo.link import protocol as wire
from thigmo.link.address import OTHER_PLACE
from thigmo.link.client import Client
from thigmo.link.heartbeat import PERIOD_S
from thigmo.link.pipe import Kind, Packet, read_packet
from thigmo.link.serial_port import SerialTransport, waits_for_operator
from thigmo.link.transport import open_transport
from thigmo.robot.stopping import stop_robot

pytestmark = pytest.mark.realtime
LIMIT_S = 0.5  # the board's default limit of host silence
SETTLE = wire.PARAMETERS["settle_ms"].index


@pytest.fixture(autouse=True)
def sockets(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of its own: a test that stops all robots must stop no other test's."""
    with tempfile.TemporaryDirectory() as folder:  # pytest's are too long for a socket
        monkeypatch.setenv(OTHER_PLACE, folder)
        yield Path(folder) / f"thigmo-{os.getuid()}"


@pytest.fixture
def board() -> Iterator[PtyDevice]:
    with PtyDevice(ReferenceDevice()) as board:
        yield board


@pytest.fixture
def client(board: PtyDevice) -> Iterator[Client]:
    with Client(open_transport(board.port)) as client:
        client.wait_for(lambda: len(board.beats) >= 2, EVER_S)
        yield client


def gaps(board: PtyDevice, since: float) -> list[float]:
    times = [since] + [t for t in board.beats if t > since] + [board.now_s()]
    return [b - a for a, b in pairwise(times)]


def alive(pid: int) -> bool:
    """Whether a process runs (an orphan that ended but was not collected does not)."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


# A conversation.


def test_a_conversation_over_a_port(client: Client, board: PtyDevice) -> None:
    assert client.request(wire.SetParameter(SETTLE, 77)).value == 77
    assert client.wait_for(lambda: client.stats.telemetry >= 100, EVER_S)
    assert client.stats.telemetry_lost == 0
    assert client.stats.bad_frames == 0
    assert client.clock.synchronised
    with board.lock:
        now_us = board.device._t_us
    # The device's time slips where the computer is busy; the computer's began long ago.
    assert client.clock.to_host(now_us) == pytest.approx(client.now(), abs=10.0)


def test_a_busy_main_thread_starves_no_heart(client: Client, board: PtyDevice) -> None:
    began = board.now_s()
    while board.now_s() - began < 1.5:
        sum(range(1000))
    assert max(gaps(board, began)) < LIMIT_S
    stats = client.stats
    client.wait_for(lambda: stats.telemetry >= 300, EVER_S)
    assert stats.telemetry_lost == 0  # what came meanwhile was kept


@pytest.fixture
def short_lease(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leases of 2 s; what the board said last is not old because the computer is busy."""
    limits = f"p.LEASE_S, p.ENERGISED_LEASE_S, p._STATE_S = 2.0, 2.0, {EVER_S}"
    source = f"import thigmo.link.port_process as p; {limits}; p.main()"
    real = subprocess.Popen

    def popen(command, **options):
        assert command[1:3] == ["-m", "thigmo.link.port_process"]
        return real([command[0], "-c", source, *command[3:]], **options)

    monkeypatch.setattr(subprocess, "Popen", popen)


@pytest.mark.usefixtures("short_lease")
def test_the_lease_ends_the_heart_of_a_host_that_hangs_and_stops_an_armed_robot(
    board: PtyDevice,
) -> None:
    board.device.state = wire.State.READY
    with Client(open_transport(board.port)) as client:
        client.wait_for(lambda: len(board.beats) >= 12, EVER_S)
        assert board.silent_for() < LIMIT_S  # reading renews it
        assert not board.device.stops
        assert comes(lambda: board.silent_for() > 3 * PERIOD_S + 0.3)
        nonces = [nonce for _, nonce in board.device.stops]
        assert len(set(nonces)) == 1  # one stop, not one each time that the lease is looked at
        client.wait_for(lambda: board.silent_for() < LIMIT_S, EVER_S)
        assert board.silent_for() < LIMIT_S  # a touch starts the heart again


@pytest.mark.usefixtures("short_lease")
def test_the_lease_of_a_disarmed_robot_ends_without_a_stop(board: PtyDevice) -> None:
    with Client(open_transport(board.port)) as client:
        client.wait_for(lambda: len(board.beats) >= 3, EVER_S)
        assert comes(lambda: board.silent_for() > 3 * PERIOD_S + 0.3)
        assert not board.device.stops


@pytest.mark.usefixtures("short_lease")
def test_a_host_that_waits_for_its_operator_does_not_hang(board: PtyDevice) -> None:
    board.device.state = wire.State.READY
    with Client(open_transport(board.port)) as client:
        client.wait_for(lambda: len(board.beats) >= 3, EVER_S)
        waits_for_operator()
        began = board.now_s()
        assert not comes(lambda: bool(board.device.stops), 3.0)
        assert max(gaps(board, began)) < LIMIT_S
        client.poll()  # the answer has come: from now on it may hang again
        assert comes(lambda: bool(board.device.stops))


@pytest.mark.usefixtures("short_lease")
def test_no_operator_s_thinking_holds_an_output_energised(board: PtyDevice) -> None:
    board.device.state = wire.State.MOVING
    with Client(open_transport(board.port)) as client:
        client.wait_for(lambda: len(board.beats) >= 3, EVER_S)
        waits_for_operator()
        assert comes(lambda: bool(board.device.stops))


def test_a_muted_board_hears_no_beats_until_it_speaks(client: Client, board: PtyDevice) -> None:
    """It may be in its boot loader."""
    with board.lock:
        board.device.silent = True
        board.device.read()
    received: list[bytes] = []
    with board.lock:
        board.device.write = received.append
    client.wait_for(lambda: False, 1.5)
    assert len(received) <= 6
    with board.lock:
        del board.device.write
        board.device.silent = False
    count = len(board.beats)
    assert client.wait_for(lambda: len(board.beats) > count, EVER_S)


HOST = """
import sys
from thigmo.link.client import Client
from thigmo.link.transport import open_transport
client = Client(open_transport(sys.argv[1]))
print(client.transport.pid, flush=True)
client.wait_for(lambda: False, 60.0)
"""


@pytest.fixture
def host(board: PtyDevice) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    board.device.state = wire.State.MOVING
    process = subprocess.Popen(
        [sys.executable, "-c", HOST, board.port],
        stdout=subprocess.PIPE,
        start_new_session=True,  # a terminal of its own, as it were
    )
    assert process.stdout is not None
    pid = int(process.stdout.readline())
    assert comes(lambda: len(board.beats) > 3)
    yield process, pid
    with suppress(ProcessLookupError):
        process.send_signal(signal.SIGCONT)
    process.kill()
    process.wait()
    process.stdout.close()


def test_a_killed_host_takes_the_heart_with_it(
    board: PtyDevice, host: tuple[subprocess.Popen[bytes], int]
) -> None:
    process, pid = host
    process.send_signal(signal.SIGKILL)
    killed = board.now_s()
    process.wait()
    assert comes(lambda: not alive(pid)), "the port's process outlived its host"
    assert board.beats[-1] - killed < 0.4
    assert board.device.stops
    with Client(open_transport(board.port)):
        pass  # and the port is free again


def test_a_stopped_host_keeps_the_heart(
    board: PtyDevice, host: tuple[subprocess.Popen[bytes], int]
) -> None:
    process, _ = host
    process.send_signal(signal.SIGSTOP)
    stopped = board.now_s()
    assert not comes(lambda: board.silent_for() > LIMIT_S, 1.5)
    assert max(gaps(board, stopped)) < LIMIT_S
    process.send_signal(signal.SIGCONT)


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP, signal.SIGTERM])
def test_nothing_that_a_terminal_sends_takes_the_port_from_the_robot(
    board: PtyDevice, host: tuple[subprocess.Popen[bytes], int], number: signal.Signals
) -> None:
    _, pid = host
    os.kill(pid, number)
    if number == signal.SIGTERM:
        assert comes(lambda: bool(board.device.stops))
    assert not comes(lambda: not alive(pid) or board.silent_for() > LIMIT_S, 0.7)
    assert bool(board.device.stops) == (number == signal.SIGTERM)


@pytest.mark.parametrize("named", [True, False])
def test_thigmo_stop_works_beside_a_host_that_hangs(
    board: PtyDevice, host: tuple[subprocess.Popen[bytes], int], tmp_path: Path, named: bool
) -> None:
    process, _ = host
    process.send_signal(signal.SIGSTOP)
    by_id = tmp_path / "by-id"
    by_id.symlink_to(board.port)
    command = ["stop", "--robot", str(by_id)] if named else ["stop"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    where = by_id if named else board.port
    by = f"its board, through process {process.pid}"
    said = f"Stopped: {where}, confirmed by {by}. `thigmo clear --robot {where}` ends the stop.\n"
    assert result.output == said
    assert board.device.stops
    process.send_signal(signal.SIGCONT)
    assert board.silent_for() < LIMIT_S


def test_a_press_beside_a_program_that_ends_is_confirmed(
    board: PtyDevice, host: tuple[subprocess.Popen[bytes], int]
) -> None:
    """The second press, just after the one that ended the program."""
    process, _ = host
    assert not stop_robot(board.port)[0].failure
    process.terminate()
    while process.poll() is None:
        (pressed,) = stop_robot(board.port)
        assert not pressed.failure
    assert not stop_robot(board.port)[0].failure


def test_thigmo_stop_opens_a_port_that_nobody_owns(board: PtyDevice) -> None:
    result = CliRunner().invoke(app, ["stop", "--robot", board.port, "--json"])
    assert result.exit_code == 0, result.output
    assert board.device.stops
    assert not board.beats


def test_thigmo_stop_without_a_robot_says_so() -> None:
    result = CliRunner().invoke(app, ["stop"])
    assert str(result.exception).startswith(
        "NOT stopped: no program of yours drives a robot; use the emergency stop, or name its port"
    )


@pytest.mark.parametrize("place", ["TMPDIR", "XDG_RUNTIME_DIR", "HOME"])
def test_thigmo_stop_finds_a_robot_from_any_shell(
    board: PtyDevice,
    host: tuple[subprocess.Popen[bytes], int],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    place: str,
) -> None:
    monkeypatch.setenv(place, str(tmp_path))
    result = CliRunner().invoke(app, ["stop"])
    assert result.exit_code == 0, result.output
    assert board.device.stops


OTHER = """
import serial, sys
port = serial.serial_for_url(sys.argv[1], exclusive=True)
print("open", flush=True)
sys.stdin.read()
"""


def test_thigmo_stop_names_the_program_that_has_the_port(board: PtyDevice) -> None:
    words = [sys.executable, "-c", OTHER, board.port]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as driver:
        assert driver.stdout is not None
        driver.stdout.readline()
        result = CliRunner().invoke(app, ["stop", "--robot", board.port])
        assert result.exit_code == 1
        said = result.output
        assert said.startswith(f"thigmo: NOT stopped: {board.port} is in use by process ")
        assert f"process {driver.pid} (" in said
        assert "; use the emergency stop, or close the program" in said
        driver.communicate()
    assert not board.device.stops


def test_a_stop_that_the_board_does_not_hear_is_repeated_and_told(
    client: Client, board: PtyDevice
) -> None:
    hears = board.device.write
    with board.lock:
        board.device.write = lambda data: None  # type: ignore[method-assign]
    (stopped,) = stop_robot(board.port)
    assert "did not confirm the stop; use the emergency stop" in stopped.failure
    with board.lock:
        board.device.write = hears  # type: ignore[method-assign]
    assert comes(lambda: bool(board.device.stops))  # and it goes on trying


def test_a_folder_that_others_can_enter_takes_no_stops(sockets: Path, board: PtyDevice) -> None:
    sockets.mkdir(mode=0o755)
    sockets.chmod(0o755)
    with pytest.raises(LinkError, match=r"other users can enter .*; remove it"):
        Client(open_transport(board.port))


def test_only_the_same_user_reaches_the_socket(client: Client, sockets: Path) -> None:
    (socket_path,) = wait_for_sockets(sockets)
    assert stat.S_ISSOCK(socket_path.stat().st_mode)
    assert stat.S_IMODE(sockets.stat().st_mode) == 0o700
    client.close()
    assert not socket_path.exists()


def wait_for_sockets(folder: Path) -> list[Path]:
    assert comes(lambda: folder.exists() and any(folder.iterdir()))
    return list(folder.iterdir())


def test_closing_ends_the_process(board: PtyDevice) -> None:
    transport = open_transport(board.port)
    assert isinstance(transport, SerialTransport)
    transport.close()
    transport.close()
    assert not alive(transport.pid)
    with pytest.raises(LinkError):
        transport.write(b"x")


# Ports that fail.


def test_a_port_that_is_not_there() -> None:
    with pytest.raises(PortError, match=r"there is no port /dev/ttyNONE; (give one of|plug)"):
        open_transport("/dev/ttyNONE")


def test_a_file_is_no_port(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.touch()
    with pytest.raises(PortError, match="file is no serial port; "):
        open_transport(str(path))


def test_a_port_in_use(board: PtyDevice, client: Client) -> None:
    with pytest.raises(PortError, match=r"is in use by process \d+ \(.*\); close the prog"):
        open_transport(board.port)


def test_an_unknown_scheme() -> None:
    with pytest.raises(PortError, match="is no address that can be opened"):
        open_transport("carrier-pigeon://roof")


def test_a_server_that_does_not_listen() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"socket://127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(PortError, match="check that its server is running"):
        open_transport(address)


def test_a_baud_rate_that_is_none() -> None:
    with pytest.raises(PortError, match="fast is not a baud rate"):
        open_transport("/dev/ttyNONE?baud=fast")


@pytest.mark.parametrize(
    ("number", "text", "problem"),
    [
        (13, "Permission denied", "no permission to open X; add yourself to the group"),
        (16, "Device or resource busy", "X is in use"),
        (11, "Could not exclusively lock port X", "X is in use"),
        (2, "No such file", "there is no port X"),
        (25, "Inappropriate ioctl", "X is no serial port"),
        (0, "weird", "cannot open X: weird"),
    ],
)
def test_each_failure_has_its_words(number: int, text: str, problem: str) -> None:
    error = serial.SerialException(number, text) if number else serial.SerialException(text)
    assert str(port_process.port_error("X", error)).startswith(problem)


def test_a_cable_pulled_in_mid_conversation(client: Client, board: PtyDevice) -> None:
    board.unplug()
    with pytest.raises(LinkError, match=r"was lost: .*; check the cable"):
        client.wait_for(lambda: False, EVER_S)
    with pytest.raises(LinkError):
        client.request(wire.GetStatus())


def test_a_port_process_that_dies_is_told(client: Client) -> None:
    transport = client.transport
    assert isinstance(transport, SerialTransport)
    os.kill(transport.pid, signal.SIGKILL)
    with pytest.raises(LinkError, match=r"the process that holds .* (died|is gone)"):
        client.wait_for(lambda: False, EVER_S)


class Babble(ReferenceDevice):
    def read(self) -> bytes:
        return os.urandom(64)

    def write(self, data: bytes) -> None:
        pass


def test_a_port_that_is_not_a_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "BOOT_LOADER_S", 0.2)
    monkeypatch.setattr(client_module, "SILENCE_S", 0.2)
    monkeypatch.setattr(wire.Hello, "DEADLINE_S", 0.5)
    with (
        PtyDevice(Babble()) as board,
        pytest.raises(NotARobotError, match="bytes that are not from a robot"),
        Client(open_transport(board.port)),
    ):
        pass


@pytest.fixture
def bridge() -> Iterator[str]:
    """The address of a serial server, as socket:// of pyserial opens it, with a device behind it.
    It takes connections one after the other.
    """
    device = ReferenceDevice()
    stop = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.05)

        def serve() -> None:
            began = time.monotonic()
            while not stop.is_set():
                with suppress(OSError):
                    peer, _ = server.accept()
                    peer.settimeout(0.005)
                    with peer:
                        talk(peer, began)

        def talk(peer: socket.socket, began: float) -> None:
            while not stop.is_set():
                with suppress(TimeoutError):
                    if not (data := peer.recv(4096)):
                        return
                    device.write(data)
                device.step(int((time.monotonic() - began) * 1000) - device.now_us // 1000)
                peer.sendall(device.read())

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"socket://127.0.0.1:{server.getsockname()[1]}"
        stop.set()
        thread.join()


def test_over_a_socket_from_hello_to_a_quiet_end(
    bridge: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with Client(open_transport(bridge)) as client:
        assert client.request(wire.SetParameter(SETTLE, 9)).value == 9
        assert client.wait_for(lambda: client.stats.telemetry >= 50, EVER_S)
        assert client.stats.telemetry_lost == 0
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")


def test_two_programs_never_drive_one_serial_server(bridge: str, sockets: Path) -> None:
    with Client(open_transport(bridge)) as client:
        alias = bridge.replace("127.0.0.1", "localhost")
        with pytest.raises(PortError, match=rf"is in use by process {os.getpid()} \(.*; close the"):
            open_transport(alias)
        (stopped,) = stop_robot(alias)
        assert stopped.confirmed_by == f"its board, through process {os.getpid()}"
        assert client.wait_for(lambda: client.stats.telemetry >= 50, EVER_S)
    assert [path for path in sockets.iterdir() if path.is_socket()] == []
    (stopped,) = stop_robot(alias)
    assert stopped.confirmed_by == "its board, over its port, which no program had open"


# The backlog for a host that does not read.


def test_a_host_that_does_not_read_loses_the_oldest_bytes() -> None:
    reader, writer = os.pipe()
    with os.fdopen(reader, "rb") as source, os.fdopen(writer, "wb") as sink:
        outbox = port_process.Outbox(sink, backlog_bytes=100_000)
        for number in range(1000):
            outbox.put(Packet(Kind.DATA, number.to_bytes(4, "little") * 256, float(number)))
        kept = [-1.0]
        while kept[-1] < 999.0:
            packet = read_packet(source)
            assert packet is not None
            kept.append(packet.t_s)
        outbox.close(1.0)
    assert kept == sorted(kept)
    # What fits into the backlog, and what the pipe had taken before.
    assert kept[-97:] == [float(number) for number in range(903, 1000)]
    assert len(kept) < 300
