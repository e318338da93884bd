"""What the client needs of a connection, and the one way to open one.

All time of the host's logic comes from `now()`, and waiting is done by `read()`: on hardware that
is the monotonic clock, in the emulator reading is what advances virtual time.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol

from thigmo.errors import PortError
from thigmo.extras import require_sources
from thigmo.link.heartbeat import Beat


class Transport(Protocol):
    """A two-way stream of bytes with a clock and a heartbeat."""

    name: str  # what was opened, for messages
    virtual: bool  # time is virtual and advances while `read` waits
    # Host time at which the bytes last returned by `read` had arrived. A main thread that was busy
    # finds old bytes with their true stamps.
    read_s: float

    def now(self) -> float:
        """Host seconds; monotonic."""

    def write(self, data: bytes) -> None:
        """Send bytes, not waiting for them to leave; raises LinkError if the connection is gone."""

    def read(self, timeout_s: float) -> bytes:
        """Bytes as soon as there are any; b"" when `timeout_s`, which may be virtual, has passed.

        Any positive time-out lets time pass. Raises LinkError if the connection is gone.
        """

    def start_heartbeat(self, session: int, period_s: float) -> None:
        """Send this session's heartbeat from now on, whatever the main thread does."""

    def stop_heartbeat(self) -> None:
        """Send no further heartbeats."""

    def beats(self) -> list[Beat]:
        """Heartbeats sent since the last call, oldest first (the last 64 at most)."""

    def close(self) -> None:
        """Close; may be called twice."""


# Entry points that open the URLs of simulated robots, named by their schemes. The link knows
# nothing of an emulator, and a session on hardware never loads one.
_EMULATORS = "thigmo.emulators"
DEFAULT_BAUD = 250_000  # exact on the Mega's 16 MHz; 500 k after a soak test


def emulated(url: str) -> bool:
    """Whether the robot at an address lives inside the program that opens it."""
    return _scheme(url) in _emulators()


def _scheme(url: str) -> str:
    scheme, separator, _ = url.partition("://")
    return scheme if separator else ""


@cache
def _emulators() -> dict[str, EntryPoint]:
    """By scheme. Installed packages do not change while a program runs."""
    return {emulator.name: emulator for emulator in entry_points(group=_EMULATORS)}


def open_transport(url: str, *, seed: int | None = None, realtime: bool = False) -> Transport:
    """Open a connection by its URL, as `thigmo.connect`; a plain port takes `?baud=500000`.

    Raises PortError for a port that is missing, busy or not allowed, or a malformed URL,
    ConfigError for a scene that cannot be used.
    """
    scheme = _scheme(url)
    if (emulator := _emulators().get(scheme)) is not None:
        require_sources(emulator.module, f"{scheme}://")
        transport: Transport = emulator.load()(url, seed=seed, realtime=realtime)
        return transport
    from thigmo.link.serial_port import SerialTransport

    baud = DEFAULT_BAUD
    if "://" not in url and "?baud=" in url:
        url, _, text = url.partition("?baud=")
        if not text.isdecimal() or int(text) == 0:
            raise PortError(f"?baud={text} is not a baud rate", "give a number, as in ?baud=500000")
        baud = int(text)
    return SerialTransport(url, baud)
