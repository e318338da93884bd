"""Which events are new, and up to which one the board may forget them.

The board sends every event at once and repeats each until an acknowledgement covers it; the line
may lose and reorder them. New ones are handed on as they come, for a contact must not wait; an
acknowledgement, which covers all numbers up to its own, waits until there is no gap below it.
"""

from __future__ import annotations

# A number that is missing while a later one came so often is not at the board: its queue
# overflowed, or another host took it.
_REPEATS = 10


class EventLedger:
    """Numbers of events seen, modulo 2**16."""

    def __init__(self) -> None:
        self._base: int | None = None  # all up to here are known
        self._ahead: dict[int, int] = {}  # above it: number -> times seen

    def reset(self) -> None:
        """The board restarted: it numbers from 1 again."""
        self._base = None
        self._ahead.clear()

    def take(self, number: int) -> bool:
        """Note an event that came; whether it is new."""
        if self._base is None and number == 1:
            self._base = 0
        if self._base is not None and not 0 < (number - self._base) & 0xFFFF < 0x8000:
            return False
        seen = self._ahead.get(number, 0)
        self._ahead[number] = seen + 1
        self._advance()
        return seen == 0

    @property
    def acknowledge(self) -> int | None:
        """The number to acknowledge; None if none is safe."""
        return self._base or None

    def _advance(self) -> None:
        if self._base is None or (self._base + 1) & 0xFFFF not in self._ahead:
            oldest = min(self._ahead, key=self._distance)
            if self._ahead[oldest] < _REPEATS:
                return
            self._base = (oldest - 1) & 0xFFFF
        while (next_number := (self._base + 1) & 0xFFFF) in self._ahead:
            del self._ahead[next_number]
            self._base = next_number

    def _distance(self, number: int) -> int:
        reference = self._base if self._base is not None else next(iter(self._ahead)) - 0x4000
        return (number - reference) & 0xFFFF
