"""The heartbeat: what keeps the board's outputs energised, and only while the host lives.

The owner of the bytes (the port's process, the emulator) beats it, so that a busy main thread
cannot starve it. The board drops a counter that does not rise, so a replayed beat keeps nobody
alive.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from thigmo.link.framing import encode
from thigmo.link.protocol import Heartbeat

PERIOD_S = 0.1  # a fifth of the board's default limit of 0.5 s


class Beat(NamedTuple):
    """A heartbeat that was sent: its counter and the host's time just before."""

    counter: int
    t_s: float


HOLD_AFTER = 4  # beats unheard after which a board counts as mute


@dataclass(slots=True)
class HeartbeatSource:
    """Beats of one session."""

    session: int  # its number
    period_s: float = PERIOD_S  # between beats
    counter: int = 0  # of the last beat; 0 before the first
    next_s: float = float("-inf")  # when the next one is due, by the clock that `beat` is given
    # beats without a byte from the board after which the heartbeat holds until `heard`: a board
    # that restarted is in its boot loader, which a stray byte keeps for 9.3 s
    # (docs/hardware/facts.md). None: never.
    hold_after: int | None = None
    unheard: int = 0  # beats since the board was last heard

    def beat(self, now_s: float) -> bytes | None:
        """The frame to send now, or None if none is due. Late beats are not made up for."""
        if now_s < self.next_s or (self.hold_after is not None and self.unheard >= self.hold_after):
            return None
        self.next_s = now_s + self.period_s
        self.counter += 1
        self.unheard += 1
        return encode(Heartbeat(self.counter), 0, self.session)

    def heard(self) -> None:
        """A byte came from the board."""
        self.unheard = 0
