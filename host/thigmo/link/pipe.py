"""Packets between the host and its port's process, pickled over the process's standard streams.

Both ends run this same module, so the layout needs no version.
"""

from __future__ import annotations

import pickle
from enum import Enum, auto
from typing import IO, Any, NamedTuple


class Kind(Enum):
    """Meaning and content of a packet."""

    # host -> process
    WRITE = auto()  # bytes for the port
    START = auto()  # send the heartbeat: session, period
    HUSH = auto()  # send no further heartbeats
    LEASE = auto()  # the host's main thread is alive
    ATTENDED = auto()  # it waits for its operator: the lease lasts until it speaks again
    CLOSE = auto()
    # process -> host
    OPENED = auto()
    DATA = auto()  # bytes from the port, stamped on arrival
    BEATEN = auto()  # a heartbeat went: its counter, stamped before
    FAILED = auto()  # the port cannot be opened, or is gone: the error to raise


class Packet(NamedTuple):
    """One packet."""

    kind: Kind
    value: Any = None
    t_s: float = 0.0

    @property
    def size(self) -> int:
        """Bytes of the port's that it carries."""
        return len(self.value) if self.kind is Kind.DATA else 0


def write_packet(stream: IO[bytes], packet: Packet) -> None:
    """Write and flush; raises OSError when the other end is gone."""
    stream.write(pickle.dumps(packet))
    stream.flush()


def read_packet(stream: IO[bytes]) -> Packet | None:
    """The next packet, waiting for it; None when the other end is gone."""
    try:
        packet: Packet = pickle.load(stream)
    except (EOFError, OSError, pickle.UnpicklingError):
        return None
    return packet
