"""Board and plant together: exchanges, faults from conditions, and the transport's clock."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from silent_board import SilentBoard

from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.scene import FaultTable, Scene
from thigmo.emulator.transport import EmulatorTransport, parse_url
from thigmo.errors import ConfigError, DataError, LinkError
from thigmo.link.heartbeat import HOLD_AFTER
from thigmo.link.protocol import ResetCause
from thigmo.mechanics import Peg


def faulty(**entries: Any) -> Scene:
    scene = Scene(start_length_cm=30.0)
    scene.faults = [FaultTable(**entries)]
    return scene


def run(lockstep: Lockstep, exchanges: int) -> None:
    for _ in range(exchanges):
        lockstep.advance()


def test_exchange_is_continuous_and_in_the_boards_time(board: SilentBoard) -> None:
    lockstep = Lockstep(Scene(), board)
    board.motor, board.braked = 300, False
    run(lockstep, 50)
    assert board.now_us == 500_000
    assert lockstep.t_s == 0.5
    for before, after in zip(board.encoder, board.encoder[1:], strict=False):
        assert before[1] == after[0]
    for first, second in zip(board.analog, board.analog[1:], strict=False):
        assert np.array_equal(first[:, 1], second[:, 0])
    assert board.noise[:10] == pytest.approx(np.ones(10))


def test_finer_exchange_passes_the_same_levels(board: SilentBoard) -> None:
    scene = Scene(start_length_cm=53.0)
    coarse, fine = Lockstep(scene, board), Lockstep(scene, other := SilentBoard(), exchange_ms=1)
    for stepped in (board, other):
        stepped.drive, stepped.drive_enabled = (500, 0), (True, False)
        stepped.motor, stepped.braked = -200, False
    run(coarse, 60)
    run(fine, 60)
    assert len(other.analog) == 10 * len(board.analog)
    assert other.analog[9][:, 1] == pytest.approx(board.analog[0][:, 1])
    assert other.analog[-1][:, 1] == pytest.approx(board.analog[-1][:, 1])
    assert other.encoder[-1][1] == pytest.approx(board.encoder[-1][1])
    assert other.now_us == board.now_us
    with pytest.raises(ConfigError):
        Lockstep(scene, board, exchange_ms=3)


def test_fault_begins_when_all_its_conditions_hold_and_ends(board: SilentBoard) -> None:
    scene = faulty(kind="spool_stall", at_s=0.2, while_motor_runs=True, duration_s=0.3)
    lockstep = Lockstep(scene, board)
    stuck = []
    for step in range(100):
        board.motor = 200 if step >= 40 else 0
        lockstep.advance()
        stuck.append(lockstep.plant.spool_stall)
    assert stuck.index(True) in (40, 41)
    assert stuck.count(True) == 30
    assert lockstep.faults.active == set()


@pytest.mark.parametrize(
    ("kind", "extra", "seen"),
    [
        ("flex_wire_cut", {"side": "right", "sensor": 2}, lambda s, b: s.plant.stuck == {7: 0.0}),
        ("flex_short", {"sensor": 1}, lambda s, b: s.plant.stuck == {1: 1023.9}),
        ("pressure_wire_cut", {"side": "right"}, lambda s, b: s.plant.stuck == {11: 0.0}),
        ("pressure_stuck", {"value": 7.0}, lambda s, b: s.plant.forced_outlet[0] == 7.0),
        ("over_pressure", {}, lambda s, b: s.plant.forced_outlet[0] == 30.0),
        ("air_lost", {}, lambda s, b: not s.plant.forced_outlet.any()),
        ("spool_slip", {}, lambda s, b: s.plant.slip_cm_s == 2.0),
        ("pressure_short", {}, lambda s, b: s.plant.stuck == {10: 1023.9}),
        ("pressure_frozen", {"value": 7.0}, lambda s, b: s.plant.pressure_reading[0] == 7.0),
        ("pressure_gain", {}, lambda s, b: s.plant.pressure_gain[0] == 0.75),
        ("pressure_offset", {}, lambda s, b: s.plant.pressure_reading[0] < -2.0),
        ("pressure_noisy", {}, lambda s, b: s.plant.pressure_noisy[0] == 1.0),
        ("flex_frozen", {"sensor": 1}, lambda s, b: set(s.plant.stuck) == {1}),
        ("flex_noisy", {}, lambda s, b: s.plant.flex_noise == {0: 40.0}),
        ("motor_lost", {}, lambda s, b: s.plant.motor_lost),
        ("motor_shorted", {}, lambda s, b: s.plant.motor_forced == 800),
        ("encoder_lost", {}, lambda s, b: s.plant.encoder_share == 0.0),
        ("encoder_share", {}, lambda s, b: s.plant.encoder_share == 0.7),
        ("tail_jam", {}, lambda s, b: s.plant.tail_jammed),
        ("host_silent", {}, lambda s, b: s.faults.host_silent),
        ("brown_out", {"value": 4100}, lambda s, b: b.supply[-1] == 4100),
        ("estop", {}, lambda s, b: b.estop[-1]),
        ("hang", {}, lambda s, b: b.hung == 1),
        ("power_cut_saving", {"value": 55}, lambda s, b: b.cuts == [55]),
        ("power_cut", {}, lambda s, b: not s.faults.powered),
    ],
)
def test_fault_does_what_it_is_named_for(
    board: SilentBoard, kind: str, extra: dict[str, Any], seen: Any
) -> None:
    lockstep = Lockstep(faulty(kind=kind, at_s=0.1, duration_s=0.2, **extra), board)
    run(lockstep, 8)
    assert not seen(lockstep, board)
    run(lockstep, 8)
    assert seen(lockstep, board)
    run(lockstep, 30)
    if kind not in ("hang", "power_cut_saving"):
        assert not seen(lockstep, board)
    if kind.startswith("power_cut"):
        assert board.resets == [ResetCause.POWER_ON]


def test_power_cut_without_an_end_lasts_a_second(board: SilentBoard) -> None:
    lockstep = Lockstep(faulty(kind="power_cut", at_s=0.0), board)
    run(lockstep, 99)
    assert board.now_us == 0
    run(lockstep, 10)
    assert board.now_us > 0


def test_slipping_spool_turns_the_braked_motor(board: SilentBoard) -> None:
    lockstep = Lockstep(faulty(kind="spool_slip", at_s=0.0, value=3.0), board)
    run(lockstep, 200)
    assert board.encoder[-1][1] - board.encoder[0][0] == pytest.approx(76 * 3.0 * 2.0, rel=0.05)


def transport(board: SilentBoard, scene: Scene | None = None) -> EmulatorTransport:
    return EmulatorTransport(scene or Scene(), board)


def test_reading_makes_time_pass_and_ends_with_the_first_bytes(board: SilentBoard) -> None:
    link = transport(board)
    assert link.read(0.5) == b""
    assert link.now() == pytest.approx(0.5)
    board.sending += b"abc"
    assert link.read(0.5) == b"abc"
    assert link.now() == pytest.approx(0.51)
    assert link.read_s == link.now()
    assert link.read(0.0) == b""
    assert link.now() == pytest.approx(0.51)
    link.read(1e-12)  # any wait makes time pass, or a caller could wait for ever
    assert link.now() == pytest.approx(0.52)


def test_heart_beats_by_the_virtual_clock(board: SilentBoard) -> None:
    link = transport(board)
    link.start_heartbeat(7, 0.1)
    for _ in range(10):
        board.sending += b"x"  # a board that is heard
        link.pass_time(0.1)
    beats = link.beats()
    assert [beat.counter for beat in beats] == list(range(1, 11))
    assert beats[3].t_s == pytest.approx(0.3, abs=0.011)
    # A mute board may be in its boot loader, which every byte would keep there.
    link.pass_time(5.0)
    assert len(link.beats()) <= HOLD_AFTER
    board.sending += b"x"
    link.pass_time(0.2)
    assert link.beats()
    assert link.beats() == []
    link.stop_heartbeat()
    board.written.clear()
    link.read(1.0)
    assert not board.written


def test_silent_host_is_not_heard(board: SilentBoard) -> None:
    link = transport(board, faulty(kind="host_silent", at_s=0.0, duration_s=0.5))
    link.read(0.02)
    link.start_heartbeat(7, 0.1)
    link.read(0.3)
    link.write(b"hello")
    assert not board.written
    assert link.beats() == []
    link.read(0.5)
    link.write(b"hello")
    assert board.written.endswith(b"hello")


def test_operator_measures_and_sets_the_regulator(board: SilentBoard) -> None:
    link = transport(board, Scene(start_length_cm=12.5))
    assert link.operator is not None
    assert link.operator.everted_length_cm() == 12.5
    link.operator.set_body_pressure(0.77)
    assert link.lockstep.plant.body_psi == 0.77
    assert link.now() == pytest.approx(5.0)


def test_operator_moves_the_dowels(board: SilentBoard) -> None:
    scene = Scene.load("default")
    scene.start_length_cm = 53.0
    link = transport(board, scene)
    assert link.operator is not None
    link.operator.place_pegs([Peg(35.0, 6.0, 0.6), Peg(20.0, -8.0, 0.5)])
    assert link.now() == pytest.approx(scene.operator.takes_s)
    assert [peg.x for peg in link.truth().pegs] == [35.0, 20.0]
    board.drive, board.drive_enabled = (430, 0), (True, False)
    link.pass_time(6.0)
    assert [contact.peg for contact in link.truth().contacts] == [0]
    link.operator.place_pegs([])
    assert link.truth().contacts == ()
    assert link.lockstep.plant.sensor_curvature == pytest.approx(
        np.full(10, link.lockstep.plant.free_curvature), abs=1e-6
    )
    with pytest.raises(DataError, match="overlaps"):
        link.operator.place_pegs([Peg(1.0, 0.0, 2.0)])


def test_operators_ruler_errs_as_the_scene_says(board: SilentBoard) -> None:
    scene = Scene(start_length_cm=20.0)
    scene.operator.length_error_cm = 0.3
    operator = transport(board, scene).operator
    assert operator is not None
    measured = [operator.everted_length_cm() for _ in range(400)]
    assert np.mean(measured) == pytest.approx(20.0, abs=0.06)
    assert np.std(measured) == pytest.approx(0.3, rel=0.15)


def test_closed_transport_says_so(board: SilentBoard) -> None:
    link = transport(board)
    link.close()
    link.close()
    with pytest.raises(LinkError, match="closed"):
        link.read(0.1)
    with pytest.raises(LinkError, match="closed"):
        link.write(b"x")


def test_url_names_scene_and_seed() -> None:
    scene, seed, _ = parse_url("emulator://empty?seed=12", None)
    assert (scene.name, seed) == ("empty", 12)
    assert parse_url("emulator://empty?seed=12", 3)[1] == 3
    assert parse_url("emulator://", None)[0].name == "default"
    for url in ("emulator://empty?seed=x", "emulator://empty?speed=2", "emulator://nowhere"):
        with pytest.raises(ConfigError):
            parse_url(url, None)
