"""A fibre's interrogator: lines of text over TCP, and whether they are of now.

Each line is the interrogator's own time in seconds and one strain in microstrain for each reading
of robot.toml, in its order, with commas or spaces between them; `nan` is a peak that was lost, and
a line that begins with # is skipped. The time must rise from line to line. It is what tells old
lines from new ones: a line's age counts from the least delay between its time and its arrival that
was seen so far, so that lines which waited in a buffer are as old as they are. A delay that all
lines had from the beginning cannot be detected.
"""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from thigmo.closing import Closing
from thigmo.errors import InterrogatorError

Floats = npt.NDArray[np.float64]

MAX_AGE_S = 0.2  # of the newest line, and of each grating's newest strain: a muscle's lag
_FIRST_S = 2.0  # for which a connection is waited
_HEARD_S = 0.3  # of lines, before their delay is known
_STUCK_S = 1.0  # for which the same strains in all gratings are those of no fibre
_CLOCKS = 5e-4  # by which the interrogator's clock and this one may differ, relative
_KEPT_S = 10.0
_LONGEST = 1 << 16  # bytes of a line
_SHOWN = 40  # characters of a line that cannot be read
_CURE = "look at the interrogator and its network; the robot is safe until lines come again"


class Source(Protocol):
    """Where lines come from."""

    name: str

    def read(self) -> bytes:
        """What has come, without waiting; raises OSError or EOFError where no more will come."""

    def close(self) -> None:
        """Close; may be called twice."""


class TcpSource:
    """A connection to `host:port`; raises InterrogatorError if there is none."""

    def __init__(self, address: str) -> None:
        self.name = address
        host, _, port = address.rpartition(":")
        try:
            self._socket = socket.create_connection((host, int(port)), _FIRST_S)
        except OSError as error:
            raise InterrogatorError(
                f"no interrogator answers at {address}: {error}",
                "start it, or correct `interrogator` in robot.toml",
            ) from error
        self._socket.setblocking(False)

    def read(self) -> bytes:
        """What has come, without waiting."""
        read = b""
        with suppress(BlockingIOError):
            while len(read) < _LONGEST:
                data = self._socket.recv(_LONGEST)
                if not data:
                    raise EOFError
                read += data
        return read

    def close(self) -> None:
        """Close; may be called twice."""
        self._socket.close()


@dataclass(frozen=True, slots=True)
class Line:
    """One line of strains."""

    stamp_s: float  # interrogator's time
    strain_ue: Floats  # (readings,), nan where a peak was lost


class Interrogator(Closing):
    """Lines of a source, each with that number of readings, by the host's clock `now`.

    Call `take` often: it does not wait.
    """

    def __init__(self, source: Source, count: int, now: Callable[[], float]) -> None:
        self._source, self._count, self._now = source, count, now
        self.on_line: list[Callable[[float, Floats], None]] = []  # host time and strains of each
        self._lines: deque[Line] = deque()  # of the last ten seconds
        self._incomplete = b""
        self._offset_s = np.inf  # from the interrogator's clock to ours
        self._arrived_s = now()
        self._seen_s = np.full(count, -np.inf)  # stamp of each reading's newest strain
        self._changed_s = -np.inf  # stamp of the newest line that is not as the one before
        self._unread = ""  # why the newest line could not be read; empty if it could
        self._ended = ""

    @property
    def heard(self) -> bool:
        """Whether lines have come for long enough to know how old they are."""
        self.take()
        lines = self._lines
        return bool(lines) and lines[-1].stamp_s - lines[0].stamp_s >= _HEARD_S

    def lines_since(self, t_s: float) -> list[tuple[float, Floats]]:
        """Host time and strains (readings,), nan where lost, of lines from a host time on."""
        self.take()
        rows = ((line.stamp_s + self._offset_s, line.strain_ue) for line in self._lines)
        return [row for row in rows if row[0] >= t_s]

    def take(self) -> None:
        """Read the lines that have come."""
        if self._ended:
            return
        try:
            *lines, self._incomplete = (self._incomplete + self._source.read()).split(b"\n")
        except (OSError, EOFError) as error:
            self._ended = str(error) or "it closed the connection"
            return
        if len(self._incomplete) > _LONGEST:
            self._unread, self._incomplete = "it sends no end of a line", b""
        now = self._now()
        for text in lines:
            self._parse(text.strip(), now)
        while len(self._lines) > 1 and self._lines[0].stamp_s + self._offset_s < now - _KEPT_S:
            self._lines.popleft()

    def _parse(self, text: bytes, now: float) -> None:
        if not text or text.startswith(b"#"):
            return
        excerpt = repr(text[:_SHOWN].decode("ascii", "replace"))
        try:
            stamp_s, *strain = (float(part) for part in text.replace(b",", b" ").split())
        except ValueError:
            self._unread = f"{excerpt} is no line of numbers"
            return
        if len(strain) != self._count:
            self._unread = f"{excerpt} has {len(strain)} strains, and robot.toml {self._count}"
            return
        last = self._lines[-1] if self._lines else None
        if not (last.stamp_s if last else -np.inf) < stamp_s < np.inf:
            self._unread = f"the time in {excerpt} does not rise"
            return
        self._unread = ""
        self._offset_s = min(self._offset_s + _CLOCKS * (now - self._arrived_s), now - stamp_s)
        self._arrived_s = now
        strains = np.array(strain)
        strains[~np.isfinite(strains)] = np.nan
        if last is None or not np.array_equal(strains, last.strain_ue, equal_nan=True):
            self._changed_s = stamp_s
        self._seen_s[np.isfinite(strains)] = stamp_s
        self._lines.append(Line(stamp_s, strains))
        for callback in self.on_line:
            callback(stamp_s + self._offset_s, strains)

    def require(self, needed: npt.NDArray[np.bool_]) -> None:
        """Raise InterrogatorError unless all needed readings (n,) are of now."""
        self.take()
        name = f"the interrogator at {self._source.name}"
        if self._ended:
            raise InterrogatorError(f"{name} is lost: {self._ended}", _CURE)
        cause = f" ({self._unread})" if self._unread else ""
        if not self._lines:
            raise InterrogatorError(f"{name} sends no lines of strains{cause}", _CURE)
        now = self._now() - self._offset_s
        age_s = now - self._lines[-1].stamp_s
        if age_s > MAX_AGE_S:
            raise InterrogatorError(
                f"{name}: its newest line is {age_s:.2f} s old (limit {MAX_AGE_S:g}){cause}",
                _CURE,
            )
        if now - self._changed_s > _STUCK_S:
            raise InterrogatorError(
                f"{name} repeats the same strains for {now - self._changed_s:.1f} s", _CURE
            )
        lost_readings = np.flatnonzero(needed & (now - self._seen_s > MAX_AGE_S))
        if lost_readings.size:
            raise InterrogatorError(
                f"{name} has lost strain_{', strain_'.join(map(str, lost_readings))}",
                "look at the fibre and its connector; a dead grating is `healthy = false` in "
                "robot.toml",
            )

    def close(self) -> None:
        """Close; may be called twice."""
        self._source.close()
