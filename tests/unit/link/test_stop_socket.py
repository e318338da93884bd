"""Who takes a robot's stops, and that neither callers nor other programs keep one away from it."""

from __future__ import annotations

import os
import socket
import threading
from contextlib import ExitStack
from multiprocessing.connection import Client
from pathlib import Path

import pytest

from thigmo.errors import LinkError, PortError
from thigmo.link.address import AddressLock, names
from thigmo.link.stop_socket import Answer, StopListener, call, owners, running

pytestmark = pytest.mark.usefixtures("own_sockets")
URL = "socket://127.0.0.1:4000"
PID = os.getpid()


def _listener(url: str = URL, **options: bool) -> StopListener:
    return StopListener(url, lambda: True, program=PID, **options)


def test_a_caller_that_says_nothing_holds_up_nobody() -> None:
    with _listener(), ExitStack() as stack:
        (where,) = owners(URL)
        for _ in range(20):
            stack.enter_context(Client(where))
        assert call(where) == Answer("stopped", PID, URL)


def test_a_second_owner_is_refused_and_takes_nothing_away() -> None:
    with _listener():
        with pytest.raises(PortError, match="is in use by another program"):
            _listener()
        (where,) = owners(URL)
        assert call(where) == Answer("stopped", PID, URL)
    assert running() == []


def test_the_socket_of_a_killed_owner_is_replaced() -> None:
    with _listener():
        (where,) = owners(URL)
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(where)
    with _listener():
        assert call(where) == Answer("stopped", PID, URL)


def test_an_owner_removes_its_own_socket_only() -> None:
    first = _listener()
    (where,) = owners(URL)
    Path(where).unlink()  # somebody cleared the folder away
    with _listener():
        first.close()
        assert call(where) == Answer("stopped", PID, URL)


def test_who_has_called_when_the_owner_closes_is_answered() -> None:
    begun, go_on = threading.Event(), threading.Event()
    answers: list[Answer | None] = []

    def stop() -> bool:
        begun.set()
        return go_on.wait(60)

    listener = StopListener(URL, stop, program=PID)
    (where,) = owners(URL)
    callers = [threading.Thread(target=lambda: answers.append(call(where))) for _ in range(5)]
    for caller in callers:
        caller.start()
    assert begun.wait(60)
    closing = threading.Thread(target=listener.close)
    closing.start()
    go_on.set()
    for thread in (*callers, closing):
        thread.join()
    # Nobody hears that a stop was not confirmed; who comes too late finds nobody.
    assert set(answers) <= {Answer("stopped", PID, URL), None}
    assert Answer("stopped", PID, URL) in answers


def test_an_emulated_robot_that_ends_meanwhile_is_told_to_have_ended() -> None:
    over = threading.Event()

    def stop() -> bool:
        over.wait(60)
        return False  # its board takes no more frames

    listener = StopListener("emulator://empty", stop, program=PID, emulated=True)
    (where,) = owners("emulator://empty", PID)
    answers: list[Answer | None] = []
    caller = threading.Thread(target=lambda: answers.append(call(where)))
    caller.start()
    closing = threading.Thread(target=listener.close)
    closing.start()
    while not listener._closed:
        pass
    over.set()
    caller.join()
    closing.join()
    assert answers[0] in (Answer("ended", PID, "emulator://empty"), None)


def test_an_owner_that_is_suspended_with_a_full_queue_is_told() -> None:
    with _listener():
        (where,) = owners(URL)
    with socket.socket(socket.AF_UNIX) as suspended, ExitStack() as stack:
        suspended.bind(where)
        suspended.listen(0)
        stack.enter_context(Client(where))  # fills its queue
        with pytest.raises(LinkError, match="does not answer; use the emergency stop"):
            call(where)
        with pytest.raises(PortError, match="is in use by another program"):
            _listener()


@pytest.mark.parametrize(
    "spelling",
    ["socket://localhost:4000", "rfc2217://127.0.0.1:4000", "SOCKET://127.0.0.1:4000?logging=info"],
)
def test_one_robot_has_one_owner_however_its_address_is_written(spelling: str) -> None:
    with _listener():
        assert owners(spelling) == owners(URL) != []
    with AddressLock(URL, PID):
        with pytest.raises(PortError, match=rf"{PID} \(.*; close the program that drives it"):
            AddressLock(spelling, PID)
        AddressLock("socket://127.0.0.1:4001", PID).close()
    AddressLock(spelling, PID).close()


def test_a_link_and_its_port_are_one_robot(tmp_path: Path) -> None:
    port, link = tmp_path / "port", tmp_path / "by-id"
    port.touch()
    link.symlink_to(port)
    with _listener(str(link)):
        assert owners(f"{port}?baud=500000") == owners(str(link)) != []
        link.unlink()  # the cable was pulled
        assert owners(str(link)) != []


def test_a_host_that_cannot_be_resolved_is_still_known_by_its_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    url = "socket://robot.invalid:4000"
    monkeypatch.setattr(socket, "getaddrinfo", lambda *asked, **options: _fails())
    assert len(names(url)) == 1
    with _listener(url):
        assert owners(url) != []


def _fails() -> list[object]:
    raise socket.gaierror("no name service")
