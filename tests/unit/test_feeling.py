"""From a sweep to what is felt: how hard to press, what is free, what earlier sweeps rule out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thigmo.config import RobotConfig, Side
from thigmo.exploration.known import beyond
from thigmo.exploration.measuring import (
    fold_moment,
    measuring_pressure,
    opposed_sides,
    touch_curvature,
)
from thigmo.exploration.reference import FreeResponse
from thigmo.exploration.swept import SweptSpace
from thigmo.localization import localize
from thigmo.robot import ContactTrigger, SweepFrame, SweepResult

CONFIG = RobotConfig()


def _half(side: Side, slope: float, onset_psi: float, noise: float = 0.0) -> list[SweepFrame]:
    """A half sine to 18 psi; beyond the onset the base's excess grows by `slope` per psi."""
    rng = np.random.default_rng(1)
    sign = 1 if side == "left" else -1
    return [
        SweepFrame(
            side,
            n / 20,
            psi,
            sign * psi / 600,
            slope * max(psi - onset_psi, 0.0) + noise * rng.standard_normal(),
            touched=False,
        )
        for n, psi in enumerate(18 * np.sin(np.linspace(0, np.pi, 190)))
    ]


def test_the_measurement_is_taken_short_of_the_fold() -> None:
    frames = _half("left", -0.002, 6.0, noise=5e-4)
    pressure = measuring_pressure(frames, "left", CONFIG, zone=2)
    excess = 0.002 * (pressure - 6.0)
    assert 0.5 * fold_moment(CONFIG, 2) < excess < fold_moment(CONFIG, 2)


def test_a_weak_contact_is_measured_where_it_is_strongest() -> None:
    assert measuring_pressure(_half("left", -0.0006, 6.0), "left", CONFIG, 2) > 17.5
    assert measuring_pressure([], "left", CONFIG, 2) == 18.0


def test_the_fold_moment_grows_with_body_pressure() -> None:
    assert fold_moment(CONFIG, 2) == pytest.approx(0.01108)
    assert fold_moment(CONFIG, 0) == pytest.approx(0.01108 * 3)


@pytest.mark.parametrize("side", ["left", "right"])
def test_only_what_holds_the_bend_back_is_a_touch(side: Side) -> None:
    back = -1 if side == "left" else 1
    trigger = ContactTrigger(side, 0.0, 0.006 * back)
    held = SweepResult([trigger], frames=_half(side, 0.002 * back, 6.0, noise=4e-4))
    assert opposed_sides(held) == {side}
    onset = touch_curvature(held.frames, side)
    assert onset is not None
    assert abs(onset) == pytest.approx((6.0 + 2.5) / 600, rel=0.1)
    further = SweepResult([trigger], frames=_half(side, -0.002 * back, 6.0, noise=4e-4))
    assert opposed_sides(further) == set()
    assert touch_curvature(further.frames, side) is None
    assert opposed_sides(SweepResult(frames=held.frames)) == set()  # the board saw nothing


def _free_sweep(gain: float, constant: float, rng: np.random.Generator) -> SweepResult:
    frames = _half("left", 0.0, 0.0)
    free = np.array([f.free_curvature for f in frames])
    readings = free[:, None] * gain + constant + 4e-4 * rng.standard_normal((len(frames), 10))
    return SweepResult(frames=frames, curvature=readings, sensors=0x3FF)


def test_free_sweeps_teach_scale_and_constant_and_sharpen_them() -> None:
    config = RobotConfig()
    for sensor in config.sensors.right:
        sensor.scale_se = 0.03
    response = FreeResponse(config)
    before, doubt = response.expected("left", 0.02)
    assert before == pytest.approx(np.full(10, 0.02))
    rng = np.random.default_rng(2)
    for _ in range(4):
        response.learn(_free_sweep(1.03, 5e-4, rng), "left")
    after, sharper = response.expected("left", 0.02)
    assert after[5:] == pytest.approx(np.full(5, 0.02 * 1.03 + 5e-4), abs=2.5e-4)
    assert (sharper[5:] < 0.5 * doubt[5:]).all()
    # The active side wrinkles, and the other direction was not swept: nothing is learnt of them.
    assert after[:5] == pytest.approx(np.full(5, 0.02))
    assert response.expected("right", -0.02)[0] == pytest.approx(np.full(10, -0.02))


def test_a_contact_lies_on_what_has_grown_since_the_last_free_sweep() -> None:
    swept = SweptSpace()
    swept.remember("left", 40.0, 0.029)
    swept.remember("left", 50.0, 0.029)
    swept.remember("right", 50.0, -0.028)
    assert swept.nearest_arc("left", 53.0, 0.02) == pytest.approx(48.25)
    assert swept.nearest_arc("left", 50.0, 0.02) == pytest.approx(38.25)
    assert swept.nearest_arc("left", 53.0, 0.0288) == 0.0  # the earlier sweep bent no further
    assert swept.nearest_arc("left", 40.0, 0.02) == 0.0


def test_what_is_known_narrows_the_posterior_and_keeps_the_moment_at_the_base() -> None:
    centers = np.array([5.0, 15, 25, 35, 45])
    readings = 2e-4 * np.maximum(49 - centers, 0)
    answer = localize(readings, centers, length=53, span=5.5, noise=1e-3)
    given = beyond(answer, 48.25, 53.0)
    (contact,), (free,) = given.contacts, answer.contacts
    assert 48.25 <= contact.interval[0] < contact.arc < contact.interval[1] <= 53
    assert contact.interval[1] - contact.interval[0] < free.interval[1] - free.interval[0]
    assert contact.force * contact.arc == pytest.approx(free.force * free.arc)
    assert contact.status == "localized"
    assert beyond(answer, 0.5 * free.interval[0], 53.0) is answer


def test_readings_that_contradict_what_is_known_leave_the_place_open() -> None:
    centers = np.array([5.0, 15, 25, 35, 45])
    readings = 4e-4 * np.maximum(22 - centers, 0)
    answer = localize(readings, centers, length=53, span=5.5, noise=2e-4)
    (contact,) = beyond(answer, 48.25, 53.0).contacts
    assert contact.interval == pytest.approx((48.25, 53.0))
    empty = replace(answer, contacts=())
    assert beyond(empty, 48.25, 53.0) is empty
