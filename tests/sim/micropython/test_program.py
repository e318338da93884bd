"""A Python program as the robot's host: it reads, commands and beats, by the checks of the wire."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from rig import Rig

from thigmo.emulator.micropython import MicroPythonBoard
from thigmo.emulator.micropython_build import missing
from thigmo.emulator.scene import Scene
from thigmo.link import protocol as wire
from thigmo.link.client import Client

Make = Callable[..., Rig[MicroPythonBoard]]

# Fifteen lines, as docs/micropython.md has them.
SWEEPS = """import time
from main import board
def busy():
    board.beat()
    time.sleep_ms(100)
    return board.activity() != "idle"
time.sleep_ms(5000)
board.select_zone(2)
board.confirm_length(51.5, True)
board.arm()
while busy(): pass
board.zero()
while busy(): pass
board.sweep([12, 8], 3)
while busy(): print("bent", board.curvature()[0])
board.stop(); print(board.state(), board.faults(), board.length())
"""
READY = "board.select_zone(2); board.confirm_length(51.5, True); board.arm()"


@pytest.fixture(autouse=True)
def _built() -> None:
    if reason := missing("unix"):
        pytest.skip(reason)


def say(robot: Rig[MicroPythonBoard], line: str) -> str:
    """Type a line at the prompt; what was printed before the next prompt."""
    board = robot.board
    robot.until(lambda: board.console().endswith(">>> "))
    before = len(board.console())
    board.type(line.encode() + b"\r")
    robot.until(lambda: board.console()[before:].endswith("\n>>> "))
    return board.console()[before:].partition("\n")[2].removesuffix(">>> ")


@pytest.fixture
def alone(bench: Make, full_length: Scene) -> Rig[MicroPythonBoard]:
    """A robot at whose prompt somebody sits; no host has said hello."""
    robot = bench()
    board = MicroPythonBoard(5, robot.board.eeprom)
    lonely = object.__new__(Rig)
    lonely.board = board
    lonely.transport = type(robot.transport)(full_length, board, seed=5)
    lonely.pass_ms(1500)
    return lonely


@pytest.mark.realtime
def test_a_script_prints_the_curvature_of_a_sweep_and_stops_the_robot(
    tmp_path: Path, full_length: Scene
) -> None:
    full_length.save(tmp_path / "room.toml")
    command = [sys.executable, "-m", "thigmo", "emulate", tmp_path / "room.toml", "--prompt"]
    ran = subprocess.run(
        command, input=SWEEPS, capture_output=True, text=True, timeout=120, check=True
    )
    lines = ran.stdout.splitlines()
    assert lines[-1] == "fault ('stopped',) 51.5", ran.stdout + ran.stderr
    bends = [float(line.split()[1]) for line in lines if line.startswith("bent")]
    assert max(bends) > 0.008
    assert min(bends) < -0.008


def test_readings_before_a_host_has_come(alone: Rig[MicroPythonBoard]) -> None:
    assert "(None, None" in say(alone, "board.curvature()")
    assert "'boot'" in say(alone, "board.state()")
    assert "None None" in say(alone, "print(board.length(), board.length())")
    say(alone, "board.confirm_length(51.5)")
    assert "51.5 safe ()" in say(alone, "print(board.length(), board.state(), board.faults())")


def test_a_command_meets_the_checks_of_the_wire(alone: Rig[MicroPythonBoard]) -> None:
    assert "a host has the robot" in say(alone, "board.vent()")
    say(alone, READY)
    assert "sweep: not_zeroed" in say(alone, "board.sweep([5, 5], 3)")
    assert "grow_to: over_limit" in say(alone, "board.grow_to(500)")
    assert "Error" in say(alone, "board.sweep([5], 3)")


def test_a_program_that_falls_silent_loses_the_robot(alone: Rig[MicroPythonBoard]) -> None:
    say(alone, READY + "; board.grow_to(53)")
    alone.pass_ms(700)
    assert alone.board.braked
    assert "('host_silent',)" in say(alone, "board.faults()")


def test_a_host_takes_the_robot_from_the_program_and_the_program_only_from_a_silent_one(
    alone: Rig[MicroPythonBoard],
) -> None:
    say(alone, READY)
    client = Client(alone.transport)  # its heart beats by itself
    assert client.request(wire.GetStatus()).state is wire.State.SAFE
    alone.pass_ms(100)
    assert "a host has the robot" in say(alone, "board.arm()")
    assert "a host has the robot" in say(alone, "board.beat()")
    assert "(" in say(alone, "board.pressure()")
    alone.transport.stop_heartbeat()
    alone.pass_ms(1000)
    say(alone, "board.arm()")
    assert "'ready'" in say(alone, "board.beat(); board.state()")
    client.close()


def test_whoever_has_the_robot_the_program_may_stop_it(bench: Make) -> None:
    robot = bench()
    robot.press()
    say(robot, "board.stop()")
    robot.pass_ms(100)
    assert robot.airless
    status = robot.client.request(wire.GetStatus())
    assert status.faults & wire.Fault.STOPPED.mask
    assert status.stop_nonce


def test_events_reach_both_the_program_and_the_host(bench: Make) -> None:
    robot = bench(program="from main import board\nboard.on_event(print)")
    heard: list[wire.EventCode] = []
    robot.client.on_event.append(lambda frame: heard.append(frame.message.code))
    robot.press()
    robot.until(lambda: "zeroed 1023 0" in robot.board.console())
    assert wire.EventCode.ZEROED in heard


def test_ctrl_c_at_200_random_moments_leaves_outputs_off_within_5_ms(bench: Make) -> None:
    """Counted from when the interpreter has the signal or the key, in ticks of the controller."""
    robot = bench()
    board = robot.board
    rng = random.Random(50)
    worst = 0
    for _ in range(200):
        if not board.running:
            say(robot, "board.start()")
            robot.client = Client(robot.transport)
        robot.client.request(wire.ClearFaults(0xFFFF))
        robot.client.request(wire.Arm())
        robot.pass_ms(500)
        robot.until(lambda: board.console().endswith(">>> "))
        if rng.random() < 0.5:
            board.type(b"while True: pass\r\r")
            robot.until(lambda: not board.console().endswith((">>> ", "... ")))
        # Python may have taken long on a busy computer; the output is on for half a second.
        robot.client.request(wire.TestOutput(wire.Output.TRANSDUCER, 0, 300, 500))
        board.step(rng.randrange(1, 300))
        assert board.drive_enabled[0]
        printed = len(board.console())
        board.interrupt()
        while not board.console()[printed:].endswith("\n>>> "):
            os.sched_yield()
        ticks = 0
        while board.drive_enabled != (False, False):
            board.step(1)
            ticks += 1
        worst = max(worst, ticks)
        robot.transport.pass_time(0.05)
        assert robot.airless
    assert worst <= 5
