"""An exploration that is watched: what its viewers see, what they may ask, and that it does not
feel them.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emulated import last_stages, room_file

import thigmo
from thigmo.emulator.scene import Scene
from thigmo.errors import CommandRefusedError, StoppedByViewerError
from thigmo.exploration import explore
from thigmo.exploration.run_control import RunControl
from thigmo.link import protocol as wire
from thigmo.link.framing import decode
from thigmo.record import RunFolder, read_ros_map
from thigmo.robot import Robot, connect
from thigmo.stream import (
    BodyShape,
    Contacts,
    Event,
    Grid,
    Message,
    Posterior,
    RemoteRun,
    RunState,
    Telemetry,
    attach,
    read_messages,
    running,
    to_json,
)

pytestmark = pytest.mark.ci

STOPPED = f"stopped: {wire.Fault.STOPPED.words[0]}"  # the board's fault says it alike
MODULE = import_module("thigmo.exploration.explore")


class Watcher:
    """All that a run publishes, and its control; `act` is called with each message."""

    def __init__(self, act: Callable[[Message, RunControl], None] | None = None) -> None:
        self.messages: list[Message] = []
        self.control = RunControl()
        self._act = act

    def connect(self, *args: Any, **options: Any) -> Robot:
        robot = connect(*args, **options)
        robot.hub.attach(self._take)
        return robot

    def _take(self, message: Message) -> None:
        self.messages.append(message)
        if self._act is not None:
            self._act(message, self.control)

    def of(self, kind: type[Message]) -> list[Any]:
        return [message for message in self.messages if isinstance(message, kind)]

    def explore(self, url: str, out: Path, **options: Any) -> thigmo.exploration.ExplorationResult:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(MODULE, "connect", self.connect)
            patch.setattr(MODULE, "RunControl", lambda: self.control)
            return explore(url, seed=1, out=out, **options)


class Viewers:
    """Three that come over the socket with the first thing that a run tells; one of them reads."""

    def __init__(self) -> None:
        self.idle: list[RemoteRun] = []
        self.read: list[Message] = []
        self._reading: threading.Thread | None = None

    def progress(self, doing: str, done: float) -> None:
        if self._reading is None:
            (mine,) = (server for server in running() if server.hello.pid == os.getpid())
            assert mine.hello.name == "watched"
            self.idle = [attach(mine.address) for _ in range(2)]
            run = attach(mine.address)
            self._reading = threading.Thread(target=lambda: self.read.extend(run))
            self._reading.start()

    def leave(self) -> None:
        assert self._reading is not None
        self._reading.join()
        for run in self.idle:
            run.close()


class Watched:
    """One exploration with viewers, and the same one without.

    A robot whose readings are three times as noisy is not sure of its contact at once, and measures
    it.
    """

    def __init__(self, url: str, folder: Path) -> None:
        self.alone = explore(url, seed=1, out=folder, name="alone")
        self.viewers, self.watcher = Viewers(), Watcher()
        self.watched = self.watcher.explore(
            url, folder, name="watched", progress=self.viewers.progress
        )
        self.viewers.leave()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Watched:
    scene = last_stages()
    scene.rescale_errors(3.0)
    url = room_file(tmp_path_factory.mktemp("late"), scene, "late")
    return Watched(url, tmp_path_factory.mktemp("runs"))


def _plain(folder: Path) -> dict[str, Any]:
    document = json.loads((folder / "contacts.json").read_text())
    for key in ("name", "started", "wall_time_s"):
        del document[key]
    return dict(document)


def test_robot_time_and_results_are_those_of_a_run_that_nobody_watches(run: Watched) -> None:
    assert _plain(run.watched.folder) == _plain(run.alone.folder)
    assert run.watched.document.robot_time_s == run.alone.document.robot_time_s
    times = [
        [entry.t_s for entry in RunFolder(run_folder.folder).read_log().entries]
        for run_folder in (run.watched, run.alone)
    ]
    assert times[0] == times[1]


def test_a_viewer_reads_to_the_end(run: Watched) -> None:
    states = [message for message in run.viewers.read if isinstance(message, RunState)]
    assert (states[-1].state, states[-1].outcome) == ("DONE", "full length")


def test_what_a_run_publishes_tells_it_from_its_states_to_its_map(run: Watched) -> None:
    published, document = run.watcher, run.watched.document
    states = published.of(RunState)
    assert {"CONFIGURE", "PLAN", "GROW", "SWEEP", "LOCALIZE", "MAP"} <= {s.state for s in states}
    assert [s.done for s in states] == sorted(s.done for s in states)
    assert (states[-1].state, states[-1].outcome) == ("DONE", "full length")
    assert published.of(Contacts)[-1].contacts == tuple(document.contacts)
    grid = published.of(Grid)[-1]
    on_disk = read_ros_map(run.watched.folder / "map.yaml")
    assert (np.reshape(grid.cells, (grid.height, grid.width)) == on_disk.cells).all()
    felt = [posterior for posterior in published.of(Posterior) if posterior.places_cm]
    assert felt
    for posterior in felt:
        assert sum(posterior.probability) == pytest.approx(1.0)
    assert "contact" in [event.name for event in published.of(Event)]


def test_posterior_comes_in_mid_sweep_twice_a_second_until_the_base_is_near_its_fold(
    run: Watched,
) -> None:
    published = run.watcher
    measured = [posterior for posterior in published.of(Posterior) if not posterior.sweeping]
    so_far = [posterior for posterior in published.of(Posterior) if posterior.sweeping]
    assert len(so_far) > 1
    steps = np.diff([posterior.t_s for posterior in so_far])
    assert np.min(steps) == pytest.approx(0.5, abs=0.05)
    assert np.median(steps) == pytest.approx(0.5, abs=0.05)
    states = published.of(RunState)
    for posterior in so_far:
        now = [state for state in states if state.t_s <= posterior.t_s][-1]
        assert now.state in ("SWEEP", "MEASURE")
        assert posterior.length_cm == pytest.approx(now.stage_cm, abs=0.2)
        assert 0.0 <= posterior.contact_probability <= 1.0
    (contact,) = run.watched.contacts
    last, then = so_far[-1], measured[-1]
    low, high = np.interp([0.025, 0.975], np.cumsum(last.probability), last.places_cm)
    assert low <= contact.arc_cm <= high + 0.5  # a cell
    spread = [
        np.sqrt(np.dot((np.array(reading.places_cm) - contact.arc_cm) ** 2, reading.probability))
        for reading in (last, then)
    ]
    assert spread[1] < spread[0]  # the fit knows more than the search alone
    assert then.contact_probability > 0.99


def test_the_record_gives_back_what_was_published(run: Watched) -> None:
    kept = list(read_messages(run.watched.folder))
    assert len(kept) > 5_000
    assert [message.t_s for message in kept] == sorted(message.t_s for message in kept)
    for channel in {message.CHANNEL for message in kept}:
        recorded = [to_json(message) for message in kept if channel == message.CHANNEL]
        published = [
            to_json(message) for message in run.watcher.messages if channel == message.CHANNEL
        ]
        first = published.index(recorded[0])  # the robot speaks before the run and after it
        assert recorded == published[first : first + len(recorded)]


def test_every_typed_value_equals_the_raw_frames(run: Watched) -> None:
    log = RunFolder(run.watched.folder).read_log()
    frames = [(e.t_s, decode(e.frame)) for e in log.entries if e.direction == "rx"]
    raw = [(t_s, f.message()) for t_s, f in frames if f.id == wire.Telemetry.ID]
    typed = list(read_messages(run.watched.folder, {"telemetry"}))
    assert len(typed) == len(raw)
    for said, (t_s, frame) in zip(typed, raw, strict=True):
        assert isinstance(said, Telemetry)
        assert isinstance(frame, wire.Telemetry)
        assert said.t_s == pytest.approx(t_s, abs=2e-9)
        assert said.device_s == pytest.approx(frame.t_us / 1e6, abs=1e-9)
        assert said.flex_sum == frame.flex_sum
        assert said.pressure_psi == tuple(number / 100 for number in frame.pressure_cpsi)
        assert said.demand_psi == tuple(number / 100 for number in frame.set_cpsi)
        assert said.drive_ma == tuple(number * 20 / 1599 for number in frame.drive)
        assert said.length_cm == frame.length_um / 1e4
        assert said.motor == frame.motor / 800
        assert (said.base_per_cm, said.free_per_cm) == (frame.base_e5 / 1e5, frame.free_e5 / 1e5)
        assert len(said.faults) == frame.faults.bit_count()
        assert said.activity == wire.Activity(frame.state_activity & 0xF).key


def test_epoch_and_robot_time_go_together(run: Watched) -> None:
    apart = [message.epoch_s - message.t_s for message in run.watcher.messages]
    assert max(apart) - min(apart) < 1e-5


def test_the_body_is_seen_to_bend_both_ways_as_long_as_it_is(run: Watched) -> None:
    shapes = [s for s in run.watcher.of(BodyShape) if len(s.poses) > 2]  # its length is known
    sideways = [shape.poses[-1][1] for shape in shapes]
    assert min(sideways) < -10.0
    assert max(sideways) > 10.0
    for shape in shapes:
        steps = np.hypot(*np.diff(np.array(shape.poses)[:, :2], axis=0).T)
        assert 49.0 < steps.sum() < 54.0
    assert len(shapes) < 20 * run.watched.document.robot_time_s


def test_a_viewer_pauses_the_run_between_stages_and_lets_it_go_on(
    late_url: str, tmp_path: Path
) -> None:
    def act(message: Message, control: RunControl) -> None:
        if isinstance(message, RunState) and message.state == "SWEEP" and not paused:
            control.command("pause")
        if isinstance(message, RunState) and message.paused:
            paused.append(message)
        # Four times the board's limit for a heartbeat.
        if paused and isinstance(message, Telemetry) and message.t_s > paused[0].t_s + 2.0:
            control.command("resume")

    paused: list[RunState] = []
    watcher = Watcher(act)
    result = watcher.explore(late_url, tmp_path)
    assert result.document.outcome == "full length"
    (state,) = paused
    assert (state.state, state.doing.split(": ")[-1]) == ("PLAN", "paused")
    during = [m for m in watcher.of(Telemetry) if state.t_s < m.t_s < state.t_s + 2.0]
    assert len(during) > 300
    assert max(max(m.pressure_psi) for m in during) < 0.5
    assert not any(m.faults for m in during)
    # What it measures afterwards may differ: sensors settle while it pauses.
    next_state = next(s for s in watcher.of(RunState) if s.t_s > state.t_s and not s.paused)
    assert 1.9 <= next_state.t_s - state.t_s < 4.0


def test_a_viewer_stops_the_run_in_mid_sweep_and_the_map_so_far_is_kept(
    late_url: str, tmp_path: Path
) -> None:
    def act(message: Message, control: RunControl) -> None:
        if isinstance(message, Telemetry) and max(message.pressure_psi) > 3.0 and not clicked:
            clicked.append(message.t_s)
            control.command("stop")

    clicked: list[float] = []
    watcher = Watcher(act)
    with pytest.raises(StoppedByViewerError, match=f"^{STOPPED}"):
        watcher.explore(late_url, tmp_path)
    telemetry = watcher.of(Telemetry)
    safe = next(m.t_s for m in telemetry if m.t_s > clicked[0] and m.drive_ma == (0.0, 0.0))
    assert safe - clicked[0] < 0.3
    assert telemetry[-1].faults == ("stopped",)
    assert watcher.of(RunState)[-1].outcome.startswith(f"aborted: {STOPPED}")
    assert [(e.name, e.severity) for e in watcher.of(Event)].count(("aborted", "fault")) == 1
    (path,) = tmp_path.iterdir()
    folder = RunFolder(path)
    assert folder.read_document().outcome.startswith(f"aborted: {STOPPED}")
    assert folder.map_path.read_bytes().startswith(b"\x89PNG")
    assert read_ros_map(path / "map.yaml").cells.size


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ValueError("a mistake in the program")])
def test_a_run_that_ends_before_its_first_stage_leaves_a_map_too(
    tmp_path: Path, error: BaseException
) -> None:
    def progress(doing: str, done: float) -> None:
        if doing == "arming":
            raise error

    with pytest.raises(type(error)):
        explore("emulator://empty", out=tmp_path, progress=progress)
    (path,) = tmp_path.iterdir()
    assert (path / "map.png").read_bytes().startswith(b"\x89PNG")
    assert read_ros_map(path / "map.yaml").cells.size


def test_a_program_reads_the_stream_while_it_commands() -> None:
    with connect("emulator://empty", Scene.load("empty").believed(1), seed=1) as robot:
        called: list[Telemetry] = []
        end = robot.on_telemetry(called.append)
        streamed = list(robot.stream(1.0, {"telemetry"}))
        assert len(streamed) == pytest.approx(200, abs=6)
        assert called[: len(streamed)] == streamed
        end()
        count = len(called)
        for message in robot.stream(0.5, {"telemetry", "shape"}):
            assert isinstance(message, Telemetry | BodyShape)
            robot.status()  # a command between two messages
        assert len(called) == count
        with pytest.raises(CommandRefusedError):
            robot.grow_to(10.0)  # not armed: nothing of that has changed
