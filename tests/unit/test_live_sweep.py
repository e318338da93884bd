"""What viewers see of a sweep while it goes on, and what it costs when there are none."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from thigmo.exploration.run_control import Live
from thigmo.stream import Posterior
from thigmo.stream.hub import Hub


class Interpreter:
    """Counts what it is asked."""

    def __init__(self) -> None:
        self.asked = 0

    def so_far(self, sweep: Any, body_pressure: int) -> Any:
        self.asked += 1
        return SimpleNamespace(
            side="left", places=np.array([1.0]), mass=np.array([1.0]), status="ambiguous",
            hypothesis="one peg", message="so far", probability=0.9,
        )  # fmt: skip


def _sweep(hub: Hub, interpreter: Interpreter) -> None:
    """Two seconds of a sweep, whose frames come twenty times a second."""
    now_s = 0.0
    robot: Any = SimpleNamespace(hub=hub, epoch_s=0.0, now=lambda: now_s)
    live = Live(robot)
    for frame in range(40):
        now_s = frame / 20
        live.sweeping(interpreter, SimpleNamespace(), 0, 40.0)  # type: ignore[arg-type]


def test_a_sweep_is_shown_twice_a_second_to_whoever_looks() -> None:
    hub, interpreter = Hub(), Interpreter()
    with hub.subscribe([Posterior.CHANNEL]) as viewer:
        _sweep(hub, interpreter)
        shown = viewer.take()
    assert interpreter.asked == len(shown) == 4
    assert all(isinstance(posterior, Posterior) and posterior.sweeping for posterior in shown)


def test_where_nobody_looks_nothing_is_computed() -> None:
    interpreter = Interpreter()
    _sweep(Hub(), interpreter)
    assert interpreter.asked == 0
