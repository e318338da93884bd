"""What the client hands on: telemetry frames, events, and counters of the link's health."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from thigmo.link import protocol as wire


class TelemetryFrame:
    """One telemetry frame, decoded when asked.

    Attributes:
        seq: its number; gaps are drops.
        t_s: host time of its arrival.
        device_us: unwrapped device time of its readings.
        payload: the undecoded message.
    """

    __slots__ = ("_message", "device_us", "payload", "seq", "t_s")

    def __init__(self, seq: int, t_s: float, device_us: int, payload: bytes) -> None:
        self.seq = seq
        self.t_s = t_s
        self.device_us = device_us
        self.payload = payload
        self._message: wire.Telemetry | None = None

    @property
    def message(self) -> wire.Telemetry:
        """The typed message."""
        if self._message is None:
            self._message = wire.Telemetry.unpack(self.payload)
        return self._message


class ReceivedEvent(NamedTuple):
    """An event, its arrival at the host, and its unwrapped device time."""

    message: wire.Event
    t_s: float
    device_us: int


@dataclass(slots=True)
class LinkCounters:
    """What the link went through, as the host sees it.

    Attributes:
        frames, bad_frames, garbage_bytes: received.
        foreign: good frames of another session, or answers to no question.
        repeats: commands sent again.
        timeouts: commands that found no answer.
        telemetry, telemetry_lost, telemetry_stale: frames, gaps, and frames out of order.
        events, event_repeats: new ones, and ones already known.
        hellos: conversations opened.
    """

    frames: int = 0
    bad_frames: int = 0
    garbage_bytes: int = 0
    foreign: int = 0
    repeats: int = 0
    timeouts: int = 0
    telemetry: int = 0
    telemetry_lost: int = 0
    telemetry_stale: int = 0
    events: int = 0
    event_repeats: int = 0
    hellos: int = 0
