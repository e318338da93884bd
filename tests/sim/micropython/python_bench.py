"""A robot on the controller under MicroPython, ready to be harmed."""

from __future__ import annotations

import time
from collections.abc import Callable

from thigmo.emulator.micropython import MicroPythonBoard
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.link.client import Client
from thigmo.robot.robot import Robot


class Bench:
    """Board, connection and robot; what drives a valve is energised.

    Attributes:
        board: MicroPython and its hardware.
        client: who talks to it.
    """

    def __init__(self, board: MicroPythonBoard, scene: Scene) -> None:
        self.board = board
        self.transport = EmulatorTransport(scene, board, seed=5)
        self.client = Client(self.transport)
        self.robot = Robot(self.client)

    def press(self) -> None:
        """Arm and hold a muscle under pressure."""
        self.robot.wait(0.3)
        self.robot.set_parameter("drift_limit_e5", [5000])
        self.robot.set_parameter("zero_ms", [200])
        self.robot.confirm_length(51.5, settled=True)
        self.robot.select_zone(2)
        self.robot.arm()
        self.robot.zero()
        self.robot.press("left", 8.0)
        self.robot.wait(1.0)
        assert self.board.drive_enabled == (True, False)

    @property
    def off(self) -> bool:
        """Valves at true zero, motor braked, no air."""
        board = self.board
        return board.drive_enabled == (False, False) and board.braked and not any(board.air)

    def until(self, done: Callable[[], bool], limit_s: float = 20.0) -> None:
        """Let time pass until something that Python does has happened, by the wall clock."""
        end = time.monotonic() + limit_s
        while not done():
            assert time.monotonic() < end, self.board.console()
            self.transport.pass_time(0.01)
