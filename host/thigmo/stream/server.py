"""A hub for other processes: the stream on a socket that only the same user can open.

Each message is sent as its JSON, with its length before it (`multiprocessing.connection` frames
it). Each client has a bounded queue and two threads of its own, so that one that stalls keeps
nobody waiting. Clients may send commands, as {"command": "pause"}.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import Literal, get_args

from thigmo.closing import Closing
from thigmo.errors import PortError
from thigmo.link import stop_socket
from thigmo.stream.hub import QUEUE, Bounded, Hub
from thigmo.stream.messages import CHANNELS, Dropped, Hello, Message, to_json

Command = Literal["pause", "resume", "stop"]
COMMANDS: tuple[Command, ...] = get_args(Command)
_MOST_BYTES = 4096
_POLL_S = 0.1
_LINGER_S = 0.01  # a thread that wakes for every message would take the robot's time
_LAST_S = 5.0  # for all clients to take what is left when the run ends
_PIPES = r"\\.\pipe"


def folder() -> Path:
    """The folder of the streams' sockets, made if need be; only its user can enter.

    Raises:
        PortError: others could enter it.
    """
    path = stop_socket.folder() / "runs"
    path.mkdir(mode=0o700, exist_ok=True)
    return path


def pipe_prefix() -> str:
    """How the names of this user's streams begin on Windows."""
    return f"thigmo-run-{os.environ.get('USERNAME', '')}-"


def _new_address(name: str) -> str:
    label = re.sub(r"\W+", "-", name)[:24].strip("-")
    if sys.platform == "win32":
        return rf"{_PIPES}\{pipe_prefix()}{label}-{os.getpid()}-{threading.get_native_id()}"
    handle, path = tempfile.mkstemp(prefix=f"{label}-{os.getpid()}-", dir=folder())
    os.close(handle)
    Path(path).unlink()
    return path


class Server(Closing):
    """Serves one run's hub. A context manager.

    Args:
        hub: what to serve.
        hello: the first message to each client.
        command: called with what a client commands, in a thread of its own.

    Attributes:
        address: of the socket.

    Raises:
        PortError: the socket cannot be made.
    """

    def __init__(self, hub: Hub, hello: Hello, command: Callable[[Command], None]) -> None:
        self._hub = hub
        self._hello = hello
        self._command = command
        self._clients: list[_Client] = []
        self._lock = threading.Lock()
        self._closed = False
        self.address = _new_address(hello.name)
        try:
            self._listener = Listener(self.address, backlog=8)
        except OSError as error:
            raise PortError(
                f"cannot serve the run at {self.address}: {error.strerror}", "remove it"
            ) from error
        self._accepting = threading.Thread(target=self._accept, daemon=True)
        self._accepting.start()

    def close(self) -> None:
        """Serve no more; clients get five seconds for what is left. May be called twice."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            clients = list(self._clients)
        with contextlib.suppress(OSError), Client(self.address):
            pass  # wakes the thread that waits for clients, which nothing else does
        self._accepting.join(_LAST_S)
        self._listener.close()
        for client in clients:
            client.end()
        until = time.monotonic() + _LAST_S
        for client in clients:
            client.join(max(until - time.monotonic(), 0.0))

    def _accept(self) -> None:
        """Thread: new clients."""
        while True:
            try:
                connection = self._listener.accept()
            except OSError:
                if self._closed:
                    return
                continue  # this one has gone already
            with self._lock:
                if self._closed:
                    connection.close()
                    return
                self._clients = [client for client in self._clients if client.alive]
                self._clients.append(
                    _Client(self._hub, self._hello, self._command, connection, self._encoded)
                )

    _last: tuple[Message, bytes] | None = None

    def _encoded(self, message: Message) -> bytes:
        """A message's JSON, made once for all clients: the publisher's thread serves them in
        turn."""
        last = self._last
        if last is None or last[0] is not message:
            self._last = last = (message, to_json(message))
        return last[1]


class _Client:
    """One client: a queue, a thread that writes, and one that reads its commands."""

    def __init__(
        self,
        hub: Hub,
        hello: Hello,
        command: Callable[[Command], None],
        connection: Connection,
        encoded: Callable[[Message], bytes],
    ) -> None:
        self._hub = hub
        self._command = command
        self._connection = connection
        self._encoded = encoded
        self._queue: Bounded[tuple[Message, bytes]] = Bounded(QUEUE)
        self._queue.put((hello, to_json(hello)))
        hub.attach(self._take, CHANNELS, self._queue.close)
        self._writer = threading.Thread(target=self._write, daemon=True)
        self._writer.start()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def alive(self) -> bool:
        """Whether it still takes messages."""
        return self._reader.is_alive()

    def end(self) -> None:
        """Send what is queued, then no more."""
        self._hub.detach(self._take)
        self._queue.close()

    def join(self, timeout_s: float) -> None:
        """Wait for the rest to be sent."""
        self._reader.join(timeout_s)

    def _take(self, message: Message) -> None:
        self._queue.put((message, self._encoded(message)))

    def _write(self) -> None:
        """Thread: messages."""
        told = 0
        with contextlib.suppress(OSError):
            while entries := self._queue.take():
                lost = self._queue.dropped - told
                if lost:
                    told += lost
                    first = entries[0][0]
                    self._connection.send_bytes(to_json(Dropped(first.t_s, first.epoch_s, lost)))
                for _, data in entries:
                    self._connection.send_bytes(data)
                if lost:
                    # Among the lost may have been the last of a channel that seldom speaks.
                    for old in self._hub.retained():
                        self._connection.send_bytes(to_json(old))
                self._queue.linger(_LINGER_S)
        self.end()

    def _read(self) -> None:
        """Thread: commands, until the client goes or all is sent; closes the connection."""
        with contextlib.suppress(OSError, EOFError), self._connection:
            while self._writer.is_alive():
                # A thread that waits in a read would keep a closed socket open.
                if not self._connection.poll(_POLL_S):
                    continue
                command = _command_in(self._connection.recv_bytes(_MOST_BYTES))
                if command is not None:
                    self._command(command)
        self.end()


def _command_in(data: bytes) -> Command | None:
    """The command that a client's bytes hold; None for what is none, which a newer client may
    send."""
    try:
        told = json.loads(data)
    except ValueError:
        return None
    wanted = told.get("command") if isinstance(told, dict) else None
    return next((command for command in COMMANDS if command == wanted), None)
