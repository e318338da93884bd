"""Frames on the wire: COBS stuffing, CRC-16 check sequence, header.

`encode` makes one; `Decoder` finds them in a stream that may lose, flip, insert and replay bytes,
with bounded memory, and picks up again at the next zero byte. Layout: protocol/PROTOCOL.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from struct import Struct
from typing import NamedTuple

import crcmod.predefined
from cobs import cobs

from thigmo.link.protocol import CRC, MAX_FRAME, MAX_WIRE, MESSAGES, Message

_HEADER = Struct("<BHH")
_CRC = Struct("<H")
MIN_FRAME = _HEADER.size + _CRC.size
check_sequence = crcmod.predefined.mkPredefinedCrcFun(CRC)


class FrameError(ValueError):
    """Bytes that are no whole good frame."""


class Frame(NamedTuple):
    """One good frame."""

    id: int  # of the message
    seq: int
    session: int
    payload: bytes  # the message's bytes
    wire: bytes  # the stuffed bytes as they came, without the closing zero

    def message(self) -> Message:
        """The typed message; FrameError for an unknown id, a wrong size or an unknown value."""
        kind = MESSAGES.get(self.id)
        if kind is None:
            raise FrameError(f"unknown message id 0x{self.id:02X}")
        try:
            return kind.unpack(self.payload)
        except ValueError as error:
            raise FrameError(str(error)) from error


def encode(message: Message, seq: int, session: int) -> bytes:
    """A message as bytes on the wire, closing zero included."""
    body = _HEADER.pack(message.ID, seq, session) + message.pack()
    stuffed: bytes = cobs.encode(body + _CRC.pack(check_sequence(body)))
    return stuffed + b"\0"


def decode(wire: bytes) -> Frame:
    """One frame from its stuffed bytes, without the closing zero; FrameError if they are none."""
    try:
        raw = cobs.decode(wire)
    except cobs.DecodeError as error:
        raise FrameError(str(error)) from error
    if not MIN_FRAME <= len(raw) <= MAX_FRAME:
        raise FrameError(f"{len(raw)} bytes, {MIN_FRAME}..{MAX_FRAME} allowed")
    if check_sequence(raw[:-2]) != raw[-2] | raw[-1] << 8:
        raise FrameError("wrong check sequence")
    kind, seq, session = _HEADER.unpack_from(raw)
    return Frame(kind, seq, session, raw[_HEADER.size : -2], wire)


@dataclass(slots=True)
class Decoder:
    """Frames out of a byte stream."""

    frames: int = 0  # good ones so far
    bad: int = 0  # pieces between zero bytes that were no good frame
    bad_bytes: int = 0  # bytes in those pieces
    _incomplete: bytes = b""
    _overlong: bool = False

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes as they come; return the frames that they complete, in order."""
        *pieces, incomplete = data.split(b"\0")
        frames: list[Frame] = []
        for piece in pieces:
            encoded = self._incomplete + piece
            if self._overlong:
                self.bad += 1
                self.bad_bytes += len(encoded)
            elif encoded:  # two zeros in a row are no loss
                try:
                    frames.append(decode(encoded))
                except FrameError:
                    self.bad += 1
                    self.bad_bytes += len(encoded)
            self._incomplete, self._overlong = b"", False
        self._incomplete += incomplete
        if len(self._incomplete) >= MAX_WIRE:  # no frame is so long: drop up to the next zero
            self.bad_bytes += len(self._incomplete)
            self._incomplete = b""
            self._overlong = True
        self.frames += len(frames)
        return frames

    @property
    def garbage(self) -> int:
        """Bytes that belonged to no good frame, those still waiting for a zero included."""
        return self.bad_bytes + len(self._incomplete)
