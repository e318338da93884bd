"""A robot with a fibre that an interrogator reads live: contacts, and what stops it."""

from __future__ import annotations

import json
import socket
import time
from pathlib import Path

import numpy as np
import pytest
from command import Thigmo
from emulated import armed, at_each_step
from served import ServedRobot, comes

from thigmo.design import draft
from thigmo.emulator.board import virtual_board
from thigmo.emulator.fibre import LineServer
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.reach import room_for
from thigmo.emulator.scene import FaultTable, Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import CommandRefusedError, InterrogatorError
from thigmo.exploration import ExplorationResult, explore, replay
from thigmo.exploration.recorded import recorded_sweeps
from thigmo.link import protocol as wire
from thigmo.link.framing import decode
from thigmo.link.interrogator import Interrogator, TcpSource
from thigmo.record import RunFolder, read_log
from thigmo.robot import Robot

_LOOSE_S = 0.5  # from the last line to outputs off: 0.2 s of age, a look at it, and a command


def _room(length_cm: float = 53.0) -> Scene:
    scene = room_for(draft(53, 10, 2, kind="fibre"), 0, peg=False)
    scene.start_length_cm = length_cm
    scene.robot.board.settle_s = 0.2
    return scene


@pytest.fixture
def pressing() -> tuple[Robot, EmulatorTransport]:
    """Zeroed, and bent to the left by 6 psi."""
    robot, transport = armed(_room())
    robot.select_body_pressure(2)
    robot.wait_settled()
    robot.zero()
    robot.press("left", 6.0)
    robot.wait(3.0)
    return robot, transport


def test_a_new_robot_feels_a_peg_with_its_fibre(thigmo: Thigmo, tmp_path: Path) -> None:
    made = thigmo("robot", "new", "--kind", "fibre", "--sensors", "20", "--seed", "6",
                  "--out", str(tmp_path))  # fmt: skip
    command = made.out.partition("thigmo feel ")[2].splitlines()[0].split()
    assert command, made.out
    answers = json.loads(thigmo("feel", *command, "--count", "2", "--json").out)
    for answer in answers:
        (truth,) = [contact["arc_cm"] for contact in answer["truth"]]
        (contact,) = answer["contacts"]
        assert contact["interval"][0] < truth < contact["interval"][1]
        assert answer["status"] == "localized"
        assert answer["lines"] >= 20
    scene = Scene.load(tmp_path / "grown.toml")
    scene.pegs = []
    scene.save(tmp_path / "grown.toml")
    empty = json.loads(thigmo("feel", *command, "--count", "2", "--json").out)
    assert all(answer["status"] == "no contact" for answer in empty)


@pytest.fixture(scope="module")
def explored(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ExplorationResult]:
    """A room with a peg, and its exploration by a fibre and two base sensors."""
    folder = tmp_path_factory.mktemp("explored")
    room_for(draft(53, 20, 2, kind="fibre"), 6).save(folder / "room.toml")
    return folder / "room.toml", explore(f"emulator://{folder / 'room.toml'}", seed=1, out=folder)


def test_a_robot_with_a_fibre_explores_and_its_record_says_the_same(
    explored: tuple[Path, ExplorationResult],
) -> None:
    _, run = explored
    (contact,) = run.document.contacts
    arcs = [c.arc_cm for c in run.document.truth.contacts if c.everted_length_cm > 52]
    assert contact.status == "localized"
    assert any(contact.interval_cm[0] < arc < contact.interval_cm[1] for arc in arcs)
    again = replay(run.folder)
    assert again.document.contacts == run.document.contacts
    assert again.document.stages == run.document.stages
    (sweep, *_) = recorded_sweeps(run.folder)
    assert bin(sweep.sensors >> 10).count("1") == 16  # in the plane, out at 40 cm


@pytest.mark.parametrize(
    ("fault", "said"),
    [("interrogator_silent", "newest line is"), ("grating_lost", "has lost strain_4")],
)
def test_an_exploration_ends_safely_when_its_fibre_is_not_read(
    explored: tuple[Path, ExplorationResult], tmp_path: Path, fault: str, said: str
) -> None:
    room, whole = explored
    zeroed = [
        n.t_s for n in read_log(whole.folder / "run.mcap").notes if n.facts.get("state") == "ZERO"
    ]
    scene = Scene.load(room)
    scene.faults = [FaultTable.model_validate(
        {"kind": fault, "at_s": zeroed[1] + 2.5, "duration_s": 1e3, "sensor": 4}
    )]  # fmt: skip
    scene.save(tmp_path / "room.toml")
    with pytest.raises(InterrogatorError, match=said):
        explore(f"emulator://{tmp_path / 'room.toml'}", seed=1, out=tmp_path)
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
    assert said in RunFolder(folder).read_document().outcome
    log = read_log(folder / "run.mcap")
    assert not log.missing
    frames = [decode(entry.frame).message() for entry in log.entries]
    heard = [frame for frame in frames if isinstance(frame, wire.Telemetry)]
    bent = [n for n, frame in enumerate(heard) if max(frame.pressure_cpsi) > 500]
    assert bent  # in the middle of a sweep
    assert max(heard[-1].drive) == heard[-1].motor == 0
    again = replay(folder)
    assert again.document.stages == whole.document.stages[: len(again.document.stages)]
    assert len(again.document.stages) == 1


