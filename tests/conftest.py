"""Options and fixtures that several folders of tests share."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import settings

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.scene import Scene

HERE = Path(__file__).parent
# Folders whose name is the marker of all tests in them (tests/sim/mega: of `sim` and `mega`).
TIERS = frozenset({"unit", "protocol", "sim", "mega", "bench", "browser", "ros"})

# One commit gives one verdict: every run draws the same examples. `HYPOTHESIS_PROFILE=random`
# draws new ones.
settings.register_profile("repeatable", derandomize=True)
settings.register_profile("random", print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


def pytest_configure() -> None:
    # A shell without job control starts what it puts in the background with SIGINT ignored, and
    # every child inherits that; the tests that send it mean programs which were started by hand.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        for folder in item.path.relative_to(HERE).parts:
            if folder in TIERS:
                item.add_marker(folder)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--robot",
        metavar="PORT",
        help="run the conformance suite against this port too (its configuration is put back)",
    )


@pytest.fixture
def own_sockets(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Runs and robots of this test are seen by this test only, and it sees no others; a socket's
    path has to be short.
    """
    folder = tempfile.mkdtemp(prefix="tg")
    monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
    yield
    shutil.rmtree(folder)


@pytest.fixture
def serve() -> Iterator[Callable[[Scene], str]]:
    """Puts an emulated robot behind a serial port, in real time, and tells the port."""
    from served import ServedRobot  # has no import where there are no terminals

    with ExitStack() as stack:

        def served(scene: Scene) -> str:
            robot = ServedRobot(Lockstep(scene, VirtualBoard(1), seed=1))
            stack.callback(robot.close)
            return robot.port

        yield served
