"""The raw record of a run: an MCAP file with every frame that crossed the link.

Written by the exploration through the link's tap, read by `thigmo replay` and `thigmo info`, and
by any MCAP tool. Frames are kept as they were on the wire and decoded on reading, so that a later
localizer or decoder can go over an old run; others may add channels of their own. Log times are
UTC, so that tools show when it was. Chunks are small and written as they close: a killed process
loses less than a second, and the reader takes what is whole and says so. On a full disk the record
ends with its last whole chunk, and `LogWriter.check` raises.
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite, nan
from pathlib import Path
from typing import IO, Any, Literal, cast

from thigmo.closing import Closing
from thigmo.errors import RunFolderError
from thigmo.link.protocol import MESSAGES, SCHEMA_HASH
from thigmo.record.mcap_file import read_mcap

Direction = Literal["tx", "rx"]

# About a third of a second of full-rate telemetry.
_CHUNK_BYTES = 16_384
_SILENCE_S = 0.5  # host and board hear of each other five times as often
EPOCH = "epoch_ns"  # metadata: UTC nanoseconds at which the robot's time base was 0
_TOPICS: dict[str, Direction] = {"/link/tx": "tx", "/link/rx": "rx"}
_SCHEMA = f"{SCHEMA_HASH:08x}"  # of the frames that this version can read
_NOTES, _FIBRE = "/run/notes", "/fibre/strains"
_FRAME_SCHEMA = (
    "One frame as it was on the wire, without its closing zero byte: COBS(id u8, seq u16, "
    "session u16, payload, crc u16). The payloads are little-endian; their fields are given as "
    "Python's struct has them. `sensors?H` is as long as the board's capacity; the first array of "
    "a message with that count comes after it, as a u8. Fields of the schema hash in this file's "
    "metadata: "
    + json.dumps({kind.NAME: {"id": kind.ID} | kind.CODES for kind in MESSAGES.values()})
)
_NOTE_SCHEMA = {
    "title": "thigmo.Note",
    "type": "object",
    "properties": {"topic": {"type": "string"}},
    "required": ["topic"],
}
_FIBRE_SCHEMA = {
    "title": "thigmo.FibreLine",
    "type": "object",
    "properties": {
        "t_s": {"type": "number", "description": "board's clock, s"},
        "strain_ue": {
            "type": "array",
            "items": {"type": ["number", "null"]},
            "description": "microstrain, in the order of robot.toml; null where unknown",
        },
        "zero": {"type": "boolean", "description": "these are the straight body's from now on"},
    },
}


@dataclass(frozen=True, slots=True)
class Entry:
    """One frame of the link."""

    t_s: float  # host clock of the robot's time base, s (virtual in the emulator)
    direction: Direction  # "tx" host to board, "rx" board to host
    frame: bytes  # the bytes on the wire, without the closing zero


@dataclass(frozen=True, slots=True)
class Note:
    """A fact of the run."""

    t_s: float  # as an entry's
    facts: dict[str, Any]  # its `topic`, and the values of that topic


@dataclass(frozen=True, slots=True)
class FibreLine:
    """Strains of a fibre: a line of its interrogator, or the zeros that count from now on."""

    t_s: float  # by the board's clock, unwrapped
    strain_ue: tuple[float, ...]  # NaN where a peak was lost, or there is no zero
    zero: bool = False


@dataclass(frozen=True, slots=True)
class Log:
    """A record that was read."""

    items: list[Entry | Note | FibreLine]  # in the order in which they were kept
    metadata: dict[str, str]  # facts of the run, as they were given to the writer
    truncated: bool = False  # the end is missing: the writer was killed
    gaps: int = 0  # places before the end at which something is missing: the file is damaged

    @property
    def entries(self) -> list[Entry]:
        """The frames, in their order."""
        return [item for item in self.items if isinstance(item, Entry)]

    @property
    def notes(self) -> list[Note]:
        """The notes, in their order."""
        return [item for item in self.items if isinstance(item, Note)]

    @property
    def missing(self) -> str:
        """A sentence for the operator about gaps in the record; empty if it is complete."""
        gaps = [f"damaged in {self.gaps} place{'s' if self.gaps > 1 else ''}"] if self.gaps else []
        times = sorted(entry.t_s for entry in self.entries)
        gaps += [
            f"silent for {end - start:.1f} s at {start:.1f} s"
            for start, end in pairwise(times)
            if end - start > _SILENCE_S
        ]
        gaps += ["cut short"] if self.truncated else []
        return f"the record is {' and '.join(gaps)}; what is whole was used" if gaps else ""


class LogWriter(Closing):
    """Writes `run.mcap`, which must not exist. A context manager; `close` may be called twice.

    The metadata are facts of the run (versions, schema hash, URL, seed); `epoch_s` is when the
    robot's time base was 0, in UTC seconds since 1970; `chunk_bytes` is the largest loss if the
    process is killed. Raises RunFolderError if the file cannot be created.

    It is written to while the robot is commanded, and so never raises then: `check` does.
    """

    def __init__(
        self,
        path: Path,
        metadata: dict[str, str],
        epoch_s: float = 0.0,
        chunk_bytes: int = _CHUNK_BYTES,
    ) -> None:
        from mcap.writer import Writer

        with RunFolderError.from_os(f"cannot write {path}", "choose another folder with --out"):
            self._stream = _Pieces(io.FileIO(path, "xb"))
        self._path = path
        self._refused: OSError | None = None
        self._closed = False
        library = f"thigmo {metadata.get('thigmo', '')}".strip()
        self._writer = Writer(cast("IO[bytes]", self._stream), chunk_size=chunk_bytes)
        self._writer.start(library=library)
        self._epoch_ns = round(epoch_s * 1e9)
        frame = self._writer.register_schema("thigmo.Frame", "text", _FRAME_SCHEMA.encode())
        note = json.dumps(_NOTE_SCHEMA).encode()
        self._frames = {
            direction: self._writer.register_channel(topic, "cobs", frame)
            for topic, direction in _TOPICS.items()
        }
        self._note = self.add_channel(_NOTES, "json", "thigmo.Note", "jsonschema", note)
        self._fibre = 0  # no channel yet
        self._writer.add_metadata("run", {**metadata, EPOCH: str(self._epoch_ns)})
        self._end_piece()

    def frame(self, direction: Direction, frame: bytes, t_s: float) -> None:
        """Keep one frame. Signature of the link's tap."""
        self.message(self._frames[direction], frame, t_s)

    def note(self, topic: str, t_s: float, **facts: Any) -> None:
        """Keep a fact of the run (a state entered, a sweep's measurement) as JSON."""
        self.message(self._note, json.dumps({"topic": topic, **facts}).encode(), t_s)

    def fibre(self, line: FibreLine, t_s: float) -> None:
        """Keep strains of a fibre that came at a time."""
        if not self._fibre:
            schema = json.dumps(_FIBRE_SCHEMA).encode()
            self._fibre = self.add_channel(_FIBRE, "json", "thigmo.FibreLine", "jsonschema", schema)
        strains = [strain if isfinite(strain) else None for strain in line.strain_ue]
        data = {"t_s": line.t_s, "strain_ue": strains, "zero": line.zero}
        self.message(self._fibre, json.dumps(data).encode(), t_s)

    def add_channel(
        self, topic: str, encoding: str, schema: str, schema_encoding: str, data: bytes
    ) -> int:
        """A further channel with its schema, as mcap.dev/spec/registry has them; its number."""
        number = self._writer.register_schema(schema, schema_encoding, data)
        return self._writer.register_channel(topic, encoding, number)

    def message(self, channel: int, data: bytes, t_s: float) -> None:
        """Keep a message of a channel; `t_s` is by the robot's time base."""
        if self._closed or self._refused is not None:
            return
        t_ns = self._epoch_ns + max(int(t_s * 1e9), 0)
        self._writer.add_message(channel, t_ns, data, t_ns)
        self._end_piece()  # a chunk that closed with it, out of this process's reach

    def check(self) -> None:
        """Raise RunFolderError if the disk has not taken what was to be kept."""
        if self._refused is not None:
            raise RunFolderError(
                f"cannot write {self._path}: {self._refused.strerror}; it ends early",
                "free some space, then start a new run",
            ) from self._refused

    def close(self) -> None:
        """Write the index and close the file."""
        if self._closed:
            return
        self._closed = True
        if self._refused is None:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._end_piece()
        self._stream.close()

    def __exit__(self, *error: object) -> None:
        self.close()
        if error[1] is None:
            self.check()

    def _end_piece(self) -> None:
        try:
            self._stream.end_piece()
        except OSError as error:
            self._refused = error


