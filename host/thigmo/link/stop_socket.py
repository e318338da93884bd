"""Where a process that owns a robot takes stops, and how to reach it.

A run may hang with its port open, and nobody else can then open it. The port's process
(`port_process`) therefore listens on a socket of its own, and so does a program that emulates its
robot. The sockets lie in one folder per user, the same for every program of his, also for a service
or a cron job, and nobody else can enter it (on Windows: named pipes that only he can write to).
`thigmo stop` calls them.

A call is "stop"; the answer, once the board has echoed or the time is over, is "stopped" or
"unconfirmed", a space, and the robot's address.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path

from thigmo.closing import Closing
from thigmo.errors import LinkError, PortError
from thigmo.link.stop import CONFIRM_S, UNCONFIRMED_CURE

# Not the session's folder, which depends on how one has signed in and ends with the session, nor
# TMPDIR's. Only tests and studies name another, to keep their robots apart.
_PLACE = "/tmp"
OTHER_PLACE = "THIGMO_SOCKETS"

_CALL = b"stop"
_STOPPED, _UNCONFIRMED = b"stopped", b"unconfirmed"
_MOST_BYTES = 4096
_NAME = 40  # of the address in the socket's name; the system allows 107 bytes in all
_PATIENCE_S = CONFIRM_S + 2.0  # for an answer, on a computer that is busy
_BEGINS_WITHIN_S = 60.0  # from a socket's name to its listening, on a computer that is busy


def folder() -> Path:
    """The folder of the sockets, made if need be; PortError if others could fake a robot there."""
    path = Path(os.environ.get(OTHER_PLACE) or _PLACE) / f"thigmo-{_user()}"
    with PortError.from_os(f"cannot make {path}", "create it as your own folder, with mode 700"):
        path.mkdir(mode=0o700, exist_ok=True)
        found = path.lstat()
    if sys.platform != "win32" and (found.st_uid != os.getuid() or found.st_mode & 0o077):
        raise PortError(f"other users can enter {path}", "remove it, or own it with mode 700")
    return path


def _user() -> str:
    return str(os.getuid()) if sys.platform != "win32" else os.environ.get("USERNAME", "")


def address(url: str) -> str:
    """Where the owner of a robot listens, whatever link names its device and however it is opened.

    Of a robot that is emulated, several may be under way: each adds to this.
    """
    scheme, named, place = url.partition("?")[0].rpartition("://")
    if "/" in place and (not named or place.endswith(".toml")):
        place = os.path.realpath(place)
    real = f"{scheme}{named}{place or 'default'}"
    label = re.sub(r"\W+", "-", real)[-_NAME:].strip("-")
    name = f"{label}-{hashlib.sha256(real.encode()).hexdigest()[:8]}"
    return rf"\\.\pipe\thigmo-{_user()}-{name}" if sys.platform == "win32" else str(folder() / name)


class StopListener(Closing):
    """Takes stops of a robot that the caller owns, in a thread of its own.

    Args:
        url: the robot's address.
        stop: called for each; stops the robot, and tells whether the board confirmed it.
        emulated: others may be under way at the same address.

    Raises PortError if it cannot listen.
    """

    def __init__(self, url: str, stop: Callable[[], bool], *, emulated: bool = False) -> None:
        self._url = url
        self._stop = stop
        self._closed = False
        where = address(url) + (f".{os.getpid()}-{secrets.token_hex(2)}" if emulated else "")
        self._where = where
        with PortError.from_os(f"cannot listen for `thigmo stop` at {where}", "remove it"):
            if sys.platform != "win32":
                Path(where).unlink(missing_ok=True)  # of an owner that was killed
            self._listener = Listener(where, backlog=64)
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop accepting stops; may be called twice."""
        if self._closed:
            return
        self._closed = True
        with suppress(OSError), Client(self._where):
            pass  # wakes the thread, which nothing else does
        self._thread.join(_PATIENCE_S)
        with suppress(FileNotFoundError):  # somebody cleared the folder away
            self._listener.close()

    def _listen(self) -> None:
        while not self._closed:
            with suppress(OSError, EOFError):  # the caller has gone
                self._answer()

    def _answer(self) -> None:
        with self._listener.accept() as caller:
            if not self._closed and caller.recv_bytes(_MOST_BYTES) == _CALL:
                said = _STOPPED if self._stop() else _UNCONFIRMED
                caller.send_bytes(b"%b %b" % (said, self._url.encode()))


def running() -> list[str]:
    """Sockets of all robots that this user's processes own, as far as their names tell."""
    if sys.platform == "win32":
        pipes = Path("//./pipe").iterdir()
        return sorted(str(path) for path in pipes if path.name.startswith(f"thigmo-{_user()}-"))
    return sorted(str(path) for path in folder().iterdir() if path.is_socket())


def owners(url: str) -> list[str]:
    """Those of them that own a robot: one of a port at most, but any number that are emulated."""
    where = address(url)
    return [each for each in running() if each == where or each.startswith(f"{where}.")]


def connect(where: str) -> Connection:
    """Connect to a socket; OSError if nobody listens. What a killed program leaves is removed."""
    try:
        return Client(where)
    except ConnectionRefusedError:
        # One that just begins has its name before it listens.
        if time.time() - Path(where).stat().st_mtime > _BEGINS_WITHIN_S:
            Path(where).unlink()
        raise


def call(where: str) -> str | None:
    """Stop the robot whose owner listens at a socket; its address, or None if nobody listens.

    Raises LinkError if the board did not confirm the stop.
    """
    try:
        with connect(where) as owner:
            owner.send_bytes(_CALL)
            if not owner.poll(_PATIENCE_S):
                raise LinkError(f"the program behind {where} does not answer", UNCONFIRMED_CURE)
            said, _, url = owner.recv_bytes(_MOST_BYTES).partition(b" ")
    except (FileNotFoundError, ConnectionError):
        return None
    except EOFError:  # it ended without an answer
        said = url = b""
    if said != _STOPPED:
        raise LinkError(
            f"the board on {url.decode() or where} did not confirm the stop", UNCONFIRMED_CURE
        )
    return url.decode()
