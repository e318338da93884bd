"""How far the body grows after its host has died: at most 2 cm, whatever the legal parameters."""

from __future__ import annotations

from functools import cache

import pytest
from emulated import emulated, scene_at
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.scene import FaultTable, Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.heartbeat import PERIOD_S
from thigmo.robot import Robot
from thigmo.robot.configuration import set_parameters

PROMISE_CM = 2.0
START_CM = 5.0  # there the 1.47 psi of the shortest body pull at the tail with 4.9 N
PULL_N = 4.9
AFTER_S = 1.5  # until a braked spool is at rest
# Counts per metre and payout describe the robot; nobody can check them but with a ruler.
FREE = (
    "spool_accel_um_s2", "spool_kp", "spool_ki", "spool_kd", "spool_kff", "spool_dead_zone",
    "spool_tolerance_um", "stall_ms", "slip_um", "telemetry_ms",
)  # fmt: skip


def anywhere(name: str) -> st.SearchStrategy[int]:
    """A legal value of a parameter, often one of its limits."""
    row = wire.PARAMETERS[name]
    return st.sampled_from((row.low, row.high)) | st.integers(row.low, row.high)


@st.composite
def parameters(draw: st.DrawFn) -> dict[str, list[int]]:
    cases = {name: draw(anywhere(name)) for name in FREE}
    cases["heartbeat_ms"] = draw(anywhere("heartbeat_ms"))
    fastest = 17_000_000 // (max(cases["heartbeat_ms"], 285) + 100)
    cases["spool_speed_um_s"] = draw(st.just(fastest) | st.integers(100, fastest))
    cases["home_speed_um_s"] = min(8000, fastest)
    return {name: [value] for name, value in cases.items()}


@cache
def stored() -> bytes:
    """The store of a board that is configured but for these parameters."""
    robot, transport = emulated(scene(), seed=5)
    robot.configure(transport.config)
    return transport.lockstep.board.eeprom


def scene() -> Scene:
    scene = scene_at(START_CM)
    scene.belief = type(scene.belief)()
    return scene


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(wanted=parameters(), lead_s=st.floats(0.1, 2.5))
def test_a_dead_host_costs_two_centimetres_at_most(
    wanted: dict[str, list[int]], lead_s: float
) -> None:
    transport = EmulatorTransport(scene(), VirtualBoard(5, stored()), seed=5)
    plant = transport.lockstep.plant
    client = Client(transport, heartbeat_s=min(wanted["heartbeat_ms"][0] / 3e3, PERIOD_S))
    robot = Robot(client)
    robot.wait(0.5)
    set_parameters(client, wanted)
    robot.confirm_length(START_CM, settled=True)
    robot.arm()
    assert plant.pull_n == pytest.approx(PULL_N, abs=0.1)
    client.request(wire.GrowTo(530_000, 0))
    transport.pass_time(lead_s)
    begun = plant.line_cm
    transport.lockstep.faults.inject(FaultTable(kind="host_silent", at_s=transport.now()))
    transport.pass_time(wanted["heartbeat_ms"][0] * 1e-3 + AFTER_S)
    assert transport.lockstep.board.braked
    assert (plant.line_cm - begun) / 2 <= PROMISE_CM
