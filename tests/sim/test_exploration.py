"""The whole path on the emulator: grow, sweep, feel, localize, map; what a run leaves behind."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from command import Thigmo
from emulated import last_stages, room_file, scene_at
from PIL import Image

from thigmo.cli.console import Console
from thigmo.emulator.reach import random_peg
from thigmo.emulator.scene import FaultTable, PegTable, Scene
from thigmo.errors import LinkError, RobotFaultError
from thigmo.exploration import ExplorationResult, explore, replay
from thigmo.exploration.effort import EFFORTS, Effort
from thigmo.exploration.replay import ReplayResult
from thigmo.exploration.run import Protocol
from thigmo.link import protocol as wire
from thigmo.link.framing import decode
from thigmo.record import OBSTACLES_FILE, RunFolder, read_obstacles
from thigmo_bench.studies.rooms import explored

FOUND = ("localized", "ambiguous")
EVERY_PITCH = Effort("every pitch", measurements=1)


@pytest.fixture(scope="module")
def default(tmp_path_factory: pytest.TempPathFactory) -> ExplorationResult:
    """Section 3.5 of the thesis, explored once."""
    return explore("emulator://default", seed=1, out=tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="module")
def replayed(default: ExplorationResult) -> ReplayResult:
    """The same run, from its record."""
    return replay(default.folder)


def test_the_peg_of_section_3_5_is_found_and_localized_within_3_cm(
    default: ExplorationResult,
) -> None:
    document = default.document
    assert document.outcome == "full length"
    (contact,) = document.contacts
    assert contact.status in FOUND
    assert contact.everted_length_cm == pytest.approx(53, abs=0.1)
    assert document.error_x_cm is not None
    assert document.error_x_cm < 3.0  # the thesis: 6.82
    assert document.truth is not None
    (true,) = document.truth.contacts
    assert contact.interval_cm[0] <= true.arc_cm <= contact.interval_cm[1] + 0.1
    assert [round(s.everted_length_cm) for s in document.stages] == [40, 50, 53]
    assert document.missed == document.false == []


@pytest.mark.ci
def test_the_same_seed_gives_the_same_run_and_studies_explore_as_users_do(
    default: ExplorationResult, tmp_path: Path
) -> None:
    first, again = (
        explored("emulator://default", tmp_path / name, 1).document for name in ("first", "again")
    )
    assert again.stages == first.stages
    assert again.robot_time_s == first.robot_time_s
    for document in (first, again):
        assert document.contacts == default.document.contacts
        assert document.truth == default.document.truth
        assert document.robot_time_s == pytest.approx(default.document.robot_time_s, abs=0.1)


def test_the_terminal_shows_a_contact_on_one_line_of_80_columns(
    default: ExplorationResult, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    Console(quiet=True).result(default)
    head, row, after = capsys.readouterr().out.splitlines()[:3]
    (contact,) = default.contacts
    assert head.split()[:2] == ["x,", "cm"]
    assert row.rstrip().endswith(contact.certainty_text)
    assert after.startswith("Against the room's truth")
    assert len(row.rstrip()) <= 80


def test_a_terminal_too_narrow_for_a_contact_breaks_its_status_between_its_parts(
    default: ExplorationResult, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "68")
    Console(quiet=True).result(default)
    _, row, rest = capsys.readouterr().out.splitlines()[:3]
    status, kinds = default.contacts[0].certainty_text.split("; ")
    assert row.rstrip().endswith(f" {status};")
    assert rest.strip() == kinds


def test_the_run_folder_is_whole(default: ExplorationResult) -> None:
    folder = RunFolder(default.folder)
    assert folder.read_document() == default.document
    assert folder.read_config().name == "vine-53"
    assert folder.map_path.read_bytes().startswith(b"\x89PNG")
    (obstacle,) = read_obstacles(folder.path / OBSTACLES_FILE).obstacles
    assert obstacle.x_cm == default.document.contacts[0].x_cm
    log = folder.read_log()
    assert not log.truncated
    assert int(log.metadata["schema_hash"], 16) == wire.SCHEMA_HASH
    kinds = {type(decode(entry.frame).message()) for entry in log.entries}
    assert {wire.Sweep, wire.Telemetry, wire.Snapshot, wire.Event, wire.GrowTo} <= kinds
    states = [note.facts["state"] for note in log.notes if note.facts["topic"] == "state"]
    assert states[:3] == ["CONFIGURE", "CONFIRM", "ARM"]
    assert states[-1] == "FINISH"


def test_a_planner_finds_the_true_contact_beside_an_occupied_cell_and_the_peg_in_no_free_one(
    default: ExplorationResult,
) -> None:
    truth = default.document.truth
    assert truth is not None
    described = yaml.safe_load((default.folder / "map.yaml").read_text())
    picture = np.array(Image.open(default.folder / described["image"]))[::-1]
    occupied = (255 - picture) / 255 > described["occupied_thresh"]
    free = (255 - picture) / 255 < described["free_thresh"]
    size = described["resolution"] * 100
    x0, y0 = (100 * value for value in described["origin"][:2])
    (contact,), (peg,) = truth.contacts, truth.pegs
    y, x = np.indices(picture.shape) * size + size / 2 + np.array([[[y0]], [[x0]]])
    # Occupied is what lies within a standard deviation; a third of the true contacts do not.
    away = np.hypot(x - contact.x_cm, y - contact.y_cm)
    assert away[occupied].min() < default.config.body.radius_cm
    assert not free[away < 0.5].any()
    inside = np.hypot(x - peg.x_cm, y - peg.y_cm) < peg.radius_cm
    assert inside.any()
    assert not (inside & free).any()
    straight = (np.abs(y) < 0.7) & (x > 0) & (x < 52)
    assert free[straight].all()  # the robot has grown through it
    assert free.sum() * size**2 > 1000  # cm^2


def test_the_robot_ends_vented_braked_and_safe(default: ExplorationResult) -> None:
    frames = [decode(e.frame) for e in RunFolder(default.folder).read_log().entries]
    last = [f.message() for f in frames if f.id == wire.Telemetry.ID][-1]
    assert isinstance(last, wire.Telemetry)
    assert (*last.drive, last.motor) == (0, 0, 0)
    assert max(last.pressure_cpsi) < 50
    stops = [f for f in frames if f.id == wire.Disarm.ID]
    assert stops


@pytest.mark.parametrize("share", [0.003, 0.2, 0.5, 0.93])
def test_a_replay_of_a_damaged_record_uses_what_is_whole_and_says_so(
    default: ExplorationResult,
    replayed: ReplayResult,
    tmp_path: Path,
    share: float,
    thigmo: Thigmo,
) -> None:
    folder = tmp_path / "damaged"
    shutil.copytree(default.folder, folder)
    record = folder / "run.mcap"
    data = bytearray(record.read_bytes())
    place = int(share * len(data))
    data[place : place + 20_000] = bytes(20_000)
    record.write_bytes(data)
    again = replay(folder)
    assert again.gaps == 1
    assert not again.truncated
    # A stage at most is damaged: two sides, and a measurement.
    assert again.sweeps >= replayed.sweeps - 3
    if share < 0.9:  # in the last stage, where the peg is felt
        (contact,), (whole,) = again.document.contacts, default.document.contacts
        assert contact.x_cm == pytest.approx(whole.x_cm, abs=0.5)
    said = " ".join(thigmo("info", folder).out.split())
    assert "damaged in 1 place" in said
    assert "what is whole was used" in said


def test_a_replay_of_the_raw_frames_finds_the_same(
    default: ExplorationResult, replayed: ReplayResult
) -> None:
    notes = RunFolder(default.folder).read_log().notes
    measured = sum(note.facts.get("state") == "MEASURE" for note in notes)
    assert replayed.sweeps == 6 + measured  # two sides at three stages
    assert replayed.bad_frames == 0
    assert replayed.document.contacts == default.document.contacts
    assert replayed.document.error_x_cm == default.document.error_x_cm
    for stage, default_stage in zip(replayed.document.stages, default.document.stages, strict=True):
        assert stage.triggers == default_stage.triggers
        assert stage.shapes == default_stage.shapes
    assert (default.folder / "replay.png").exists()
    for name in ("map.pgm", "map.yaml"):
        live = (default.folder / name).read_bytes()
        assert (default.folder / f"replay-{name}").read_bytes().replace(b"replay-", b"") == live
    obstacles = read_obstacles(default.folder / f"replay-{OBSTACLES_FILE}")
    assert obstacles.obstacles == read_obstacles(default.folder / OBSTACLES_FILE).obstacles
    assert replayed.document.missed == replayed.document.false == []


@pytest.mark.parametrize("seed", [1, *(pytest.param(n, marks=pytest.mark.ci) for n in (2, 3))])
def test_an_empty_room_gives_no_contact(tmp_path: Path, seed: int) -> None:
    document = explored("emulator://empty", tmp_path, seed, effort=EVERY_PITCH).document
    assert document.outcome == "full length"
    assert document.contacts == []
    assert document.error_x_cm is None
    assert len(document.stages) == 6


@pytest.mark.parametrize(
    "seed", [*(pytest.param(n, marks=pytest.mark.ci) for n in (0, 1, 2)), 3, 4]
)
def test_a_random_peg_is_found_at_the_first_stage_that_can_feel_it(
    tmp_path: Path, seed: int
) -> None:
    scene = Scene.load("default")
    peg, felt = random_peg(scene.robot, np.random.default_rng(seed))
    scene.pegs = [PegTable(x=peg.x, y=peg.y, radius=peg.radius)]
    document = explored(room_file(tmp_path, scene), tmp_path, seed, effort=EVERY_PITCH).document
    first = next(s for s in document.stages if any(t.status in FOUND for t in s.triggers))
    assert round(first.everted_length_cm) == felt.length_cm
    assert felt.side in {t.side for t in first.triggers if t.status in FOUND}
    (contact,) = document.contacts
    assert document.truth is not None
    true = min(
        document.truth.contacts, key=lambda t: abs(t.everted_length_cm - contact.everted_length_cm)
    )
    low, high = contact.interval_cm
    print(f"seed {seed}: {peg}, error {document.error_cm:.2f} cm, interval {low:.1f}..{high:.1f}")
    assert low - 1.0 <= true.arc_cm <= high + 1.0


@pytest.mark.parametrize(
    "peg",
    [
        PegTable(x=36.4, y=4.46, radius=1.96),
        pytest.param(PegTable(x=49.12, y=5.77, radius=1.98), marks=pytest.mark.ci),
    ],
)
def test_a_peg_beside_the_straight_body_is_felt_though_it_stops_each_sweep_at_once(
    tmp_path: Path, peg: PegTable
) -> None:
    scene = Scene.load("default")
    scene.pegs = [peg]
    document = explored(room_file(tmp_path, scene), tmp_path, 1).document
    (contact,) = document.contacts
    assert document.error_cm is not None
    print(f"{peg}: {document.error_cm:.2f} cm off, {contact.interval_cm}")
    assert document.error_cm < 3.0
    assert document.missed == document.false == []


def test_a_tip_that_was_caught_beside_a_peg_stalls_there_and_not_on_the_straight_path(
    tmp_path: Path,
) -> None:
    scene = Scene.load("default")
    scene.body.friction = 0.55  # the vented body does not slip off
    scene.pegs = [PegTable(x=30.472, y=-4.305, radius=0.951)]
    document = explored(room_file(tmp_path, scene), tmp_path, 1, effort=EFFORTS["careful"]).document
    (contact,) = document.contacts
    assert document.stall is not None
    low, high = document.stall.interval_cm
    assert low <= 30.0 <= high
    assert document.error_cm is not None
    print(f"{document.error_cm:.2f} cm off, at y {contact.y_cm:.1f} cm")
    assert document.error_cm < 3.0
    assert contact.y_cm < -scene.robot.body.radius_cm
    assert document.missed == document.false == []


def test_the_thesis_protocol_measures_at_the_full_sweeps_peak(tmp_path: Path) -> None:
    url = room_file(tmp_path, scene_at(38.0, "mid_body"))  # one stage less to explore
    times = {}
    protocols: tuple[Protocol, ...] = ("thesis", "measure")
    for protocol in protocols:
        result = explored(url, tmp_path / protocol, 2, protocol=protocol)
        times[protocol] = result.document.robot_time_s
        pressures = [
            max(s.pressure_psi for s in stage.shapes if s.side == "right")
            for stage in result.document.stages
        ]
        assert result.document.contacts
        assert (min(pressures) > 17) == (protocol == "thesis")
    assert times["measure"] < times["thesis"]


@pytest.mark.parametrize(
    ("fault", "error", "named"),
    [
        (FaultTable(kind="flex_wire_cut", above_length_cm=15.0), RobotFaultError, "flex_"),
        (FaultTable(kind="spool_stall", above_length_cm=12.0), RobotFaultError, "spool_stall"),
        (FaultTable(kind="pressure_wire_cut", above_pressure_psi=9.0), RobotFaultError, "wire"),
        (FaultTable(kind="host_silent", above_pressure_psi=9.0), LinkError, "answer"),
    ],
    ids=lambda value: getattr(value, "kind", None),
)  # fmt: skip
def test_a_fault_ends_the_run_safely_and_the_folder_says_so(
    tmp_path: Path, fault: FaultTable, error: type[Exception], named: str
) -> None:
    scene = last_stages(0.0, "empty")
    scene.faults = [fault]
    with pytest.raises(error, match=named):
        explore(room_file(tmp_path, scene), seed=1, out=tmp_path)
    (path,) = tmp_path.glob("*-room")
    folder = RunFolder(path)
    document = folder.read_document()
    assert document.outcome.startswith("aborted: ")
    assert named in document.outcome
    assert len(document.stages) <= 2
    assert not folder.read_log().truncated
    assert replay(path).document.contacts == []


def test_each_command_prints_one_object_or_what_fits_80_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, thigmo: Thigmo
) -> None:
    monkeypatch.chdir(tmp_path)
    room_file(tmp_path, scene_at(51.0, "default"), "late")
    late = tmp_path / "late.toml"
    ran = thigmo("explore", "--scene", late, "--seed", 1, "--out", tmp_path, "--json")
    assert ran.code == 0, ran.err
    result = json.loads(ran.out)
    contact_keys = {
        "arc_cm", "x_cm", "y_cm", "force_per_cm2", "interval_cm", "status", "everted_length_cm",
    }  # fmt: skip
    assert contact_keys <= result["contacts"][0].keys()
    assert result["truth"]["pegs"]
    assert result["error_x_cm"] <= result["error_cm"]
    assert min(result["robot_time_s"], result["wall_time_s"]) > 0
    for command, keys in (
        (["info", result["run"]], {"frames", "truncated", "outcome"}),
        (["replay", result["run"]], {"contacts", "sweeps"}),
        (["info", "--robot", "emulator://default"], {"state", "faults", "firmware"}),
        (["params", "--robot", "emulator://default", "settle_ms"], {"settle_ms"}),
        (["scene", "check", late], {"pegs", "robot"}),
        (["retract", "--robot", f"emulator://{late}"], {"length_cm"}),
    ):
        ran = thigmo(*command, "--json")
        assert ran.code == 0, command
        assert keys <= json.loads(ran.out).keys(), command
    shutil.move(result["run"], "run")
    for command in (["info", "run"], ["replay", "run"], ["export", "run", "--csv", "tables"]):
        ran = thigmo(*command)
        assert ran.code == 0, command
        assert 0 < max(map(len, ran.out.splitlines())) <= 90
        assert "…" not in ran.out


@pytest.mark.parametrize("time_s", [61.0, 63.0])
def test_a_short_budget_is_kept_to_and_buys_a_sweep(tmp_path: Path, time_s: float) -> None:
    run = explore("emulator://default", seed=1, time_s=time_s, out=tmp_path)
    assert run.document.outcome.startswith("time is up")
    assert run.document.robot_time_s <= time_s
    assert run.document.stages
    assert "obstacles farther out are not felt" in run.document.skips


def test_a_budget_of_a_minute_and_a_half_reaches_the_full_length(tmp_path: Path) -> None:
    run = explore("emulator://default", seed=1, time_s=90.0, out=tmp_path)
    assert run.document.outcome == "full length"
    assert run.document.robot_time_s <= 90.0
