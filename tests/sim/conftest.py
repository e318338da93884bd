"""A robot at rest in the default room, for boards that are compared."""

from __future__ import annotations

import pytest

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.link.client import Client
from thigmo.robot.robot import Robot


@pytest.fixture(scope="session")
def full_length(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """The default room, the robot out to 51.5 cm and rested."""
    scene = Scene.load("default")
    return scene.model_copy(update={"start_length_cm": 51.5})


@pytest.fixture(scope="session")
def stored_config(full_length: Scene) -> bytes:
    """An EEPROM in which the default robot's configuration was saved."""
    board = VirtualBoard(1)
    transport = EmulatorTransport(full_length, board, seed=1)
    Robot(Client(transport)).configure(transport.config)
    return board.eeprom
