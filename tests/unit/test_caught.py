"""A sweep that begins with a body that something holds bent."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo.config import Side
from thigmo.exploration.measuring import caught_sides
from thigmo.robot import SweepFrame, SweepResult


def _sweep(side: Side, held_at_rest: float, gives_up: float) -> SweepResult:
    """A base that is held back by so much before it bends, and by a share of the bend after."""
    way = 1.0 if side == "left" else -1.0
    free = np.linspace(0.0, 0.03, 80)
    excess = -way * (held_at_rest + gives_up * np.maximum(free - 0.01, 0.0))
    frames = [
        SweepFrame(side, n / 20, 600 * g, way * g, e)
        for n, (g, e) in enumerate(zip(free.tolist(), excess.tolist(), strict=True))
    ]
    return SweepResult(frames=frames)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_peg_beside_a_straight_body_catches_nothing(side: Side) -> None:
    sweep = _sweep(side, 0.0, 1.2)
    assert caught_sides(sweep) == set()


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("held", [0.007, -0.007])
def test_a_body_that_is_bent_either_way_before_its_muscle_bends_it_is_caught(
    side: Side, held: float
) -> None:
    sweep = _sweep(side, held, 1.2)
    assert caught_sides(sweep) == {side}
