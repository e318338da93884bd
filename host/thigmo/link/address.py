"""The names under which a robot's address is known, however it is written.

One robot may be reached as `/dev/serial/by-id/...` and `/dev/ttyACM0`, or as `socket://robot:4000`
and `rfc2217://192.168.1.5:4000`. Who owns it and who calls it must find each other all the same,
and two programs of this computer must not drive it at once (`AddressLock`).
"""

from __future__ import annotations

import hashlib
import os
import socket
import sys
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import urlsplit

from thigmo.closing import Closing
from thigmo.errors import PortError
from thigmo.link.port_owner import words

# Not the session's folder, which depends on how one has signed in and ends with the session, nor
# TMPDIR's. Only tests and studies name another, to keep their robots apart.
_PLACE = "/tmp"
OTHER_PLACE = "THIGMO_SOCKETS"

_NETWORK = ("socket", "rfc2217")
_MOST_RESOLVED = 3  # of a host's addresses
_HASH = 8  # hexadecimal digits of a name's hash
# A host that was resolved once keeps its addresses here: a stop must not wait for a name service.
_resolved: dict[tuple[str, int], list[str]] = {}


def place() -> Path:
    """The folder in which all programs of this computer meet."""
    return Path(os.environ.get(OTHER_PLACE) or _PLACE)


def over_network(url: str) -> bool:
    """Whether an address is that of a serial server, which takes connections of its own accord."""
    return url.partition("://")[0].lower() in _NETWORK


def names(url: str) -> list[str]:
    """Hashes of an address as written, without its options, and of the addresses it resolves to."""
    return [_hashed(name) for name in dict.fromkeys([_written(url), *_places(url)])]


def _hashed(name: str) -> str:
    return hashlib.sha256(name.encode()).hexdigest()[:_HASH]


def _written(url: str) -> str:
    scheme, named, where = url.partition("?")[0].rpartition("://")
    return f"{scheme}{named}{where or 'default'}"


def _places(url: str) -> list[str]:
    """Where an address leads: a file's real path, or a host's addresses with the port; empty if
    that cannot be known.
    """
    if over_network(url):
        with suppress(ValueError):  # no port, or none that is a number
            parts = urlsplit(url)
            if parts.hostname and parts.port:
                return [f"{host} {parts.port}" for host in _hosts(parts.hostname, parts.port)]
        return []
    scheme, named, where = _written(url).rpartition("://")
    if "/" in where and (not named or where.endswith(".toml")):
        where = os.path.realpath(where)
    return [f"{scheme}{named}{where}"]


def _hosts(host: str, port: int) -> list[str]:
    """A host's addresses; all that lead back to this computer are one."""
    if (host, port) not in _resolved:
        try:
            entries = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        except OSError:
            return []
        addresses = [ip_address(str(entry[4][0]).partition("%")[0]) for entry in entries]
        hosts = {"localhost" if address.is_loopback else str(address) for address in addresses}
        _resolved[host, port] = sorted(hosts)[:_MOST_RESOLVED]
    return _resolved[host, port]


class AddressLock(Closing):
    """Keeps every other program of this computer from driving a robot behind a serial server.

    A serial port is locked by the system. A serial server may take a second connection, and its
    robot would then hear two hosts. The lock ends with its process.

    Raises PortError if another program holds it.
    """

    def __init__(self, url: str, program: int) -> None:
        self._files: list[int] = []
        try:
            for name in names(url) if over_network(url) else ():
                self._lock(url, name, program)
        except BaseException:
            self.close()
            raise

    def _lock(self, url: str, name: str, program: int) -> None:
        path = place() / f"thigmo-lock-{name}"
        with PortError.from_os(f"cannot lock {url} with {path}", "remove it"):
            file = _opened(path)
        self._files.append(file)
        if not _locked(file):
            holder = os.pread(file, 20, 0).decode("ascii", "replace").strip()
            holder_text = words(int(holder)) if holder.isdigit() else ""
            raise PortError(f"{url} is in use{holder_text}", "close the program that drives it")
        os.ftruncate(file, 0)
        os.pwrite(file, str(program).encode(), 0)

    def close(self) -> None:
        """Let others drive it; may be called twice."""
        while self._files:
            os.close(self._files.pop())


def _opened(path: Path) -> int:
    """A file that every user of this computer can lock."""
    flags = os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
    with suppress(FileNotFoundError):
        # Linux lets nobody create, in a folder that all can write to, what another user owns.
        return os.open(path, flags)
    file = os.open(path, flags | os.O_CREAT, 0o666)
    if sys.platform != "win32":
        os.fchmod(file, 0o666)  # whatever the umask
    return file


def _locked(file: int) -> bool:
    """Lock a file, unless another program has; whether it is locked now."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
