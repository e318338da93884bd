"""The study of stopping: a trial begins with a driven transducer and ends with all outputs off."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from thigmo.errors import DataError
from thigmo_bench.studies import stopping

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize("way", ["Ctrl-C", "emergency stop", "cable"])
def test_each_trial_presses_and_is_stopped(way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    outputs = []

    class Seen(stopping.ServedRobot):
        def off_ms(self, press: Callable[[], object]) -> float:
            outputs.append((any(self.board.drive), self.off))
            took_ms = super().off_ms(press)
            outputs.append((any(self.board.drive), self.off))
            return took_ms

    monkeypatch.setattr(stopping, "ServedRobot", Seen)
    times = stopping.stopped_ms(way, 2)
    assert outputs == 2 * [(True, False), (False, True)]
    assert all(time > 0 for time in times)


def test_a_robot_that_is_off_was_not_stopped() -> None:
    with stopping.ServedRobot(1) as robot, pytest.raises(DataError, match="off before"):
        robot.off_ms(lambda: None)


def test_a_robot_that_nothing_stops_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stopping, "_EVER_S", 1.0)
    monkeypatch.setitem(stopping.WAYS, "prayer", ("", stopping.at_once(lambda *robot: None)))
    with pytest.raises(DataError, match="not stopped"):
        stopping.stopped_ms("prayer", 1)
