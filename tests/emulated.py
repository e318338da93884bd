"""Emulated robots in virtual time, and rooms as scene files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from thigmo.emulator.board import virtual_board
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.link.client import Client
from thigmo.robot import Robot

if TYPE_CHECKING:
    from served import ServedRobot  # which imports this module

Serve = Callable[[Scene], "ServedRobot"]  # the fixture `serve`


def scene_at(length_cm: float, name: str = "empty") -> Scene:
    """A built-in scene whose robot is out so far."""
    scene = Scene.load(name)
    scene.start_length_cm = length_cm
    return scene


def emulated(scene: Scene, seed: int = 1) -> tuple[Robot, EmulatorTransport]:
    """A robot with a new board."""
    transport = EmulatorTransport(scene, virtual_board(scene.robot, seed), seed=seed)
    return Robot(Client(transport)), transport


def armed(scene: Scene, seed: int = 1) -> tuple[Robot, EmulatorTransport]:
    """Configured and armed, at its confirmed length."""
    robot, transport = emulated(scene, seed)
    robot.configure(transport.config)
    robot.arm()
    robot.confirm_length(scene.start_length_cm, settled=True)
    return robot, transport


def at_each_step(transport: EmulatorTransport, look: Callable[[], object]) -> None:
    """From now on, look after each step of 10 ms."""
    advance = transport.lockstep.advance

    def advance_and_look() -> None:
        advance()
        look()

    transport.lockstep.advance = advance_and_look  # type: ignore[method-assign]


def room_file(folder: Path, scene: Scene, name: str = "room") -> str:
    """The address of the robot in a scene, which is saved in a folder."""
    scene.save(folder / f"{name}.toml")
    return f"emulator://{folder / f'{name}.toml'}"


def last_stages(length_cm: float = 50.0, name: str = "default") -> Scene:
    """A room of which only the last stages are explored, with sensors that settle at once."""
    scene = scene_at(length_cm, name)
    scene.robot.board.settle_s = 0.2
    return scene
