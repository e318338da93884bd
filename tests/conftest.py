"""Options and fixtures that several folders of tests share."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from hypothesis import settings

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.scene import Scene

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


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--robot",
        metavar="PORT",
        help="run the conformance suite against this port too (its configuration is put back)",
    )


@pytest.fixture
def serve() -> Iterator[Callable[[Scene], str]]:
    """Puts an emulated robot behind a serial port, in real time, and tells the port."""
    from thigmo.emulator.serve import PtyServer  # has no import where there are no terminals

    with ExitStack() as stack:

        def served(scene: Scene) -> str:
            lockstep = Lockstep(scene, VirtualBoard(1), seed=1)
            server = PtyServer(lockstep)
            on = threading.Event()
            on.set()
            thread = threading.Thread(target=lambda: server.run(on.is_set))
            thread.start()
            stack.callback(server.close)
            stack.callback(thread.join)
            stack.callback(on.clear)
            return server.path

        yield served
