"""Every fault and every interlock, provoked through hand-made inputs: named, safe at once, latched,
and cleared only when its cause is gone. None leaves a state that only a reset ends: the robot then
grows again by commands alone."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

import pytest
from firmware_bench import Bench, FlowingAir, pressure_count

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.board import EmulatedBoard
from thigmo.link import protocol as wire
from thigmo.link.framing import encode

F = wire.Fault
R = wire.Reason
SWEEP = wire.Sweep((1000, 1000), 10_000, 1, 0)
PRESS = wire.SetPressure((500, 0), 0)


def bending() -> Bench:
    """A robot in the middle of a sweep, 10 psi in the left muscle."""
    bench = Bench().zeroed(trigger_e5=10_000)
    bench.bend()
    assert bench.board.drive_enabled == (True, False)
    return bench


def growing() -> Bench:
    """A robot in the middle of growth."""
    bench = Bench().zeroed()
    bench.grow()
    return bench


def expect(bench: Bench, fault: wire.Fault, ms: int, value: int | None = None) -> None:
    """The fault latches within a time, everything is safe, its event says so, and it stays."""
    bench.until(lambda: bool(bench.event(wire.EventCode.FAULT, fault)), ms)
    assert bench.safe()
    if value is not None:
        assert bench.event(wire.EventCode.FAULT, fault)[0].value == value
    length = bench.spool.counts
    bench.step(500)
    assert bench.safe()
    assert bench.spool.counts >= length - 1  # never a retraction
    status = bench.status()
    assert status.state == wire.State.FAULT
    assert status.faults & fault.mask
    assert status.activity == wire.Activity.IDLE
    assert len(bench.event(wire.EventCode.FAULT, fault)) == 1
    if not bench.board.boots > 1:
        aborted = bench.event(wire.EventCode.ACTIVITY_ABORTED)
        assert [e.value for e in aborted] == [R.FAULT_LATCHED]
    for command in (wire.Arm(), wire.Home(), wire.GrowTo(200_000, 0), SWEEP):
        assert bench.refused(command) == R.FAULT_LATCHED
    assert bench.safe()


def recover(bench: Bench) -> None:
    """The cause is gone: the robot grows again, by what an operator can command."""
    boots = bench.board.boots
    bench.step(3000)  # until the muscles are empty
    bench.do(wire.Disarm())
    bench.do(wire.ClearStop(bench.status().stop_nonce))
    if F.BAD_CONFIG in bench.faults():
        bench.do(wire.LoadDefaults())
        bench.do(wire.SaveConfig(), 10_000)
    assert bench.do(wire.ClearFaults(0xFFFF)) == 0
    assert bench.status().state == wire.State.SAFE
    assert bench.safe()
    bench.do(wire.Arm())
    assert bench.status().state == wire.State.READY
    bench.do(wire.ConfirmLength(100_000, 1))
    bench.events.clear()
    bench.do(wire.GrowTo(110_000, 0))
    bench.until(lambda: bench.ended(wire.Activity.GROWING))
    assert bench.board.boots == boots


def persists(bench: Bench, fault: wire.Fault) -> None:
    """Clearing is in vain while the cause lasts."""
    assert bench.do(wire.ClearFaults(0xFFFF)) & fault.mask
    assert bench.status().state == wire.State.FAULT


# --- faults --------------------------------------------------------------------------------------


def be_silent(bench: Bench) -> None:
    bench.beating = False


def channel(number: int, count: float) -> Callable[[Bench], None]:
    """An analog input that stands at a count."""
    return lambda bench: bench.override.update({number: count})


def stick(bench: Bench) -> None:
    bench.air.stuck[0] = True


def jam(bench: Bench) -> None:
    bench.spool.jammed = True


def pull(bench: Bench) -> None:
    bench.spool.pull = 400.0


def tear(bench: Bench) -> None:
    bench.spool.pull = 800.0  # 5 cm/s of the tip, whose profile runs at 2
    bench.spool.speed = 2000.0  # a jerk; the loop brakes, and the brake does not hold


def sag(bench: Bench) -> None:
    bench.board.set_supply_mv(4200)


def press_emergency_stop(bench: Bench) -> None:
    bench.board.set_estop(True)


def stop(bench: Bench) -> None:
    bench.send(wire.Stop(7), 0, 0)


def overrun(bench: Bench) -> None:
    bench.board.stall(30)  # while 400 bytes come
    bench.board.write(bytes(400))
    bench.step(40)


@dataclass(frozen=True)
class Cause:
    """A fault's cause, and what comes of it."""

    fault: wire.Fault
    busy: Callable[[], Bench]
    provoke: Callable[[Bench], None]
    within_ms: tuple[int, int]  # the outputs are off: not before, and not after
    value: int | None = None  # of the event
    lasts: bool = True  # until it is taken away
    consequences: tuple[wire.Fault, ...] = ()


