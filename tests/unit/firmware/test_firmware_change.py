"""A change of parameters takes a while: what falls into it finds all of it done, or nothing."""

from __future__ import annotations

import pytest
from firmware_bench import STEP_MS, Bench

from thigmo.link import protocol as wire
from thigmo.link.framing import encode

A = wire.Activity
S = wire.State
R = wire.Reason
# Parameters from which most constants follow, those of the first and of the last index among them.
CHANGED = {
    "counts_per_m": 40_000,
    "payout_q8": 256,
    "slip_um": 4_000,
    "line_speed_um_s": 40_000,
    "speed_margin_duty": 800,
    "motor_stall_n": 70,
    "line_rating_n": 90,
    "brake_closes_ms": 35,
}
STEPS = 24  # longer than the change takes


def changing(steps: int) -> Bench:
    """A board some control steps after it was told to change parameters."""
    bench = Bench().prepare()
    bench.do(wire.Disarm())
    for name, value in CHANGED.items():
        bench.stage(name, value)
    bench.seq += 1
    bench.send(wire.ApplyParameters(), bench.seq, bench.session)
    bench.step(steps * STEP_MS)
    return bench


def held(bench: Bench) -> dict[str, int]:
    return {
        name: bench.get(wire.GetParameter(wire.PARAMETERS[name].index), wire.ParameterValue).value
        for name in CHANGED
    }


def counts_of_a_move(bench: Bench) -> float:
    """Counts that the spool turns for 2 cm of growth."""
    bench.do(wire.ConfirmLength(100_000, 1))
    bench.do(wire.Arm())
    before = bench.spool.shown
    bench.do(wire.GrowTo(120_000, 0))
    bench.until(lambda: bench.ended(A.GROWING))
    return bench.spool.shown - before


@pytest.fixture(scope="module")
def undisturbed() -> float:
    bench = changing(40)
    return counts_of_a_move(bench)


def test_a_change_takes_one_step_for_each_parameter_and_part() -> None:
    for steps in range(1, 60):
        bench = changing(steps)
        if any(isinstance(h.message, wire.Ack) and h.seq == bench.seq for h in bench.heard):
            break
    assert len(CHANGED) < steps <= STEPS


@pytest.mark.parametrize("steps", range(0, STEPS, 3))
def test_a_stop_within_a_change_drives_nothing_and_the_change_is_whole(
    steps: int, undisturbed: float
) -> None:
    bench = changing(steps)
    bench.board.write(encode(wire.Stop(7), 0, 0))
    for _ in range(STEPS):
        bench.step()
        assert bench.safe()
    status = bench.status()
    assert (status.state, status.activity) == (S.FAULT, A.IDLE)
    assert held(bench) == CHANGED
    bench.do(wire.ClearStop(7))
    assert counts_of_a_move(bench) == pytest.approx(undisturbed, abs=3)


@pytest.mark.parametrize("steps", range(0, STEPS, 3))
def test_a_fault_within_a_change_leaves_it_whole(steps: int, undisturbed: float) -> None:
    bench = changing(steps)
    bench.board.set_estop(True)
    for _ in range(STEPS):
        bench.step()
        assert bench.safe()
    bench.board.set_estop(False)
    bench.step()
    assert held(bench) == CHANGED
    assert bench.do(wire.ClearFaults(0xFFFF)) == 0
    assert counts_of_a_move(bench) == pytest.approx(undisturbed, abs=3)


@pytest.mark.parametrize("steps", range(0, STEPS, 3))
def test_another_host_finds_a_change_whole_and_arms_nothing_before(
    steps: int, undisturbed: float
) -> None:
    bench = changing(steps)
    bench.nonce += 1
    bench.seq = bench.beats = bench.session = 0
    hello = wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH, bench.nonce)
    bench.session = bench.get(hello, wire.HelloReply).session
    bench.beat()
    early = bench.ask(wire.Arm())
    assert isinstance(early, wire.Ack)
    assert early.reason in (R.BUSY, R.NONE)
    if early.reason is R.NONE:
        assert bench.status().activity is not A.SAVING
        bench.do(wire.Disarm())
    assert bench.safe()
    bench.step(STEPS * STEP_MS)
    assert held(bench) == CHANGED
    assert counts_of_a_move(bench) == pytest.approx(undisturbed, abs=3)


def test_nothing_is_armed_while_another_hosts_configuration_is_stored() -> None:
    bench = Bench().prepare()
    bench.do(wire.Disarm())
    bench.stage("settle_ms", 4321)
    bench.do(wire.ApplyParameters())
    bench.seq += 1
    bench.send(wire.SaveConfig(), bench.seq, bench.session)
    bench.step()
    bench.nonce += 1
    bench.seq = bench.beats = bench.session = 0
    hello = wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH, bench.nonce)
    bench.session = bench.get(hello, wire.HelloReply).session
    bench.beat()
    assert bench.status().activity is A.SAVING
    assert bench.refused(wire.Arm()) == R.BUSY
    bench.until(lambda: bench.status().activity is A.IDLE)
    bench.do(wire.Arm())
