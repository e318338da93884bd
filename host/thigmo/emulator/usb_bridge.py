"""The Mega's USB bridge (an ATmega16U2), between the host's port and the board's UART.

It passes the board's bytes on when its 4.1 ms timer runs over or it has 96 of them, and the host's
bytes once a USB frame (1 ms). Under load both ways it has been reported to insert
bytes and to repeat old ones (ArduinoCore-avr issues 296 and 167): `insert` and `replay` do that on
purpose, from a seed.
"""

from __future__ import annotations

import random
from collections import deque

FLUSH_MS = 4.096  # timer 0 overflow: 256 * 256 / 16 MHz
NEARLY_FULL = 96
_REMEMBERED = 128


class UsbBridge:
    """Delays both directions.

    From the seed, and with the probability `insert`, a transfer gains a byte that nobody sent; with
    `replay` a piece of an earlier one follows.
    """

    def __init__(self, seed: int = 0, *, insert: float = 0.0, replay: float = 0.0) -> None:
        self.insert = insert
        self.replay = replay
        self.inserted = 0
        self.replayed = 0
        self._rng = random.Random(seed)
        self._down = bytearray()
        self._up = bytearray()
        self._old = {way: deque[int](maxlen=_REMEMBERED) for way in ("down", "up")}
        self._flushed_ms = 0.0

    def send(self, data: bytes) -> None:
        """Bytes from the host."""
        self._down += data

    def exchange(self, now_ms: float, from_board: bytes) -> tuple[bytes, bytes]:
        """A USB frame, at a time that rises; returns bytes for the board, and for the host."""
        down = self._transfer("down", self._down) if self._down else b""
        self._down.clear()
        self._up += from_board
        up = b""
        due = now_ms - self._flushed_ms >= FLUSH_MS
        if due:
            self._flushed_ms += FLUSH_MS * ((now_ms - self._flushed_ms) // FLUSH_MS)
        if self._up and (due or len(self._up) >= NEARLY_FULL):
            up = self._transfer("up", self._up)
            self._up.clear()
        return down, up

    def drop(self) -> None:
        """Pull the cable; bytes under way are lost."""
        self._down.clear()
        self._up.clear()

    def _transfer(self, way: str, data: bytearray) -> bytes:
        out = bytearray(data)
        old = self._old[way]
        if self._rng.random() < self.insert:
            out.insert(self._rng.randrange(len(out) + 1), self._rng.randrange(256))
            self.inserted += 1
        if old and self._rng.random() < self.replay:
            start = self._rng.randrange(len(old))
            out += bytes(old)[start : start + self._rng.randrange(1, 64)]
            self.replayed += 1
        old.extend(data)
        return bytes(out)
