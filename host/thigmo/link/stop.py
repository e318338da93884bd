"""Stopping the board: a frame that it obeys in every state, repeated until it echoes the nonce.

Used by all that can write to the port: the client, and the owner of its bytes (the process that
owns a serial port, the emulator). No session, no sequence number and no command that waits for its
answer stands in the way. The stop latches on the board until an operator clears it.
"""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from thigmo.link.framing import Frame, encode
from thigmo.link.heartbeat import HOLD_AFTER
from thigmo.link.protocol import Stop, Stopped

REPEAT_S = 0.05
CONFIRM_S = 3.0  # of a board that talks: sixty repeats
# A board that is silent for this time may be in its boot loader, which must receive nothing: after
# a reset its outputs are off anyway. A board that runs sends at least twice a second.
MUTE_S = 0.6
# Silence longer than any boot loader's (`client.SILENCE_S`).
SILENT_S = 1.6
UNCONFIRMED_CURE = "use the emergency stop or cut the power, and shut the air"


@dataclass(slots=True)
class StopCall:
    """One stop, from the first frame to its echo."""

    called_s: float  # when it began, by the clock that all methods are given
    heard_s: float = float("-inf")  # when a byte last came from the board
    # Random, never 0. Its bytes have the top bit set, for "!!!" enters the boot loader's monitor.
    nonce: int = field(default_factory=lambda: secrets.randbits(32) | 0x8080_8080)
    next_s: float = float("-inf")  # when the next frame is due
    unheard: int = 0  # frames sent since the board was last heard
    confirmed: bool = False  # the board has echoed the nonce: its outputs are off

    def frame(self, now_s: float) -> bytes | None:
        """The bytes to send now, or None if none are due.

        The zero before the frame ends whatever piece of another the board may hold.
        """
        if self.confirmed or now_s < self.next_s:
            return None
        silent = now_s - self.called_s < SILENT_S or self.unheard >= HOLD_AFTER
        if now_s - self.heard_s > MUTE_S and silent:
            return None
        self.next_s = now_s + REPEAT_S
        self.unheard += 1
        return b"\0" + encode(Stop(self.nonce), 0, 0)

    def heard(self, now_s: float) -> None:
        """Bytes came from the board."""
        self.heard_s = now_s
        self.unheard = 0

    def take(self, frame: Frame) -> None:
        """A frame from the board: perhaps the echo."""
        if frame.id == Stopped.ID and frame.payload == Stopped(self.nonce).pack():
            self.confirmed = True


class Stopper:
    """A stop that any thread may request, repeated until the board has confirmed it.

    The program that writes to the board sends `frame` when one is due by the clock `now` (s).
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._heard_s = float("-inf")
        self._call: StopCall | None = None
        self._lock = threading.RLock()  # a signal's handler may come upon itself
        self._over = False
        self._answered = threading.Event()  # the board has confirmed, or will no longer

    def call(self) -> None:
        """Stop the robot, from now on until the board confirms it; returns at once."""
        with self._lock:
            if not self.calling and not self._over:
                self._answered.clear()
                self._call = StopCall(self._now(), self._heard_s)

    def stop(self, within_s: float = CONFIRM_S) -> bool:
        """Stop the robot; whether the board confirmed it within so long, by the wall clock."""
        self.call()
        return self._answered.wait(within_s) and not (self.calling or self._over)

    def end(self) -> None:
        """The board cannot be reached any more: nobody has to wait for it."""
        self._over = True
        self._answered.set()

    @property
    def calling(self) -> bool:
        """Whether a stop waits to be confirmed."""
        return self._call is not None and not self._call.confirmed

    def frame(self) -> bytes | None:
        """The bytes to send now, or None if none are due."""
        return self._call.frame(self._now()) if self._call is not None else None

    def heard(self) -> None:
        """Bytes came from the board."""
        self._heard_s = self._now()
        if self._call is not None:
            self._call.heard(self._heard_s)

    def take(self, frame: Frame) -> None:
        """A frame from the board: perhaps the echo."""
        call = self._call
        if call is not None:
            call.take(frame)
            if call.confirmed:
                self._answered.set()
