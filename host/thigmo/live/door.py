"""The page's door: takes every connection, answers stops itself, and limits the others.

A stop must not wait for those who look, however many they are and whatever they leave unread. One
thread accepts all connections of the page's port and looks at how each begins. A stop is answered
by a thread of its own; everything else goes to the page's server while there is room. A browser
opens a connection for each request, because the server closes each after its answer.
"""

from __future__ import annotations

import asyncio
import json
import selectors
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler
from typing import Any

from aiohttp import web

from thigmo.closing import Closing
from thigmo.live.guard import HEADERS, refusal

_STOP = b"POST /stop"
_MOST_GUESTS = 64  # connections of the page's server
_MOST_SILENT = 256  # that have not said anything; browsers open some ahead
_MOST_STOPS = 512  # at once: each is over soon, also of who does not go on
_BACKLOG = 1024
_STOP_PATIENCE_S = 2.0  # for the rest of a stop's request
_FULL = b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"

Stop = Callable[[str], dict[str, Any]]
"""Stops the robot for a computer at an address, from any thread, which may take seconds: what came
of it, for the page."""


class Door(Closing):
    """Keeps the door at an address until it is closed; OSError if it cannot be listened at."""

    def __init__(self, place: tuple[str, int], server: web.Server, stop: Stop) -> None:
        family = socket.AF_INET6 if ":" in place[0] else socket.AF_INET
        self._listener = socket.create_server(place, family=family, backlog=_BACKLOG)
        self._listener.setblocking(False)
        self.port = int(self._listener.getsockname()[1])
        self._server = server
        self._loop = asyncio.get_running_loop()
        self._stop = stop
        self._stops = threading.Semaphore(_MOST_STOPS)
        self._silent: dict[socket.socket, None] = {}  # the oldest first
        self._wake, self._woken = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        for each in (self._listener, self._woken):
            self._selector.register(each, selectors.EVENT_READ)
        self._closed = False
        self._thread = threading.Thread(target=self._keep, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Refuse further connections."""
        self._closed = True
        self._wake.close()
        self._thread.join()
        for each in (self._listener, self._woken, *self._silent):
            each.close()
        self._selector.close()

    def _keep(self) -> None:
        """Thread: those who come, and those who begin to speak."""
        while not self._closed:
            for key, _ in self._selector.select():
                if key.fileobj is self._listener:
                    self._greet()
                elif isinstance(guest := key.fileobj, socket.socket) and guest in self._silent:
                    self._forget(guest)
                    self._hear(guest)

    def _greet(self) -> None:
        try:
            guest, _ = self._listener.accept()
        except OSError:  # it has gone again, or this process has no place for one more
            self._turn_out_oldest()
            return
        if len(self._silent) >= _MOST_SILENT:
            self._turn_out_oldest()
        guest.setblocking(False)
        self._silent[guest] = None
        self._selector.register(guest, selectors.EVENT_READ)

    def _turn_out_oldest(self) -> None:
        if self._silent:
            oldest = next(iter(self._silent))
            self._forget(oldest)
            oldest.close()

    def _forget(self, guest: socket.socket) -> None:
        del self._silent[guest]
        self._selector.unregister(guest)

    def _hear(self, guest: socket.socket) -> None:
        try:
            begins = guest.recv(len(_STOP), socket.MSG_PEEK)
        except OSError:
            begins = b""
        if begins == _STOP and self._stops.acquire(blocking=False):
            threading.Thread(target=self._answer, args=(guest,), daemon=True).start()
        elif begins and begins != _STOP:
            self._loop.call_soon_threadsafe(self._let_in, guest)
        else:
            guest.close()

    def _let_in(self, guest: socket.socket) -> None:
        """Called by the loop: the page's server takes it over, if there is room."""
        if len(self._server.connections) >= _MOST_GUESTS:
            with suppress(OSError):
                guest.send(_FULL)
            guest.close()
            return
        taken = self._loop.create_task(self._loop.connect_accepted_socket(self._server, guest))
        taken.add_done_callback(lambda task: task.cancelled() or task.exception())

    def _answer(self, guest: socket.socket) -> None:
        """Thread of a stop."""
        try:
            guest.settimeout(_STOP_PATIENCE_S)
            with guest, suppress(OSError):
                _StopRequest(guest, self._stop)
        finally:
            self._stops.release()


class _StopRequest(BaseHTTPRequestHandler):
    """Reads a request and answers it, all while it is made. Needs no token: anybody may stop."""

    def __init__(self, guest: socket.socket, stop: Stop) -> None:
        self._stop = stop
        super().__init__(guest, guest.getpeername(), None)  # type: ignore[arg-type]

    def do_POST(self) -> None:
        """Stop, if the page itself asks."""
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        refused = refusal(host, origin, acts=True)
        if self.path != "/stop":
            refused = "There is nothing here."
        if refused:
            self._say(403, "text/plain", refused)
        else:
            self._say(200, "application/json", json.dumps(self._stop(self.client_address[0])))

    def _say(self, status: int, kind: str, text: str) -> None:
        self.send_response(status)
        for name, value in {**HEADERS, "Content-Type": kind}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(text.encode())

    def log_message(self, *arguments: object) -> None:
        """Nothing: strangers' requests are not the operator's."""
