"""What a client hears besides replies: telemetry, events, and the pulse that sets its clock.

Telemetry is counted and handed on undecoded; pulses pair the board's clock with the host's. Events
are handed on once, as they come, for a contact must not wait. The board repeats each until an
acknowledgement covers it, and the line may lose and reorder them: an acknowledgement, which covers
all numbers up to its own, waits until there is no gap below it. `client.Client` builds on it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from thigmo.link import protocol as wire
from thigmo.link.clock import DeviceClock
from thigmo.link.framing import Frame
from thigmo.link.heartbeat import Beat

_EVENTS = 1024
_BEATS = 64
_WRITES = 64
_LINE_S = 0.009  # a frame of 96 bytes takes 8.3 ms at 115 200 baud, the slowest in use
# A number that is missing while a later one came so often is not at the board: its queue
# overflowed, or another host took it.
_REPEATS = 10


@dataclass
class TelemetryFrame:
    """One telemetry frame, decoded when asked."""

    seq: int  # gaps are drops
    t_s: float  # host time of its arrival
    device_us: int  # unwrapped device time of its readings
    payload: bytes  # the undecoded message

    @property
    def device_s(self) -> float:
        """The same in seconds."""
        return self.device_us * 1e-6

    @cached_property
    def message(self) -> wire.Telemetry:
        """The typed message."""
        return wire.Telemetry.unpack(self.payload)


class ReceivedEvent(NamedTuple):
    """An event, its arrival at the host, and its unwrapped device time."""

    message: wire.Event
    t_s: float
    device_us: int


@dataclass(slots=True)
class LinkCounters:
    """What the link went through, as the host sees it."""

    bad_frames: int = 0
    repeats: int = 0  # commands sent again
    timeouts: int = 0  # commands that found no answer
    telemetry: int = 0  # frames
    telemetry_lost: int = 0  # by the gaps in their numbers
    hellos: int = 0  # conversations opened


class EventLedger:
    """Numbers of events seen, modulo 2**16."""

    def __init__(self) -> None:
        self._base: int | None = None  # all up to here are known
        self._ahead: dict[int, int] = {}  # above it: number -> times seen

    def take(self, number: int) -> bool:
        """Record an event; returns whether it is new."""
        if self._base is None and number == 1:
            self._base = 0
        if self._base is not None and not 0 < (number - self._base) & 0xFFFF < 0x8000:
            return False
        count = self._ahead.get(number, 0)
        self._ahead[number] = count + 1
        below = number - 0x4000 if self._base is None else self._base
        oldest = min(self._ahead, key=lambda event: (event - below) & 0xFFFF)
        if self._ahead[oldest] >= _REPEATS:
            self._base = (oldest - 1) & 0xFFFF
        while self._base is not None and self._ahead.pop((self._base + 1) & 0xFFFF, 0):
            self._base = (self._base + 1) & 0xFFFF
        return count == 0

    @property
    def acknowledge(self) -> int | None:
        """The number to acknowledge; None if none is safe."""
        return self._base or None


class Inbox:
    """Telemetry, events and clock of one conversation after another."""

    def __init__(self) -> None:
        self.clock = DeviceClock()  # the board's
        self.stats = LinkCounters()
        # Received and not yet taken, oldest first. When it is full the board keeps the rest.
        self.events: deque[ReceivedEvent] = deque()
        # Called for each, in order. They must not send commands.
        self.on_telemetry: list[Callable[[TelemetryFrame], None]] = []
        self.on_event: list[Callable[[ReceivedEvent], None]] = []
        self.session = 0  # number of the conversation; 0 before the first
        self._telemetry_seq: int | None = None
        self._ledger = EventLedger()
        self._ack_due: int | None = None
        # Of those not answered: the time, and how long each may have waited for the line.
        self._beats: dict[int, tuple[float, float]] = {}
        self._writes: deque[float] = deque(maxlen=_WRITES)  # when frames were handed to the line

    def device_s(self, t_us: int) -> float:
        """Unwrapped seconds of a 32-bit device stamp."""
        return self.clock.unwrap(t_us) * 1e-6

    def _begin_session(self, session: int, new_boot: bool) -> None:
        """Another conversation: telemetry and heartbeats count from 0; a boot restarts all."""
        if new_boot:
            self.clock, self._ledger = DeviceClock(), EventLedger()
        self.session = session
        self._telemetry_seq = None
        self._ack_due = None
        self._beats.clear()

    def _beat_sent(self, beat: Beat) -> None:
        ahead = any(0.0 <= beat.t_s - written_s < _LINE_S for written_s in self._writes)
        self._beats[beat.counter] = beat.t_s, _LINE_S if ahead else 0.0
        if len(self._beats) > _BEATS:
            del self._beats[next(iter(self._beats))]

    def _take_telemetry(self, frame: Frame, t_s: float) -> None:
        if frame.session != self.session:
            return
        if self._telemetry_seq is not None:
            delta = (frame.seq - self._telemetry_seq) & 0xFFFF
            if not 0 < delta < 0x8000:
                return  # an old one
            self.stats.telemetry_lost += delta - 1
        self._telemetry_seq = frame.seq
        self.stats.telemetry += 1
        device_us = self.clock.unwrap(int.from_bytes(frame.payload[:4], "little"))
        received = TelemetryFrame(frame.seq, t_s, device_us, frame.payload)
        for callback in self.on_telemetry:
            callback(received)

    def _take_pulse(self, message: wire.Pulse, t_s: float) -> None:
        beat = self._beats.pop(message.counter, None)
        device_us = self.clock.unwrap(message.t_us)
        if beat is not None:
            sent_s, waited_s = beat
            self.clock.pair(sent_s, t_s, device_us, waited_s=waited_s)

    def _take_event(self, message: wire.Event, t_s: float) -> None:
        if len(self.events) >= _EVENTS:
            return  # unacknowledged, so the board keeps it and asks again
        new = self._ledger.take(message.number)
        self._ack_due = self._ledger.acknowledge  # again, if the board did not hear the last one
        if not new:
            return
        received = ReceivedEvent(message, t_s, self.clock.unwrap(message.t_us))
        self.events.append(received)
        for callback in self.on_event:
            callback(received)
