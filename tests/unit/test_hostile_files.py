"""Files that are broken, or made to break what reads them: one line each says what is wrong."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from command import Thigmo
from mcap.writer import MCAP0_MAGIC

from thigmo.config import RobotConfig
from thigmo.errors import ConfigError, RunFolderError
from thigmo.exploration import replay
from thigmo.files import read_file
from thigmo.record import RunDocument, RunFolder
from thigmo.record.log import LogWriter, read_log
from thigmo.record.mcap_file import read_mcap
from thigmo.stream import read_messages

ZERO = Path("/dev/zero")


def test_only_regular_files_of_a_stated_size_are_read(tmp_path: Path) -> None:
    file, pipe = tmp_path / "file", tmp_path / "pipe"
    file.write_bytes(b"12345")
    os.mkfifo(pipe)
    assert read_file(file, 5) == b"12345"
    with pytest.raises(OSError, match="it is larger than 0 MB"):
        read_file(file, 4)
    for path in (pipe, ZERO, tmp_path):
        with pytest.raises(OSError, match=r"not a regular file|directory"):
            read_file(path, 1000)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a = " + "[" * 5000, "it is nested too deeply"),
        (".".join("a" * 20_000) + " = 1", "it is nested too deeply"),
        ("[" + ".".join(['"a"'] * 20_000) + "]", "it is nested too deeply"),
        ("version = " + "9" * 5000, "a number in it has too many digits"),
    ],
    ids=["arrays", "key", "table", "digits"],
)
def test_a_robot_toml_that_overcharges_its_parser_is_one_line(
    text: str, reason: str, tmp_path: Path
) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=rf"is not valid TOML: {reason}; correct that line$"):
        RobotConfig.load(file)


def test_a_robot_toml_of_50_mb_is_not_read(tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    with file.open("wb") as stream:
        stream.truncate(50_000_000)
    with pytest.raises(ConfigError, match="it is larger than 4 MB"):
        RobotConfig.load(file)


def _record(stated: int, content: bytes) -> bytes:
    """A file of one chunk, which states to how many bytes it unpacks."""
    chunk = struct.pack("<QQQII", 0, 1, stated, 0, 4) + b"zstd"
    chunk += struct.pack("<Q", len(content)) + content
    return MCAP0_MAGIC + struct.pack("<BQ", 6, len(chunk)) + chunk + MCAP0_MAGIC


@pytest.mark.parametrize("lies", [False, True], ids=["says so", "says 1 kB"])
def test_a_chunk_that_unpacks_to_gigabytes_is_refused_before_it_is_unpacked(
    lies: bool, tmp_path: Path
) -> None:
    size = 1 << 30
    packer = zstandard.ZstdCompressor().compressobj(size)
    content = b"".join(packer.compress(bytes(1 << 20)) for _ in range(size >> 20)) + packer.flush()
    file = tmp_path / "run.mcap"
    file.write_bytes(_record(1024 if lies else size, content))
    assert file.stat().st_size < 100_000
    with pytest.raises(RunFolderError, match="would unpack to more than 100 times its size"):
        read_mcap(file, {"/link/rx"})


def test_a_note_that_is_none_is_a_gap(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with LogWriter(path, {}) as log:
        log.note("state", 0.0)
        for data in (b"[" * 5000, b"3", b'{"a": 1}', b"9" * 5000):
            log.message(log._note, data, 1.0)
    read = read_log(path)
    assert [note.facts for note in read.notes] == [{"topic": "state"}]
    assert read.gaps == 4


def _folder(path: Path, record: bytes) -> Path:
    document = RunDocument(thigmo="0", name="run", url="emulator://empty", started="", seed=None)
    RunFolder(path).write_document(document)
    RobotConfig().save(path / "robot.toml")
    (path / "run.mcap").write_bytes(record)
    return path


@pytest.mark.parametrize("record", [b"", MCAP0_MAGIC, MCAP0_MAGIC * 2])
@pytest.mark.parametrize("read", [replay, lambda folder: list(read_messages(folder))])
def test_an_empty_record_is_said_to_be_empty(
    record: bytes, read: Callable[[Path], object], tmp_path: Path
) -> None:
    empty = r"(is empty|has no message of a run); its run ended before it began"
    with pytest.raises(RunFolderError, match=empty):
        read(_folder(tmp_path, record))


@pytest.mark.parametrize(("command", "name"), [("watch", "contacts.json"), ("info", "run.mcap")])
def test_a_device_in_a_run_folder_is_one_line(
    command: str, name: str, tmp_path: Path, thigmo: Thigmo
) -> None:
    file = _folder(tmp_path, b"") / name
    file.unlink()
    file.symlink_to(ZERO)
    ran = thigmo(command, tmp_path)
    assert ran.code == 1
    assert "it is not a regular file" in ran.err
    assert ran.err.count("\n") == 1


def test_words_of_a_file_command_no_terminal(tmp_path: Path, thigmo: Thigmo) -> None:
    evil = "\x1b]0;title\x07\x1b[31mred [/bold] \u202e \x9b2J"
    file = _folder(tmp_path, MCAP0_MAGIC * 2) / "contacts.json"
    document = json.loads(file.read_text())
    file.write_text(json.dumps({**document, "name": evil}))
    ran = thigmo("info", tmp_path)
    assert ran.code == 0
    assert "\\x1b]0;title\\x07\\x1b[31mred [/bold]" in " ".join(ran.out.split())
    missing = thigmo("robot", "check", f"{tmp_path}/{evil[:12]}.toml")
    for said in (ran.out, missing.err):
        assert all(c.isprintable() or c == "\n" for c in said)
