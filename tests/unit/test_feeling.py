"""From a sweep to what is felt: how hard to press, and what is free."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from thigmo.config import SIGN, RobotConfig, Side
from thigmo.exploration.measuring import (
    held_back,
    measuring_pressure,
    pressing_zone,
    touch_curvature,
)
from thigmo.exploration.reference import FreeResponse
from thigmo.exploration.sighting import bend_grid, touch_mass
from thigmo.exploration.stage import Interpreter
from thigmo.field import fold_moment
from thigmo.robot import TRIGGER_PER_CM, SweepFrame, SweepResult

CONFIG = RobotConfig()
felt_sides = Interpreter(CONFIG).felt_sides


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
    pressure = measuring_pressure(frames, "left", CONFIG, zone=2)
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
    assert held_back(vented, "left").max() < 1e-9


@pytest.mark.parametrize(
    ("slope", "onset_psi", "zone"),
    [
        (-0.004, 2.0, 0),  # touched early: three times the moment
        (-0.004, 11.0, 1),  # later: at the highest pressure the muscle would bend it too little
        (-0.004, 14.5, 2),  # just before the end: at any higher one
        (-0.0006, 6.0, 2),  # the base is far from its fold
    ],
)
def test_the_body_pressure_is_raised_where_the_fold_limits(
    slope: float, onset_psi: float, zone: int
) -> None:
    frames = _half("left", slope, onset_psi)
    config = deepcopy(CONFIG)
    for each, amplitude in zip(config.muscle("left").maps, (0.026, 0.028, 0.03), strict=True):
        each.inflate.amplitude = amplitude
    assert pressing_zone(frames, {"left"}, config, 2) == zone
    assert pressing_zone(frames, {"left", "right"}, config, 2) == 2  # the right one felt nothing
    assert pressing_zone(frames, {"left"}, config, 0) == 0  # there is no higher one


def test_the_fold_moment_grows_with_body_pressure() -> None:
    assert fold_moment(CONFIG, 2) == pytest.approx(0.01108)
    assert fold_moment(CONFIG, 0) == pytest.approx(0.01108 * 3)


@pytest.mark.parametrize("side", ["left", "right"])
def test_only_what_holds_the_bend_back_is_a_touch(side: Side) -> None:
    back = -1 if side == "left" else 1
    held = SweepResult(frames=_half(side, 0.002 * back, 6.0, noise=4e-4))
    assert felt_sides(held) == {side}
    onset = touch_curvature(held.frames, side)
    assert onset is not None
    assert abs(onset) == pytest.approx((6.0 + 2.5) / 600, rel=0.1)
    further = SweepResult(frames=_half(side, -0.002 * back, 6.0, noise=4e-4))
    assert felt_sides(further) == set()
    assert touch_curvature(further.frames, side) is None


@pytest.mark.parametrize(("length_cm", "bend"), [(30.0, 1 / 300), (53.0, 1 / 600), (120, 1 / 1200)])
def test_a_touch_is_known_among_the_bends_of_a_body_of_any_length(
    length_cm: float, bend: float
) -> None:
    bends = bend_grid(length_cm)
    touched = touch_mass(_half("left", -1.2 * bend, 12.0, bend=bend), "left", bends, 5e-4)
    assert touched @ bends == pytest.approx(12.0 * bend, abs=3e-4)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_touch_is_where_the_excess_grows_faster_whatever_the_zero_and_the_map(side: Side) -> None:
    bends, way = bend_grid(53.0), SIGN[side]
    frames = [
        replace(frame, excess=frame.excess - way * 0.002 + 0.03 * frame.free_curvature)
        for frame in _half(side, -1.2 * way / 600, 8.0, noise=3e-4)
    ]
    touched = touch_mass(frames, side, bends, 1.6e-3)
    spread = np.sqrt(touched @ (bends - 8.0 / 600) ** 2)
    assert touched @ bends == pytest.approx(8.0 / 600, abs=5e-4)
    assert spread < 1e-3


def test_a_touch_beyond_all_bends_tells_nothing() -> None:
    """Two obstacles would share the last of them."""
    touched = touch_mass(_half("left", -0.004, 12.0, bend=1 / 300), "left", bend_grid(53.0), 5e-4)
    assert touched.max() < 1.1 / len(touched)


@pytest.mark.parametrize("gain", [0.0, 0.12])
def test_a_body_that_bends_less_than_its_map_touches_nothing(gain: float) -> None:
    frames = [
        replace(frame, excess=frame.excess - 2 * gain * frame.free_curvature)
        for frame in _half("left", 0.0, 0.0, noise=4e-4)
    ]
    assert (held_back(frames, "left").max() > TRIGGER_PER_CM) == (gain > 0)
    assert felt_sides(SweepResult(frames=frames)) == set()


@pytest.mark.parametrize("zero", [-0.001, 0.001])
def test_a_touch_that_holds_back_by_less_than_the_trigger_takes_is_felt(zero: float) -> None:
    frames = [
        replace(frame, excess=frame.excess + zero)
        for frame in _half("left", -1.2 / 600, 16.2, noise=4e-4)
    ]
    assert held_back(frames, "left").max() < TRIGGER_PER_CM
    assert felt_sides(SweepResult(frames=frames)) == {"left"}


def _free_sweep(gain: float, constant: float, rng: np.random.Generator) -> SweepResult:
    frames = _half("left", 0.0, 0.0)
    free = np.array([f.free_curvature for f in frames])
    readings = free[:, None] * gain + constant + 4e-4 * rng.standard_normal((len(frames), 10))
    return SweepResult(frames=frames, curvature=readings, sensors=0x3FF)


def test_free_sweeps_teach_scale_and_constant_and_sharpen_them() -> None:
    config = RobotConfig()
    for sensor in config.column("right"):
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


@pytest.mark.parametrize("bends", [1.1, 0.9])
def test_a_touch_of_a_body_that_bends_otherwise_than_its_map_is_felt(bends: float) -> None:
    frames = [
        replace(frame, excess=frame.excess + (bends - 1.0) * frame.free_curvature)
        for frame in _half("left", -1.3 / 600, 14.0, noise=4e-4)
    ]
    sweep = SweepResult(frames=frames)
    assert felt_sides(sweep) == {"left"}
    touch = touch_mass(frames, "left", bend_grid(53.0), 1.6e-3)
    assert touch @ bend_grid(53.0) == pytest.approx(14 / 600, abs=1e-3)


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


def test_sweeps_that_repeat_leave_less_doubt_than_sweeps_that_scatter() -> None:
    use = np.arange(10) >= 5
    doubt = []
    for scatter in (0.0, 4e-3):
        rng, response = np.random.default_rng(5), FreeResponse(CONFIG)
        for _ in range(6):
            sweep = _free_sweep(1.0, 0.0, rng)
            sweep.curvature[:] += scatter * rng.standard_normal(10)
            response.learn(sweep, "left", 2)
        said = response.expected("left", 2, 0.025, np.full(10, 0.025), use)
        doubt.append(np.hypot.reduce(said.shared_errors, axis=1).mean())
    assert doubt[0] < 0.8 * doubt[1]


def test_what_one_zone_teaches_of_the_map_is_expected_of_the_next() -> None:
    config = RobotConfig()
    for zone in config.muscle("left").maps:
        zone.scale_se = 0.01
    response = FreeResponse(config)
    for seed in range(3):
        response.learn(_free_sweep(0.9, 0.0, np.random.default_rng(seed)), "left", 0)
    use = np.arange(10) >= 5
    mean = response.expected("left", 1, 0.025, np.full(10, 0.0225), use).mean
    assert mean == pytest.approx(np.full(5, 0.0225), abs=8e-4)
