"""What the client hands on: telemetry frames, events, and counters of the link's health."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from thigmo.link import protocol as wire


@dataclass
class TelemetryFrame:
    """One telemetry frame, decoded when asked."""

    seq: int  # its number; gaps are drops
    t_s: float  # host time of its arrival
    device_us: int  # unwrapped device time of its readings
    payload: bytes  # the undecoded message

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

    frames: int = 0  # good ones received
    bad_frames: int = 0
    garbage_bytes: int = 0  # in no good frame
    foreign: int = 0  # good frames of another session, or answers to no question
    repeats: int = 0  # commands sent again
    timeouts: int = 0  # commands that found no answer
    telemetry: int = 0  # frames
    telemetry_lost: int = 0  # by the gaps in their numbers
    telemetry_stale: int = 0  # frames out of order
    events: int = 0  # new ones
    event_repeats: int = 0  # ones already known
    hellos: int = 0  # conversations opened
