"""What a client hears besides replies: telemetry, events, and the pulse that sets its clock.

Telemetry is counted and handed on undecoded; events are handed on once and noted for
acknowledgement; pulses pair the board's clock with the host's. `client.Client` builds on it.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable

from thigmo.link import protocol as wire
from thigmo.link.clock import DeviceClock
from thigmo.link.events import EventLedger
from thigmo.link.framing import Frame
from thigmo.link.received import LinkCounters, ReceivedEvent, TelemetryFrame

_EVENTS = 1024
_BEATS = 64


class Inbox:
    """Telemetry, events and clock of one conversation after another."""

    def __init__(self) -> None:
        self.clock = DeviceClock()  # the board's
        self.stats = LinkCounters()
        # Received and not yet taken, oldest first. When it is full the board keeps the rest.
        self.events: deque[ReceivedEvent] = deque()
        self.telemetry: TelemetryFrame | None = None  # the latest
        # Called for each, in order. They must not send commands.
        self.on_telemetry: list[Callable[[TelemetryFrame], None]] = []
        self.on_event: list[Callable[[ReceivedEvent], None]] = []
        self.session = 0  # number of the conversation; 0 before the first
        self._telemetry_seq: int | None = None
        self._ledger = EventLedger()
        self._ack_due: int | None = None
        self._beats: OrderedDict[int, float] = OrderedDict()

    def device_s(self, t_us: int) -> float:
        """Unwrapped seconds of a 32-bit device stamp."""
        return self.clock.unwrap(t_us) * 1e-6

    def _begin_session(self, session: int, new_boot: bool) -> None:
        """Another conversation: telemetry and heartbeats count anew; a boot restarts all."""
        if new_boot:
            self.clock.reset()
            self._ledger.reset()
        self.session = session
        self._telemetry_seq = None
        self._ack_due = None
        self._beats.clear()

    def _beat_sent(self, counter: int, t_s: float) -> None:
        self._beats[counter] = t_s
        if len(self._beats) > _BEATS:
            self._beats.popitem(last=False)

    def _take_telemetry(self, frame: Frame, t_s: float) -> None:
        payload = frame.payload
        if frame.session != self.session or len(payload) != wire.Telemetry.SIZE:
            self.stats.foreign += 1
            return
        if self._telemetry_seq is not None:
            delta = (frame.seq - self._telemetry_seq) & 0xFFFF
            if not 0 < delta < 0x8000:
                self.stats.telemetry_stale += 1
                return
            self.stats.telemetry_lost += delta - 1
        self._telemetry_seq = frame.seq
        self.stats.telemetry += 1
        device_us = self.clock.unwrap(int.from_bytes(payload[:4], "little"))
        received = TelemetryFrame(frame.seq, t_s, device_us, payload)
        self.telemetry = received
        for callback in self.on_telemetry:
            callback(received)

    def _take_pulse(self, message: wire.Pulse, t_s: float) -> None:
        sent_s = self._beats.pop(message.counter, None)
        device_us = self.clock.unwrap(message.t_us)
        if sent_s is not None:
            self.clock.pair(sent_s, t_s, device_us)

    def _take_event(self, message: wire.Event, t_s: float) -> None:
        if len(self.events) >= _EVENTS:
            return  # unacknowledged, so the board keeps it and asks again
        new = self._ledger.take(message.number)
        self._ack_due = self._ledger.acknowledge  # again, if the board did not hear the last one
        if not new:
            self.stats.event_repeats += 1
            return
        self.stats.events += 1
        received = ReceivedEvent(message, t_s, self.clock.unwrap(message.t_us))
        self.events.append(received)
        for callback in self.on_event:
            callback(received)