CAUSES = {
    "silent in a sweep": Cause(F.HOST_SILENT, bending, be_silent, (380, 520)),  # 0.5 s after a beat
    "silent in growth": Cause(F.HOST_SILENT, growing, be_silent, (380, 520)),
    "25 psi": Cause(F.OVER_PRESSURE, bending, channel(10, pressure_count(25.0)), (0, 60), 0),
    "left wire": Cause(F.PRESSURE_WIRE, bending, channel(10, 0.0), (0, 25), 0),
    "right wire": Cause(F.PRESSURE_WIRE, bending, channel(11, 0.0), (0, 25), 1),
    "shorted wire": Cause(F.PRESSURE_WIRE, bending, channel(10, 1023.0), (0, 25), 0),
    "no air": Cause(
        F.PRESSURE_STUCK, bending, stick, (0, 6000), 0, consequences=(F.PRESSURE_MISMATCH,)
    ),
    **{
        f"sensor {sensor} {fault.key}": Cause(
            fault, bending, channel(sensor, count), (0, 100), sensor
        )
        for sensor in (0, 3, 5, 9)
        for fault, count in ((F.FLEX_OPEN, 0.0), (F.FLEX_SHORT, 1023.0))
    },
    "jam": Cause(F.SPOOL_STALL, growing, jam, (100, 400), lasts=False),  # 3 mm of the profile
    "slip in a sweep": Cause(F.SPOOL_SLIP, bending, pull, (0, 1500), lasts=False),
    "slip in growth": Cause(F.SPOOL_SLIP, growing, tear, (0, 1500), lasts=False),
    "4.2 V": Cause(F.BROWN_OUT, bending, sag, (0, 50), 4200),
    "emergency stop in a sweep": Cause(F.ESTOP, bending, press_emergency_stop, (0, 5)),
    "emergency stop in growth": Cause(F.ESTOP, growing, press_emergency_stop, (0, 5)),
    "stop": Cause(F.STOPPED, growing, stop, (0, 5), 7),
    "overrun": Cause(F.LINK_OVERRUN, bending, overrun, (0, 100), lasts=False),
}
ELSEWHERE = {F.PRESSURE_MISMATCH, F.WATCHDOG, F.BAD_CONFIG, F.INTERLOCK}  # in tests of their own


def restore(bench: Bench) -> None:
    """The causes go."""
    bench.beating = True
    bench.override.clear()
    bench.air.stuck = [False, False]
    bench.spool.jammed = False
    bench.spool.pull = 0.0
    bench.board.set_supply_mv(5000)
    bench.board.set_estop(False)


def test_every_fault_has_a_cause_here() -> None:
    assert {cause.fault for cause in CAUSES.values()} | ELSEWHERE == set(F)


@pytest.mark.parametrize("name", CAUSES)
def test_a_fault_is_named_and_safe_and_left_by_commands_alone(name: str) -> None:
    cause = CAUSES[name]
    bench = cause.busy()
    start = bench.board.now_us
    cause.provoke(bench)
    bench.until(bench.safe, 10_000)
    earliest, latest = cause.within_ms
    assert 1000 * earliest <= bench.board.now_us - start <= 1000 * latest
    expect(bench, cause.fault, max(100, latest), cause.value)
    assert set(bench.faults()) == {cause.fault, *cause.consequences}
    moves = cause.fault in (F.SPOOL_STALL, F.SPOOL_SLIP)
    assert bool(bench.status().conditions & wire.Condition.LENGTH_KNOWN.mask) is not moves
    if cause.lasts:
        persists(bench, cause.fault)
    if cause.fault is F.LINK_OVERRUN:
        assert 100 < bench.get(wire.GetLinkStats(), wire.LinkStats).rx_overruns < 500
    restore(bench)
    recover(bench)


def test_many_faults_at_once_are_left_by_commands_alone() -> None:
    bench = bending()
    for provoke in (pull, channel(11, 0.0), channel(0, 0.0), channel(5, 1023.0), sag, overrun):
        provoke(bench)
    press_emergency_stop(bench)
    stop(bench)
    bench.step(1000)
    bench.beating = False
    bench.step(1000)
    assert len(bench.faults()) >= 8
    restore(bench)
    recover(bench)


def test_a_silent_host_is_a_fault_while_armed_and_none_while_safe() -> None:
    bench = Bench().zeroed()
    bench.beating = False
    bench.step(1000)
    assert bench.faults() == (F.HOST_SILENT,)
    bench.beating = True
    bench.step(200)
    bench.do(wire.ClearFaults(0xFFFF))
    bench.beating = False
    bench.step(5000)
    assert bench.faults() == ()
    assert bench.status().state == wire.State.SAFE
    assert bench.refused(wire.Arm()) == R.HOST_SILENT  # arming needs a beat
    bench.beating = True
    bench.step(200)
    bench.do(wire.Arm())


