"""A robot at rest in the default room, for boards that are compared."""

from __future__ import annotations

import pytest
from emulated import emulated, scene_at

from thigmo.emulator.scene import Scene


@pytest.fixture(scope="session")
def full_length() -> Scene:
    """The default room, the robot out to 51.5 cm and rested."""
    return scene_at(51.5, "default")


@pytest.fixture(scope="session")
def stored_config(full_length: Scene) -> bytes:
    """An EEPROM in which the default robot's configuration was saved."""
    robot, transport = emulated(full_length)
    robot.configure(transport.config)
    return transport.lockstep.board.eeprom