class _Pieces:
    """A file that grows by whole pieces; one that the disk does not take is cut off again."""

    def __init__(self, file: io.FileIO) -> None:
        self._file = file
        self._size = 0
        self._piece = bytearray()

    def write(self, data: bytes) -> int:
        """Add to the piece."""
        self._piece += data
        return len(data)

    def tell(self) -> int:
        """Bytes so far, the piece's included."""
        return self._size + len(self._piece)

    def flush(self) -> None:
        """Pieces are ended by `end_piece`."""

    def end_piece(self) -> None:
        """Write the piece. Raises OSError if the disk does not take it: the file is as it was."""
        if not self._piece:
            return
        remaining = bytes(self._piece)
        self._piece.clear()
        size = self._size + len(remaining)
        try:
            while remaining:
                remaining = remaining[self._file.write(remaining) :]
        except OSError:
            self._file.truncate(self._size)
            raise
        self._size = size

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_log(path: Path) -> Log:
    """Read the intact part of a `run.mcap`, even if it is damaged or its writer was killed.

    Raises RunFolderError if there is no such file, it is no MCAP file, or its frames are of another
    protocol schema.
    """
    record = read_mcap(path, {*_TOPICS, _NOTES, _FIBRE})
    schema = record.metadata.get("schema_hash", _SCHEMA)  # damaged records name none
    if schema != _SCHEMA:
        raise RunFolderError(
            f"{path} was recorded with protocol schema {schema}, and this is {_SCHEMA}",
            f"read it with thigmo {record.metadata.get('thigmo', 'of its time')}",
        )
    epoch = record.metadata.pop(EPOCH, "0")  # damaged records hold none
    epoch_ns = int(epoch) if epoch.isdecimal() else 0
    items: list[Entry | Note | FibreLine] = []
    gaps = record.gaps
    for topic, log_ns, data in record.messages:
        t_s = (log_ns - epoch_ns) / 1e9
        if topic in _TOPICS:
            items.append(Entry(t_s, _TOPICS[topic], data))
            continue
        try:
            items.append(_note(t_s, data) if topic == _NOTES else _fibre_line(data))
        except (ValueError, KeyError, TypeError, RecursionError):
            gaps += 1
    return Log(items, record.metadata, record.truncated, gaps)


def _note(t_s: float, data: bytes) -> Note:
    """A note of a record. Raises ValueError, TypeError or RecursionError if it is none."""
    facts = json.loads(data)
    if not isinstance(facts, dict) or "topic" not in facts:
        raise TypeError("no note")
    return Note(t_s, facts)


def _fibre_line(data: bytes) -> FibreLine:
    """A line of a fibre; raises as `_note`, and KeyError."""
    entry = json.loads(data)
    strains = tuple(nan if strain is None else float(strain) for strain in entry["strain_ue"])
    return FibreLine(float(entry["t_s"]), strains, bool(entry["zero"]))
