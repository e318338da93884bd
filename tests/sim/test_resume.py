"""An exploration that was killed, and one that goes on from it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from command import Thigmo

from thigmo.emulator.scene import Scene
from thigmo.errors import DataError, RunFolderError
from thigmo.exploration import ExplorationResult, explore, open_run, replay
from thigmo.exploration.recorded import RecordedRun
from thigmo.record import RunFolder


class Killed(BaseException):
    """Stands for the end of the process."""


def _explore(room: Path, out: Path, killed_at: str = "", **options: object) -> ExplorationResult:
    def progress(doing: str, share: float) -> None:
        if killed_at and doing.startswith(killed_at):
            raise Killed

    return explore(f"emulator://{room}", seed=3, out=out, progress=progress, **options)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A room with a peg that is felt before the end."""
    scene = Scene.load("mid_body")
    scene.robot.board.settle_s = 0.2
    path = tmp_path_factory.mktemp("rooms") / "room.toml"
    scene.save(path)
    return path


@pytest.fixture(scope="module")
def whole(room: Path, tmp_path_factory: pytest.TempPathFactory) -> ExplorationResult:
    """The run that nothing cuts short."""
    return _explore(room, tmp_path_factory.mktemp("whole"))


@pytest.fixture(scope="module")
def killed(room: Path, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A run as it is on the disk when its process is killed in its last but one stage."""
    out = tmp_path_factory.mktemp("killed")
    with pytest.raises(Killed):
        _explore(room, out, "sweeping at 50 cm")
    (path,) = out.iterdir()
    file = path / "contacts.json"
    known = json.loads(file.read_text())
    # What the process would have written on its way out, it has not.
    known |= {"outcome": "running", "length_cm": 0.0, "robot_time_s": 0.0, "wall_time_s": 0.0}
    file.write_text(json.dumps(known))
    record = path / "run.mcap"
    record.write_bytes(record.read_bytes()[:-9_000])
    return RunFolder(path)


@pytest.fixture(scope="module")
def resumed(room: Path, killed: RunFolder, whole: ExplorationResult) -> ExplorationResult:
    """The run that goes on, on the robot as it stands; the whole run is over by then."""
    scene = Scene.load(room)
    scene.start_length_cm = 50.0
    scene.save(room)
    return _explore(room, killed.path.parent, resume=killed.path)


def test_a_killed_run_says_so_with_its_length_and_times(killed: RunFolder, thigmo: Thigmo) -> None:
    document = killed.read_document()
    assert document.outcome == "killed"
    assert document.length_cm == pytest.approx(50.0, abs=0.2)
    log = killed.read_log()
    assert document.robot_time_s == pytest.approx(log.entries[-1].t_s - log.entries[0].t_s)
    assert document.wall_time_s > 0.0
    said = json.loads(thigmo("info", killed.path, "--json").out)
    assert (said["outcome"], said["length_cm"]) == ("killed", document.length_cm)


def test_it_goes_on_from_what_was_swept_and_felt(
    killed: RunFolder, resumed: ExplorationResult, whole: ExplorationResult
) -> None:
    before, now = killed.read_document(), resumed.document
    assert now.outcome == "full length"
    assert now.resumes == str(killed.path)
    assert now.stages[: len(before.stages)] == before.stages
    lengths = [stage.everted_length_cm for stage in now.stages]
    assert lengths == pytest.approx([s.everted_length_cm for s in whole.document.stages], abs=0.3)
    again = [note.facts for note in RunFolder(resumed.folder).read_log().notes]
    assert sum(note.get("state") == "SWEEP" for note in again) == len(lengths) - len(before.stages)
    for contact, whole_contact in zip(now.contacts, whole.document.contacts, strict=True):
        assert (contact.x_cm, contact.y_cm) == pytest.approx(
            (whole_contact.x_cm, whole_contact.y_cm), abs=1.0
        )


def test_its_replay_knows_what_both_runs_knew(resumed: ExplorationResult) -> None:
    again = replay(resumed.folder)
    assert again.document.contacts == resumed.document.contacts
    assert [stage.shapes for stage in again.document.stages] == [
        stage.shapes for stage in resumed.document.stages
    ]
    assert not again.truncated


def test_what_ended_or_is_under_way_is_not_resumed(
    room: Path, killed: RunFolder, resumed: ExplorationResult, tmp_path: Path
) -> None:
    with pytest.raises(RunFolderError, match=r"is finished \(full length\); begin a new"):
        _explore(room, tmp_path, resume=resumed.folder)
    with killed.hold(), pytest.raises(RunFolderError, match="is under way; end it first"):
        _explore(room, tmp_path, resume=killed.path)
    with pytest.raises(DataError, match="keeps the map it was given"):
        _explore(room, tmp_path, resume=killed.path, prior=resumed.folder)
    with pytest.raises(DataError, match="keeps its protocol, measure; leave --protocol out"):
        _explore(room, tmp_path, resume=killed.path, protocol="thesis")
    assert open_run(killed.path).document.outcome == "killed"


def test_a_record_without_the_runs_steps_is_no_run_without_contacts(killed: RunFolder) -> None:
    (log,), config = killed.read_logs(), killed.read_config()
    mute = replace(log, items=log.entries)
    with pytest.raises(RunFolderError, match="has sweeps, but none of the run's steps"):
        RecordedRun(killed, [mute], config)
