"""Where a process that owns a robot takes stops, and how to reach it.

A run may hang with its port open, and nobody else can then open it. The port's process
(`port_process`) therefore listens on a socket of its own, and so does a program that emulates its
robot. The sockets lie in one folder per user, the same for every program of his, also for a service
or a cron job, and nobody else can enter it (on Windows: named pipes that only he can write to).
`robot.stopping` calls them.

A call is "stop". The answer is what came of it ("stopped" once the board has echoed, "unconfirmed"
once the time is over, "ended" if an emulated robot has ended with its program), the process of the
program that drives the robot, and the robot's address. Each caller has a thread and a deadline of
its own, and none waits for another.
"""

from __future__ import annotations

import os
import re
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import Literal

from thigmo.closing import Closing
from thigmo.errors import LinkError, PortError
from thigmo.link.address import names, place
from thigmo.link.stop import CONFIRM_S, UNCONFIRMED_CURE

Outcome = Literal["stopped", "ended"]

_CALL, _END = b"stop", b"end"
_MOST_BYTES = 4096
_QUEUE = 64  # of callers that are not yet taken
_LABEL = 24  # letters of the address in the socket's name; the system allows 107 bytes in all
_CALLER_S = 2.0  # for a caller's word, on a computer that is busy
_PATIENCE_S = CONFIRM_S + 2.0  # for an answer, on a computer that is busy
_BEGINS_WITHIN_S = 60.0  # from a socket's name to its listening, on a computer that is busy


def folder() -> Path:
    """The folder of the sockets, made if need be; PortError if others could fake a robot there."""
    path = place() / f"thigmo-{_user()}"
    with PortError.from_os(f"cannot make {path}", "create it as your own folder, with mode 700"):
        path.mkdir(mode=0o700, exist_ok=True)
        status = path.lstat()
    if sys.platform != "win32" and (status.st_uid != os.getuid() or status.st_mode & 0o077):
        raise PortError(f"other users can enter {path}", "remove it, or own it with mode 700")
    return path


def _user() -> str:
    return str(os.getuid()) if sys.platform != "win32" else os.environ.get("USERNAME", "")


def _prefix() -> str:
    """How the paths of all of this user's sockets begin."""
    return rf"\\.\pipe\thigmo-{_user()}-" if sys.platform == "win32" else f"{folder()}/"


def _path(url: str) -> str:
    """The socket of a robot's owner: a few letters of its address, and all its names."""
    label = re.sub(r"\W+", "-", url.partition("?")[0])[-_LABEL:].strip("-")
    return f"{_prefix()}{label}-{'-'.join(names(url))}"


