"""The other end of a `Server`: which runs can be watched, and the messages of one."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Client, Connection
from pathlib import Path

from thigmo.closing import Closing
from thigmo.errors import LinkError
from thigmo.stream.messages import Hello, Message, from_json
from thigmo.stream.server import Command, folder, pipe_prefix

_PATIENCE_S = 2.0  # for a server's hello
_BEGINS_WITHIN_S = 60.0  # from a socket's name to its listening, on a computer that is busy


@dataclass(frozen=True, slots=True)
class Watchable:
    """A run that is under way: the address of its stream, and its hello."""

    address: str
    hello: Hello


class RemoteRun(Closing):
    """The stream of a run in another process. A context manager and an iterator, which ends when
    the run does.

    Attributes:
        address: of its socket.
        hello: whose stream it is.
    """

    def __init__(self, connection: Connection, address: str, hello: Hello) -> None:
        self._connection = connection
        self._sending = threading.Lock()
        self.address = address
        self.hello = hello

    def get(self, timeout_s: float | None = None) -> Message | None:
        """The next message; None if none comes in time.

        Raises:
            EOFError: the run has ended, or its process has.
            DataError: it speaks another version of the stream.
        """
        try:
            if not self._connection.poll(timeout_s):
                return None
            return from_json(self._connection.recv_bytes())
        except OSError as error:
            raise EOFError from error

    def send(self, command: Command) -> None:
        """Ask the run to pause between stages, to go on, or to stop. For several threads.

        Raises:
            LinkError: the run has ended.
        """
        try:
            with self._sending:
                self._connection.send_bytes(json.dumps({"command": command}).encode())
        except OSError as error:
            raise LinkError(f"the run {self.hello.name} has ended", "see its run folder") from error

    def close(self) -> None:
        """Listen no more; may be called twice."""
        self._connection.close()

    def __iter__(self) -> Iterator[Message]:
        while True:
            try:
                message = self.get()
            except EOFError:
                return
            if message is not None:
                yield message


def attach(address: str) -> RemoteRun:
    """Listen to the run that is served at an address.

    Raises:
        LinkError: nobody serves one there.
    """
    hello: Message | None = None
    with suppress(OSError, EOFError):
        try:
            connection = Client(address)
        except ConnectionRefusedError:
            _remove_old(Path(address))
            raise
        if connection.poll(_PATIENCE_S):
            hello = from_json(connection.recv_bytes())
        if isinstance(hello, Hello):
            return RemoteRun(connection, address, hello)
        connection.close()
    raise LinkError(f"no run is under way at {address}", "start one with `thigmo explore`")


def running() -> list[Watchable]:
    """All runs of this user that can be watched, the youngest last."""
    found = []
    for address in _addresses():
        with suppress(LinkError), attach(address) as run:
            found.append(Watchable(address, run.hello))
    return sorted(found, key=lambda each: each.hello.epoch_s)


def _remove_old(socket: Path) -> None:
    """Remove what a killed run left; a run that just begins has a socket before it listens."""
    with suppress(FileNotFoundError):
        if time.time() - socket.stat().st_mtime > _BEGINS_WITHIN_S:
            socket.unlink()


def _addresses() -> list[str]:
    if sys.platform == "win32":
        prefix = pipe_prefix()
        return [str(path) for path in Path("//./pipe").iterdir() if path.name.startswith(prefix)]
    return [str(path) for path in folder().iterdir() if path.is_socket()]
