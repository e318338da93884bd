"""Writes MCAP files whose messages may come by the hundred, as rows of one array.

MCAP's own writer makes several Python objects of every message. A record has four hundred messages
a second, and an emulated run spent a third of its time on them. What is not a message (schemas,
channels, chunks, the summary) is made of that library's records (mcap.dev/spec).
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from typing import IO

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

MAGIC = b"\x89MCAP0\r\n"
# Of a message before its data: opcode, length, channel, sequence, log time, publish time.
_MESSAGE = np.dtype(
    [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("times", "<u8", 2)]
)
_HEAD = struct.Struct("<BQHIQQ")
_INDEX_HEAD = struct.Struct("<BQHI")
_ENTRY = struct.Struct("<QQ")
_FOOTER_HEAD = struct.Struct("<BQQQ")
_COUNTED = 22  # bytes of a message's head that its length counts


class McapWriter:
    """Writes to a stream, chunk by chunk; a chunk is compressed once it holds `chunk_bytes`."""

    def __init__(self, stream: IO[bytes], library: str, chunk_bytes: int) -> None:
        self._stream = stream
        self._chunk_bytes = chunk_bytes
        self._schemas: list[McapRecord] = []
        self._channels: list[McapRecord] = []
        self._chunks: list[McapRecord] = []
        self._metadata: list[McapRecord] = []
        self._counts: dict[int, int] = defaultdict(int)
        self._sequence = 0
        self._compressor = zstandard.ZstdCompressor()
        self._chunk = bytearray()
        self._index: dict[int, bytearray] = defaultdict(bytearray)  # a channel's times and places
        self._span_ns: tuple[int, int] | None = None  # of the chunk's messages
        self._file_span_ns: tuple[int, int] | None = None
        stream.write(MAGIC + _bytes(Header("", library)))

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Tell a schema; its number."""
        made = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        return self._declare(made, self._schemas)

    def channel(self, topic: str, encoding: str, schema: int) -> int:
        """Tell a channel of a schema; its number."""
        number = len(self._channels) + 1
        made = Channel(
            id=number, topic=topic, message_encoding=encoding, metadata={}, schema_id=schema
        )
        return self._declare(made, self._channels)

    def _declare(self, made: McapRecord, known: list[McapRecord]) -> int:
        known.append(made)
        self._chunk += _bytes(made)
        return len(known)

    def metadata(self, name: str, facts: dict[str, str]) -> None:
        """Keep named facts."""
        data = _bytes(Metadata(name=name, metadata=facts))
        self._metadata.append(MetadataIndex(self._stream.tell(), len(data), name))
        self._stream.write(data)

    def message(self, channel: int, t_ns: int, data: bytes) -> None:
        """Keep a message of a channel."""
        self._index[channel] += _ENTRY.pack(t_ns, len(self._chunk))
        length = _COUNTED + len(data)
        self._chunk += _HEAD.pack(Opcode.MESSAGE, length, channel, self._sequence, t_ns, t_ns)
        self._chunk += data
        self._took(channel, 1, t_ns, t_ns)

    def messages(self, channel: int, t_ns: NDArray[np.uint64], data: NDArray[np.uint8]) -> None:
        """Keep messages of one channel and one size: times (n,) and their bytes (n, size)."""
        count, size = data.shape
        rows = np.empty(count, np.dtype([("head", _MESSAGE), ("data", "u1", size)]))
        head = rows["head"]
        head["op"], head["length"], head["channel"] = Opcode.MESSAGE, _COUNTED + size, channel
        head["sequence"] = self._sequence + np.arange(count)
        head["times"] = t_ns[:, None]
        rows["data"] = data
        places = len(self._chunk) + rows.itemsize * np.arange(count, dtype=np.uint64)
        self._index[channel] += np.column_stack([t_ns, places]).astype("<u8").tobytes()
        self._chunk += rows.tobytes()
        self._took(channel, count, int(t_ns.min()), int(t_ns.max()))

    def _took(self, channel: int, count: int, first_ns: int, last_ns: int) -> None:
        self._sequence = (self._sequence + count) & 0xFFFFFFFF
        self._counts[channel] += count
        self._span_ns = _joined(self._span_ns, (first_ns, last_ns))
        if len(self._chunk) > self._chunk_bytes:
            self._finish_chunk()

    def _finish_chunk(self) -> None:
        if self._span_ns is None:
            return
        first_ns, last_ns = self._span_ns
        data = self._compressor.compress(self._chunk)
        chunk = Chunk(
            compression="zstd",
            data=data,
            message_start_time=first_ns,
            message_end_time=last_ns,
            uncompressed_crc=zlib.crc32(self._chunk),
            uncompressed_size=len(self._chunk),
        )
        start, written = self._stream.tell(), _bytes(chunk)
        indices, offsets = b"", {}
        for channel, entries in self._index.items():
            offsets[channel] = start + len(written) + len(indices)
            length = _INDEX_HEAD.size - 9 + len(entries)
            indices += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, length, channel, len(entries))
            indices += entries
        self._stream.write(written + indices)
        self._chunks.append(
            ChunkIndex(
                chunk_length=len(written),
                chunk_start_offset=start,
                compression="zstd",
                compressed_size=len(data),
                message_end_time=last_ns,
                message_index_length=len(indices),
                message_index_offsets=offsets,
                message_start_time=first_ns,
                uncompressed_size=len(self._chunk),
            )
        )
        self._file_span_ns = _joined(self._file_span_ns, self._span_ns)
        self._span_ns = None
        self._chunk.clear()
        self._index.clear()

    def finish(self) -> None:
        """Write what remains, and the summary."""
        self._finish_chunk()
        self._stream.write(_bytes(DataEnd(0)))
        first_ns, last_ns = self._file_span_ns or (0, 0)
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=last_ns,
            message_start_time=first_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, self._metadata),
        ]
        start = self._stream.tell()
        summary, places = b"", b""
        for opcode, records in groups:
            data = b"".join(map(_bytes, records))
            if data:
                places += _bytes(SummaryOffset(opcode, start + len(summary), len(data)))
            summary += data
        offsets_start = start + len(summary)
        summary += places
        head = _FOOTER_HEAD.pack(Opcode.FOOTER, 20, start, offsets_start)
        checksum = zlib.crc32(summary + head)
        footer = Footer(
            summary_start=start, summary_offset_start=offsets_start, summary_crc=checksum
        )
        self._stream.write(summary + _bytes(footer) + MAGIC)


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _joined(known: tuple[int, int] | None, more: tuple[int, int]) -> tuple[int, int]:
    return more if known is None else (min(known[0], more[0]), max(known[1], more[1]))
