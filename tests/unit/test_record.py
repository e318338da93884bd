"""Run folders: what is written is read back, also when the writer was killed at any byte."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import pytest
from command import Thigmo
from contacts import CONTACT
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from thigmo.config import RobotConfig
from thigmo.errors import RunFolderError
from thigmo.record import (
    Entry,
    Log,
    LogWriter,
    NamedMuscle,
    Note,
    RunDocument,
    RunFolder,
    Shape,
    Stage,
    Trigger,
    TrueContact,
    TruePeg,
    Truth,
    read_log,
)

NOON = datetime(2024, 5, 17, 12, 0, 0)


def _frames(count: int) -> list[bytes]:
    return [bytes((n * 7 + k) % 255 + 1 for k in range(70)) for n in range(count)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    with LogWriter(path, {"thigmo": "1"}) as log:
        for number, frame in enumerate(_frames(1000)):
            log.frame("rx" if number % 5 else "tx", frame, number * 0.005)
        log.note("state", 5.0, state="SWEEP")
    return path.read_bytes()


def test_frames_notes_and_metadata_survive_in_order(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(whole)
    log = read_log(path)
    assert [e.frame for e in log.entries] == _frames(1000)
    assert [e.direction for e in log.entries[:6]] == ["tx", "rx", "rx", "rx", "rx", "tx"]
    assert log.entries[200].t_s == pytest.approx(1.0)
    assert log.notes == [Note(5.0, {"topic": "state", "state": "SWEEP"})]
    assert log.metadata == {"thigmo": "1"}
    assert not log.truncated


@given(share=st.floats(0.0, 0.999))
def test_a_record_cut_anywhere_gives_a_prefix_and_says_so(
    tmp_path_factory: pytest.TempPathFactory, whole: bytes, share: float
) -> None:
    path = tmp_path_factory.mktemp("cut") / "run.mcap"
    path.write_bytes(whole[: int(share * len(whole))])
    try:
        log = read_log(path)
    except RunFolderError:
        assert share * len(whole) < 1000  # nothing but a torn header
        return
    assert log.truncated
    count = len(log.entries)
    assert [e.frame for e in log.entries] == _frames(1000)[:count]
    # At most the open chunk is lost: 16 KiB of about 200 frames, and its index.
    assert count >= 1000 * share - 300


@given(place=st.integers(200, 30_000), value=st.integers(0, 255))
def test_a_flipped_byte_never_invents_a_frame(
    tmp_path_factory: pytest.TempPathFactory, whole: bytes, place: int, value: int
) -> None:
    data = bytearray(whole)
    data[place % len(data)] = value
    path = tmp_path_factory.mktemp("flip") / "run.mcap"
    path.write_bytes(data)
    try:
        log = read_log(path)
    except RunFolderError:
        return
    known = set(_frames(1000))
    assert all(e.frame in known for e in log.entries)


@given(share=st.floats(0.02, 0.98), count=st.integers(1, 40), seed=st.integers(0, 2**32 - 1))
def test_a_record_damaged_in_its_middle_gives_up_only_what_is_damaged(
    tmp_path_factory: pytest.TempPathFactory, whole: bytes, share: float, count: int, seed: int
) -> None:
    place = int(share * len(whole))
    data = bytearray(whole)
    data[place : place + count] = random.Random(seed).randbytes(count)
    path = tmp_path_factory.mktemp("damaged") / "run.mcap"
    path.write_bytes(data)
    log = read_log(path)
    frames = [e.frame for e in log.entries]
    assert set(frames) <= set(_frames(1000))
    # Two chunks of about 180 frames each, if the damage lies across their border.
    assert len(frames) >= 1000 - 2 * 200
    if len(frames) < 1000:
        assert log.gaps
        assert "damaged in" in log.missing


@pytest.mark.parametrize("lost_s", [0.0, 0.3, 0.5, 20.0])
def test_a_whole_file_says_when_it_lacks_frames(lost_s: float) -> None:
    times = [0.1 * tick for tick in range(50)]
    entries = [Entry(t_s + lost_s * (t_s > 2.0), "rx", b"") for t_s in times]
    # Frames are kept in the order in which they came, which the two ends' clocks may turn round.
    items: list[Entry | Note] = [*entries[25:30], *entries[:25], *entries[30:]]
    log = Log(items, {})
    assert not log.gaps
    silent = f"the record is silent for {lost_s + 0.1:.1f} s at 2.0 s; what is whole was used"
    assert log.missing == (silent if lost_s + 0.1 > 0.5 else "")


def test_the_first_chunk_holds_what_the_others_need_and_may_be_lost_all_the_same(
    tmp_path: Path, whole: bytes
) -> None:
    data = bytearray(whole)
    data[400:600] = bytes(200)
    (tmp_path / "run.mcap").write_bytes(data)
    log = read_log(tmp_path / "run.mcap")
    assert (log.gaps, log.truncated) == (1, False)
    assert 700 < len(log.entries) < 1000
    assert log.entries[-1] == Entry(999 * 0.005, "rx", _frames(1000)[-1])


def test_log_times_are_utc_and_times_read_back_are_the_robots(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with LogWriter(path, {"thigmo": "1"}, epoch_s=1.7e9) as log:
        log.frame("rx", b"1", 12.345)
    assert read_log(path).entries == [Entry(12.345, "rx", b"1")]
    assert read_log(path).metadata == {"thigmo": "1"}
    with path.open("rb") as stream:
        ((_, _, message),) = make_reader(stream).iter_messages()
    assert message.log_time == 1_700_000_012_345_000_000


def test_a_killed_writer_leaves_all_but_its_last_chunk(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    script = f"""
import os, signal
from pathlib import Path
from thigmo.record import LogWriter
log = LogWriter(Path({str(path)!r}), {{}})
for n in range(2000):
    log.frame("rx", os.urandom(70), n * 0.005)
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-c", script], check=False)
    assert done.returncode == -9
    log = read_log(path)
    assert log.truncated
    assert 1800 <= len(log.entries) < 2000


