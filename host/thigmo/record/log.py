"""The raw record of a run: an MCAP file with every frame that crossed the link.

Written by the exploration through the link's tap, read by `thigmo replay` and `thigmo info`, and
by any MCAP tool. Frames are kept as they were on the wire and decoded on reading, so that a later
localizer or decoder can go over an old run. Chunks are small and flushed as they close: a killed
process loses less than a second, and the reader takes what is whole and says so.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from thigmo.errors import RunFolderError

Direction = Literal["tx", "rx"]

# About a third of a second of full-rate telemetry.
_CHUNK_BYTES = 16_384
_FRAME_SCHEMA = (
    "One frame as it was on the wire, without its closing zero byte: COBS(id u8, seq u16, "
    "session u16, payload, crc u16). protocol/schema.yaml of the schema hash in this file's "
    "metadata decodes it."
)
_NOTE_SCHEMA = {
    "title": "thigmo.Note",
    "type": "object",
    "properties": {"topic": {"type": "string"}},
    "required": ["topic"],
}


@dataclass(frozen=True, slots=True)
class Entry:
    """One frame of the link.

    Attributes:
        t_s: host clock of the robot's time base, s (virtual in the emulator).
        direction: "tx" host to board, "rx" board to host.
        frame: the bytes on the wire, without the closing zero.
    """

    t_s: float
    direction: Direction
    frame: bytes


@dataclass(frozen=True, slots=True)
class Log:
    """A record that was read: frames and notes in time order, and whether its end is missing."""

    entries: list[Entry]
    notes: list[tuple[float, dict[str, Any]]]
    metadata: dict[str, str]
    truncated: bool = False


class LogWriter:
    """Writes `run.mcap`. A context manager; `close` may be called twice.

    Args:
        path: the file; it must not exist.
        metadata: facts of the run, as strings (versions, schema hash, URL, seed).

    Raises:
        RunFolderError: the file cannot be created.
    """

    def __init__(self, path: Path, metadata: dict[str, str]) -> None:
        from mcap.writer import IndexType, Writer

        try:
            self._stream = path.open("xb")
        except OSError as error:
            raise RunFolderError(
                f"cannot write {path}: {error.strerror}", "choose another folder with --out"
            ) from error
        self._writer: Any = Writer(
            self._stream, chunk_size=_CHUNK_BYTES, index_types=IndexType.CHUNK
        )
        self._writer.start("", f"thigmo {metadata.get('thigmo', '')}".strip())
        frame = self._writer.register_schema("thigmo.Frame", "text", _FRAME_SCHEMA.encode())
        note = self._writer.register_schema(
            "thigmo.Note", "jsonschema", json.dumps(_NOTE_SCHEMA).encode()
        )
        self._channels: dict[str, int] = {
            direction: self._writer.register_channel(f"/link/{direction}", "cobs", frame)
            for direction in ("tx", "rx")
        }
        self._channels["note"] = self._writer.register_channel("/run/notes", "json", note)
        self._writer.add_metadata("run", metadata)
        self._sequence = 0
        self._end = self._stream.tell()
        self._stream.flush()
        self._closed = False

    def frame(self, direction: Direction, frame: bytes, t_s: float) -> None:
        """Keep one frame. Signature of the link's tap."""
        self._add(self._channels[direction], frame, t_s)

    def note(self, topic: str, t_s: float, **facts: Any) -> None:
        """Keep a fact of the run (a state entered, a sweep's measurement) as JSON."""
        self._add(self._channels["note"], json.dumps({"topic": topic, **facts}).encode(), t_s)

    def _add(self, channel: int, data: bytes, t_s: float) -> None:
        if self._closed:
            return
        t_ns = max(int(t_s * 1e9), 0)
        self._writer.add_message(channel, t_ns, data, t_ns, self._sequence)
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        end = self._stream.tell()
        if end != self._end:  # a chunk closed: hand it to the system, out of this process's reach
            self._stream.flush()
            self._end = end

    def close(self) -> None:
        """Write the index and close the file."""
        if self._closed:
            return
        self._closed = True
        self._writer.finish()
        self._stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def read_log(path: Path) -> Log:
    """Read a `run.mcap`, also one whose writer was killed.

    Returns:
        What is whole; `truncated` is set if the file has no proper end.

    Raises:
        RunFolderError: there is no such file, or it is no MCAP file.
    """
    from mcap.exceptions import EndOfFile, InvalidMagic, McapError
    from mcap.records import Channel, Message, Metadata
    from mcap.stream_reader import CRCValidationError, StreamReader
    from zstandard import ZstdError

    entries: list[Entry] = []
    notes: list[tuple[float, dict[str, Any]]] = []
    metadata: dict[str, str] = {}
    topics: dict[int, str] = {}
    truncated = False
    try:
        with path.open("rb") as stream:
            for record in StreamReader(stream, validate_crcs=True).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Metadata):
                    metadata |= record.metadata
                elif isinstance(record, Message):
                    topic, t_s = topics[record.channel_id], record.log_time / 1e9
                    if topic == "/run/notes":
                        notes.append((t_s, json.loads(record.data)))
                    elif topic == "/link/tx":
                        entries.append(Entry(t_s, "tx", bytes(record.data)))
                    elif topic == "/link/rx":
                        entries.append(Entry(t_s, "rx", bytes(record.data)))
    except OSError as error:
        raise RunFolderError(
            f"cannot read {path}: {error.strerror}", "give a run folder that holds run.mcap"
        ) from error
    except InvalidMagic as error:
        if not topics:
            raise RunFolderError(f"{path} is not an MCAP file", "give a run folder") from error
        truncated = True
    except (
        EndOfFile, McapError, CRCValidationError, ZstdError, struct.error, ValueError,
        OverflowError, MemoryError,
    ):  # fmt: skip
        # A writer that was killed leaves a last record that is cut anywhere; a flipped bit can make
        # a record's length absurd.
        truncated = True
    return Log(entries, notes, metadata, truncated)
