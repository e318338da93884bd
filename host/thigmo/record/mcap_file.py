"""Reads MCAP files that may be damaged: what is whole is given, and the gaps are counted.

MCAP's own reader stops at the first record that is not as it should be. A file is a sequence of
records (opcode u8, length u64, content), most of them chunks with a checksum of their own
(mcap.dev/spec), so that a flipped bit costs one chunk, a fraction of a second of a run.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Literal

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata

from thigmo.errors import RunFolderError

_MAGIC = b"\x89MCAP0\r\n"
_HEADER = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK_BYTES = 28  # before a chunk's compression: start and end time, size (u64), checksum (u32)
_MOST_BYTES = 1 << 28  # in a chunk: more is a damaged length
_COMPRESSION = b"\x04\x00\x00\x00zstd"
_OPCODES = frozenset(int(opcode) for opcode in Opcode)
_DAMAGE = (
    struct.error, ValueError, OverflowError, MemoryError, McapError, zstandard.ZstdError,
)  # fmt: skip


class _DamagedError(ValueError):
    """A chunk that is not whole."""


@dataclass(slots=True)
class McapContents:
    """What a file holds.

    Attributes:
        channels: by their number.
        metadata: of all metadata records.
        messages: channel number, log time in ns, and data of each, in the file's order.
        gaps: places at which something is missing.
        truncated: the end is missing: the writer was killed.
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)
    messages: list[tuple[int, int, bytes]] = field(default_factory=list)
    gaps: int = 0
    truncated: bool = False


def read_mcap(path: Path, wanted: Callable[[str], bool]) -> McapContents:
    """Read a file's messages on the topics that are wanted.

    Raises:
        RunFolderError: there is no such file, or it is no MCAP file.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RunFolderError(
            f"cannot read {path}: {error.strerror}", "give a run folder that holds run.mcap"
        ) from error
    found = McapContents(truncated=not data.endswith(_MAGIC) or len(data) < 2 * len(_MAGIC))
    place: int | None = len(_MAGIC)
    broken = False  # nothing whole has come since the last gap
    if not data.startswith(_MAGIC):
        place = _next_chunk(data, 0)
        if place is None and not _MAGIC.startswith(data[: len(_MAGIC)]):
            raise RunFolderError(f"{path} is not an MCAP file", "give a run folder")
        found.gaps, broken = int(place is not None), True
    while place is not None and place + _HEADER.size <= len(data):
        opcode, length = _HEADER.unpack_from(data, place)
        end = place + _HEADER.size + length
        if opcode == Opcode.FOOTER:
            break
        known = opcode in _OPCODES and end <= len(data)
        state = _take(data, place, end, wanted, found) if known else "lost"
        following = end if state != "lost" else _next_chunk(data, place + 1)
        if state == "whole":
            broken = broken and opcode != Opcode.CHUNK
        elif not broken and (following is not None or not found.truncated):
            found.gaps += 1
            broken = True
        place = following
    return found


def _take(
    data: bytes, place: int, end: int, wanted: Callable[[str], bool], found: McapContents
) -> Literal["whole", "damaged", "lost"]:
    """Take the record of `data[place:end]`; where the next one begins may be lost with it."""
    opcode, content = data[place], data[place + _HEADER.size : end]
    try:
        if opcode == Opcode.CHUNK:
            _take_chunk(content, wanted, found)
        else:
            _take_definition(opcode, content, found)
    except _DamagedError:
        return "damaged"  # its length is right
    except _DAMAGE:
        return "lost"
    return "whole"


def _take_definition(opcode: int, content: bytes, found: McapContents) -> None:
    stream = ReadDataStream(BytesIO(content))
    if opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        found.channels[channel.id] = channel
    elif opcode == Opcode.METADATA:
        found.metadata |= Metadata.read(stream).metadata


def _take_chunk(content: bytes, wanted: Callable[[str], bool], found: McapContents) -> None:
    """Take a chunk's records, or none of them.

    Raises:
        _DamagedError: its content is not what its checksum says.
        ValueError, struct.error, McapError: its lengths do not add up.
    """
    stream = ReadDataStream(BytesIO(content))
    chunk = Chunk.read(stream)
    if stream.count != len(content):
        raise ValueError("a chunk's lengths do not add up")
    size, checksum, records = chunk.uncompressed_size, chunk.uncompressed_crc, chunk.data
    try:
        if size > _MOST_BYTES:
            raise _DamagedError
        if chunk.compression == "zstd":
            records = zstandard.decompress(records, size)
        if len(records) != size or (checksum and zlib.crc32(records) != checksum):
            raise _DamagedError
    except _DAMAGE as error:
        raise _DamagedError from error
    place = 0
    while place < len(records):
        opcode, length = _HEADER.unpack_from(records, place)
        place += _HEADER.size
        if opcode == Opcode.MESSAGE:
            number, _, log_ns, _ = _MESSAGE.unpack_from(records, place)
            channel = found.channels.get(number)
            if channel is None or wanted(channel.topic):
                body = records[place + _MESSAGE.size : place + length]
                found.messages.append((number, log_ns, body))
        else:
            _take_definition(opcode, records[place : place + length], found)
        place += length


def _next_chunk(data: bytes, place: int) -> int | None:
    """Where the next chunk's record seems to begin; None if there is none."""
    before = _HEADER.size + _CHUNK_BYTES
    at = data.find(_COMPRESSION, place + before)
    while at >= 0:
        start = at - before
        opcode, length = _HEADER.unpack_from(data, start)
        if opcode == Opcode.CHUNK and start + _HEADER.size + length <= len(data):
            return start
        at = data.find(_COMPRESSION, at + 1)
    return None
