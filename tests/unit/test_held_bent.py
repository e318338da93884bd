"""Zeros that move while the robot grows say that it leans on a peg; zeros that creep do not."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo.config import RobotConfig
from thigmo.exploration.stall import HeldBent, detect_held_bent
from thigmo.robot import Profile, SensorTable
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring

TABLE = SensorTable.laid_out(Wiring.laid_out(RobotConfig()))
LENGTHS = np.linspace(30.0, 40.0, 120)
_KNOWN = (0, 1, 5, 6)  # zeroed before, at 5 and 15 cm of either side


def _grown(
    force: float, met_cm: float, creep: float = 0.0, alone: float = 0.0, hung: float = 0.0
) -> HeldBent | None:
    """A growth in which a peg at `met_cm` bends the body; `creep` moves the zeros only after it,
    and `alone` moves that of one sensor meanwhile; `hung` is the bend at 15 cm from its start on.
    """
    rng = np.random.default_rng(3)
    before: Floats = np.full(10, np.nan)
    before[list(_KNOWN)] = rng.normal(0.0, 0.4, len(_KNOWN))
    lever = np.maximum(met_cm - TABLE.center_cm, 0.0)
    step = np.clip((LENGTHS - met_cm) / 1.0 + 0.5, 0.0, 1.0)[:, None]
    change = force * lever + alone * (np.arange(10) == _KNOWN[0])
    bent = step * change
    hanging = hung * np.isin(np.arange(10), _KNOWN) * np.where(TABLE.center_cm < 10.0, 0.3, 1.0)
    bent, change = bent + hanging, change + hanging
    readings = np.nan_to_num(before) + bent + rng.normal(0.0, 3e-4, bent.shape)
    after = np.nan_to_num(before) + change + creep
    return detect_held_bent(Profile(LENGTHS / 2.0, LENGTHS, readings), before, after, TABLE)


@pytest.mark.parametrize("force", [2e-4, -2e-4])
def test_a_body_that_was_bent_while_it_grew_leans_where_the_bend_appeared(force: float) -> None:
    growth = _grown(force, 34.0)
    assert growth is not None
    assert growth.interval_cm[0] < 34.0 < growth.interval_cm[1]
    assert growth.arc_cm == pytest.approx(34.0, abs=0.5)
    assert growth.force_per_cm2 == pytest.approx(force, rel=0.03)


def test_a_straight_body_and_zeros_that_creep_are_no_lean() -> None:
    assert _grown(0.0, 34.0) is None
    assert _grown(3e-6, 34.0) is None
    assert _grown(0.0, 34.0, creep=5e-3) is None  # moved, but not while the robot grew


@pytest.mark.parametrize("moved", [8e-3, -8e-3])
def test_a_zero_that_moves_alone_is_no_lean(moved: float) -> None:
    assert _grown(0.0, 34.0, alone=moved) is None


@pytest.mark.parametrize("hung", [1e-2, -1e-2])
def test_a_body_that_a_sweep_left_bent_hangs_where_its_end_was(hung: float) -> None:
    growth = _grown(0.0, 34.0, hung=hung)
    assert growth is not None
    assert growth.hangs
    assert growth.clear_cm < LENGTHS[0] - TABLE.radius_cm
    leaning = _grown(2e-4, 34.0)
    assert leaning is not None
    assert not leaning.hangs


def test_a_held_body_is_released_when_its_tip_is_clear_and_moved_zeros_are_not() -> None:
    held = _grown(2e-4, 34.0)
    assert held is not None
    assert held.clear_cm < held.interval_cm[0]
    bent = np.nan_to_num(held.bend)
    assert held.released(bent, 1e-4 * np.ones(10))
    assert not held.released(bent, 0.9 * bent)


def test_a_body_is_taken_to_be_held_if_no_sensor_says_otherwise() -> None:
    held = _grown(2e-4, 34.0)
    assert held is not None
    bent = np.nan_to_num(held.bend)
    assert held.released(bent, bent)  # zeros that were not taken again
    assert held.released(bent, np.full(10, np.nan))
