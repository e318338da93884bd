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
from command import Thigmo, thigmo_command
from emulated import Serve, last_stages, room_file
from hypothesis import settings
from hypothesis.internal.conjecture import providers
from served import ServedRobot

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.scene import Scene
from thigmo.emulator.serve import brought_up
from thigmo.link.address import OTHER_PLACE

HERE = Path(__file__).parent
# Folders whose name is the marker of all tests in them (tests/sim/mega: of `sim` and `mega`).
TIERS = frozenset({"unit", "oracles", "protocol", "sim", "mega", "bench", "browser", "ros"})

# One commit gives one verdict: every run draws the same examples. `HYPOTHESIS_PROFILE=random`
# draws new ones. No example has a deadline, for the computer may be busy.
settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=30)
settings.register_profile("nightly", settings.get_profile("repeatable"), max_examples=1000)
settings.register_profile("random", deadline=None, print_blob=True)

# Hypothesis also draws constants from whatever modules of ours are loaded by then: examples would
# depend on which tests this worker ran before. It has no setting against that.
pytest.MonkeyPatch().setattr(providers, "is_local_module_file", lambda path: False)

NIGHTLY_TIMES = 20  # as many cases of `many`


def pytest_configure(config: pytest.Config) -> None:
    usual = "nightly" if config.getoption("--nightly") else "repeatable"
    settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", usual))
    # A shell without job control starts what it puts in the background with SIGINT ignored, and
    # every child inherits that; the tests that send it mean programs which were started by hand.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        # `unit` takes a minute in all: what is marked to take longer is none of it.
        longer = any(item.get_closest_marker(marker) for marker in ("ci", "sim"))
        slow = {"unit"} if longer else set()
        for folder in (TIERS - slow).intersection(item.path.relative_to(HERE).parts):
            item.add_marker(folder)
        # Hypothesis marks its tests after this; it tells them by an attribute.
        properties = getattr(getattr(item, "obj", None), "is_hypothesis_test", False)
        if properties or "many" in getattr(item, "fixturenames", ()):
            item.add_marker("scaled")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """`-m unit` does not even read the other folders."""
    if config.option.markexpr != "unit" or collection_path.parent != HERE:
        return None
    return True if collection_path.name in TIERS - {"unit"} else None


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--robot",
        metavar="PORT",
        help="run the conformance suite against this port too (its configuration is put back)",
    )
    parser.addoption(
        "--nightly",
        action="store_true",
        help="many more examples and cases in the tests marked `scaled`",
    )


@pytest.fixture(scope="session")
def many(pytestconfig: pytest.Config) -> Callable[[int], int]:
    """How many cases to take where so many are usual: those, and in `make nightly` 20 times."""
    times = NIGHTLY_TIMES if pytestconfig.getoption("--nightly") else 1
    return lambda usual: usual * times


@pytest.fixture(scope="session", autouse=True)
def _own_runtime_folder() -> Iterator[None]:
    """Sockets of runs and robots of this worker's tests: no other worker sees or clears them."""
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory(prefix="tg") as folder:
        patch.setenv(OTHER_PLACE, folder)
        yield


@pytest.fixture
def own_sockets(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Runs and robots of this test are seen by this test only, and it sees no others; a socket's
    path has to be short.
    """
    folder = tempfile.mkdtemp(prefix="tg")
    monkeypatch.setenv(OTHER_PLACE, folder)
    yield
    shutil.rmtree(folder)


@pytest.fixture(scope="session")
def late_url(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The default room, of which only the last stages are explored: its address."""
    return room_file(tmp_path_factory.mktemp("late"), last_stages(), "late")


@pytest.fixture
def thigmo(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Thigmo:
    return thigmo_command(monkeypatch, capsys)


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Puts an emulated robot behind a serial port, in real time, until the test is over."""
    with ExitStack() as stack:

        def served(scene: Scene) -> ServedRobot:
            robot = ServedRobot(Lockstep(scene, VirtualBoard(1, brought_up()), seed=1))
            stack.callback(robot.close)
            return robot

        yield served
