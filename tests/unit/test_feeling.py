"""From a sweep to how hard to press for a measurement."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from thigmo.config import SIGN, RobotConfig, Side
from thigmo.exploration.measuring import (
    curvature_deficit,
    measuring_pressure,
    pressing_body_pressure,
    touch_curvature,
)
from thigmo.field import fold_moment
from thigmo.robot import SweepFrame, SweepResult

CONFIG = RobotConfig()


def _half(
    side: Side, slope: float, onset_psi: float, noise: float = 0.0, bend: float = 1 / 600
) -> list[SweepFrame]:
    """A half sine to 18 psi, which bends by `bend` per psi.

    Beyond the onset the base's excess grows by `slope` per psi.
    """
    rng = np.random.default_rng(1)
    sign = SIGN[side]
    return [
        SweepFrame(
            side,
            n / 20,
            psi,
            sign * psi * bend,
            slope * max(psi - onset_psi, 0.0) + noise * rng.standard_normal(),
        )
        for n, psi in enumerate(18 * np.sin(np.linspace(0, np.pi, 190)))
    ]


def test_the_measurement_is_taken_short_of_the_fold() -> None:
    frames = _half("left", -0.002, 6.0, noise=5e-4)
    pressure = measuring_pressure(frames, "left", CONFIG, body_pressure=2)
    excess = 0.002 * (pressure - 6.0)
    assert 0.5 * fold_moment(CONFIG, 2) < excess < fold_moment(CONFIG, 2)


def test_a_weak_contact_is_measured_where_it_is_strongest() -> None:
    assert measuring_pressure(_half("left", -0.0006, 6.0), "left", CONFIG, 2) > 17.5
    assert measuring_pressure([], "left", CONFIG, 2) == 18.0


def test_a_base_that_reads_too_much_is_measured_where_it_is_held_back_most() -> None:
    frames = [
        replace(frame, excess=frame.excess + 0.16 * frame.free_curvature)
        for frame in _half("left", -0.0009, 10.0)
    ]
    assert measuring_pressure(frames, "left", CONFIG, 2) > 17.5


def test_a_body_that_straightens_sooner_than_its_map_says_is_not_held_back() -> None:
    frames = _half("left", 0.0, 6.0)
    vented = [replace(frame, excess=-0.006) if frame.t_s > 6.0 else frame for frame in frames]
    assert curvature_deficit(vented, "left").max() < 1e-9


@pytest.mark.parametrize(
    ("slope", "onset_psi", "body_pressure"),
    [
        (-0.004, 2.0, 0),  # touched early: three times the moment
        (-0.004, 11.0, 1),  # later: at the highest pressure the muscle would bend it too little
        (-0.004, 14.5, 2),  # just before the end: at any higher one
        (-0.0006, 6.0, 2),  # the base is far from its fold
    ],
)
def test_the_body_pressure_is_raised_where_the_fold_limits(
    slope: float, onset_psi: float, body_pressure: int
) -> None:
    frames = _half("left", slope, onset_psi)
    config = deepcopy(CONFIG)
    for muscle_map, amplitude in zip(config.muscle("left").maps, (0.026, 0.028, 0.03), strict=True):
        muscle_map.inflate.amplitude = amplitude
    assert pressing_body_pressure(frames, {"left"}, config, 2) == body_pressure
    # The right one felt nothing.
    assert pressing_body_pressure(frames, {"left", "right"}, config, 2) == 2
    assert pressing_body_pressure(frames, {"left"}, config, 0) == 0  # there is no higher one


def test_the_fold_moment_grows_with_body_pressure() -> None:
    assert fold_moment(CONFIG, 2) == pytest.approx(0.01108)
    assert fold_moment(CONFIG, 0) == pytest.approx(0.01108 * 3)


@pytest.mark.parametrize("side", ["left", "right"])
def test_only_what_holds_the_bend_back_is_a_touch(side: Side) -> None:
    back = -1 if side == "left" else 1
    held = SweepResult(frames=_half(side, 0.002 * back, 6.0, noise=4e-4))
    onset = touch_curvature(held.frames, side)
    assert onset is not None
    assert abs(onset) == pytest.approx((6.0 + 2.5) / 600, rel=0.1)
    further = SweepResult(frames=_half(side, -0.002 * back, 6.0, noise=4e-4))
    assert touch_curvature(further.frames, side) is None
