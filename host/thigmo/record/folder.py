"""The run folder on disk: made, filled while the run goes on, closed, found again.

Its files are on disk whole or not at all: a crash leaves the previous file.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError

from thigmo import files
from thigmo.config import RobotConfig
from thigmo.errors import RunFolderError
from thigmo.link.framing import FrameError, decode
from thigmo.link.protocol import Telemetry
from thigmo.record.document import KILLED, RUNNING, RunDocument
from thigmo.record.log import Entry, Log, LogWriter, read_log
from thigmo.toml_model import invalid_entry

try:
    import fcntl
except ImportError:  # on Windows
    fcntl = None  # type: ignore[assignment]

T = TypeVar("T")
_CHUNK_BYTES = 65_536  # half a second of frames and decoded channels
_DOCUMENT = TypeAdapter(RunDocument)


class RunFolder:
    """One run's folder. Its methods raise RunFolderError where a file is missing or malformed, or
    cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)

    @classmethod
    def create(cls, parent: str | os.PathLike[str], name: str, started: datetime) -> RunFolder:
        """Make `parent/DATE-NAME`; a number is appended if it exists."""
        slug = re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip("-.") or "run"
        stem = f"{started:%Y%m%d-%H%M%S}-{slug}"
        for number in range(1, 1000):
            path = Path(parent) / (stem if number == 1 else f"{stem}-{number}")
            try:
                path.mkdir(parents=True, exist_ok=False)
            except OSError as error:
                exists = isinstance(error, FileExistsError)
                if exists and Path(parent).is_dir():
                    continue
                reason = "it is not a folder" if exists else error.strerror
                raise RunFolderError(
                    f"cannot make a run folder in {parent}: {reason}", "choose another with --out"
                ) from error
            return cls(path)
        raise RunFolderError(f"{parent} holds too many runs of this second", "wait a second")

    @property
    def map_path(self) -> Path:
        """The picture of the map."""
        return self.path / "map.png"

    def open_log(self, metadata: dict[str, str], epoch_s: float = 0.0) -> LogWriter:
        """Start `run.mcap`, with room for decoded channels; arguments as for `LogWriter`."""
        return LogWriter(self.path / "run.mcap", metadata, epoch_s, _CHUNK_BYTES)

    def read_log(self) -> Log:
        """Read `run.mcap`."""
        return read_log(self.path / "run.mcap")

    def read_logs(self) -> list[Log]:
        """Read `run.mcap` and, before it, the records of the runs that it resumes, oldest first."""
        return [read_log(path) for path in self._records()]

    def _records(self) -> list[Path]:
        earlier = sorted(self.path.glob("earlier-*.mcap"), key=lambda path: len(path.name))
        return [*earlier, self.path / "run.mcap"]

    def keep_records_of(self, resumed: RunFolder) -> None:
        """Copy the records of a run that this one resumes."""
        for number, record in enumerate(resumed._records(), 1):
            write_whole(self.path / f"earlier-{number}.mcap", _content(record))

    def write_document(self, document: RunDocument, name: str = "contacts.json") -> None:
        """Write contacts.json whole or not at all."""
        write_whole(self.path / name, _DOCUMENT.dump_json(document, indent=2) + b"\n")

    def read_document(self) -> RunDocument:
        """Read contacts.json; it says so if the run's process ended without closing the run."""
        document = read_json(
            _DOCUMENT,
            self.path / "contacts.json",
            missing="give a run folder",
            invalid="run `thigmo replay` on the folder",
        )
        if document.outcome == RUNNING and not self._is_locked:
            return self._killed(document)
        return document

    def _killed(self, document: RunDocument) -> RunDocument:
        """The document with the length and the times that the record ends with."""
        document = replace(document, outcome=KILLED)
        with suppress(RunFolderError):  # it has no record
            entries = self.read_log().entries
            if entries:
                seconds = entries[-1].t_s - entries[0].t_s
                length_cm = _last_length_cm(entries)
                document = replace(document, robot_time_s=round(seconds, 3), length_cm=length_cm)
        with suppress(OSError, ValueError):
            ended_s = (self.path / "run.mcap").stat().st_mtime
            seconds = ended_s - datetime.fromisoformat(document.started).timestamp()
            document = replace(document, wall_time_s=round(max(seconds, 0.0), 3))
        return document

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Mark the run as under way, for as long as this process lives at most."""
        if fcntl is None:
            yield
            return
        folder = os.open(self.path, os.O_RDONLY)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX)
            yield
        finally:
            os.close(folder)

    @property
    def _is_locked(self) -> bool:
        """Whether a process holds it; on Windows that is not known, and taken for granted."""
        if fcntl is None:
            return True
        folder = os.open(self.path, os.O_RDONLY)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
        finally:
            os.close(folder)
        return False

    def read_config(self) -> RobotConfig:
        """Read robot.toml as it was used. Raises ConfigError if it is missing or malformed."""
        return RobotConfig.load(self.path / "robot.toml")


def _content(path: Path) -> bytes:
    with RunFolderError.from_os(f"cannot read {path}", "give a run folder that holds it"):
        return files.read_file(path, files.RECORD_BYTES)


def _last_length_cm(entries: Sequence[Entry]) -> float:
    """The everted length by the last telemetry; 0 without."""
    for entry in reversed(entries):
        with suppress(FrameError):
            message = decode(entry.frame).message()
            if isinstance(message, Telemetry):
                return message.length_um / 1e4
    return 0.0


def write_whole(path: Path, data: bytes) -> None:
    """Replace a file's content; on disk on return. Raises RunFolderError if that fails."""
    with RunFolderError.from_os(f"cannot write {path}", "free some space, or check permissions"):
        files.write_whole(path, data)


def read_json(
    kind: TypeAdapter[T], path: str | os.PathLike[str], *, missing: str, invalid: str
) -> T:
    """Read a JSON file of a kind. Raises RunFolderError, which says what to do where it is so."""
    try:
        return kind.validate_json(files.read_file(path, files.DATA_BYTES))
    except OSError as error:
        raise RunFolderError(f"cannot read {path}: {error.strerror}", missing) from error
    except ValidationError as error:
        raise RunFolderError(invalid_entry(path, error), invalid) from error
