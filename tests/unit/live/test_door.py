"""The page's door: a stop gets through whoever else is there."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from page_server import Served

from thigmo.live.server import WatchOptions

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


@pytest.mark.parametrize("says", [b"", b"GET /", b"POST /stop HTTP/1.1\r\n"])
def test_a_stop_gets_through_hundreds_who_never_go_on(address: str, says: bytes) -> None:
    with ExitStack() as stack:
        for _ in range(400):
            guest = stack.enter_context(socket.create_connection(_place(address), timeout=60))
            guest.sendall(says)
        assert b"200" in _asked(address, STOP).splitlines()[0]


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
    assert [each for each in caplog.records if each.levelname != "DEBUG"] == []
