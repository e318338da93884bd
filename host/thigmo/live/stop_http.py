"""The page's listener: takes every connection, reads each request's head, answers stops itself.

A stop must not wait for those who look, however many they are and whatever they leave unread or
unsaid. One thread accepts all connections of the page's port and reads how each begins. Every
request has one deadline for the whole of its head. When places run out, the oldest connection whose
request is not complete goes; one that is complete is never turned out. A complete stop is answered
by a thread that stops the robot, all that wait at once; any other complete request goes to the
page's server while there is room. A browser opens a connection for each request, because the server
closes each after its answer.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
import queue
import selectors
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from http.client import HTTPException, parse_headers
from io import BytesIO
from typing import Any, cast

from aiohttp import web

from thigmo.closing import Closing
from thigmo.live.guard import HEADERS, refusal

_MOST_GUESTS = 64  # connections of the page's server
_MOST_UNFINISHED = 512  # connections whose request is not complete; browsers open some ahead
_MOST_HEAD = 16_384  # bytes of a request's head; a browser's is below 2 000
_HEAD_END = b"\r\n\r\n"
_BACKLOG = 1024
# From a request's first byte to the end of its head. A phone at the edge of a wireless network
# repeats a lost packet after 0.2 to 1 s.
_PATIENCE_S = 2.0

Stop = Callable[[str], dict[str, Any]]
"""Stops the robot for a computer at an address, from any thread, which may take seconds: what came
of it, for the page."""

_LOG = logging.getLogger("thigmo.live")


@dataclass(slots=True)
class _Caller:
    """A connection whose request is not complete."""

    guest: socket.socket
    head: bytearray = field(default_factory=bytearray)
    until_s: float = math.inf  # deadline of its request, once it has begun


@dataclass(frozen=True, slots=True)
class _Request:
    """The head of a request. Headers are looked up without regard to case."""

    method: str
    path: str
    headers: Mapping[str, str]

    @classmethod
    def parse(cls, head: bytes) -> _Request:
        """Raises ValueError or HTTPException if it is none."""
        line, _, rest = head.partition(b"\r\n")
        method, path, _version = line.decode("latin-1").split(" ")
        return cls(method, path, cast("Mapping[str, str]", parse_headers(BytesIO(rest))))

    @property
    def has_body(self) -> bool:
        """Whether more is to come than its head."""
        return self.headers.get("Content-Length", "0") != "0" or (
            "Transfer-Encoding" in self.headers
        )


class StopHttp(Closing):
    """Listens at an address until it is closed; OSError if it cannot."""

    def __init__(self, place: tuple[str, int], server: web.Server, stop: Stop) -> None:
        family = socket.AF_INET6 if ":" in place[0] else socket.AF_INET
        self._listener = socket.create_server(place, family=family, backlog=_BACKLOG)
        self._listener.setblocking(False)
        self.port = int(self._listener.getsockname()[1])
        self._server = server
        self._loop = asyncio.get_running_loop()
        self._stop = stop
        self._stops: queue.SimpleQueue[socket.socket | None] = queue.SimpleQueue()
        self._unfinished: dict[socket.socket, _Caller] = {}  # the oldest first
        self._entering: set[asyncio.Task[object]] = set()
        self._wake, self._woken = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        for watched in (self._listener, self._woken):
            self._selector.register(watched, selectors.EVENT_READ)
        self._closed = False
        self._thread = threading.Thread(target=self._keep, daemon=True)
        self._thread.start()
        threading.Thread(target=self._obey, daemon=True).start()

    def close(self) -> None:
        """Refuse further connections."""
        self._closed = True
        self._wake.close()
        self._thread.join()
        self._stops.put(None)
        for connection in (self._listener, self._woken, *self._unfinished):
            connection.close()
        self._selector.close()

    # The thread of all who have not said everything.

    def _keep(self) -> None:
        while not self._closed:
            # Who is here is heard before others are let in, so that those turn out nobody who has
            # said everything by now.
            ready = {key.fileobj for key, _ in self._selector.select(self._waits_s())}
            for caller in [c for guest, c in self._unfinished.items() if guest in ready]:
                self._hear(caller)
            if self._listener in ready:
                self._greet()
            self._turn_out_late()

    def _waits_s(self) -> float | None:
        """How long until the next deadline; None if there is none."""
        until_s = min((c.until_s for c in self._unfinished.values()), default=math.inf)
        return None if math.isinf(until_s) else max(until_s - time.monotonic(), 0.0)

    def _greet(self) -> None:
        try:
            guest, _ = self._listener.accept()
        except OSError:  # it has gone again, or this process has no place for one more
            self._turn_out_oldest()
            return
        if len(self._unfinished) >= _MOST_UNFINISHED:
            self._turn_out_oldest()
        guest.setblocking(False)
        caller = self._unfinished[guest] = _Caller(guest)
        self._selector.register(guest, selectors.EVENT_READ)
        self._hear(caller)  # most send their request at once

    def _hear(self, caller: _Caller) -> None:
        try:
            data = caller.guest.recv(_MOST_HEAD)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        caller.head += data
        if data and _HEAD_END in caller.head:
            self._forget(caller)
            self._take(caller.guest, bytes(caller.head))
        elif not data or len(caller.head) >= _MOST_HEAD:
            self._turn_out(caller)
        elif math.isinf(caller.until_s):
            caller.until_s = time.monotonic() + _PATIENCE_S

    def _turn_out_late(self) -> None:
        now_s = time.monotonic()
        for caller in [c for c in self._unfinished.values() if c.until_s <= now_s]:
            self._turn_out(caller)

    def _turn_out_oldest(self) -> None:
        if self._unfinished:
            self._turn_out(next(iter(self._unfinished.values())))

    def _turn_out(self, caller: _Caller) -> None:
        self._forget(caller)
        caller.guest.close()

    def _forget(self, caller: _Caller) -> None:
        del self._unfinished[caller.guest]
        self._selector.unregister(caller.guest)

    # Complete requests.

    def _take(self, guest: socket.socket, head: bytes) -> None:
        try:
            request = _Request.parse(head)
        except (ValueError, HTTPException):
            _answer(guest, HTTPStatus.BAD_REQUEST, "This is not a request.")
            return
        if request.method == "POST" and request.path == "/stop":
            # Needs no token: anybody may stop, if the page itself asks.
            host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
            refused = refusal(host, origin, acts=True)
            if refused:
                _answer(guest, HTTPStatus.FORBIDDEN, refused)
            else:
                self._stops.put(guest)
        elif request.method not in ("GET", "HEAD") or request.has_body:
            # Nothing but a stop is asked for so, and the server would wait for the rest of it.
            _answer(guest, HTTPStatus.METHOD_NOT_ALLOWED, "There is nothing here.")
        else:
            self._loop.call_soon_threadsafe(self._let_in, guest, head)

    def _let_in(self, guest: socket.socket, head: bytes) -> None:
        """Called by the loop: the page's server takes a request over, if there is room."""
        if len(self._server.connections) >= _MOST_GUESTS:
            _answer(guest, HTTPStatus.SERVICE_UNAVAILABLE, "Too many look at this page.")
            return
        entering = self._loop.create_task(
            self._loop.connect_accepted_socket(lambda: _Begun(self._server(), head), guest)
        )
        self._entering.add(entering)
        entering.add_done_callback(self._entered)

    def _entered(self, entering: asyncio.Task[object]) -> None:
        self._entering.discard(entering)
        if not entering.cancelled():
            entering.exception()  # it has gone again, which needs no word

    def _obey(self) -> None:
        """Thread: stops. All that wait are answered by one stop that begins after them."""
        open_ = True
        while open_:
            waiting = [self._stops.get()]
            with suppress(queue.Empty):
                while True:
                    waiting.append(self._stops.get_nowait())
            open_ = None not in waiting
            guests = [guest for guest in waiting if guest is not None]
            if not guests:
                continue
            try:
                outcome = self._stop(_address(guests[0]))
            except Exception as error:  # noqa: BLE001 - the next stop must find this thread
                _LOG.exception("A stop failed.")
                failed = f"{error!r}; use the emergency stop"
                outcome = {"at_s": time.time(), "stopped": [], "failed": failed, "robots": []}
            text = json.dumps(outcome)
            for guest in guests:
                _answer(guest, HTTPStatus.OK, text, kind="application/json")


class _Begun(asyncio.Protocol):
    """Gives a protocol of the page's server the head that was read, then steps aside."""

    def __init__(self, handler: web.RequestHandler, head: bytes) -> None:
        self._handler = handler
        self._head = head

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by the loop."""
        cast("asyncio.Transport", transport).set_protocol(self._handler)
        self._handler.connection_made(transport)
        self._handler.data_received(self._head)


def _address(guest: socket.socket) -> str:
    """Where a connection comes from; empty if it has gone."""
    with suppress(OSError):
        return str(guest.getpeername()[0])
    return ""


def _answer(guest: socket.socket, status: HTTPStatus, text: str, kind: str = "text/plain") -> None:
    """Answer a request and close its connection. Waits for nobody: the answer is small enough for
    the system to take it whole.
    """
    body = text.encode()
    headers = {
        **HEADERS, "Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close",
    }  # fmt: skip
    lines = [f"HTTP/1.1 {status.value} {status.phrase}", *(f"{k}: {v}" for k, v in headers.items())]
    with guest, suppress(OSError):  # it has gone
        guest.send("\r\n".join(lines).encode() + _HEAD_END + body)
