"""How long to wait for an answer before a command is repeated, from measured round trips.

Jacobson, Congestion avoidance and control, SIGCOMM 1988: smoothed round trip plus four mean
deviations, doubled at each time-out. Karn's rule (no measurement from a repeated command) is the
caller's.
"""

from __future__ import annotations

_FIRST_S = 0.15
_MIN_S = 0.02
_MAX_S = 0.25


class RoundTrip:
    """Smoothed round trip and the time-out that follows from it."""

    def __init__(self) -> None:
        self.smoothed_s = 0.0
        self.deviation_s = 0.0
        self._backoff = 1.0

    def measure(self, round_trip_s: float) -> None:
        """Take the round trip of a command that was sent once."""
        if self.smoothed_s == 0.0:
            self.smoothed_s, self.deviation_s = round_trip_s, round_trip_s / 2
        else:
            error = round_trip_s - self.smoothed_s
            self.smoothed_s += error / 8
            self.deviation_s += (abs(error) - self.deviation_s) / 4
        self._backoff = 1.0

    def back_off(self) -> None:
        """A time-out happened: wait longer, until a fresh measurement."""
        self._backoff = min(2 * self._backoff, 8.0)

    @property
    def timeout_s(self) -> float:
        """When to repeat."""
        base = self.smoothed_s + 4 * self.deviation_s if self.smoothed_s else _FIRST_S
        return min(max(base, _MIN_S) * self._backoff, _MAX_S)
