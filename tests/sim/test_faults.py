"""Faults of the emulated body as `Robot` tells them: named with their place and the next step.

tests/unit/firmware provokes every fault and interlock of the supervisor: safe at once, latched,
cleared only with its cause gone. Here they come from the body, and the whole robot is safe in time.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest
from emulated import armed, at_each_step, scene_at

from thigmo.emulator.scene import FaultTable, Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import RobotFaultError
from thigmo.link import protocol as wire
from thigmo.robot import Robot

BEGIN_S = 3.0  # from the start of the motion: well inside every one of them
LASTS_S = 15.0
Move = Callable[[Robot], object]


def ready() -> tuple[Robot, EmulatorTransport]:
    """At 20 cm, armed and zeroed; the host knows the robot exactly."""
    scene: Scene = scene_at(20.0)
    scene.belief = type(scene.belief)()
    robot, transport = armed(scene)
    robot.select_body_pressure(0)
    robot.zero()
    return robot, transport


def inject(transport: EmulatorTransport, **fault: Any) -> float:
    """Have something fail soon; when."""
    begins_s = transport.now() + BEGIN_S
    transport.lockstep.faults.inject(FaultTable(at_s=begins_s, duration_s=LASTS_S, **fault))
    return begins_s


def sweep(robot: Robot) -> None:
    robot.sweep({"left": 12.0}, period_s=24.0)


def grow(robot: Robot) -> None:
    robot.grow_to(40.0)


def retract(robot: Robot) -> None:
    robot.retract_to(5.0)


def rest(robot: Robot) -> None:
    robot.wait(10.0)


# What fails, what it interrupts, the fault, how soon it must be safe, and where it is.
CASES: list[tuple[str, Move, str, float, dict[str, Any]]] = [
    ("flex_wire_cut", sweep, "flex_open", 0.2, {"side": "right", "sensor": 1}),
    ("flex_wire_cut", grow, "flex_open", 0.2, {}),
    ("flex_wire_cut", rest, "flex_open", 0.2, {"sensor": 4}),
    ("flex_short", sweep, "flex_short", 0.2, {"sensor": 0}),
    ("pressure_wire_cut", sweep, "pressure_wire", 0.1, {}),
    ("pressure_wire_cut", grow, "pressure_wire", 0.1, {"side": "right"}),
    ("pressure_stuck", sweep, "pressure_stuck", 8.0, {"value": 3.0}),
    ("air_lost", sweep, "pressure_stuck", 8.0, {}),
    ("over_pressure", sweep, "over_pressure", 0.8, {}),
    ("over_pressure", rest, "over_pressure", 0.8, {"side": "right"}),
    ("spool_stall", grow, "spool_stall", 0.8, {}),
    ("spool_stall", retract, "spool_stall", 0.8, {}),
    ("spool_slip", sweep, "spool_slip", 0.8, {}),
    ("spool_slip", rest, "spool_slip", 0.8, {}),
    ("brown_out", sweep, "brown_out", 0.1, {}),
    ("brown_out", grow, "brown_out", 0.1, {}),
    ("estop", sweep, "estop", 0.03, {}),
    ("estop", grow, "estop", 0.03, {}),
]


@pytest.mark.parametrize(
    ("kind", "move", "name", "within_s", "where"),
    CASES,
    ids=[f"{kind}-{move.__name__}" for kind, move, *_ in CASES],
)
def test_fault_of_the_body_is_named_and_leaves_a_safe_robot_that_works_again(
    kind: str, move: Move, name: str, within_s: float, where: dict[str, Any]
) -> None:
    robot, transport = ready()
    board, plant, watched = transport.lockstep.board, transport.lockstep.plant, []

    def look() -> None:
        safe = not any(board.drive_enabled) and board.motor == 0 and board.braked
        watched.append((transport.lockstep.t_s, safe, board.motor))

    at_each_step(transport, look)
    begins_s = inject(transport, kind=kind, **where)
    with pytest.raises(RobotFaultError) as caught:
        move(robot)

    said = str(caught.value)
    assert name in caught.value.faults
    problem, _, cure = wire.Fault[name.upper()].doc.partition("; ")
    if said.partition(":")[0].startswith(name):
        assert problem in said
        assert said.replace(" (healthy = false)", "").endswith(f"; {cure.rstrip('.')}")
    assert "; " in said
    side = where.get("side", "left")
    if name.startswith("flex"):
        assert f": {side} {where.get('sensor', 0)} (0 = at the base)" in said
    elif name in ("over_pressure", "pressure_wire", "pressure_stuck"):
        assert f"({side} muscle); " in said

    # Safe in time, and from then on; the spool is never driven in by a fault.
    if move is not rest:
        before = [safe for t, safe, _ in watched if begins_s - 0.2 < t < begins_s]
        assert not any(before), "nothing ran that the fault could stop"
    length_cm = plant.length_cm
    transport.pass_time(3.0)
    assert all(safe for t, safe, _ in watched if t > begins_s + within_s)
    assert plant.length_cm >= length_cm - 1e-6
    if move is not retract:
        assert all(motor >= 0 for t, _, motor in watched if t > begins_s)

    with pytest.raises(RobotFaultError) as refused:
        robot.arm()
    assert name in refused.value.faults
    transport.pass_time(max(begins_s + LASTS_S - robot.now(), 0.0) + 2.0)
    assert robot.clear_faults() == ()
    robot.link.events.clear()
    robot.arm()
    assert (robot.status().length_cm is None) == name.startswith("spool")
    robot.confirm_length(plant.length_cm, settled=True)
    robot.vent()
    assert robot.grow_to(45.0) == pytest.approx(45.0, abs=0.1)


@pytest.mark.parametrize(
    "entry", [*wire.Fault, *(r for r in wire.Reason if r is not wire.Reason.NONE)], ids=str
)
def test_every_fault_and_reason_says_what_to_do(entry: wire.Fault | wire.Reason) -> None:
    problem, _, cure = entry.doc.partition("; ")
    assert problem[0].isupper()
    assert re.fullmatch(r"[a-z][^\n]+\.", cure)


@pytest.mark.parametrize("kind", ["flex_wire_cut", "flex_short"])
def test_a_sensor_that_is_marked_dead_stops_nothing_any_more(kind: str) -> None:
    robot, transport = ready()
    inject(transport, kind=kind, side="right", sensor=1)
    with pytest.raises(RobotFaultError):
        rest(robot)
    with pytest.raises(RobotFaultError, match=r": right 1 \(0 = at the base\); .*healthy = false"):
        robot.arm()
    config = transport.config.model_copy(deep=True)
    robot.configure(config)  # nothing changed: still latched
    assert robot.status().faults
    config.column("right")[1].healthy = False
    robot.configure(config)
    robot.arm()
    rest(robot)
    assert robot.status().faults == ()
