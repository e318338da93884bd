"""Reads MCAP files that may be damaged: intact records are returned, and gaps are counted.

MCAP's own reader stops at the first damaged record. A file is a sequence of
records (opcode u8, length u64, content), most of them chunks with a checksum of their own
(mcap.dev/spec), so that a flipped bit costs one chunk, a fraction of a second of a run.
"""

from __future__ import annotations

import struct
from collections.abc import Container
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC as MAGIC

from thigmo.errors import RunFolderError
from thigmo.files import RECORD_BYTES, read_file

_HEADER = struct.Struct("<BQ")
# A limit on unpacked size. Telemetry unpacks to four to eight times its size in the file.
_MOST_RATIO, _MOST_MORE = 100, 64 << 20
_CHUNK_BYTES = 28  # before a chunk's compression: start and end time, size (u64), checksum (u32)
_STATED = struct.Struct("<16xQ")  # a chunk's size before compression
_FRAME_HEADER = 18  # of zstd, at most
_COMPRESSION = b"\x04\x00\x00\x00zstd"
_OPCODES = frozenset(int(opcode) for opcode in Opcode)
_DAMAGE = (
    struct.error, ValueError, OverflowError, MemoryError, McapError, zstandard.ZstdError,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class McapContents:
    """What a file holds."""

    topics: frozenset[str]  # of all its channels
    metadata: dict[str, str]  # of all metadata records
    # topic, log time in ns, and data of each that is wanted, in the file's order
    messages: list[tuple[str, int, bytes]]
    gaps: int  # places at which something is missing
    truncated: bool  # the end is missing: the writer was killed


def read_mcap(path: Path, topics: Container[str]) -> McapContents:
    """Read a file's messages on the topics that are wanted.

    Raises RunFolderError if there is no such file, or it is no MCAP file.
    """
    with RunFolderError.from_os(f"cannot read {path}", "give a run folder that holds run.mcap"):
        data = read_file(path, RECORD_BYTES)
    truncated = not data.endswith(MAGIC) or len(data) < 2 * len(MAGIC)
    contents: list[McapRecord] = []
    place: int | None = len(MAGIC)
    broken = not data.startswith(MAGIC)  # nothing whole has come since the last gap
    if broken:
        place = _next_chunk(data, 0)
        if place is None and not MAGIC.startswith(data[: len(MAGIC)]):
            raise RunFolderError(f"{path} is not an MCAP file", "give a run folder")
    gaps = int(broken and place is not None)
    budget = _MOST_RATIO * len(data) + _MOST_MORE  # bytes to which its chunks may unpack
    while place is not None and place + _HEADER.size <= len(data):
        opcode, length = _HEADER.unpack_from(data, place)
        start, end = place + _HEADER.size, place + _HEADER.size + length
        if opcode == Opcode.FOOTER:
            break
        records = None
        try:
            if opcode not in _OPCODES or end > len(data):
                raise ValueError("no record begins here")
            if opcode == Opcode.CHUNK and (budget := budget - _unpacked_bytes(data[start:end])) < 0:
                raise RunFolderError(
                    f"{path} would unpack to more than {_MOST_RATIO} times its size",
                    "it is damaged or no record: give another run folder",
                )
            records, place = _records(opcode, data[start:end]), end
        except _DAMAGE:
            place = _next_chunk(data, place + 1)
        if records is not None:
            contents += records
            broken = broken and opcode != Opcode.CHUNK
        elif not broken and (place is not None or not truncated):
            gaps += 1
            broken = True
    # A damaged file may tell of a channel after its messages: in its summary.
    channels = {record.id: record.topic for record in contents if isinstance(record, Channel)}
    metadata = [record.metadata for record in contents if isinstance(record, Metadata)]
    messages = [
        (channels[record.channel_id], record.log_time, record.data)
        for record in contents
        if isinstance(record, Message) and channels.get(record.channel_id) in topics
    ]
    facts = {name: value for record in metadata for name, value in record.items()}
    return McapContents(frozenset(channels.values()), facts, messages, gaps, truncated)


def _records(opcode: int, content: bytes) -> list[McapRecord] | None:
    """What a record tells, with those in it; None if it is damaged, and its length fits.

    Raises one of `_DAMAGE` if its lengths do not add up.
    """
    stream = ReadDataStream(BytesIO(content))
    if opcode == Opcode.CHANNEL:
        return [Channel.read(stream)]
    if opcode == Opcode.METADATA:
        return [Metadata.read(stream)]
    if opcode != Opcode.CHUNK:
        return []
    chunk = Chunk.read(stream)
    if stream.count != len(content):
        raise ValueError("a chunk's lengths do not add up")
    with suppress(*_DAMAGE):
        return breakup_chunk(chunk, validate_crc=True)
    return None


def _unpacked_bytes(content: bytes) -> int:
    """To how much a chunk unpacks, as it says itself and as its frame does; without unpacking it.

    Raises struct.error or zstandard's error if it is damaged.
    """
    stated = _STATED.unpack_from(content)[0]
    begins = _CHUNK_BYTES + len(_COMPRESSION) + 8
    if not content[_CHUNK_BYTES:].startswith(_COMPRESSION):
        return int(stated)
    return int(max(stated, zstandard.frame_content_size(content[begins : begins + _FRAME_HEADER])))


def _next_chunk(data: bytes, place: int) -> int | None:
    """Where the next chunk's record seems to begin; None if there is none."""
    offset = _HEADER.size + _CHUNK_BYTES
    found_at = data.find(_COMPRESSION, place + offset)
    while found_at >= 0:
        start = found_at - offset
        opcode, length = _HEADER.unpack_from(data, start)
        if opcode == Opcode.CHUNK and start + _HEADER.size + length <= len(data):
            return start
        found_at = data.find(_COMPRESSION, found_at + 1)
    return None