class StopListener(Closing):
    """Takes stops of a robot that the caller owns.

    Args:
        url: the robot's address.
        stop: called for each; stops the robot, and tells whether the board confirmed it. Several
            threads may call it at once.
        program: process of the program that drives the robot.
        emulated: the robot lives in this program and ends with it; others may be under way at the
            same address.

    Raises PortError if it cannot listen, or another program takes this robot's stops.
    """

    def __init__(
        self, url: str, stop: Callable[[], bool], *, program: int, emulated: bool = False
    ) -> None:
        self._stop = stop
        self._about = f"{program} {url}".encode()
        self._emulated = emulated
        self._closed = False
        where = _path(url) + (f".{program}-{secrets.token_hex(2)}" if emulated else "")
        self._where = where
        with PortError.from_os(f"cannot listen for `thigmo stop` at {where}", "remove it"):
            _remove_dead(where, url)
            self._listener = _listening(where)
            self._socket_identity = _identity(where)
        self._callers: list[threading.Thread] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Answer those who have called, and take no further stops; may be called twice."""
        if self._closed:
            return
        self._closed = True
        # OSError: somebody cleared the folder away, and nobody can call any more.
        with suppress(OSError):
            with Client(self._where) as last:
                last.send_bytes(_END)  # wakes the thread, which nothing else does
            self._thread.join(_PATIENCE_S)
        for caller in self._callers:
            caller.join(_PATIENCE_S)
        self._listener.close()
        # Where somebody cleared the folder away, another program may listen by now.
        if self._socket_identity is not None and _identity(self._where) == self._socket_identity:
            Path(self._where).unlink(missing_ok=True)

    def _listen(self) -> None:
        while True:
            try:
                caller = _accepted(self._listener)
            except OSError:  # the caller has gone
                if self._closed:
                    return
                continue
            if self._closed:  # who came before the last one is answered before it
                if self._answer(caller) == _END:
                    return
                continue
            self._callers = [thread for thread in self._callers if thread.is_alive()]
            self._callers.append(threading.Thread(target=self._answer, args=(caller,), daemon=True))
            self._callers[-1].start()

    def _answer(self, caller: Connection) -> bytes:
        """Answer a caller; return its request."""
        request = b""
        with suppress(OSError, EOFError), caller:
            if caller.poll(_CALLER_S):
                request = caller.recv_bytes(_MOST_BYTES)
            if request == _CALL:
                caller.send_bytes(b"%b %b" % (self._outcome(), self._about))
        return request

    def _outcome(self) -> bytes:
        if self._closed and self._emulated:
            return b"ended"
        if self._stop():
            return b"stopped"
        return b"ended" if self._closed and self._emulated else b"unconfirmed"


def _listening(where: str) -> socket.socket | Listener:
    """What takes callers at a path. A `Listener` would remove, at this program's end, whatever is
    there by then.
    """
    if sys.platform == "win32":
        return Listener(where, backlog=_QUEUE)
    listener = socket.socket(socket.AF_UNIX)
    try:
        listener.bind(where)
        listener.listen(_QUEUE)
    except BaseException:
        listener.close()
        raise
    return listener


def _accepted(listener: socket.socket | Listener) -> Connection:
    """The next caller."""
    if isinstance(listener, Listener):
        return listener.accept()
    caller, _ = listener.accept()
    return Connection(caller.detach())


def _identity(where: str) -> tuple[int, int] | None:
    """Which file is there; None if none is, as of a pipe of Windows."""
    with suppress(OSError):
        status = os.lstat(where)
        return status.st_dev, status.st_ino
    return None


def _remove_dead(where: str, url: str) -> None:
    """Remove the socket of an owner that was killed. PortError if one is alive."""
    if sys.platform == "win32":
        return
    try:
        _connected(where).close()
    except FileNotFoundError:
        return
    except ConnectionRefusedError:
        Path(where).unlink(missing_ok=True)
        return
    except BlockingIOError:  # it has a queue of callers
        pass
    raise PortError(f"{url} is in use by another program", "close the program that drives it")


def running() -> list[str]:
    """Sockets of all robots that this user's processes own, as far as their names tell."""
    if sys.platform == "win32":
        return sorted(str(pipe) for pipe in Path("//./pipe").iterdir() if pipe.name.startswith(
            f"thigmo-{_user()}-"
        ))  # fmt: skip
    return sorted(str(path) for path in folder().iterdir() if path.is_socket())


def owners(url: str, program: int | None = None) -> list[str]:
    """Paths of the stop sockets of a robot's owners.

    A port has one owner at most. An emulated robot may have several, one in each program;
    `program` selects that of one process.
    """
    url_names = set(names(url))
    owned = []
    for where in running():
        socket_names, _, emulates = Path(where).name.partition(".")
        of_program = program is None or emulates.startswith(f"{program}-")
        if url_names & set(socket_names.split("-")) and (of_program or not emulates):
            owned.append(where)
    return owned


def _connected(where: str) -> Connection:
    """Connect to a socket; OSError if nobody listens, or its queue is full."""
    if sys.platform == "win32":
        return Client(where)
    caller = socket.socket(socket.AF_UNIX)
    try:
        caller.setblocking(False)  # a program that is suspended takes nobody out of its queue
        caller.connect(where)
        caller.setblocking(True)
    except BaseException:
        caller.close()
        raise
    return Connection(caller.detach())


def connect(where: str) -> Connection:
    """Connect to a socket; OSError if nobody listens. What a killed program leaves is removed."""
    try:
        return _connected(where)
    except ConnectionRefusedError:
        # One that just begins has its name before it listens.
        if time.time() - Path(where).stat().st_mtime > _BEGINS_WITHIN_S:
            Path(where).unlink()
        raise


@dataclass(frozen=True, slots=True)
class Answer:
    """What the owner of a robot said to a stop.

    Attributes:
        outcome: the board has confirmed, or has ended with the program that emulated it.
        program: process of the program that drives the robot.
        url: the robot's address as that program has it.
    """

    outcome: Outcome
    program: int
    url: str


def call(where: str) -> Answer | None:
    """Stop the robot whose owner listens at a socket; None if nobody listens there any more.

    Raises LinkError if the board did not confirm the stop.
    """
    silent = LinkError(f"the program behind {where} does not answer", UNCONFIRMED_CURE)
    try:
        with connect(where) as owner:
            owner.send_bytes(_CALL)
            if not owner.poll(_PATIENCE_S):
                raise silent
            reply = owner.recv_bytes(_MOST_BYTES).decode()
    except BlockingIOError:  # many have called it before
        raise silent from None
    except (FileNotFoundError, ConnectionError, EOFError):  # EOFError: it ended meanwhile
        return None
    outcome, program, url = reply.split(" ", 2)
    if outcome not in ("stopped", "ended"):
        raise LinkError(f"the board on {url} did not confirm the stop", UNCONFIRMED_CURE)
    return Answer("stopped" if outcome == "stopped" else "ended", int(program), url)
