"""`stop`, the unsequenced datagram: obeyed in every state and activity, by every board."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from firmware_bench import Bench

from thigmo.emulator import mega_build
from thigmo.link import protocol as wire
from thigmo.link.framing import encode

A = wire.Activity
S = wire.State
STOP = encode(wire.Stop(0xDEAD), 77, 0x1234)  # of nobody's session, out of any sequence
BYTE_US = 40  # at 250 kbaud


def boot(bench: Bench) -> None:
    bench.until(lambda: any(isinstance(h.message, wire.Announce) for h in bench.heard))


def safe(bench: Bench) -> None:
    bench.prepare()
    bench.do(wire.Disarm())


def growing(bench: Bench) -> None:
    bench.grown()
    bench.grow(300_000)


def retracting(bench: Bench) -> None:
    bench.grown(300_000)
    bench.do(wire.RetractTo(100_000, 0))
    bench.until(lambda: bench.board.motor < -120)


def homing(bench: Bench) -> None:
    bench.grown(300_000)
    bench.do(wire.Home())
    bench.until(lambda: bench.board.motor < -60)


def sweeping(bench: Bench) -> None:
    bench.zeroed(trigger_e5=10_000)
    bench.bend()


def pressing(bench: Bench) -> None:
    bench.zeroed(trigger_e5=10_000)
    bench.do(wire.SetPressure((0, 1200), 0))
    bench.until(lambda: bench.air.psi[1] > 10)


def zeroing(bench: Bench) -> None:
    bench.grown()
    bench.do(wire.ZeroSensors(bench.status().everted_mask))


def holding(bench: Bench) -> None:
    bench.zeroed()
    bench.body = lambda left, right: -0.003 * max(0.0, left - 8.0)
    bench.do(wire.Sweep((1500, 0), 8000, 1, wire.SweepOption.HOLD_ON_CONTACT.mask))
    bench.until(lambda: bench.status().activity is A.HOLDING)


def saving(bench: Bench) -> None:
    safe(bench)
    bench.stage("settle_ms", 4321)
    bench.do(wire.ApplyParameters())
    bench.seq += 1
    bench.send(wire.SaveConfig(), bench.seq, bench.session)
    bench.step(100)


def under_test(output: wire.Output, level: int) -> Callable[[Bench], None]:
    def begin(bench: Bench) -> None:
        bench.prepare()
        bench.do(wire.TestOutput(output, 0, level, 500))

    return begin


# How it gets there; its state; its activity; whether something is energised then.
SITUATIONS = {
    "boot": (boot, S.BOOT, A.IDLE, False),
    "fault": (Bench.hello, S.FAULT, A.IDLE, False),
    "safe": (safe, S.SAFE, A.IDLE, False),
    "ready": (Bench.prepare, S.READY, A.IDLE, False),
    "growing": (growing, S.MOVING, A.GROWING, True),
    "retracting": (retracting, S.MOVING, A.RETRACTING, True),
    "homing": (homing, S.MOVING, A.HOMING, True),
    "sweeping": (sweeping, S.MOVING, A.SWEEPING, True),
    "pressing": (pressing, S.MOVING, A.PRESSING, True),
    "zeroing": (zeroing, S.MOVING, A.ZEROING, False),
    "holding": (holding, S.MOVING, A.HOLDING, True),
    "saving": (saving, S.SAFE, A.SAVING, False),
    "testing a valve": (under_test(wire.Output.TRANSDUCER, 336), S.MOVING, A.TESTING, True),
    "testing the motor": (under_test(wire.Output.MOTOR, -150), S.MOVING, A.TESTING, True),
}


@pytest.fixture(params=[False, pytest.param(True, marks=[pytest.mark.sim, pytest.mark.mega])])
def bench(request: pytest.FixtureRequest) -> Bench:
    """A virtual board; then the Mega's image."""
    if request.param and (reason := mega_build.missing()):
        pytest.skip(f"simulated Mega: {reason}")
    return Bench(mega=request.param)


def test_every_state_and_activity_is_among_the_situations() -> None:
    assert {state for _, state, _, _ in SITUATIONS.values()} == set(S)
    assert {activity for _, _, activity, _ in SITUATIONS.values()} == set(A)


@pytest.mark.parametrize("situation", SITUATIONS)
def test_a_stop_is_obeyed_within_two_ticks_of_its_last_byte(situation: str, bench: Bench) -> None:
    begin, state, activity, energised = SITUATIONS[situation]
    begin(bench)
    if state is not S.BOOT and activity is not A.SAVING:  # which answers when it has saved
        status = bench.status()
        assert (status.state, status.activity) == (state, activity)
    bench.until(lambda: bench.safe() != energised)  # homing is slow: the motor turns in steps
    bench.board.write(STOP)
    bench.board.step(len(STOP) * BYTE_US // 1000 + 2)
    assert bench.safe()
    bench.listen()
    for _ in range(100):
        bench.step()
        assert bench.safe()
    echo = [h.message for h in bench.heard if isinstance(h.message, wire.Stopped)]
    assert echo == [wire.Stopped(0xDEAD)]
    if not bench.session:
        bench.hello()
    if activity is A.SAVING:  # which goes on: the store is whole
        bench.until(lambda: bool(bench.event(wire.EventCode.SAVED)))
    status = bench.status()
    assert (status.state, status.activity) == (S.FAULT, A.IDLE)
    assert status.faults & wire.Fault.STOPPED.mask
    assert status.stop_nonce == 0xDEAD
    aborted = {e.arg: e.value for e in bench.event(wire.EventCode.ACTIVITY_ABORTED)}
    ended = activity not in (A.IDLE, A.SAVING)
    assert aborted == ({activity: wire.Reason.FAULT_LATCHED} if ended else {})
    press = wire.SetPressure((500, 0), 0)
    for command in (wire.Arm(), wire.Home(), wire.GrowTo(200_000, 0), press):
        assert bench.refused(command) == wire.Reason.FAULT_LATCHED
    assert bench.safe()
    bench.do(wire.ClearStop(0xDEAD))
    bench.do(wire.ClearFaults(0xFFFF))
    bench.step(20)
    assert bench.safe()
    assert bench.status().state in (S.SAFE, S.FAULT), "nothing goes on by itself"
