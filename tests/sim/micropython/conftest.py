"""Robots on each processor that runs MicroPython."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from rig import Rig

from thigmo.emulator.micropython import MicroPythonBoard, Processor
from thigmo.emulator.micropython_build import missing
from thigmo.emulator.scene import Scene


@pytest.fixture
def bench(stored_config: bytes, full_length: Scene) -> Callable[..., Rig[MicroPythonBoard]]:
    """Makes a robot on a board: (processor, Python's program)."""

    def make(on: Processor = "unix", program: str | None = None) -> Rig[MicroPythonBoard]:
        if reason := missing(on):
            pytest.skip(reason)
        board = MicroPythonBoard(5, stored_config, processor=on, program=program)
        return Rig(board, full_length, seed=5)

    return make
