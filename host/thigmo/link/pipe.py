"""Packets between the host and its port's process, over the process's standard streams.

A packet is a kind, a time stamp, a length and that many bytes. Both ends run this same module, so
the layout needs no version.
"""

from __future__ import annotations

from enum import IntEnum
from struct import Struct
from typing import IO, NamedTuple

_HEAD = Struct("<BdI")
START = Struct("<Hd")  # session, period
BEAT = Struct("<I")  # counter
MAX_BYTES = 1 << 20


class Kind(IntEnum):
    """What a packet says."""

    # host -> process
    WRITE = 1  # bytes for the port
    START = 2  # beat the heart: START
    HUSH = 3  # beat no more
    LEASE = 4  # the host's main thread is alive
    ATTENDED = 6  # it waits for its operator: the lease lasts until it speaks again
    CLOSE = 5
    # process -> host
    OPENED = 16
    DATA = 17  # bytes from the port, stamped on arrival
    BEATEN = 18  # a heartbeat left: BEAT, stamped before
    DROPPED = 19  # the host did not read for so long that bytes were dropped
    FAILED = 20  # the port cannot be opened, or is gone: errno as text, a space, what happened


class Packet(NamedTuple):
    """One packet."""

    kind: Kind
    t_s: float
    data: bytes


def write_packet(stream: IO[bytes], kind: Kind, data: bytes = b"", t_s: float = 0.0) -> None:
    """Write and flush; raises OSError when the other end is gone."""
    stream.write(_HEAD.pack(kind, t_s, len(data)) + data)
    stream.flush()


def read_packet(stream: IO[bytes]) -> Packet | None:
    """The next packet, waiting for it; None when the other end is gone or talks nonsense."""
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    kind, t_s, size = _HEAD.unpack(head)
    if size > MAX_BYTES:
        return None
    data = stream.read(size)
    if len(data) < size:
        return None
    return Packet(Kind(kind), t_s, data)
