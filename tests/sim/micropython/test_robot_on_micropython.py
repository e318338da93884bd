"""The robot on MicroPython does what it does on the virtual board."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from rig import Rig

import thigmo
from thigmo.emulator.micropython import STORE_SIZE, MicroPythonBoard
from thigmo.emulator.micropython_build import missing
from thigmo.errors import CommandRefusedError, LinkError
from thigmo.exploration import explore
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.protocol import ResetCause
from thigmo_bench.studies.faults import FAILURES, QUICK, Case, visit

Make = Callable[..., Rig[MicroPythonBoard]]


@pytest.fixture(autouse=True)
def _built() -> None:
    if reason := missing("unix"):
        pytest.skip(reason)


def test_connect_opens_the_module_by_its_address() -> None:
    with thigmo.connect("micropython://default?seed=3") as robot:
        assert robot.identity["board"] == "unix"


@pytest.mark.ci
def test_an_exploration_finds_what_it_finds_on_the_virtual_board(tmp_path: Path) -> None:
    module, virtual = (
        explore(f"{board}://default", seed=1, out=tmp_path, name=board).document
        for board in ("micropython", "emulator")
    )
    assert module.outcome == virtual.outcome == "full length"
    assert len(module.contacts) == len(virtual.contacts) == 1
    assert module.contacts[0].side == virtual.contacts[0].side
    assert module.contacts[0].arc_cm == pytest.approx(virtual.contacts[0].arc_cm, abs=1.0)
    assert module.error_x_cm is not None
    assert module.error_x_cm < 3.0


@pytest.mark.ci
@pytest.mark.parametrize("state", QUICK)
def test_every_failure_of_the_campaign_ends_as_on_the_virtual_board(state: str) -> None:
    different = []
    for failure in FAILURES:
        core = visit(Case(failure, state))
        module = visit(Case(failure, state), lambda store: MicroPythonBoard(5, store[:STORE_SIZE]))
        # Its flash is written faster than an EEPROM, so noise and phases are others.
        alike = (
            module.noticed == core.noticed
            and (module.safe_s is None) == (core.safe_s is None)
            and (module.safe_s or 0.0) == pytest.approx(core.safe_s or 0.0, abs=0.15)
            and module.peak_psi == pytest.approx(core.peak_psi, abs=0.5)
            and module.moved_cm == pytest.approx(core.moved_cm, abs=0.3)
            and module.recovers == core.recovers
        )
        if not alike:
            different.append((failure.name, core, module))
    assert different == []


def test_hello_telemetry_a_sweep_and_a_stop_on_the_cortex_m3(bench: Make) -> None:
    robot = bench("cortex-m3")
    assert robot.client.hello.board is wire.BoardKind.CORTEX_M3
    robot.press()
    robot.robot.vent()
    robot.robot.wait(1.0)
    robot.robot.sweep({"left": 12.0, "right": 8.0}, period_s=2.0)
    robot.client.stop()
    robot.transport.pass_time(0.1)  # the air enables' longest hold is 60 ms
    assert robot.airless
    assert robot.board.running


def test_an_encoder_whose_signals_jump_is_a_stall(bench: Make) -> None:
    robot = bench()
    robot.robot.wait(0.3)
    robot.robot.confirm_length(51.5, settled=True)
    robot.robot.select_body_pressure(2)
    robot.robot.arm()
    robot.client.request(wire.GrowTo(530_000, 0))
    robot.transport.pass_time(0.3)
    assert robot.board.motor > 0
    robot.board.set_encoder_errors(60)
    robot.transport.pass_time(0.1)
    assert robot.board.braked
    assert robot.client.request(wire.GetStatus()).faults & wire.Fault.SPOOL_STALL.mask


def test_a_loop_that_hangs_is_restarted_by_the_watchdog(bench: Make) -> None:
    robot = bench()
    robot.press()
    robot.board.hang()
    robot.transport.pass_time(0.3)
    assert robot.airless
    robot.transport.pass_time(1.0)
    assert robot.board.boots == 2


def test_a_collecting_python_changes_no_byte_of_telemetry(bench: Make) -> None:
    """Garbage collection over and over, beside the controller."""
    collects = """import gc
from main import board
hog = [[i] for i in range(500)]
while True: gc.collect()
"""
    said = []
    for program in (None, collects):
        board = bench(program=program).board
        board.step(2000)
        said.append(board.read())
    assert len(said[0]) > 50
    assert said[0] == said[1]


@pytest.mark.parametrize("cut", [0, 3, 500, 4095, 4096, 4100, 4500, 10**6])
def test_a_power_cut_in_a_save_keeps_a_whole_configuration_and_the_stop(
    bench: Make, cut: int
) -> None:
    robot = bench()
    robot.robot.wait(0.3)
    client, board = robot.client, robot.board
    before = client.request(wire.GetParameter(40)).value
    client.stop()
    nonce = client.request(wire.GetStatus()).stop_nonce
    client.request(wire.SetParameter(40, before + 1))
    client.request(wire.ApplyParameters())
    board.cut_power_after(cut)
    with suppress(LinkError):  # nobody answers
        client.request(wire.SaveConfig())
    assert board.powered == (cut == 10**6)
    assert robot.airless
    # The supply sags for so short that RAM holds: the stop must hold as well.
    board.reset(ResetCause.BROWN_OUT)
    robot.transport.pass_time(1.5)
    again = Client(robot.transport)
    assert again.hello.reset_cause is ResetCause.BROWN_OUT
    status = again.request(wire.GetStatus())
    kept = again.request(wire.GetParameter(40)).value
    assert kept == before + 1 if cut == 10**6 else kept in (before, before + 1)
    assert status.config_generation != 0
    assert status.stop_nonce == nonce
    assert not status.faults & wire.Fault.BAD_CONFIG.mask


def test_an_armed_robot_writes_no_flash(bench: Make) -> None:
    robot = bench()
    robot.press()
    _ = robot.board.eeprom
    erased = robot.board.erasures
    kept = robot.board.eeprom
    with pytest.raises(CommandRefusedError):
        robot.client.request(wire.SaveConfig())
    robot.robot.wait(0.5)
    assert robot.board.eeprom == kept
    assert robot.board.erasures == erased