@pytest.mark.parametrize("pull", [100.0, 400.0, 800.0])
def test_a_tail_that_overruns_the_spool_does_not_restart_the_dead_man(pull: float) -> None:
    """The output then alternates between brake and drive, as the body's air pulls."""
    bench = growing()
    bench.spool.pull = pull  # counts/s, whenever the loop brakes
    bench.beating = False
    start = bench.board.now_us
    bench.until(lambda: bool(bench.event(wire.EventCode.FAULT, F.HOST_SILENT)), 1000)
    assert bench.safe()
    assert bench.board.now_us - start < 520_000


@pytest.mark.parametrize("heartbeat_ms", [150, 500])
@pytest.mark.parametrize("name", ["spool_speed_um_s", "home_speed_um_s"])
def test_a_speed_that_outruns_the_heartbeat_is_not_applied(name: str, heartbeat_ms: int) -> None:
    top = 17_000_000 // (max(heartbeat_ms, 285) + 100)  # the watchdog needs as long
    bench = Bench().prepare(heartbeat_ms=heartbeat_ms)
    bench.stage(name, top + 1)
    ack = bench.ask(wire.ApplyParameters())
    assert isinstance(ack, wire.Ack)
    assert (ack.reason, ack.detail) == (R.CONTRADICTION, wire.PARAMETERS[name].index)
    bench.stage(name, top)
    bench.do(wire.ApplyParameters())


def test_a_replayed_heartbeat_keeps_nobody_alive() -> None:
    bench = bending()
    bench.beating = False
    old = encode(wire.Heartbeat(bench.beats), 0, bench.session)
    for _ in range(20):
        bench.board.write(old)
        bench.step(50)
    assert F.HOST_SILENT in bench.faults()
    assert bench.safe()


def frozen_at(psi: float) -> Callable[[float], float]:
    """A sensor that follows up to a pressure and no further."""
    return lambda true: min(true, psi)


@pytest.mark.parametrize(
    ("sensor", "asked_psi", "most_psi"),
    [
        (frozen_at(17.0), 18.0, 20.0),
        (frozen_at(17.0), 18.5, 20.0),
        (frozen_at(9.5), 11.0, 18.0),
        (lambda true: 0.9 * true, 18.5, 20.0),
        (lambda true: 0.75 * true, 12.0, 17.0),
        (frozen_at(0.4), 2.3, 9.0),
        (lambda true: true - 3.0 if true > 4 else true, 14.0, 19.0),
    ],
    ids=[
        "17 of 18",
        "17 of 18.5",
        "9.5 of 11",
        "gain of 0.9",
        "gain of 0.75",
        "0.4 of 2.3",
        "offset",
    ],
)
def test_a_pressure_sensor_that_lies_is_found_by_the_transducers_current(
    sensor: Callable[[float], float], asked_psi: float, most_psi: float
) -> None:
    bench = Bench().zeroed(trigger_e5=10_000)
    bench.sensor = sensor
    bench.do(wire.SetPressure((round(100 * asked_psi), 0), 0))
    assert bench.highest_psi(8000) <= most_psi
    expect(bench, F.PRESSURE_MISMATCH, 100, value=0)
    assert F.OVER_PRESSURE not in bench.faults()
    bench.sensor = lambda true: true
    recover(bench)


def noticed(bench: Bench, *faults: wire.Fault) -> None:
    """One of these faults is latched, the outputs are off, and the robot can be used again."""
    assert set(bench.faults()) & set(faults), bench.faults()
    assert bench.safe()
    bench.sensor = lambda true: true
    bench.override.clear()
    recover(bench)


@pytest.mark.parametrize("begins", ["from the start", "under pressure"])
@pytest.mark.parametrize("period_ms", [500, 900, 1400])
@pytest.mark.parametrize("most_psi", [2.0, 4.0, 9.0, 16.0])
def test_a_pressure_sensor_that_is_true_for_moments_only_is_noticed(
    most_psi: float, period_ms: int, begins: str
) -> None:
    bench = Bench().zeroed(trigger_e5=10_000)

    def flickering(true: float) -> float:
        return true if bench.board.now_us // 1000 % period_ms < 15 else min(true, most_psi)

    if begins == "from the start":
        bench.sensor = flickering
    bench.do(wire.SetPressure((1800, 0), 0))
    if begins == "under pressure":
        bench.step(6000)
        bench.sensor = flickering
    assert bench.highest_psi(10_000) <= 20.0
    noticed(bench, F.PRESSURE_STUCK, F.PRESSURE_MISMATCH)


