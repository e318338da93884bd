"""From a sweep to what is felt: how hard to press, what is free, what earlier sweeps rule out."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from thigmo.config import RobotConfig, Side
from thigmo.exploration.feel import Felt, arc_grid, fused
from thigmo.exploration.map import ContactMap
from thigmo.exploration.measuring import (
    fold_moment,
    held_sides,
    measuring_pressure,
    touch_curvature,
)
from thigmo.exploration.reference import FreeResponse
from thigmo.exploration.stage import nearest_arc
from thigmo.exploration.workspace import Bend
from thigmo.localization import Contact
from thigmo.robot import ContactTrigger, Peak, SweepFrame, SweepResult

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
    assert held_sides(held) == {side}
    onset = touch_curvature(held.frames, side)
    assert onset is not None
    assert abs(onset) == pytest.approx((6.0 + 2.5) / 600, rel=0.1)
    further = SweepResult([trigger], frames=_half(side, -0.002 * back, 6.0, noise=4e-4))
    assert held_sides(further) == set()
    assert touch_curvature(further.frames, side) is None
    assert held_sides(SweepResult(frames=held.frames)) == set()  # the board saw nothing


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
    every = np.ones(10, dtype=np.bool_)
    readings = np.full(10, 0.02)
    before = response.expected("left", 2, 0.02, readings, every)
    assert before.mean == pytest.approx(readings)
    rng = np.random.default_rng(2)
    for _ in range(4):
        response.learn(_free_sweep(1.03, 5e-4, rng), "left", 2)
    after = response.expected("left", 2, 0.02, readings, every)
    assert after.mean[5:] == pytest.approx(np.full(5, 0.02 * 1.03 + 5e-4), abs=2.5e-4)
    doubt, sharper = (np.hypot.reduce(each.shared_errors, axis=1) for each in (before, after))
    assert (sharper[5:] < 0.5 * doubt[5:]).all()
    # All sensors depart alike: it is the map's scale, and the body itself bends so.
    assert 0.02 < after.body_curvature < 0.02 * 1.03 + 5e-4
    # The other direction was not swept: nothing is learnt of it.
    right = response.expected("right", 2, -0.02, -readings, every)
    assert right.mean == pytest.approx(-readings)


def test_frames_before_the_touch_teach_a_map_that_is_a_tenth_off() -> None:
    use = np.arange(10) >= 5
    untaught = FreeResponse(CONFIG)
    taught = deepcopy(untaught)
    taught.learn(_free_sweep(0.9, 0.0, np.random.default_rng(3)), "left", 2, below=0.012)
    before, after = (
        np.hypot.reduce(
            each.expected("left", 2, 0.025, np.full(10, 0.0225), use).shared_errors, axis=1
        )
        for each in (untaught, taught)
    )
    mean = taught.expected("left", 2, 0.025, np.full(10, 0.0225), use).mean
    assert mean == pytest.approx(np.full(5, 0.0225), abs=3 * after.max())
    assert after.max() < 0.6 * before.min()


def test_a_body_that_swings_as_a_sweep_begins_does_not_bend_the_map() -> None:
    """Less bend at first, and nothing else: what is learnt below a touch holds at the peak."""
    sweep = _free_sweep(1.0, 0.0, np.random.default_rng(4))
    start = np.array([frame.t_s < 0.6 for frame in sweep.frames])
    sweep.curvature[start] -= 1.5e-3
    response = FreeResponse(CONFIG)
    response.learn(sweep, "left", 2, below=0.012)
    every = np.ones(10, dtype=np.bool_)
    mean = response.expected("left", 2, 0.025, np.full(10, 0.025), every).mean
    assert mean == pytest.approx(np.full(10, 0.025), abs=5e-4)


def test_what_one_zone_teaches_of_the_map_is_expected_of_the_next() -> None:
    config = RobotConfig()
    for zone in config.actuators.left.maps:
        zone.scale_se = 0.01
    response = FreeResponse(config)
    for seed in range(3):
        response.learn(_free_sweep(0.9, 0.0, np.random.default_rng(seed)), "left", 0)
    feeling = np.arange(10) >= 5
    mean = response.expected("left", 1, 0.025, np.full(10, 0.0225), feeling).mean
    assert mean == pytest.approx(np.full(5, 0.0225), abs=8e-4)


def test_a_contact_lies_on_what_has_grown_since_the_last_free_sweep() -> None:
    def swept(side: Side, length_cm: float, free_curvature: float) -> Peak:
        return Peak(side, 0.0, length_cm, np.zeros(10), free_curvature, 18.0, 0, 10, np.zeros(10))

    untouched = [swept("left", 40, 0.029), swept("left", 50, 0.029), swept("right", 50, -0.028)]
    assert nearest_arc(untouched, swept("left", 53, 0.03), 0.02) == pytest.approx(48.25)
    assert nearest_arc(untouched, swept("left", 50, 0.03), 0.02) == pytest.approx(38.25)
    assert nearest_arc(untouched, swept("left", 53, 0.03), 0.0288) == 0.0  # bent no further before
    assert nearest_arc(untouched, swept("left", 40, 0.03), 0.02) == 0.0
    assert nearest_arc(untouched, swept("left", 53, 0.03), None) == 0.0  # nothing touched it


def _felt(
    length: float, arc: float, deviation: float, side: Side = "left", turn: float = 0.02
) -> Felt:
    grid = arc_grid(53.0)
    mass = np.exp(-0.5 * ((grid - arc) / deviation) ** 2) * (grid <= length)
    interval = (arc - 1.96 * deviation, min(arc + 1.96 * deviation, length))
    force = -2e-4 if side == "left" else 2e-4
    bend = Bend(length, turn if side == "left" else -turn)
    contact = Contact(arc, force, interval, "localized")
    return Felt(side, length, bend, contact, mass / mass.sum(), "plain beam", 4)


def test_a_peg_felt_at_several_stages_is_one_contact_and_known_better() -> None:
    room = ContactMap(CONFIG)
    for length, arc in ((40.0, 33.0), (50.0, 37.0), (53.0, 36.0)):
        room.add(_felt(length, arc, 3.0))
    (contact,) = room.contacts
    assert contact.arc_cm == pytest.approx(np.mean([33.0, 37.0, 36.0]), abs=0.2)
    width = contact.interval_cm[1] - contact.interval_cm[0]
    assert width == pytest.approx(2 * 1.96 * 3.0 / 3**0.25, rel=0.15)
    assert contact.merged == [40.0, 50.0]
    assert contact.everted_length_cm == 53.0
    assert contact.force_per_cm2 * contact.arc_cm == pytest.approx(-2e-4 * 36.0)


def test_an_open_place_at_first_is_settled_by_the_stage_that_knows() -> None:
    room = ContactMap(CONFIG)
    first = _felt(40.0, 34.0, 3.0)
    grid = arc_grid(53.0)
    flat = ((grid >= 28.25) & (grid <= 40.0)).astype(float)
    room.add(replace(first, mass=flat / flat.sum()))
    room.add(_felt(50.0, 38.5, 2.0))
    (contact,) = room.contacts
    assert contact.arc_cm == pytest.approx(38.0, abs=0.6)


def test_pegs_on_other_sides_places_or_of_the_same_stage_stay_apart() -> None:
    room = ContactMap(CONFIG)
    room.add(_felt(53.0, 45.0, 1.0))
    room.add(_felt(53.0, 45.0, 1.0, side="right"))
    room.add(_felt(53.0, 43.0, 1.0))  # the same stage and side: another peg
    room.add(_felt(53.0, 20.0, 1.0))
    assert len(room.contacts) == 4


def test_one_wrong_stage_does_not_erase_the_others() -> None:
    grid = arc_grid(53.0)
    masses = [_felt(53.0, arc, 1.0).mass for arc in (30.0, 30.5, 29.5, 45.0)]
    mass = fused(grid, masses)
    assert mass.sum() == pytest.approx(1.0)
    assert grid[mass.argmax()] == pytest.approx(30.0, abs=0.3)
    assert mass[grid > 40].sum() < 2e-2
