"""The boards that the conformance suite runs against."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from desk import Board, Desk

from thigmo.errors import PortError


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "desk" in metafunc.fixturenames:
        port = metafunc.config.getoption("--robot")
        backends = ["virtual", "mega-sim", "micropython", "skeleton", *([port] if port else [])]
        metafunc.parametrize("desk", backends, indirect=True, scope="module")


def virtual_board() -> Board:
    """The firmware core, natively."""
    from thigmo.emulator._board import VirtualBoard

    return VirtualBoard(1)


def simulated_mega() -> Board:
    """The real image on a simulated chip."""
    from thigmo.emulator.mega_sim import SimulatedMega

    try:
        return SimulatedMega(1)
    except PortError as error:  # its simulator or compiler is not installed
        pytest.skip(str(error))


def micropython() -> Board:
    """The core as a module of MicroPython's unix port."""
    from thigmo.emulator.micropython import MicroPythonBoard
    from thigmo.emulator.micropython_build import missing

    if reason := missing("unix"):
        pytest.skip(reason)
    return MicroPythonBoard(1)


def skeleton() -> Board:
    """The binding that a newcomer copies, on QEMU's Cortex-M3."""
    from skeleton import Skeleton, missing

    if reason := missing():
        pytest.skip(reason)
    return Skeleton(1)


SIMULATED = {
    "virtual": virtual_board,
    "mega-sim": simulated_mega,
    "micropython": micropython,
    "skeleton": skeleton,
}


@pytest.fixture(scope="module")
def desk(request: pytest.FixtureRequest) -> Iterator[Desk]:
    make = SIMULATED.get(request.param)
    try:
        desk = Desk(request.param, make() if make else None)
    except PortError as error:  # one line, not a traceback for each test
        pytest.exit(f"--robot: {error}", returncode=pytest.ExitCode.USAGE_ERROR)
    yield desk
    desk.put_back()
    desk.transport.close()