@pytest.mark.parametrize("share", [0.35, 0.5, 0.65])
@pytest.mark.parametrize("count", [0.0, 1023.0])
def test_a_pressure_wire_that_chatters_is_noticed(count: float, share: float) -> None:
    bench = Bench().zeroed(trigger_e5=10_000)
    chance = random.Random(7)
    bench.do(wire.SetPressure((1800, 0), 0))
    for _ in range(400):
        bench.override = {10: count} if chance.random() < share else {}
        bench.step()
    noticed(bench, F.PRESSURE_WIRE)


def test_a_pressure_above_its_limit_for_moments_only_is_noticed() -> None:
    bench = Bench().zeroed(trigger_e5=10_000)
    bench.do(wire.SetPressure((1500, 0), 0))
    bench.step(4000)
    for _ in range(20):
        bench.override = {10: pressure_count(26.0)}
        bench.step(10)
        bench.override = {}
        bench.step(700)
    noticed(bench, F.OVER_PRESSURE)


@pytest.mark.parametrize("sensor", [0, 3])
def test_a_flex_sensor_whose_wire_chatters_is_named(sensor: int) -> None:
    bench = bending()
    chance = random.Random(8)
    for _ in range(400):
        bench.override = {sensor: 0.0} if chance.random() < 0.5 else {}
        bench.step()
    assert bench.event(wire.EventCode.FAULT, F.FLEX_OPEN)[0].value == sensor
    noticed(bench, F.FLEX_OPEN)


def test_a_jammed_spool_that_shows_a_count_now_and_then_is_a_stall() -> None:
    bench = Bench().grown(300_000)
    bench.do(wire.RetractTo(100_000, 0))
    bench.until(lambda: bench.board.motor < -120)
    bench.spool.jammed = True
    for _ in range(4):
        bench.step(350)
        bench.spool.shown -= 1.0
    assert bench.faults() == (F.SPOOL_STALL,)
    assert bench.safe()


# --- what permitted a motion, lost ---------------------------------------------------------------


def retracting() -> Bench:
    bench = Bench().grown(300_000)
    bench.do(wire.RetractTo(100_000, 0))
    bench.until(lambda: bench.board.motor < -120)
    return bench


def homing() -> Bench:
    bench = Bench().grown(300_000)
    bench.do(wire.Home())
    bench.until(lambda: bench.board.motor < -60)
    return bench


def with_the_motor_under_test() -> Bench:
    bench = Bench().prepare()
    bench.do(wire.TestOutput(wire.Output.MOTOR, 0, 150, 500))
    bench.until(lambda: bench.board.motor > 0)
    return bench


@pytest.mark.parametrize("begin", [growing, retracting, homing, with_the_motor_under_test])
@pytest.mark.parametrize("psi", [0.6, 0.9, 1.9, 5.0])
def test_a_muscle_that_fills_ends_what_needs_it_empty_within_100_ms(
    begin: Callable[[], Bench], psi: float
) -> None:
    bench = begin()
    bench.air.stuck[0], bench.air.psi[0] = True, psi
    start = bench.board.now_us
    bench.until(bench.safe, 1000)
    assert bench.board.now_us - start <= 100_000
    expect(bench, F.INTERLOCK, 100, value=R.NOT_VENTED)
    persists(bench, F.INTERLOCK)
    restore(bench)
    recover(bench)


@pytest.mark.parametrize("psi", [0.0, 0.3])
def test_an_empty_muscle_ends_no_motion(psi: float) -> None:
    bench = Bench(noise=2.0).zeroed()
    bench.grow(500_000)
    bench.air.stuck[0], bench.air.psi[0] = True, psi
    bench.until(lambda: bench.ended(wire.Activity.GROWING), 60_000)
    assert bench.faults() == ()


class SwappedAir(FlowingAir):
    """The plugs of the two pressure sensors, or of the two transducers, are swapped."""

    def step(self, board: EmulatedBoard, dt: float) -> None:
        self.psi.reverse()
        super().step(board, dt)
        self.psi.reverse()


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("command", ["press", "sweep"])
def test_swapped_pressure_plugs_press_no_muscle_beyond_the_proof(side: int, command: str) -> None:
    bench = Bench().zeroed(trigger_e5=10_000)
    bench.air = SwappedAir()
    psi = (1800, 0) if side == 0 else (0, 1800)
    bench.do(wire.SetPressure(psi, 0) if command == "press" else wire.Sweep(psi, 20_000, 1, 0))
    assert bench.highest_psi(8000) < 5.0
    assert F.PRESSURE_STUCK in bench.faults()


@pytest.mark.parametrize("pressure", [1800, 1000, 400])
def test_a_transducer_map_that_is_wrong_by_four_is_found_before_the_pressure_is_high(
    pressure: int,
) -> None:
    bench = Bench().zeroed(trigger_e5=10_000, drive_20ma_cpsi=1500)
    bench.do(wire.SetPressure((pressure, 0), 0))
    assert bench.highest_psi(8000) < 9.0
    assert F.PRESSURE_MISMATCH in bench.faults()


