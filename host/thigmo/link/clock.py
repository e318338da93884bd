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


class _Pair(NamedTuple):
    """One instant by both clocks."""

    host_s: float  # in the middle of the round trip
    device_us: int
    round_trip_s: float


class DeviceClock:
    """Unwraps and maps; bounded memory."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._best: deque[_Pair] = deque(maxlen=_STRETCHES)  # of each stretch
        self._until_s = 0.0  # end of the newest stretch

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

    def pair(
        self, sent_s: float, received_s: float, device_us: int, *, waited_s: float = 0.0
    ) -> None:
        """Take a round trip: host times around an (unwrapped) device stamp.

        `waited_s` is the longest time for which the request may have queued behind other bytes; it
        is added to the pair's uncertainty.
        """
        round_trip_s = received_s - sent_s + waited_s
        pair = _Pair((sent_s + received_s) / 2, device_us, round_trip_s)
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
        if not self._best:
            raise LookupError("the clocks are not synchronised yet")
        limit = 1.5 * min(pair.round_trip_s for pair in self._best) + 0.5e-3
        pairs = [pair for pair in self._best if pair.round_trip_s <= limit]
        first = pairs[0]  # differences keep the sums small and exact
        device_s = [(pair.device_us - first.device_us) * 1e-6 for pair in pairs]
        host_s = [pair.host_s - first.host_s for pair in pairs]
        slope = 1.0
        if host_s[-1] >= _MIN_BASE_S:
            fitted = linear_regression(device_s, host_s).slope
            if abs(fitted - 1.0) <= _MAX_SKEW:
                slope = fitted
        late_s = (device_us - first.device_us) * 1e-6 - fmean(device_s)
        return first.host_s + fmean(host_s) + slope * late_s