def test_a_record_of_another_schema_is_refused_in_one_line(tmp_path: Path, thigmo: Thigmo) -> None:
    run = tmp_path / "run"
    run.mkdir()
    with LogWriter(run / "run.mcap", {"thigmo": "0.1", "schema_hash": "0badcafe"}) as log:
        log.frame("rx", b"1", 1.0)
    with pytest.raises(RunFolderError, match="schema 0badcafe, and this is") as refused:
        read_log(run / "run.mcap")
    assert refused.value.next_step == "read it with thigmo 0.1"
    described = thigmo("info", run)
    assert described.code != 0
    assert "schema 0badcafe" in described.err


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_text("not a record at all")
    with pytest.raises(RunFolderError, match="not an MCAP file"):
        read_log(tmp_path / "run.mcap")
    with pytest.raises(RunFolderError, match="cannot read"):
        read_log(tmp_path / "none.mcap")


def test_run_folders_of_the_same_second_are_kept_apart(tmp_path: Path) -> None:
    paths = [RunFolder.create(tmp_path / "runs", "peg / one", NOON).path.name for _ in range(3)]
    assert paths == [f"20240517-120000-peg-one{tail}" for tail in ("", "-2", "-3")]


def test_an_unwritable_place_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file", tmp_path / "file" / "deeper"):
        with pytest.raises(RunFolderError, match="--out"):
            RunFolder.create(place, "x", NOON)


def test_a_document_of_another_version_is_refused(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.write_document(RunDocument("0", "n", "u", "s", "full length", None, [CONTACT]))
    file = tmp_path / "contacts.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"version": 1}))
    with pytest.raises(RunFolderError, match=r"version must be 2, not 1; run `thigmo replay`"):
        folder.read_document()


def test_the_document_names_its_muscles(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    muscles = NamedMuscle.all_of(RobotConfig())
    assert [(muscle.side, muscle.angle_deg) for muscle in muscles] == [
        ("left", 90),
        ("right", 270),
    ]
    folder.write_document(RunDocument("0", "n", "u", "s", "full length", muscles=muscles))
    assert folder.read_document().muscles == muscles


def test_the_document_survives_a_round_trip(tmp_path: Path) -> None:
    contact = replace(CONTACT, merged=[50.0])
    document = RunDocument(
        thigmo="0",
        name="n",
        url="emulator://default",
        started="now",
        outcome="full length",
        contacts=[contact],
        stages=[
            Stage(
                53.0,
                0.49,
                1.0,
                [Shape("left", 18.0, [(0.0, 0.0, 0.0), (1.0, 0.0, 0.1)])],
                [Trigger("left", 0.5, -0.006, "localized")],
            )
        ],
        truth=Truth([TruePeg(1, 2, 3)], [TrueContact(1, 2, 3, 53, 0)]),
        error_x_cm=1.0,
    )
    folder = RunFolder(tmp_path)
    folder.write_document(document)
    assert folder.read_document() == document


def test_a_malformed_document_is_named(tmp_path: Path) -> None:
    (tmp_path / "contacts.json").write_text('{"thigmo": "0"}')
    with pytest.raises(RunFolderError, match=r"contacts\.json"):
        RunFolder(tmp_path).read_document()