def test_a_channel_is_proven_once_in_an_armed_session_and_anew_in_the_next() -> None:
    bench = Bench().zeroed(trigger_e5=10_000)

    def rise_s(psi: float) -> float:
        for ms in range(0, 6000, 5):
            if bench.air.psi[0] > psi:
                return ms / 1000
            bench.step()
        raise AssertionError("it does not rise")

    bench.do(wire.SetPressure((1000, 0), 0))
    first = rise_s(9.0)
    bench.do(wire.Vent())
    bench.step(4000)
    bench.do(wire.SetPressure((1000, 0), 0))
    again = rise_s(9.0)
    assert 0.2 < first - again < 1.2
    bench.do(wire.Disarm())
    bench.step(4000)
    bench.do(wire.Arm())
    bench.do(wire.SetPressure((1000, 0), 0))
    assert rise_s(9.0) == pytest.approx(first, abs=0.05)


@pytest.mark.parametrize(("offset_psi", "gain"), [(-1.2, 1.02), (-1.2, 0.98), (0.2, 0.98), (0, 1)])
@pytest.mark.parametrize("asked_psi", [2.3, 6.0, 18.0])
def test_a_bring_up_without_calibration_is_no_fault(
    offset_psi: float, gain: float, asked_psi: float
) -> None:
    """Before zeroing the sensor is off by its error band, and the transducer by its gain."""
    bench = Bench()
    bench.air.gain = gain
    bench.sensor = lambda true: true + offset_psi
    bench.zeroed(trigger_e5=10_000)
    for _ in range(2):
        bench.do(wire.SetPressure((round(100 * asked_psi), 0), 0))
        bench.step(8000)
        bench.do(wire.SetPressure((0, 0), 0))
        bench.step(3000)
    assert bench.faults() == ()


@pytest.mark.parametrize("ended_by", ["fault", "stop"])
def test_the_integral_does_not_survive_a_fault_or_a_stop(ended_by: str) -> None:
    """Wound up while the air was away, it would overshoot when the air is back."""
    press = wire.SetPressure((500, 0), 0)

    def highest(bench: Bench) -> float:
        bench.do(press)
        return bench.highest_psi(4000)

    usual = highest(Bench().zeroed(trigger_e5=10_000))
    bench = Bench().zeroed(trigger_e5=10_000)
    bench.air.stuck[0] = True
    bench.do(press)
    if ended_by == "fault":
        bench.until(lambda: bool(bench.event(wire.EventCode.FAULT, F.PRESSURE_STUCK)))
    else:
        bench.step(1200)
        bench.do(wire.Disarm())
    bench.air.stuck[0] = False
    bench.step(3000)
    bench.do(wire.ClearFaults(0xFFFF))
    bench.do(wire.Arm())
    assert highest(bench) == pytest.approx(usual, abs=0.05)


@pytest.mark.parametrize(
    ("fault", "count", "flag"), [(F.FLEX_OPEN, 0.0, 8), (F.FLEX_SHORT, 1023.0, 16)]
)
def test_a_dead_sensor_is_named_and_then_ignored(
    fault: wire.Fault, count: float, flag: int
) -> None:
    bench = Bench()
    bench.override[3] = count
    bench.hello()
    bench.do(wire.LoadDefaults())
    assert fault in bench.faults()
    assert bench.get(wire.GetSensor(3), wire.SensorReport).flags & 0b11000 == flag
    assert bench.do(wire.ClearFaults(0xFFFF)) == fault.mask
    bench.set("flex_enabled", 0, element=3)
    assert bench.do(wire.ClearFaults(0xFFFF)) == 0


def test_an_encoder_whose_signals_jump_is_a_stall() -> None:
    bench = growing()
    for errors in range(1, 9):  # a few are no fault
        bench.board.set_encoder_errors(errors)
        bench.step(10)
    assert not bench.safe()
    bench.board.set_encoder_errors(60)
    expect(bench, F.SPOOL_STALL, 10, value=wire.StallCause.JUMPS)


def test_an_encoder_that_shows_half_of_the_way_is_a_stall() -> None:
    bench = growing()
    bench.until(lambda: bench.spool.speed > 250, 3000)
    bench.spool.share = 0.5
    expect(bench, F.SPOOL_STALL, 1500, value=wire.StallCause.SLOW)


