"""A hub for other processes: the stream on a socket that only the same user can open.

Each message is sent as its JSON, with its length before it (`multiprocessing.connection` frames
it). Each client has a subscription and two threads of its own, so that one that stalls keeps
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
from thigmo.stream.hub import Hub, Subscription
from thigmo.stream.messages import Dropped, Hello, to_json

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
        self._clients: list[tuple[threading.Thread, Subscription]] = []
        self._lock = threading.Lock()
        self._closed = False
        self.address = _new_address(hello.name)
        try:
            self._listener = Listener(self.address, backlog=8)
        except OSError as error:
            raise PortError(
                f"cannot serve the run at {self.address}: {error.strerror}", "remove it"
            ) from error
        self._accepting = _thread(self._accept)

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
        for _, messages in clients:
            messages.close()
        until = time.monotonic() + _LAST_S
        for thread, _ in clients:
            thread.join(max(until - time.monotonic(), 0.0))

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
                self._clients = [client for client in self._clients if client[0].is_alive()]
                messages = self._hub.subscribe()
                self._clients.append((_thread(self._serve, connection, messages), messages))

    def _serve(self, connection: Connection, messages: Subscription) -> None:
        """Thread of a client: its commands, until it goes or all is sent."""
        writer = _thread(self._write, connection, messages)
        with messages, contextlib.suppress(OSError, EOFError), connection:
            while writer.is_alive():
                # A thread that waits in a read would keep a closed socket open.
                if not connection.poll(_POLL_S):
                    continue
                command = _command_in(connection.recv_bytes(_MOST_BYTES))
                if command is not None:
                    self._command(command)

    def _write(self, connection: Connection, messages: Subscription) -> None:
        """Thread of a client: messages."""
        told = 0
        with messages, contextlib.suppress(OSError):
            connection.send_bytes(to_json(self._hello))
            while taken := messages.take():
                lost = messages.dropped - told
                if lost:
                    told += lost
                    # Among the lost may have been the last of a channel that seldom speaks.
                    lead = Dropped(taken[0].t_s, taken[0].epoch_s, lost)
                    taken = [lead, *taken, *self._hub.retained()]
                for message in taken:
                    connection.send_bytes(to_json(message))
                messages.linger(_LINGER_S)


def _thread(target: Callable[..., None], *arguments: object) -> threading.Thread:
    thread = threading.Thread(target=target, args=arguments, daemon=True)
    thread.start()
    return thread


def _command_in(data: bytes) -> Command | None:
    """The command that a client's bytes hold; None for what is none, which a newer client may
    send."""
    try:
        wanted = json.loads(data).get("command")
    except (ValueError, AttributeError):
        return None
    return next((command for command in COMMANDS if command == wanted), None)
