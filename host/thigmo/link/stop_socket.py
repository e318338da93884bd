"""Where a process that owns a robot's port takes stops, and how to reach it.

A run may hang with the port open, and nobody else can then open it. Its port's process
(`port_process`) therefore listens on a socket of its own, in a folder that only the same user can
enter (on Windows: a named pipe that only he can write to). `thigmo stop` calls it.

A call is "stop"; the answer, once the board has echoed or the time is over, is "stopped" or
"unconfirmed", a space, and the port's address.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import tempfile
from collections.abc import Callable
from multiprocessing.connection import Client, Listener
from pathlib import Path

from thigmo.errors import LinkError, PortError

_CALL = b"stop"
_STOPPED, _UNCONFIRMED = b"stopped", b"unconfirmed"
_MOST_BYTES = 4096
_NAME = 40  # of the address in the socket's name; the system allows 107 bytes in all


def folder() -> Path:
    """The folder of the sockets, made if need be; PortError if others could fake a robot there."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    path = Path(runtime or tempfile.gettempdir()) / ("thigmo" if runtime else f"thigmo-{_user()}")
    with PortError.from_os(f"cannot make {path}", "make it, yours and with mode 700"):
        path.mkdir(mode=0o700, exist_ok=True)
        found = path.lstat()
    if sys.platform != "win32" and (found.st_uid != os.getuid() or found.st_mode & 0o077):
        raise PortError(f"others can enter {path}", "remove it, or make it yours with mode 700")
    return path


def _user() -> str:
    return str(os.getuid()) if sys.platform != "win32" else os.environ.get("USERNAME", "")


def address(url: str) -> str:
    """The socket of the process that owns a port, whatever link names the device."""
    real = os.path.realpath(url) if url.startswith("/") else url
    label = re.sub(r"\W+", "-", real)[-_NAME:].strip("-")
    name = f"{label}-{hashlib.sha256(real.encode()).hexdigest()[:8]}"
    return rf"\\.\pipe\thigmo-{_user()}-{name}" if sys.platform == "win32" else str(folder() / name)


def serve(url: str) -> Listener:
    """Listen for stops of a port, which the caller owns; raises PortError if it cannot."""
    where = address(url)
    with PortError.from_os(f"cannot listen for `thigmo stop` at {where}", "remove it"):
        if sys.platform != "win32":
            Path(where).unlink(missing_ok=True)  # of an owner that was killed
        return Listener(where, backlog=8)


def answer(listener: Listener, url: str, stop: Callable[[], bool]) -> None:
    """Take one call and obey it; `stop` says whether the board confirmed it.

    Raises OSError when the listener is closed.
    """
    with listener.accept() as caller:
        try:
            if caller.recv_bytes(_MOST_BYTES) == _CALL:
                caller.send_bytes(b"%b %b" % (_STOPPED if stop() else _UNCONFIRMED, url.encode()))
        except (OSError, EOFError):
            return  # the caller has gone


def running() -> list[str]:
    """Sockets of all ports that this user's processes own, as far as their names tell."""
    if sys.platform == "win32":
        pipes = Path("//./pipe").iterdir()
        return sorted(str(path) for path in pipes if path.name.startswith(f"thigmo-{_user()}-"))
    return sorted(str(path) for path in folder().iterdir() if path.is_socket())


def call(where: str) -> str | None:
    """Stop the robot of the process behind a socket; its port's address, or None if nobody listens.

    Raises LinkError if the board did not confirm the stop.
    """
    try:
        with Client(where) as owner:
            owner.send_bytes(_CALL)
            said, _, url = owner.recv_bytes(_MOST_BYTES).partition(b" ")
    except (FileNotFoundError, ConnectionError):
        return None
    except EOFError:  # it ended without an answer
        said = url = b""
    if said != _STOPPED:
        raise LinkError(
            f"the board on {url.decode() or where} did not confirm the stop",
            "press the emergency stop or cut the power, and shut the air",
        )
    return url.decode()
