"""A sweep that begins with a body that something holds bent."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo.config import RobotConfig, Side
from thigmo.exploration.measuring import caught_sides
from thigmo.robot import SensorTable, SweepFrame, SweepResult
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring

TABLE = SensorTable.laid_out(Wiring.laid_out(RobotConfig()))


def _sweep(side: Side, held_at_rest: Floats, gives_up: float) -> SweepResult:
    """A body that is held by so much (10,) before its muscle bends it, and by a share of the bend
    after.
    """
    way = 1.0 if side == "left" else -1.0
    free = np.linspace(0.0, 0.03, 80)
    excess = -way * (held_at_rest + gives_up * np.maximum(free - 0.01, 0.0)[:, None])
    frames = [
        SweepFrame(side, n / 20, 600 * g, way * g, float(e))
        for n, (g, e) in enumerate(zip(free.tolist(), excess[:, 0], strict=True))
    ]
    return SweepResult(frames=frames, curvature=way * free[:, None] + excess, sensors=-1)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_peg_beside_a_straight_body_catches_nothing(side: Side) -> None:
    assert caught_sides(_sweep(side, np.zeros(10), 1.2), TABLE) == set()


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("held", [0.007, -0.007])
def test_a_body_that_is_bent_either_way_before_its_muscle_bends_it_is_caught(
    side: Side, held: float
) -> None:
    assert caught_sides(_sweep(side, np.full(10, held), 1.2), TABLE) == {side}


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_body_whose_base_is_straight_is_caught_by_its_end(side: Side) -> None:
    held = np.tile([0.0, 0.0, 0.008, 0.016, 0.012], 2)
    assert caught_sides(_sweep(side, held, 1.2), TABLE) == {side}


@pytest.mark.parametrize("side", ["left", "right"])
def test_one_zero_that_moved_catches_nothing(side: Side) -> None:
    held = np.tile([0.0, 0.0, 0.02, 0.0, 0.0], 2)
    assert caught_sides(_sweep(side, held, 1.2), TABLE) == set()
