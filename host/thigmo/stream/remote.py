"""A run's hub for other processes: the stream on a socket that only the same user can open.

Each message is sent as its JSON, with its length before it (`multiprocessing.connection` frames
it). Each client has a subscription and two threads of its own, so that one that stalls keeps
nobody waiting. Clients may send commands, as {"command": "pause"}.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, StringConstraints, ValidationError

from thigmo.closing import Closing
from thigmo.errors import LinkError, PortError
from thigmo.link import stop_socket
from thigmo.stream.hub import Hub, Subscription
from thigmo.stream.messages import Dropped, Hello, Message, from_json, to_json

Command = Literal["pause", "resume", "stop", "answer"]
# What a person types in one line. Control characters mean something to a terminal, and a zero byte
# ends an argument of a program.
Text = Annotated[str, StringConstraints(max_length=1000, pattern=r"^[^\x00-\x1f\x7f]*$")]
_MOST_BYTES = 4096
_POLL_S = 0.1
_LINGER_S = 0.01  # a thread that wakes for every message would take the robot's time
_LAST_S = 5.0  # for all clients to take what remains when the run ends
_PATIENCE_S = 2.0  # for a server's hello
_HUNG_S = 0.05  # for that of one which has not answered before
# How the names of this user's streams begin on Windows.
_PIPE_PREFIX = f"thigmo-run-{os.environ.get('USERNAME', '')}-"


def _folder() -> Path:
    """The folder of the streams' sockets, made if need be; only its user can enter.

    Raises PortError if others could.
    """
    path = stop_socket.folder() / "runs"
    path.mkdir(mode=0o700, exist_ok=True)
    return path


def _new_address(name: str) -> str:
    label = re.sub(r"\W+", "-", name)[:24].strip("-")
    file_name = f"{label}-{os.getpid()}-{secrets.token_hex(4)}"
    return (
        rf"\\.\pipe\{_PIPE_PREFIX}{file_name}"
        if sys.platform == "win32"
        else str(_folder() / file_name)
    )


def _addresses() -> list[str]:
    if sys.platform == "win32":
        pipes = Path("//./pipe").iterdir()
        return [str(path) for path in pipes if path.name.startswith(_PIPE_PREFIX)]
    return [str(path) for path in _folder().iterdir() if path.is_socket()]


class Server(Closing):
    """Serves one run's hub at the `address` of a socket. A context manager.

    `hello` is the first message to each client. `command` is called, in a thread of its own, with
    each command of a client and the text of its answer. Raises PortError if the socket cannot be
    made.
    """

    def __init__(self, hub: Hub, hello: Hello, command: Callable[[Command, str], None]) -> None:
        self._hub = hub
        self._hello = hello
        self._command = command
        self._clients: list[tuple[threading.Thread, Subscription]] = []
        self._lock = threading.Lock()
        self._closed = False
        self.address = _new_address(hello.name)
        with PortError.from_os(f"cannot serve the run at {self.address}", "remove it"):
            self._listener = Listener(self.address, backlog=8)
        self._accepting = _thread(self._accept)

    @property
    def viewers(self) -> int:
        """How many clients there are."""
        with self._lock:
            return sum(thread.is_alive() for thread, _ in self._clients)

    def close(self) -> None:
        """Stop serving; clients have five seconds to read what remains. May be called twice."""
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
        end_s = time.monotonic() + _LAST_S
        for thread, _ in clients:
            thread.join(max(end_s - time.monotonic(), 0.0))

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
        with connection:
            with messages, contextlib.suppress(OSError, EOFError):
                while writer.is_alive():
                    # A thread that waits in a read would keep a closed socket open.
                    if not connection.poll(_POLL_S):
                        continue
                    request = _request_in(connection.recv_bytes(_MOST_BYTES))
                    if request is not None:
                        self._command(request.command, request.text)
            writer.join()  # it must not write to what is closed, and maybe another file by then

    def _write(self, connection: Connection, messages: Subscription) -> None:
        """Thread of a client: messages."""
        reported = 0
        with messages, contextlib.suppress(OSError):
            connection.send_bytes(to_json(self._hello))
            while taken := messages.take():
                lost = messages.dropped - reported
                if lost:
                    reported += lost
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


class _Request(BaseModel):
    """A command of a client, as JSON."""

    command: Command
    text: Text = ""


def _request_in(data: bytes) -> _Request | None:
    """The request that a client's bytes hold; None for what a newer one may send."""
    try:
        return _Request.model_validate_json(data)
    except ValidationError:
        return None


@dataclass(frozen=True, slots=True)
class Watchable:
    """A run that is under way: the address of its stream, and the stream's first message."""

    address: str
    hello: Hello


class RemoteRun(Closing):
    """The stream of a run in another process: an iterator of messages that ends when the run does.

    It is also a context manager. `address` is that of its socket, `hello` the stream's first
    message.
    """

    def __init__(self, connection: Connection, address: str, hello: Hello) -> None:
        self._connection = connection
        self._sending = threading.Lock()
        self.address = address
        self.hello = hello

    def get(self, timeout_s: float | None = None) -> Message | None:
        """The next message; None if none comes in time.

        Raises EOFError if the run or its process has ended, and DataError if its version of thigmo
        has another stream.
        """
        try:
            if not self._connection.poll(timeout_s):
                return None
            return from_json(self._connection.recv_bytes())
        except (OSError, TypeError) as error:  # TypeError: it was closed while it was read
            raise EOFError from error

    def send(self, command: Command, text: str = "") -> None:
        """Ask the run to pause between stages, to go on, or to stop; or answer its question.

        Several threads may call it. Raises LinkError if the run has ended.
        """
        try:
            with self._sending:
                self._connection.send_bytes(json.dumps({"command": command, "text": text}).encode())
        except OSError as error:
            raise LinkError(f"the run {self.hello.name} has ended", "see its run folder") from error

    def close(self) -> None:
        """Stop listening; from any thread, and may be called twice."""
        with self._sending:  # a descriptor that is closed may be another file's a moment later
            self._connection.close()

    def __iter__(self) -> Iterator[Message]:
        with contextlib.suppress(EOFError):
            while True:
                if (message := self.get()) is not None:
                    yield message


def attach(address: str, patience_s: float = _PATIENCE_S) -> RemoteRun:
    """Listen to the run that is served at an address.

    Raises LinkError if there is none, or it does not answer within `patience_s`.
    """
    hello: Message | None = None
    with contextlib.suppress(OSError, EOFError):
        connection = stop_socket.connect(address)
        if connection.poll(patience_s):
            hello = from_json(connection.recv_bytes())
        if isinstance(hello, Hello):
            return RemoteRun(connection, address, hello)
        connection.close()
    raise LinkError(f"no run is under way at {address}", "start one with `thigmo explore`")


def running(hung: set[str] | None = None) -> list[Watchable]:
    """All of this user's runs that can be watched, the newest last.

    A caller that looks repeatedly passes the same set as `hung`: it collects the addresses that did
    not answer, which are then waited for only briefly.
    """
    runs = []
    silent = set() if hung is None else hung
    for address in _addresses():
        patience_s = _HUNG_S if address in silent else _PATIENCE_S
        silent.add(address)
        with contextlib.suppress(LinkError), attach(address, patience_s) as run:
            runs.append(Watchable(address, run.hello))
            silent.discard(address)
    return sorted(runs, key=lambda run: run.hello.epoch_s)
