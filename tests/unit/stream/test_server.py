"""The stream between processes: who may listen, what he gets, and that nobody has to wait."""

from __future__ import annotations

import os
import queue
import socket
import threading
from collections.abc import Iterator
from multiprocessing.connection import Client
from pathlib import Path

import pytest
from contacts import a_telemetry
from test_hub import a_state, an_event

from thigmo.errors import LinkError
from thigmo.link import stop_socket
from thigmo.stream import (
    Command,
    Dropped,
    Hello,
    Hub,
    RunState,
    Server,
    attach,
    running,
)
from thigmo.stream.hub import QUEUE

HELLO = Hello(0.0, 1.7e9, "emulator://default", "two pegs/1", "/run", os.getpid(), "0.1.0", True)


class Run:
    """A hub that is served, and the commands that came."""

    def __init__(self) -> None:
        self.hub = Hub()
        self.commands: queue.Queue[tuple[Command, str]] = queue.Queue()
        self.server = Server(self.hub, HELLO, lambda *said: self.commands.put(said))


@pytest.fixture
def run() -> Iterator[Run]:
    run = Run()
    yield run
    run.server.close()


def test_a_viewer_gets_hello_what_was_last_and_what_follows(run: Run) -> None:
    run.hub.publish(a_state(1.0))
    with attach(run.server.address) as viewer:
        assert viewer.hello == HELLO
        assert viewer.get() == a_state(1.0)  # now it is attached
        run.hub.publish(a_telemetry(2.0))
        run.hub.publish(an_event(3.0))
        assert [viewer.get(), viewer.get()] == [a_telemetry(2.0), an_event(3.0)]


def test_the_end_of_the_run_ends_the_stream_after_its_last_message(run: Run) -> None:
    run.hub.publish(a_state(1.0))
    with attach(run.server.address) as viewer:
        assert viewer.get() == a_state(1.0)
        run.hub.publish(a_state(2.0, "done"))
        run.hub.close()
        run.server.close()
        assert list(viewer) == [a_state(2.0, "done")]
        with pytest.raises(LinkError, match="has ended"):
            viewer.send("pause")


def test_commands_reach_the_run_and_anything_else_does_not(run: Run) -> None:
    with Client(run.server.address) as raw:
        for data in (b"", b"{", b"[1]", b'{"command": "explode"}', b'{"command": {}}'):
            raw.send_bytes(data)
        raw.send_bytes(b'{"command": "stop"}')
        assert run.commands.get() == ("stop", "")
    with attach(run.server.address) as viewer:
        viewer.send("pause")
        viewer.send("answer", "20,5 cm")
        assert [run.commands.get() for _ in range(2)] == [("pause", ""), ("answer", "20,5 cm")]
    assert run.commands.empty()


def test_a_viewer_that_stalls_keeps_nobody_waiting_and_is_told_what_it_lost(run: Run) -> None:
    run.hub.publish(a_state(0.5))
    with attach(run.server.address) as stalled, attach(run.server.address) as other:
        assert stalled.get() == other.get() == a_state(0.5)
        count = 3 * QUEUE  # more than the socket and the queue hold
        for number in range(count):
            run.hub.publish(a_telemetry(float(number)))
        run.hub.publish(a_state(9.0, "done"))
        run.hub.close()
        got, lost, states = 0, 0, []
        for message in stalled:
            if isinstance(message, Dropped):
                lost += message.count
            elif isinstance(message, RunState):
                states.append(message.doing)
            else:
                got += 1
        assert lost > 0
        assert states[-1] == "done"
        assert got + lost >= count


def test_a_run_is_found_while_it_is_under_way_and_only_then(run: Run) -> None:
    assert run.server.address in [found_run.address for found_run in running()]
    run.server.close()
    assert run.server.address not in [found_run.address for found_run in running()]
    with pytest.raises(LinkError, match="no run is under way"):
        attach(run.server.address)


def test_no_thread_outlives_its_run() -> None:
    before = threading.active_count()
    for _ in range(3):
        run = Run()
        with attach(run.server.address):
            run.server.close()
    assert threading.active_count() <= before  # those of earlier tests may end meanwhile


def test_a_connection_that_is_closed_meanwhile_has_ended(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    run.hub.publish(a_state(1.0))
    with attach(run.server.address) as viewer:
        reading = viewer._connection

        def closed_meanwhile() -> bytes:
            viewer.close()
            return os.read(reading._handle, 4)  # type: ignore[attr-defined, no-any-return]

        monkeypatch.setattr(reading, "recv_bytes", closed_meanwhile)
        with pytest.raises(EOFError):
            viewer.get()
        with pytest.raises(LinkError, match="has ended"):
            viewer.send("pause")


def test_what_a_killed_run_left_behind_is_cleared_away(run: Run) -> None:
    left = Path(run.server.address + "x")
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(left))
        running()
        assert left.exists()  # a run that just begins is no run that was killed
    os.utime(left, (0, 0))
    running()
    assert not left.exists()


def test_only_the_user_can_enter_and_stops_of_ports_are_no_streams(run: Run) -> None:
    folder = Path(run.server.address).parent
    assert folder.stat().st_mode & 0o077 == 0
    assert run.server.address not in stop_socket.running()
    assert str(folder) not in stop_socket.running()
