"""A robot on a port while a fit computes: it is minded, however long that takes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from emulated import Serve, last_stages
from served import EVER_S, comes

from thigmo.errors import ThigmoError
from thigmo.exploration import explore
from thigmo.operator_prompts import Dowel
from thigmo.robot.stopping import stop_robot

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("own_sockets")]

LENGTH_CM = 20.0


class Assistant:
    """Does as asked; the emulator's regulator follows the board by itself."""

    def everted_length_cm(self) -> float:
        return LENGTH_CM

    def set_body_pressure(self, pressure_psi: float) -> None:
        pass

    def warn(self, danger: str) -> None:
        pass

    def place_pegs(self, pegs: Sequence[Dowel]) -> None:
        pass


def test_a_stop_ends_a_fit(serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    room = last_stages(LENGTH_CM, "empty")
    served = serve(room)
    fitting = threading.Event()

    def endless(*_: object, meanwhile: Callable[[], None], **__: object) -> None:
        fitting.set()
        until = time.monotonic() + EVER_S
        while time.monotonic() < until:
            meanwhile()
        raise AssertionError("the stop did not end the fit")

    monkeypatch.setattr("thigmo.exploration.fitted.contacts", endless)
    stopping = threading.Thread(target=lambda: fitting.wait(EVER_S) and stop_robot(served.port))
    stopping.start()
    with pytest.raises(ThigmoError, match="stopped"):
        explore(served.port, config=room.robot, operator=Assistant(), out=tmp_path)
    stopping.join()
    assert comes(lambda: served.off)
