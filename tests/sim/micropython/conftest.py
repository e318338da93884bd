"""Benches for each processor that runs MicroPython."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from python_bench import Bench

from thigmo.emulator.micropython import MicroPythonBoard, Processor
from thigmo.emulator.micropython_build import missing
from thigmo.emulator.scene import Scene


@pytest.fixture
def bench(stored_config: bytes, full_length: Scene) -> Callable[..., Bench]:
    """Makes a bench: (processor, Python's program)."""

    def make(on: Processor = "unix", program: str | None = None) -> Bench:
        if reason := missing(on):
            pytest.skip(reason)
        return Bench(MicroPythonBoard(5, stored_config, on=on, program=program), full_length)

    return make