def test_the_supply_is_told_and_scaled_by_the_chips_own_reference() -> None:
    """A chip whose reference is 1.2 V reads 4.5 V of 4.91: no brown-out, once it is calibrated."""
    bench = Bench().prepare()
    bench.board.set_supply_mv(4500)
    bench.step(50)
    assert bench.status().supply_mv == 4500
    bench.set("supply_min_mv", 4600)
    bench.step(50)
    assert bench.faults() == (F.BROWN_OUT,)
    bench.set("reference_mv", 1200)
    bench.step(50)
    assert bench.status().supply_mv == 4909
    assert bench.do(wire.ClearFaults(0xFFFF)) == 0


def test_watchdog() -> None:
    bench = bending()
    bench.board.hang()
    start = bench.board.now_us
    bench.until(bench.safe, 1000)
    assert bench.board.now_us - start < 300_000
    bench.until(lambda: bench.board.boots == 2, 2000)
    bench.heard.clear()
    bench.events.clear()
    reply = bench.hello()
    assert reply.reset_cause == wire.ResetCause.WATCHDOG
    expect(bench, F.WATCHDOG, 1000)
    assert not bench.status().conditions & wire.Condition.LENGTH_KNOWN.mask
    recover(bench)


@pytest.mark.parametrize("cause", [wire.ResetCause.BROWN_OUT, wire.ResetCause.EXTERNAL])
def test_reset_in_a_sweep(cause: wire.ResetCause) -> None:
    bench = bending()
    bench.board.reset(cause)
    assert bench.safe()
    bench.heard.clear()
    bench.events.clear()
    assert bench.hello().reset_cause == cause
    assert bench.safe()
    assert (F.BROWN_OUT in bench.faults()) == (cause == wire.ResetCause.BROWN_OUT)


RESETS = [cause for cause in wire.ResetCause if cause is not wire.ResetCause.UNKNOWN]


@pytest.mark.parametrize("cause", RESETS)
@pytest.mark.parametrize("name", ["25 psi", "left wire", "jam", "slip in growth", "4.2 V"])
def test_a_fault_outlives_every_reset_but_a_loss_of_power(
    name: str, cause: wire.ResetCause
) -> None:
    latched = CAUSES[name]
    bench = latched.busy()
    latched.provoke(bench)
    bench.until(lambda: bool(bench.event(wire.EventCode.FAULT, latched.fault)), 10_000)
    restore(bench)
    for _ in range(2):
        bench.board.reset(cause)
        bench.heard.clear()
        bench.events.clear()
        bench.hello()
        if cause is wire.ResetCause.POWER_ON:
            assert bench.faults() == (F.BAD_CONFIG,)  # nothing was saved
            return
        assert latched.fault in bench.faults()
        (event,) = bench.event(wire.EventCode.FAULT, latched.fault)
        assert event.value == (-1 if latched.fault.key != cause.key else 0)
        assert bench.refused(wire.Arm()) == R.FAULT_LATCHED
    recover(bench)
    bench.board.reset(cause)
    bench.heard.clear()
    bench.hello()
    assert latched.fault not in bench.faults() or latched.fault.key == cause.key


def test_half_everted_in_a_bend() -> None:
    # 1.2 cm short of the next sensor's keep-out; slip counts as such only beyond 3 cm.
    bench = Bench().zeroed(108_000, slip_um=30_000, trigger_e5=10_000)
    bench.do(wire.Sweep((1500, 0), 20_000, 1, 0))
    bench.until(lambda: bench.air.psi[0] > 10)
    bench.spool.pull = 140.0
    expect(bench, F.INTERLOCK, 3000, value=R.HALF_EVERTED)
    assert bench.status().conditions & wire.Condition.HALF_EVERTED.mask
    bench.spool.pull = 0.0
    recover(bench)


def test_a_short_stall_costs_no_control_step_and_a_longer_one_is_noted() -> None:
    bench = bending()
    bench.get(wire.GetLinkStats(), wire.LinkStats)
    frames = len([h for h in bench.heard if isinstance(h.message, wire.Telemetry)])
    bench.board.stall(3)
    bench.step(1000)
    after = len([h for h in bench.heard if isinstance(h.message, wire.Telemetry)])
    assert after - frames >= 195
    assert bench.status().state == wire.State.MOVING


def test_bad_configuration_after_a_cut_save() -> None:
    bench = Bench().prepare()
    bench.board.cut_power_after(200)
    bench.seq += 1
    bench.send(wire.SaveConfig(), bench.seq, bench.session)
    bench.until(lambda: not bench.board.powered, 3000)
    assert bench.safe()
    bench.board.reset(wire.ResetCause.POWER_ON)
    bench.heard.clear()
    bench.events.clear()
    bench.hello()
    assert bench.faults() == (F.BAD_CONFIG,)
    event = bench.event(wire.EventCode.FAULT, F.BAD_CONFIG)[0]
    assert event.value == wire.ConfigCause.INTERRUPTED
    assert bench.refused(wire.Arm()) == R.FAULT_LATCHED
    recover(bench)


