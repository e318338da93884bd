"""The board's clock, unwrapped and mapped to the host's.

The board counts 32 bits of microseconds, which wrap every 71.6 minutes, on a resonator that may be
off by half a percent. Heartbeats and their pulses give pairs of both clocks; those with the
shortest round trip bound the error best (the idea of Klipper's klippy/clocksync.py), so the best
pair of each stretch of time is kept and a line is fitted through the best of these.
"""

from __future__ import annotations

from collections import deque
from statistics import fmean, linear_regression
from typing import NamedTuple

_WRAP = 1 << 32
_STRETCH_S = 2.0
_STRETCHES = 64
_MAX_SKEW = 0.02  # a resonator is never so far off; a fit that says so is noise
_MIN_BASE_S = 5.0  # a slope over less time than this is mostly jitter


class Pair(NamedTuple):
    """One instant by both clocks: host time in the middle of a round trip, device microseconds."""

    host_s: float
    device_us: int
    round_trip_s: float


class DeviceClock:
    """Unwraps and maps; bounded memory."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._best: deque[Pair] = deque(maxlen=_STRETCHES)  # of each stretch
        self._until_s = 0.0  # end of the newest stretch

    def reset(self) -> None:
        """Forget everything: the board restarted."""
        self._last = None
        self._best.clear()

    def unwrap(self, t_us: int) -> int:
        """Microseconds since the first wrap's start, of a 32-bit stamp.

        Stamps may come out of order by up to 35 minutes either way.
        """
        if self._last is None:
            self._last = t_us
            return t_us
        delta = (t_us - self._last) & (_WRAP - 1)
        if delta >= _WRAP >> 1:  # an older stamp (an event, a snapshot): keep the newest
            return self._last + delta - _WRAP
        self._last += delta
        return self._last

    def pair(self, sent_s: float, received_s: float, device_us: int) -> None:
        """Take a round trip: host times around an (unwrapped) device stamp."""
        pair = Pair((sent_s + received_s) / 2, device_us, received_s - sent_s)
        if not self._best or received_s >= self._until_s:
            self._best.append(pair)
            self._until_s = received_s + _STRETCH_S
        elif pair.round_trip_s < self._best[-1].round_trip_s:
            self._best[-1] = pair

    @property
    def synchronised(self) -> bool:
        """Whether any pair is known."""
        return bool(self._best)

    def to_host(self, device_us: float) -> float:
        """Host seconds of unwrapped device microseconds; raises LookupError before any pair."""
        host_s, base_us, slope = self._line()
        return host_s + slope * (device_us - base_us) * 1e-6

    def to_device(self, host_s: float) -> float:
        """Unwrapped device microseconds of host seconds; raises LookupError before any pair."""
        base_s, device_us, slope = self._line()
        return device_us + (host_s - base_s) / slope * 1e6

    def _line(self) -> tuple[float, float, float]:
        """Host seconds and device microseconds of a point, and the slope through it."""
        if not self._best:
            raise LookupError("the clocks are not synchronised yet")
        limit = 1.5 * min(pair.round_trip_s for pair in self._best) + 0.5e-3
        pairs = [pair for pair in self._best if pair.round_trip_s <= limit]
        base = pairs[0].device_us  # differences keep the sums small and exact
        device_us = [float(p.device_us - base) for p in pairs]
        host_s = [p.host_s - pairs[0].host_s for p in pairs]
        slope = 1.0
        if host_s[-1] >= _MIN_BASE_S:
            fitted = linear_regression(device_us, host_s).slope * 1e6
            if abs(fitted - 1.0) <= _MAX_SKEW:
                slope = fitted
        return pairs[0].host_s + fmean(host_s), base + fmean(device_us), slope
