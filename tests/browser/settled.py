"""A robot on a port whose sensors have settled."""

from __future__ import annotations

from collections.abc import Iterator

from served import ServedRobot

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.scene import Scene
from thigmo.emulator.serve import brought_up


def settled_robot(length_cm: float) -> Iterator[ServedRobot]:
    """Serves a robot of a length in real time, until it is no longer needed."""
    scene = Scene.load("empty").model_copy(update={"start_length_cm": length_cm})
    lockstep = Lockstep(scene, VirtualBoard(3, brought_up()), seed=3)
    while lockstep.t_s < 60.0:
        lockstep.advance()
    served = ServedRobot(lockstep, reset_on_open=False)
    yield served
    served.close()