def test_a_pressed_body_is_read_as_it_bends(pressing: tuple[Robot, EmulatorTransport]) -> None:
    robot, transport = pressing
    got = robot.read_fibre(1.0)
    in_plane = [grating.side is not None for grating in robot.config.gratings]
    true = transport.lockstep.plant.free_curvature
    assert got.side == "left"
    assert got.free_curvature == pytest.approx(true, rel=0.1)
    assert got.curvature[in_plane] == pytest.approx(np.full(10, true), abs=1e-3)
    assert np.isnan(got.curvature[np.logical_not(in_plane)]).all()
    assert 45 <= got.lines <= 51
    assert got.zero_age_s == pytest.approx(8.0, abs=1.5)


def test_only_a_body_at_rest_is_zeroed_and_only_what_is_out_of_it() -> None:
    robot, transport = armed(_room(30.0))
    robot.select_body_pressure(1)
    robot.wait_settled()
    transport.lockstep.faults.inject(FaultTable(kind="grating_lost", at_s=0.0, sensor=0))
    robot.config.gratings[0].healthy = False  # and its peak is lost
    robot.zero()
    known = np.isfinite(robot.read_fibre().curvature)
    assert np.flatnonzero(known).tolist() == [2, 4, 6, 8, 10]  # in the plane, to 27.5 cm
    transport.lockstep.plant.fibre._ramp_k_s = 5.0  # an oven
    with pytest.raises(CommandRefusedError, match="strains still drift"):
        robot.zero()


@pytest.mark.parametrize(
    ("fault", "said"),
    [("interrogator_silent", "newest line is"), ("grating_lost", "has lost strain_4")],
)
def test_what_is_under_way_stops_when_the_fibre_is_not_read(
    pressing: tuple[Robot, EmulatorTransport], fault: str, said: str
) -> None:
    robot, transport = pressing
    begins_s = robot.now() + 1.0
    transport.lockstep.faults.inject(FaultTable.model_validate(
        {"kind": fault, "at_s": begins_s, "duration_s": 20.0, "sensor": 4}
    ))  # fmt: skip
    off: list[float] = []

    def look() -> None:
        board = transport.lockstep.board
        if not any(board.drive_enabled) and not board.motor and not off:
            off.append(robot.now())

    at_each_step(transport, look)
    with pytest.raises(InterrogatorError, match=said):
        robot.wait(5.0)
    assert begins_s < off[0] < begins_s + _LOOSE_S
    assert robot.status().state == "safe"
    robot.wait(5.0)  # nothing is guarded any longer
    robot.arm()
    with pytest.raises(InterrogatorError, match=said):
        robot.read_fibre()
    robot.arm()
    with pytest.raises(InterrogatorError, match=said):
        robot.press("left", 6.0)
    robot.arm()
    reached_cm = robot.retract_to(50.0).length_cm  # winding in needs no fibre
    assert reached_cm == pytest.approx(50.0, abs=0.3)
    robot.wait(15.0)
    robot.zero()
    assert np.isfinite(robot.read_fibre().curvature).any()


def _free_address() -> str:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"127.0.0.1:{server.getsockname()[1]}"


def test_a_served_robot_serves_its_fibre_on_a_socket() -> None:
    scene = _room()
    scene.robot.interrogator = _free_address()
    served = ServedRobot(Lockstep(scene, virtual_board(scene.robot, 1), seed=1))
    try:
        with Interrogator(TcpSource(scene.robot.interrogator), 20, time.monotonic) as heard:
            assert comes(lambda: heard.heard)
            strains = np.array([strain for _, strain in heard.lines_since(-np.inf)])
            assert np.nanstd(strains, axis=0) == pytest.approx(0.8, abs=0.5)
    finally:
        served.close()


def test_over_a_socket_a_robot_is_read_and_stops_when_it_is_cut() -> None:
    address = _free_address()
    robot, transport = armed(_room())
    server = LineServer(address, transport.lockstep.plant.fibre)
    at_each_step(transport, server.exchange)
    transport.interrogator = lambda: TcpSource(address)  # type: ignore[method-assign, assignment, return-value]
    robot.select_body_pressure(2)
    robot.wait_settled()
    robot.zero()
    robot.press("left", 6.0)
    robot.wait(3.0)
    assert robot.read_fibre().lines > 20
    server.close()
    with pytest.raises(InterrogatorError, match=f"{address} is lost: it closed the connection"):
        robot.wait(1.0)
    assert robot.status().state == "safe"
    with pytest.raises(InterrogatorError, match="is lost"):
        robot.read_fibre()
    robot.configure(transport.config)
    robot.arm()
    with pytest.raises(InterrogatorError, match=f"no interrogator answers at {address}"):
        robot.zero()
    robot.close()
