"""The page's door: a stop gets through whoever else is there."""

from __future__ import annotations

import asyncio
import json
import queue
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from typing import Any

import pytest
from aiohttp import web
from page_server import Served

from thigmo.live.server import WatchOptions
from thigmo.live.stop_http import StopHttp

REFUSED = b"403"
GARBAGE = [
    b"\x00\xff\x00\r\n\r\n",
    b"GET / HTTP/9.9\r\n\r\n",
    b"GET /\x80 HTTP/1.1\r\nHost: x\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost: a:b:c\r\n\r\n",
    b"POST /stop\r\n\r\n",
    b"POST /stop HTTP/1.1\r\nHost",
]


@pytest.fixture
def address(own_sockets: None) -> Iterator[str]:
    """Where a page is served, in a thread."""
    server = Served(WatchOptions(port=0))
    yield server.address
    server.close()


def _place(address: str) -> tuple[str, int]:
    host, _, port = address.removeprefix("http://").partition("/")[0].partition(":")
    return host, int(port)


def _asked(address: str, request: str) -> bytes:
    """What a server answers to a request of the page."""
    place = _place(address)
    host = f"{place[0]}:{place[1]}"
    with socket.create_connection(place, timeout=60) as caller:
        caller.sendall(request.format(host=host, origin=f"http://{host}").encode())
        answer = b""
        while more := caller.recv(65536):
            answer += more
    return answer


STOP = "POST /stop HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\nContent-Length: 0\r\n\r\n"


def test_a_stop_needs_no_token_and_everything_else_does(address: str) -> None:
    head, _, body = _asked(address, STOP).partition(b"\r\n\r\n")
    assert b"200" in head.splitlines()[0]
    assert b"frame-ancestors 'none'" in head
    said = json.loads(body)
    assert (said["stopped"], said["failed"]) == ([], "")  # no robot is in use
    assert REFUSED in _asked(address, "GET / HTTP/1.1\r\nHost: {host}\r\n\r\n").splitlines()[0]
    evil = STOP.replace("{origin}", "http://evil.example")
    assert REFUSED in _asked(address, evil).splitlines()[0]
    named = STOP.replace("{host}", "evil.example").replace("{origin}", "http://evil.example")
    assert REFUSED in _asked(address, named).splitlines()[0]


@pytest.mark.parametrize("says", [b"", b"GET /", b"GET / HTTP/1.1\r\n", STOP[:22].encode()])
def test_stops_get_through_hundreds_who_never_finish(address: str, says: bytes) -> None:
    with ExitStack() as stack:
        guests = [
            stack.enter_context(socket.create_connection(_place(address), timeout=60))
            for _ in range(700)
        ]
        for _ in range(9):
            for guest in guests:
                with suppress(OSError):  # it was turned out
                    guest.sendall(says)
            assert b"200" in _asked(address, STOP).splitlines()[0]
        # And the page opens: who never finishes keeps no place of its server.
        assert b"302" in _asked(address, _get(address)).splitlines()[0]


def _get(address: str) -> str:
    """A request for the page, with its token."""
    return f"GET /{address.rpartition('/')[2]} HTTP/1.1\r\nHost: {{host}}\r\n\r\n"


@pytest.mark.parametrize("drips", [b"POST /stop HTTP/1.1\r\nX: ", b"GET / HTTP/1.1\r\nX: "])
def test_request_has_one_deadline_however_it_drips(address: str, drips: bytes) -> None:
    with socket.create_connection(_place(address), timeout=0.1) as caller:
        caller.sendall(drips)
        while _is_open(caller):
            with suppress(ConnectionError):
                caller.sendall(b"x")


def _is_open(caller: socket.socket) -> bool:
    """Whether nothing, not even an end, comes for a moment."""
    try:
        return bool(caller.recv(1))
    except TimeoutError:
        return True
    except ConnectionError:
        return False


@pytest.mark.parametrize(
    "rest", ["POST / HTTP/1.1\r\n", "GET / HTTP/1.1\r\nContent-Length: 9\r\n", "PUT /stop X\r\n"]
)
def test_nothing_but_a_stop_may_keep_the_server_waiting_for_more(address: str, rest: str) -> None:
    assert b"405" in _asked(address, f"{rest}Host: {{host}}\r\n\r\n").splitlines()[0]


@pytest.fixture
def slow() -> Iterator[tuple[StopHttp, threading.Event, list[str]]]:
    """A door whose stops take until an event; and who asked for each."""
    go_on = threading.Event()
    asked: list[str] = []

    def stop(peer: str) -> dict[str, Any]:
        asked.append(peer)
        assert go_on.wait(60)
        if len(asked) == 2:
            raise OSError("the wire broke")
        return {"stopped": ["robot"]}

    async def keep() -> None:
        with StopHttp(("127.0.0.1", 0), web.Server(_nobody), stop) as door:
            doors.put(door)
            await asyncio.to_thread(closing.wait)

    doors: queue.SimpleQueue[StopHttp] = queue.SimpleQueue()
    closing = threading.Event()
    thread = threading.Thread(target=lambda: asyncio.run(keep()))
    thread.start()
    yield doors.get(), go_on, asked
    go_on.set()
    closing.set()
    thread.join()


async def _nobody(request: web.BaseRequest) -> web.StreamResponse:
    raise AssertionError("nothing but stops is asked for")


def test_a_complete_stop_is_never_turned_out_and_all_that_wait_are_answered_by_one(
    slow: tuple[StopHttp, threading.Event, list[str]],
) -> None:
    door, go_on, asked = slow
    whole = STOP.format(host=f"127.0.0.1:{door.port}", origin=f"http://127.0.0.1:{door.port}")
    with ExitStack() as stack:
        pressed = []
        for _ in range(20):
            pressed.append(stack.enter_context(_connected(door)))
            pressed[-1].sendall(whole.encode())
        for _ in range(700):
            stack.enter_context(_connected(door)).sendall(b"POST /stop")
        go_on.set()
        answers = [b"".join(iter(lambda p=press: p.recv(4096), b"")) for press in pressed]  # type: ignore[misc]
    assert all(b"200" in answer.splitlines()[0] for answer in answers)
    assert set(asked) == {"127.0.0.1"}
    assert len(asked) <= 3  # those that came while one was under way share the next


def test_a_stop_that_fails_is_told_and_the_next_one_is_answered(
    slow: tuple[StopHttp, threading.Event, list[str]],
) -> None:
    door, go_on, _ = slow
    go_on.set()
    address = f"http://127.0.0.1:{door.port}/"
    answers = [json.loads(_asked(address, STOP).partition(b"\r\n\r\n")[2]) for _ in range(3)]
    assert answers[0] == answers[2] == {"stopped": ["robot"]}
    assert (answers[1]["stopped"], "the wire broke" in answers[1]["failed"]) == ([], True)
    assert "emergency stop" in answers[1]["failed"]


def _connected(door: StopHttp) -> socket.socket:
    return socket.create_connection(("127.0.0.1", door.port), timeout=60)


def test_malformed_requests_print_nothing(
    address: str, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    for garbage in GARBAGE:
        with socket.create_connection(_place(address), timeout=60) as caller:
            caller.sendall(garbage)
            caller.shutdown(socket.SHUT_WR)
            while caller.recv(65536):
                pass
    assert b"200" in _asked(address, STOP).splitlines()[0]
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")
    assert [record for record in caplog.records if record.levelname != "DEBUG"] == []