def stored_twice() -> bytes:
    """A store of two configurations, the newer one for 10 psi and the older one for 18."""
    bench = Bench().prepare()
    for most in (1850, 1000):
        bench.set("max_pressure_cpsi", most)
        bench.do(wire.SaveConfig(), 10_000)
    return bench.board.eeprom


SLOTS = (16, 1032)  # firmware/core/config/store.h


@pytest.mark.parametrize("slot", SLOTS)
@pytest.mark.parametrize(("byte", "bit"), [(0, 0), (0, 5), (2, 1), (5, 7), (40, 3), (400, 6)])
def test_a_flipped_bit_of_the_store_refuses_arming_until_a_host_has_saved(
    slot: int, byte: int, bit: int
) -> None:
    store = bytearray(stored_twice())
    store[slot + byte] ^= 1 << bit
    bench = Bench(eeprom=bytes(store))
    bench.hello()
    assert bench.faults() == (F.BAD_CONFIG,)
    assert bench.event(wire.EventCode.FAULT, F.BAD_CONFIG)[0].value == wire.ConfigCause.DAMAGED
    bench.do(wire.LoadDefaults())  # of the board's memory: the store is as it was
    persists(bench, F.BAD_CONFIG)
    assert bench.refused(wire.Arm()) == R.FAULT_LATCHED
    bench.do(wire.SaveConfig(), 10_000)
    assert bench.do(wire.ClearFaults(0xFFFF)) == 0
    bench.do(wire.Arm())
    again = Bench(eeprom=bench.board.eeprom)
    again.hello()
    assert again.faults() == ()


# --- interlocks ----------------------------------------------------------------------------------


def test_not_vented() -> None:
    bench = Bench().zeroed()
    bench.do(wire.SetPressure((800, 0), 0))
    bench.step(2000)
    assert bench.refused(SWEEP) == R.BUSY
    bench.do(wire.Vent())
    for command in (SWEEP, wire.GrowTo(200_000, 0), wire.RetractTo(0, 0), wire.Home()):
        assert bench.refused(command) == R.NOT_VENTED
    assert bench.refused(wire.ZeroSensors(1)) == R.NOT_VENTED
    assert bench.refused(wire.ConfirmLength(0, 1)) == R.NOT_VENTED
    bench.step(3000)
    bench.do(SWEEP)


def test_not_settled_after_growth() -> None:
    bench = Bench().zeroed(settle_ms=5000)
    bench.do(wire.GrowTo(200_000, 25_000))
    bench.until(lambda: bench.ended(wire.Activity.GROWING))
    assert bench.refused(wire.ZeroSensors(0b0001000010)) == R.NOT_SETTLED
    assert bench.refused(SWEEP) == R.NOT_ZEROED
    left = bench.get(wire.GetSensor(1), wire.SensorReport).settle_left_ms
    assert 3000 < left < 5000
    bench.step(5000)
    bench.do(wire.ZeroSensors(0b0001100011))
    bench.until(lambda: len(bench.event(wire.EventCode.ZEROED)) == 2)
    bench.do(SWEEP)


def test_configuration_is_closed_while_something_runs() -> None:
    bench = bending()
    index = wire.PARAMETERS["trigger_e5"].index
    curve = (0,) * 11
    for command in (
        wire.SetParameter(index, 600),
        wire.SetMap(0, 0, wire.Branch.INFLATE, curve),
        wire.LoadDefaults(),
        wire.SaveConfig(),
        wire.SelectZone(1),
        wire.GrowTo(200_000, 0),
        wire.ZeroSensors(1),
    ):
        assert bench.refused(command) == R.BUSY, command


@pytest.mark.parametrize("limit_cpsi", [2000, 6000])
def test_no_sensor_makes_a_board_press_beyond_its_limit(limit_cpsi: int) -> None:
    """The thesis presses its muscles to 18 psi; 60 psi are compiled in."""
    bench = Bench().prepare(
        pressure_full_cpsi=10_000, over_pressure_cpsi=6500, max_pressure_cpsi=limit_cpsi
    )
    assert wire.PARAMETERS["max_pressure_cpsi"].high == 6000
    for name in ("max_pressure_cpsi", "over_pressure_cpsi"):
        entry = wire.PARAMETERS[name]
        assert bench.refused(wire.SetParameter(entry.index, entry.high + 1)) == R.BAD_VALUE
    bench.do(wire.ConfirmLength(100_000, 1))
    bench.do(wire.SelectZone(0))
    bench.do(wire.ZeroSensors(0b00001_00001))
    bench.until(lambda: bool(bench.event(wire.EventCode.ZEROED)))
    assert bench.refused(wire.SetPressure((limit_cpsi + 1, 0), 0)) == R.OVER_LIMIT
    bench.sensor = lambda true: 0.0  # whatever the sensor says
    bench.do(wire.SetPressure((limit_cpsi, 0), 0))
    assert bench.highest_psi(6000) < limit_cpsi / 100 + 1.1
    assert bench.safe()


