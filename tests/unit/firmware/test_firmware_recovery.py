"""No state is left that only a reset ends: after every fault there is, and after all of them at
once, the robot grows again by commands alone, once the causes are gone."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from firmware_bench import Bench, pressure_count

from thigmo.link import protocol as wire

F = wire.Fault
Provoke = Callable[[Bench], None]


def host_silent(bench: Bench) -> None:
    bench.grow()
    bench.beating = False


def over_pressure(bench: Bench) -> None:
    bench.bend()
    bench.override[10] = pressure_count(25.0)


def pressure_wire(bench: Bench) -> None:
    bench.override[11] = 0.0


def pressure_stuck(bench: Bench) -> None:
    bench.bend()
    bench.air.stuck[0] = True


def pressure_mismatch(bench: Bench) -> None:
    bench.sensor = lambda true: 0.75 * true
    bench.do(wire.SetPressure((1500, 0), 0))


def flex_open(bench: Bench) -> None:
    bench.override[0] = 0.0


def flex_short(bench: Bench) -> None:
    bench.override[5] = 1023.0


def spool_stall(bench: Bench) -> None:
    bench.grow()
    bench.spool.jammed = True


def spool_slip(bench: Bench) -> None:
    bench.spool.pull = 400.0


def brown_out(bench: Bench) -> None:
    bench.board.set_supply_mv(4000)


def watchdog(bench: Bench) -> None:
    bench.grow()
    bench.board.hang()
    bench.until(lambda: bench.board.boots == 2)
    bench.heard.clear()
    bench.hello()


def bad_config(bench: Bench) -> None:
    bench.board.cut_power_after(50)  # in the board's first save
    bench.send(wire.SaveConfig(), bench.seq + 1, bench.session)
    bench.until(lambda: not bench.board.powered)
    bench.board.reset(wire.ResetCause.POWER_ON)
    bench.heard.clear()
    bench.hello()


def estop(bench: Bench) -> None:
    bench.grow()
    bench.board.set_estop(True)


def interlock(bench: Bench) -> None:
    bench.bend()
    bench.spool.pull = 400.0


def link_overrun(bench: Bench) -> None:
    bench.board.stall(30)
    bench.board.write(bytes(400))
    bench.step(100)


def stopped(bench: Bench) -> None:
    bench.grow()
    bench.send(wire.Stop(7), 0, 0)


PROVOKE: dict[wire.Fault, Provoke] = {fault: globals()[fault.key] for fault in F}


def restore(bench: Bench) -> None:
    """The causes go."""
    bench.beating = True
    bench.override.clear()
    bench.air.stuck = [False, False]
    bench.sensor = lambda true: true
    bench.spool.jammed = False
    bench.spool.pull = 0.0
    bench.board.set_supply_mv(5000)
    bench.board.set_estop(False)
    bench.step(3000)


def grows_again(bench: Bench) -> None:
    """By what an operator can command."""
    bench.do(wire.Disarm())
    bench.do(wire.ClearStop(bench.status().stop_nonce))
    if F.BAD_CONFIG in bench.faults():
        bench.do(wire.LoadDefaults())
        bench.do(wire.SaveConfig(), 10_000)
    assert bench.do(wire.ClearFaults(0xFFFF)) == 0
    bench.do(wire.Arm())
    bench.do(wire.ConfirmLength(100_000, 1))
    bench.events.clear()
    bench.do(wire.GrowTo(110_000, 0))
    bench.until(lambda: bool(bench.event(wire.EventCode.ACTIVITY_DONE, wire.Activity.GROWING)))


@pytest.mark.parametrize("fault", list(F), ids=lambda fault: fault.key)
def test_every_fault_is_left_by_commands_alone(fault: wire.Fault) -> None:
    bench = Bench()
    bench.zeroed(trigger_e5=10_000)
    PROVOKE[fault](bench)
    bench.until(lambda: bool(bench.status().faults & fault.mask))
    assert bench.safe()
    boots = bench.board.boots
    restore(bench)
    grows_again(bench)
    assert bench.board.boots == boots


def test_many_faults_at_once_are_left_by_commands_alone() -> None:
    bench = Bench()
    bench.zeroed(trigger_e5=10_000)
    interlock(bench)
    for provoke in (pressure_wire, flex_open, flex_short, brown_out, link_overrun):
        provoke(bench)
    bench.board.set_estop(True)
    bench.send(wire.Stop(9), 0, 0)
    bench.step(1000)
    bench.beating = False
    bench.step(1000)
    assert len(bench.faults()) >= 8
    restore(bench)
    grows_again(bench)
    assert bench.board.boots == 1
