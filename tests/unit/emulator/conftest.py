"""Fixtures of the emulator's unit tests."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from silent_board import SilentBoard


@pytest.fixture
def board() -> SilentBoard:
    return SilentBoard()
