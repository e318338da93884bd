"""Every fault of the supervisor, provoked in the emulated body and seen through `Robot`.

Each is named with its next step, safe in time (never a retraction), latched, and cleared only with
its cause gone.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.scene import FaultTable, Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import BoardResetError, CommandRefusedError, LinkError, RobotFaultError
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.robot import Robot

BEGIN_S = 3.0  # from the start of the motion: well inside every one of them
LASTS_S = 15.0


class Bench:
    """An emulated robot whose outputs are watched at every step of 10 ms."""

    def __init__(self, length_cm: float = 20.0, board: VirtualBoard | None = None) -> None:
        scene = Scene.load("empty")
        scene.start_length_cm = length_cm
        scene.belief = type(scene.belief)()
        self.board = board or VirtualBoard(1)
        self.transport = EmulatorTransport(scene, self.board, seed=1)
        self.lockstep = self.transport.lockstep
        self.plant = self.lockstep.plant
        self.watched: list[tuple[float, bool, int]] = []  # time, safe, motor
        self._advance = self.lockstep.advance
        self.lockstep.advance = self._watch  # type: ignore[method-assign]
        self.robot = Robot(Client(self.transport))

    def _watch(self) -> None:
        self._advance()
        self.watched.append((self.lockstep.t_s, self.safe, self.board.motor))

    @property
    def safe(self) -> bool:
        """Both valves at true zero, motor braked."""
        return not any(self.board.drive_enabled) and self.board.motor == 0 and self.board.braked

    def ready(self) -> Bench:
        """Configured, armed, length and zone known, zeroed."""
        robot, scene = self.robot, self.transport.scene
        robot.configure(self.transport.config)
        robot.arm()
        robot.confirm_length(scene.start_length_cm, settled=True)
        robot.select_zone(scene.robot.body.zone_at(scene.start_length_cm))
        robot.zero()
        return self

    def inject(self, begin_s: float = BEGIN_S, lasts_s: float = LASTS_S, **fault: Any) -> None:
        self.lockstep.faults.inject(
            FaultTable(at_s=self.robot.now() + begin_s, duration_s=lasts_s, **fault)
        )
        self.begins_s = self.robot.now() + begin_s
        self.ends_s = self.begins_s + lasts_s

    def reconnected(self) -> Robot:
        self.robot = Robot(Client(self.transport))
        return self.robot


def sweep(robot: Robot) -> None:
    robot.sweep({"left": 12.0}, period_s=24.0)


def grow(robot: Robot) -> None:
    robot.grow_to(40.0)


def retract(robot: Robot) -> None:
    robot.retract_to(5.0)


def rest(robot: Robot) -> None:
    robot.wait(10.0)


def says_what_to_do(error: Exception, fault: str) -> None:
    """The operator's line: the schema's name and sentence, next step included."""
    doc = wire.Fault[fault.upper()].doc
    assert fault in str(error)
    what, _, cure = doc.partition("; ")
    assert cure
    named = str(error).partition(":")[0]
    if named.startswith(fault):
        said = str(error).replace(" (healthy = false)", "")
        assert what in said
        assert said.endswith(f"; {cure.rstrip('.')}")
    assert "; " in str(error)


@dataclass(frozen=True)
class Case:
    """A fault, what it interrupts, its name, how soon it must be safe, and what it leaves."""

    kind: str
    name: str
    move: Callable[[Robot], None]
    within_s: float
    lasting: bool = True  # whether it cannot be cleared while its cause lasts
    forgets: bool = False  # whether the length is unknown afterwards
    options: tuple[tuple[str, Any], ...] = ()

    def __str__(self) -> str:
        return f"{self.kind}-{self.move.__name__}"


CASES = [
    Case("flex_wire_cut", "flex_open", sweep, 0.2, options=(("side", "right"), ("sensor", 1))),
    Case("flex_wire_cut", "flex_open", grow, 0.2),
    Case("flex_wire_cut", "flex_open", rest, 0.2, options=(("sensor", 4),)),
    Case("flex_short", "flex_short", sweep, 0.2, options=(("sensor", 0),)),
    Case("pressure_wire_cut", "pressure_wire", sweep, 0.1),
    Case("pressure_wire_cut", "pressure_wire", grow, 0.1, options=(("side", "right"),)),
    Case("pressure_stuck", "pressure_stuck", sweep, 8.0, options=(("value", 3.0),)),
    Case("air_lost", "pressure_stuck", sweep, 8.0, lasting=False),
    Case("over_pressure", "over_pressure", sweep, 0.8),
    Case("over_pressure", "over_pressure", rest, 0.8, options=(("side", "right"),)),
    Case("spool_stall", "spool_stall", grow, 0.8, lasting=False, forgets=True),
    Case("spool_stall", "spool_stall", retract, 0.8, lasting=False, forgets=True),
    Case("spool_slip", "spool_slip", sweep, 0.8, lasting=False, forgets=True),
    Case("spool_slip", "spool_slip", rest, 0.8, lasting=False, forgets=True),
    Case("brown_out", "brown_out", sweep, 0.1),
    Case("brown_out", "brown_out", grow, 0.1),
    Case("estop", "estop", sweep, 0.03),
    Case("estop", "estop", grow, 0.03),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_fault_is_named_safe_latched_and_cleared_with_its_cause(case: Case) -> None:
    bench = Bench(20.0).ready()
    robot = bench.robot
    bench.inject(kind=case.kind, **dict(case.options))
    with pytest.raises(RobotFaultError) as caught:
        case.move(robot)

    # Named.
    assert case.name in caught.value.faults
    says_what_to_do(caught.value, case.name)
    if case.name.startswith("flex"):
        options = {"side": "left", "sensor": 0, **dict(case.options)}
        assert f": {options['side']} {options['sensor']} (0 = at the base)" in str(caught.value)
    elif case.name in ("over_pressure", "pressure_wire", "pressure_stuck"):
        assert f"({dict(case.options).get('side', 'left')} muscle); " in str(caught.value)

    # Safe in time, and from then on; the spool is never driven in by a fault.
    if case.move is not rest:
        before = [safe for t, safe, _ in bench.watched if bench.begins_s - 0.2 < t < bench.begins_s]
        assert not any(before), "nothing ran that the fault could stop"
    after = [
        (safe, motor) for t, safe, motor in bench.watched if t > bench.begins_s + case.within_s
    ]
    length = bench.plant.length_cm
    assert all(safe for safe, _ in after)
    bench.transport.pass_time(3.0)
    assert all(safe for t, safe, _ in bench.watched if t > bench.begins_s + case.within_s)
    assert bench.plant.length_cm >= length - 1e-6
    if case.move is not retract:
        assert all(motor >= 0 for t, _, motor in bench.watched if t > bench.begins_s)

    # Latched: nothing runs, also when the cause is gone.
    bench.robot._client.events.clear()
    for _ in ("with its cause", "after it"):
        assert robot.status().state == "fault"
        for command in (robot.arm, robot.home, lambda: grow(robot)):
            with pytest.raises(RobotFaultError) as refused:
                command()
            assert case.name in refused.value.faults
        if case.lasting and bench.robot.now() < bench.ends_s:
            assert case.name in robot.clear_faults()
        bench.transport.pass_time(max(bench.ends_s - robot.now(), 0.0) + 2.0)
    assert bench.safe

    # Cleared, it is safe and not yet armed; armed, it works again.
    assert robot.clear_faults() == ()
    assert robot.status().state == "safe"
    assert bench.safe
    robot._client.events.clear()
    robot.arm()
    assert (robot.status().length_cm is None) == case.forgets
    if case.forgets:
        with pytest.raises(CommandRefusedError, match="; measure it and confirm it") as unknown:
            grow(robot)
        assert unknown.value.reason == "length_unknown"
        robot.confirm_length(bench.plant.length_cm, settled=True)
    robot.vent()
    assert robot.grow_to(45.0) == pytest.approx(45.0, abs=0.1)


@pytest.mark.parametrize("move", [sweep, grow])
def test_a_silent_host_is_named_when_it_speaks_again(move: Callable[[Robot], None]) -> None:
    bench = Bench(20.0).ready()
    bench.inject(kind="host_silent", lasts_s=6.0)
    with pytest.raises((LinkError, RobotFaultError), match="; "):
        move(bench.robot)
    # Half a second after the last heartbeat, which came up to 0.1 s before the silence.
    assert all(safe for t, safe, _ in bench.watched if t > bench.begins_s + 0.55)
    assert all(motor >= 0 for _, _, motor in bench.watched)
    bench.transport.pass_time(max(bench.ends_s - bench.robot.now(), 0.0) + 0.5)
    robot = bench.reconnected()
    assert robot.status().faults == ("host_silent",)
    with pytest.raises(RobotFaultError, match=r"host_silent: .*; check the cable"):
        robot.arm()
    bench.transport.pass_time(0.3)  # heartbeats: the cause is gone
    assert robot.clear_faults() == ()
    robot.arm()
    assert robot.status().length_cm is not None  # a silence costs no length


def test_a_hang_bites_the_watchdog_and_the_length_is_forgotten() -> None:
    bench = Bench(20.0).ready()
    bench.inject(kind="hang")
    with pytest.raises((BoardResetError, LinkError), match="; "):
        sweep(bench.robot)
    assert all(safe for t, safe, _ in bench.watched if t > bench.begins_s + 0.3)
    bench.transport.pass_time(2.0)
    robot = bench.reconnected()
    assert robot.identity["reset_cause"] == "watchdog"
    with pytest.raises(RobotFaultError, match=r"watchdog: .*; report it") as caught:
        robot.arm()
    assert caught.value.faults == ("watchdog",)
    assert robot.clear_faults() == ()
    robot.arm()
    robot.select_zone(0)
    assert robot.status().length_cm is None
    for move in (sweep, grow):
        with pytest.raises(CommandRefusedError) as refused:
            move(robot)
        assert refused.value.reason == "length_unknown"
    assert bench.plant.muscle_psi[0] < 0.1
    assert bench.safe


@pytest.mark.parametrize("move", [sweep, grow])
def test_a_power_cut_is_told_as_a_reset_and_leaves_nothing_running(
    move: Callable[[Robot], None],
) -> None:
    bench = Bench(20.0).ready()
    bench.inject(kind="power_cut", lasts_s=1.5)
    with pytest.raises((BoardResetError, LinkError), match="; "):
        move(bench.robot)
    bench.transport.pass_time(4.0)
    assert bench.plant.muscle_psi == pytest.approx((0.0, 0.0), abs=1e-3)
    robot = bench.reconnected()
    status = robot.status()
    assert (status.state, status.length_cm, status.zone) == ("safe", None, None)
    assert status.config_generation == 1
    assert bench.safe


@pytest.mark.parametrize(
    "entry", [*wire.Fault, *(r for r in wire.Reason if r is not wire.Reason.NONE)], ids=str
)
def test_every_fault_and_reason_says_what_to_do(entry: wire.Fault | wire.Reason) -> None:
    what, _, cure = entry.doc.partition("; ")
    assert what[0].isupper()
    assert re.fullmatch(r"[a-z][^\n]+\.", cure)


def test_a_sensor_that_half_everts_during_a_bend_ends_it() -> None:
    bench = Bench(31.0).ready()
    bench.robot.set_parameter("slip_um", [60_000])  # a slip counts as such only beyond 6 cm
    bench.inject(kind="spool_slip", lasts_s=2.0, value=2.0)
    with pytest.raises(RobotFaultError) as caught:
        sweep(bench.robot)
    assert caught.value.faults == ("interlock",)
    says_what_to_do(caught.value, "interlock")
    bench.transport.pass_time(3.0)
    assert bench.safe
    robot = bench.robot
    assert robot.clear_faults() == ()
    robot._client.events.clear()
    robot.arm()
    with pytest.raises(CommandRefusedError) as caught_again:
        sweep(robot)
    assert caught_again.value.reason == "half_everted"
    robot.vent()
    robot.grow_to(40.0)  # what the message asks for


@pytest.mark.parametrize("kind", ["flex_wire_cut", "flex_short"])
def test_a_sensor_that_is_marked_dead_stops_nothing_any_more(kind: str) -> None:
    bench = Bench(20.0).ready()
    bench.inject(kind=kind, side="right", sensor=1)
    with pytest.raises(RobotFaultError):
        rest(bench.robot)
    with pytest.raises(RobotFaultError, match=r": right 1 \(0 = at the base\); .*healthy = false"):
        bench.robot.arm()
    config = bench.transport.config.model_copy(deep=True)
    bench.robot.configure(config)  # nothing changed: still latched
    assert bench.robot.status().faults
    config.column("right")[1].healthy = False
    bench.robot.configure(config)
    bench.robot.arm()
    rest(bench.robot)
    assert bench.robot.status().faults == ()