def test_a_pressure_that_the_sensors_cannot_show_is_no_limit() -> None:
    """A muscle of 30 psi with a sensor of 30 psi would burst unseen."""
    bench = Bench().prepare()
    bench.stage("pressure_full_cpsi", 3000)
    bench.stage("over_pressure_cpsi", 3300)
    reply = bench.ask(wire.ApplyParameters())
    assert isinstance(reply, wire.Ack)
    named = wire.PARAMETERS["pressure_full_cpsi"].index
    assert (reply.reason, reply.detail) == (R.CONTRADICTION, named)


def test_a_body_that_does_not_grow_has_no_spool() -> None:
    """Its encoder's inputs float, and its last sensor ends at the tip."""
    bench = Bench().prepare(grows=0, flex_center_um=97_250, full_length_um=100_000)
    bench.spool.pull = 2000.0
    bench.do(wire.ConfirmLength(100_000, 1))
    bench.do(wire.SelectZone(0))
    bench.step(2000)
    for command in (
        wire.GrowTo(100_000, 0),
        wire.RetractTo(50_000, 0),
        wire.Home(),
        wire.TestOutput(wire.Output.MOTOR, 0, 100, 100),
    ):
        assert bench.refused(command) == R.DOES_NOT_GROW, command
    status = bench.status()
    assert (status.length_um, status.faults) == (100_000, 0)
    assert status.everted_mask & 1
    assert bench.board.motor == 0
    bench.do(wire.ZeroSensors(status.everted_mask))
    bench.until(lambda: bool(bench.event(wire.EventCode.ZEROED)))
    bench.bend()


def test_contradictions_are_refused_and_the_running_parameters_stay() -> None:
    bench = Bench().prepare()
    index = wire.PARAMETERS["over_pressure_cpsi"].index
    bench.stage("vent_cpsi", 15)
    bench.stage("over_pressure_cpsi", 1800)
    reply = bench.ask(wire.ApplyParameters())
    assert isinstance(reply, wire.Ack)
    assert (reply.reason, reply.detail) == (R.CONTRADICTION, index)
    bench.override[11] = pressure_count(0.3)
    bench.step(500)
    assert bench.status().conditions & wire.Condition.VENTED.mask  # by the 0.5 psi that runs on
    bench.stage("max_pressure_cpsi", 1700)
    bench.do(wire.ApplyParameters())
    bench.step(500)
    assert not bench.status().conditions & wire.Condition.VENTED.mask


@pytest.mark.parametrize("busy", [bending, growing])
def test_disarm_is_safe_within_two_ticks_of_its_last_byte(busy: Callable[[], Bench]) -> None:
    bench = busy()
    bench.seq += 1
    data = encode(wire.Disarm(), bench.seq, bench.session)
    bench.board.write(data)
    bench.board.step(len(data) * 40 // 1000 + 2)
    assert bench.safe()
    bench.step(20)
    assert bench.status().state == wire.State.SAFE
    assert [e.value for e in bench.event(wire.EventCode.ACTIVITY_ABORTED)] == [R.NONE]


def test_vent_ends_a_sweep_and_stays_ready() -> None:
    bench = bending()
    bench.do(wire.Vent())
    assert bench.safe()
    bench.step(3000)
    status = bench.status()
    assert (status.state, status.activity) == (wire.State.READY, wire.Activity.IDLE)
    assert max(bench.air.psi) < 0.1
    aborted = bench.event(wire.EventCode.ACTIVITY_ABORTED)
    assert [(e.arg, e.value) for e in aborted] == [(wire.Activity.SWEEPING, R.NONE)]


def test_a_released_press_ramps_down_and_ends() -> None:
    bench = Bench().zeroed(trigger_e5=10_000)
    bench.do(wire.SetPressure((0, 1000), 500))
    bench.step(4000)
    assert bench.air.psi[1] == pytest.approx(10, abs=0.15)
    bench.do(wire.SetPressure((0, 600), 0))
    bench.step(3000)
    assert bench.air.psi[1] == pytest.approx(6, abs=0.15)
    bench.do(wire.SetPressure((0, 0), 500))
    bench.step(500)
    assert bench.air.psi[1] > 2
    bench.until(lambda: bench.ended(wire.Activity.PRESSING))
    assert bench.safe()


def test_outputs_are_off_from_power_on_until_armed() -> None:
    board = VirtualBoard(1)
    for _ in range(200):
        board.step(10)
        assert board.drive_enabled == (False, False)
        assert board.drive == (0, 0)
        assert board.braked
    assert board.running
