"""A peg at rest is found from all frames of an inflation: side and end, either side, any unit."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo.errors import DataError
from thigmo.localization import LocalizeResult, localize_obstacle
from thigmo.mechanics import Peg, Tube, solve

FREE = np.array([0.0175, 0.0213, 0.0241])
COLUMN = np.array([5.0, 15.0, 25.0, 35.0, 45.0])
CRITICAL = 0.01108


def peg(arc: float, touch: float = 0.0175) -> Peg:
    """That the body just touches with its left side."""
    turn, reach = touch * arc, 1.75 + 0.6
    return Peg(
        np.sin(turn) / touch - reach * np.sin(turn),
        (1 - np.cos(turn)) / touch + reach * np.cos(turn),
        0.6,
    )


def answer(
    obstacle: Peg | None, noise: float, sign: float = 1.0, unit: float = 1.0
) -> LocalizeResult:
    tube = Tube(3.5, CRITICAL)
    bodies = [solve(g, 53.0, tube=tube, pegs=[obstacle] if obstacle else []) for g in FREE]
    frames = np.array([body.averages(COLUMN, 5.5) for body in bodies])
    frames += noise * np.random.default_rng(0).standard_normal(frames.shape)
    return localize_obstacle(
        sign * frames / unit,
        COLUMN * unit,
        length=53.0 * unit,
        span=5.5 * unit,
        free_curvature=sign * FREE / unit,
        noise=max(noise, 1e-4) / unit,
        critical_curvature=CRITICAL / unit,
        tube_radius=1.75 * unit,
        peg_radius=0.6 * unit,
    )


@pytest.mark.parametrize("arc", [53.0, 40.0, 26.0])
def test_without_noise_the_peg_is_found(arc: float) -> None:
    true = peg(arc)
    result = answer(true, 0.0)
    assert result.parameters["peg_x"] == pytest.approx(true.x, abs=0.5)
    assert result.parameters["peg_y"] == pytest.approx(true.y, abs=0.5)
    assert (result.contacts[0].end_offset is not None) == (arc == 53.0)


def test_sides_are_mirrored_and_units_scale() -> None:
    left = answer(peg(40.0), 2e-4)
    right = answer(peg(40.0), 2e-4, sign=-1.0, unit=0.01)
    assert right.contacts[0].arc == pytest.approx(0.01 * left.contacts[0].arc, rel=1e-6)
    assert right.contacts[0].force == pytest.approx(-1e4 * left.contacts[0].force, rel=1e-6)
    assert right.parameters["peg_y"] == pytest.approx(-0.01 * left.parameters["peg_y"], rel=1e-6)


def test_a_free_body_touches_nothing() -> None:
    result = answer(None, 4e-4)
    assert not result.contacts
    assert result.status in ("no contact", "below detection")


def test_frames_must_bend_further_each() -> None:
    with pytest.raises(DataError, match="further"):
        localize_obstacle(
            np.zeros((2, 5)), COLUMN, length=53.0, free_curvature=[0.02, 0.01], noise=5e-4
        )
