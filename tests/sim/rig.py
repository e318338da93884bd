"""A robot on a board that runs the real image or MicroPython, ready to be harmed."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Generic, TypeVar

from thigmo.emulator.mega_sim import SimulatedMega
from thigmo.emulator.micropython import MicroPythonBoard
from thigmo.emulator.plant import STEP_MS
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.emulator.usb_bridge import UsbBridge
from thigmo.link.client import Client
from thigmo.robot.robot import Robot

Harmed = TypeVar("Harmed", SimulatedMega, MicroPythonBoard)


class Rig(Generic[Harmed]):
    """Board, connection and robot; nothing is asked of it yet."""

    def __init__(self, board: Harmed, scene: Scene, seed: int, exchange_ms: int = STEP_MS) -> None:
        self.board: Harmed = board
        self.transport = EmulatorTransport(scene, board, seed=seed, exchange_ms=exchange_ms)
        self.client = Client(self.transport)
        self.robot = Robot(self.client)

    def prepare(self) -> None:
        """Length and body pressure known, armed, zeroed."""
        robot = self.robot
        robot.wait(0.3)
        robot.set_parameter("drift_limit_e5", [5000])
        robot.set_parameter("zero_ms", [200])
        robot.confirm_length(self.transport.lockstep.plant.length_cm, settled=True)
        robot.select_body_pressure(2)
        robot.arm()
        robot.zero()

    def press(self) -> None:
        """Prepare it, and hold a muscle under pressure."""
        self.prepare()
        self.robot.press("left", 8.0)
        self.robot.wait(1.0)
        assert self.board.drive_enabled == (True, False)

    @property
    def off(self) -> bool:
        """Valves at true zero, motor braked."""
        board = self.board
        return board.drive_enabled == (False, False) and board.drive == (0, 0) and board.braked

    @property
    def airless(self) -> bool:
        """Off, and the air enables stand still."""
        return self.off and not any(self.board.air)

    def pass_ms(self, milliseconds: int) -> None:
        """Let time pass; what the board says is kept for the client."""
        self.transport.pass_time(milliseconds / 1000)

    def until_off(self, limit_ms: int) -> int:
        """Milliseconds (in steps of 10) until valves carry nothing and the motor is braked."""
        for waited in range(0, limit_ms, 10):
            if self.off:
                return waited
            self.pass_ms(10)
        raise AssertionError(f"outputs are on after {limit_ms} ms")

    def until(self, done: Callable[[], bool], limit_s: float = 20.0) -> None:
        """Let time pass until something that Python does has happened, by the wall clock."""
        end = time.monotonic() + limit_s
        while not done():
            assert time.monotonic() < end, self.board.console()
            self.pass_ms(10)


def open_rig(
    scene: Scene, eeprom: bytes, *, usb: UsbBridge | None = None, baud: int = 250_000
) -> Rig[SimulatedMega]:
    """A simulated Mega."""
    return Rig(SimulatedMega(7, eeprom, usb=usb, baud=baud), scene, seed=7, exchange_ms=1)
