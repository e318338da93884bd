"""Flex calibration: right within its stated errors, and every mishap of a lab named."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest
from calibration_truth import CENTERS, LENGTH, SPANS, Lab, merge, real_sweeps

from thigmo.calibrate import thesis
from thigmo.calibrate.flex import FlexResult, fit_flex
from thigmo.calibrate.flex_data import FlexReadings
from thigmo.calibrate.flex_lines import loop_turns
from thigmo.calibrate.flex_rows import tip_curvature
from thigmo.calibrate.regression import fit_linear
from thigmo.calibrate.step_figures import draw
from thigmo.calibrate.steps import fit_csv
from thigmo.config import HeadingSensor, RobotConfig
from thigmo.errors import DataError
from thigmo.mechanics import push
from thigmo.record.table import Table

pytestmark = pytest.mark.sim  # sensors are simulated by the hundred


def errors(result: FlexResult, lab: Lab) -> np.ndarray:
    """Relative errors of the scales; nan for sensors given up."""
    return np.array(
        [f.scale_per_ohm / s - 1 if f.healthy else np.nan
         for f, s in zip(result.sensors, lab.scale, strict=True)]
    )  # fmt: skip


@pytest.mark.ci
def test_stated_errors_cover_the_true_ones_over_many_labs(many):
    """Scales and zeros of 18 labs, ten sensors each: their z-scores spread as they say.

    A lab's ten sensors share the places of the camera, so the 180 scores count as fewer.
    """
    scales, zeros, relative = [], [], []
    for seed in range(100, 100 + many(18)):
        lab = Lab(seed)
        result = fit_flex(lab.flex(), lab.config)
        assert result.verdict.good, result.verdict
        relative.extend(errors(result, lab))
        fits = [f for f in result.sensors if f.healthy]
        true = [(s, z) for f, s, z in zip(result.sensors, lab.scale, lab.zero, strict=True)
                if f.healthy]  # fmt: skip
        assert len(fits) == 10
        scales += [
            (f.scale_per_ohm / s - 1) / f.scale_se for f, (s, _) in zip(fits, true, strict=True)
        ]
        zeros += [(f.zero_ohm - z) / f.zero_se_ohm for f, (_, z) in zip(fits, true, strict=True)]
    for scores in (scales, zeros):
        assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.25
        assert np.mean(np.abs(scores) > 3) < 0.02
    assert abs(np.mean(scales)) < 0.25  # no bias
    assert np.sqrt(np.mean(np.square(relative))) < 0.02


def test_spans_of_imus_beside_flex_sensors_are_not_judged_as_these():
    lab = Lab(5)
    for number in (3, 4):
        old = lab.config.sensors[number]
        lab.config.sensors[number] = HeadingSensor(
            kind="heading", angle_deg=old.angle_deg, center_cm=old.center_cm,
            span_cm=10.0, i2c_address=74 + number,
        )  # fmt: skip
    readings = lab.flex()
    drifting = readings.ohm.copy()
    drifting[:, 3:5] += 40.0 * np.arange(len(drifting))[:, None]
    result = fit_flex(replace(readings, ohm=drifting), lab.config)
    assert result.verdict.good, result.verdict
    assert [fit.healthy for fit in result.sensors] == [True] * 3 + [False] * 2 + [True] * 5
    assert not any("left 3" in note for note in result.verdict.notes)


def test_ten_tip_places_alone_leave_distal_sensors_uncertain_and_say_so():
    lab = Lab(0)
    result = fit_flex(lab.flex(bends=0, straight=3), lab.config)
    base, distal = result.sensors[0], result.sensors[4]
    assert base.scale_se < 0.06
    assert distal.scale_se > 0.1
    assert not distal.healthy
    assert "take more places and bends" in distal.reason


def test_zero_noise_and_direction_are_reported():
    lab = Lab(3)
    result = fit_flex(lab.flex(places=20, bends=30), lab.config)
    for fit, zero in zip(result.sensors, lab.zero, strict=True):
        assert abs(fit.zero_ohm - zero) < 4 * fit.zero_se_ohm
        assert fit.bend_sign == 0
        assert fit.noise == pytest.approx(6e-4, rel=0.5)


def test_one_way_sensor_is_found():
    lab = Lab(4)
    readings = lab.flex(places=24, bends=0)
    k = result_curvature(readings)
    ohm = readings.ohm.copy()
    dull = lab.zero[0] + np.where(k[:, 0] > 0, k[:, 0] / lab.scale[0], 0)
    ohm[:, 0] = dull + lab.rng.normal(0, 5, len(dull))
    fit = fit_flex(replace(readings, ohm=ohm), lab.config).sensors[0]
    assert fit.bend_sign == 1
    assert fit.scale_per_ohm == pytest.approx(lab.scale[0], rel=0.05)


def result_curvature(readings: FlexReadings) -> np.ndarray:
    return np.array(
        [np.zeros(10) if kind == "straight"
         else tip_curvature(tip[1], LENGTH, CENTERS, SPANS)
         for kind, tip in zip(readings.kind, readings.tip_cm, strict=True)]
    )  # fmt: skip


def test_dead_sensor_is_named_and_left_out():
    lab = Lab(5)
    readings = lab.flex()
    ohm = readings.ohm.copy()
    ohm[:, 2] = 1e6  # open
    ohm[:, 7] = 11_000 + lab.rng.normal(0, 15, len(ohm))  # stuck
    result = fit_flex(replace(readings, ohm=ohm), lab.config)
    assert [f.name for f in result.sensors if not f.healthy] == ["left 2", "right 2"]
    assert "open or shorted" in result.sensors[2].reason
    assert "does not answer" in result.sensors[7].reason
    said = [note for note in result.verdict.notes if "omitted sensor" in note]
    assert ["left 2" in said[0], "right 2" in said[1], len(said)] == [True, True, 2]
    assert all("check its" in note for note in said)
    made = result.apply(lab.config)
    assert not made.column("left")[2].healthy
    assert np.nanmax(np.abs(errors(result, lab))) < 0.05


def test_lost_marker_is_named_and_left_out():
    lab = Lab(6)
    readings = lab.flex()
    tip = readings.tip_cm.copy()
    tip[5] = np.nan
    result = fit_flex(replace(readings, tip_cm=tip), lab.config)
    assert not result.rows.good[5]
    assert any("row 6: the camera lost the marker" in note for note in result.verdict.notes)
    named = tuple(f"tip {n}" for n in range(len(tip)))
    notes = fit_flex(replace(readings, tip_cm=tip, name=named), lab.config).verdict.notes
    assert any("omitted tip 5: the camera lost the marker" in note for note in notes)
    assert np.abs(errors(result, lab)).max() < 0.05


@pytest.mark.parametrize("asked", [True, False])
def test_tip_on_the_wrong_side_is_detected(asked):
    lab = Lab(7)
    readings = lab.flex()
    row = readings.kind.index("tip") + 1
    tip, want = readings.tip_cm.copy(), readings.intended_y_cm.copy()
    tip[row, 1] *= -1  # the camera saw the other side than the sensors felt
    if not asked:
        want[:] = np.nan
    result = fit_flex(replace(readings, tip_cm=tip, intended_y_cm=want), lab.config)
    assert not result.rows.good[row]
    said = "on the other side than asked for" if asked else "the sensors say"
    assert any(f"row {row + 1}: " in note and said in note for note in result.verdict.notes)
    assert np.abs(errors(result, lab)).max() < 0.05


def test_a_bend_within_the_camera_s_error_is_on_no_side():
    """Quiet sensors read a body that lies a little to the right; the picture says to the left."""
    lab = Lab(7, sigma=5e-5)
    readings = lab.flex()
    row = readings.kind.index("bend")
    for off, omitted in ((3e-4, False), (1e-5, True)):
        curvature, error = readings.curvature.copy(), readings.curvature_se.copy()
        ohm = readings.ohm.copy()
        curvature[row], error[row], ohm[row] = 6e-4, off, lab.ohm(np.full(10, -6e-4))
        result = fit_flex(
            replace(readings, curvature=curvature, curvature_se=error, ohm=ohm), lab.config
        )
        assert any("the sensors say" in note for note in result.verdict.notes) == omitted


def test_a_camera_whose_sides_are_exchanged_is_detected():
    lab = Lab(7)
    readings = lab.flex(bends=24)
    mirrored = replace(
        readings, tip_cm=readings.tip_cm * np.array([1, -1]), curvature=-readings.curvature
    )
    verdict = fit_flex(mirrored, lab.config).verdict
    assert not verdict.good
    assert "+y is not the robot's left" in verdict.reason


def test_moved_camera_is_detected_and_later_rows_left_out():
    lab = Lab(8)
    readings = lab.flex(places=16)
    order = np.r_[np.arange(3), 3 + lab.rng.permutation(16), np.arange(19, len(readings.kind))]
    tip = readings.tip_cm[order].copy()
    tip[11:19, 1] += 2.0
    shuffled = replace(
        readings, tip_cm=tip, ohm=readings.ohm[order], intended_y_cm=np.full(len(order), np.nan)
    )
    result = fit_flex(shuffled, lab.config)
    said = [note for note in result.verdict.notes if "moved" in note]
    assert said, result.verdict
    assert "omitted row " in said[0]
    assert "`thigmo camera locate`" in said[0]
    assert not result.rows.good[12:19].any()
    assert result.rows.good[:10].all()
    assert np.nanmax(np.abs(errors(result, lab))) < 0.05


def test_ten_percent_outliers_do_not_bend_the_lines():
    for seed in range(5):
        lab = Lab(seed)
        readings = lab.flex(places=12, bends=24)
        ohm = readings.ohm.copy()
        wild = lab.rng.random(ohm.shape) < 0.1
        ohm[wild] += lab.rng.choice([-1, 1], wild.sum()) * lab.rng.uniform(300, 5000, wild.sum())
        result = fit_flex(replace(readings, ohm=ohm), lab.config)
        assert np.nanmax(np.abs(errors(result, lab))) < 0.06
        said = next(note for note in result.verdict.notes if "outliers" in note)
        for fit in result.sensors:
            if fit.healthy and fit.rejected:
                assert f"{fit.name}: {fit.rejected}" in said


def test_swapped_sides_are_detected():
    lab = Lab(9)
    readings = lab.flex(bends=24)
    swapped = np.hstack([readings.ohm[:, 5:], readings.ohm[:, :5]])
    result = fit_flex(replace(readings, ohm=swapped), lab.config)
    assert not result.verdict.good
    assert "swapped" in result.verdict.reason
    # No sensor is blamed for it.
    assert not any("omitted sensor" in note for note in result.verdict.notes)
    blind = fit_flex(lab.flex(places=20, bends=0), lab.config)
    assert any("the two columns are swapped" in note for note in blind.verdict.notes)


def test_a_tip_place_tells_the_curvature_and_large_deflection_matters():
    bent = push(2.2e-4, LENGTH, free_curvature=0.0, length=LENGTH)
    x, y, _ = bent.tip
    truth = bent.averages(CENTERS, SPANS)
    assert tip_curvature(y, LENGTH, CENTERS, SPANS) == pytest.approx(truth, rel=1e-4)
    small = 3 * y / x**3 * (x - CENTERS[:3])  # thesis, (2.12) and (2.9)
    assert np.abs(small / truth[:3] - 1).max() > 0.01


def test_round_trip_through_csv(tmp_path):
    lab = Lab(1)
    readings = lab.flex()
    readings.write(tmp_path / "flex.csv", lab.config)
    again = FlexReadings.read(Table.read(tmp_path / "flex.csv"), lab.config)
    first, second = fit_flex(readings, lab.config), fit_flex(again, lab.config)
    assert again.name == readings.name
    assert [f.scale_per_ohm for f in first.sensors] == pytest.approx(
        [f.scale_per_ohm for f in second.sensors], rel=1e-6
    )


@pytest.mark.parametrize(
    ("column", "factor", "said"),
    [
        ("ohm", 1e-3, r"resistances are about 10\.8; .*like kOhm: give Ohm"),
        ("ohm", -1.0, r"resistances are about -1\d{4}; give Ohm, above zero"),
        (
            "tip_cm",
            10.0,
            r"tips are about 52\d from the base of .* 53 cm; .*like mm: give cm",
        ),
        ("curvature", 100.0, r"curvatures are about 2, tighter .*; .*like 1/m: give 1/cm"),
    ],
)
def test_other_units_are_told_with_their_cure(tmp_path, column, factor, said):
    lab = Lab(1)
    readings = lab.flex()
    readings = replace(readings, **{column: factor * getattr(readings, column)})
    readings.write(tmp_path / "flex.csv", lab.config)
    with pytest.raises(DataError, match=said):
        FlexReadings.read(Table.read(tmp_path / "flex.csv"), lab.config)


def test_bad_input_is_refused_with_a_next_step(tmp_path):
    lab = Lab(1)
    (tmp_path / "bad.csv").write_text("kind,tip_x_cm\ntip,1\n")
    with pytest.raises(DataError, match="no column 'ohm_left_0'"):
        FlexReadings.read(Table.read(tmp_path / "bad.csv"), RobotConfig())
    with pytest.raises(DataError, match="rows can be used"):
        fit_flex(lab.flex(places=1, bends=0, straight=1), lab.config)
    with pytest.raises(DataError, match="cannot stand"):
        tip_curvature(50.0, LENGTH, CENTERS, SPANS)


def test_loop_turns_over_within_its_width_and_starts_anew_in_a_session():
    model = np.array([[0.0], [0.02], [0.018], [0.0], [0.0], [-0.02]])
    held = model.copy()
    turn = loop_turns(model, np.array([0, 0, 0, 0, 1, 1]), 5e-3)[:, 0]
    assert (model == held).all()
    assert turn[:4] == pytest.approx([0, 0.98, -1 + 1.98 * np.exp(-0.4), -0.96], abs=0.02)
    assert turn[4:] == pytest.approx([0, -0.98], abs=0.01)


def test_loop_and_one_way_column_are_found_with_the_scale():
    lab = Lab(11, sigma=1e-4)
    readings = lab.flex(places=16, bends=24)
    model = fit_flex(readings, lab.config).rows.model
    loop = lab.rng.normal(0, 4e-4, 10)
    turn = loop_turns(model, readings.block, 5e-3)
    weak = np.where(model * np.repeat([-1, 1], 5) < 0, 0.6, 1.0)
    k = model * weak + loop * turn
    wrinkled = np.array([[a == side for side in ["left"] * 5 + ["right"] * 5]
                         for a in readings.active])  # fmt: skip
    k = np.where(wrinkled, 0.3 * k + 0.01 * np.sin(400 * model), k)
    result = fit_flex(replace(readings, ohm=lab.ohm(k)), lab.config)
    assert [f.bend_sign for f in result.sensors] == [-1] * 5 + [1] * 5
    assert np.abs(errors(result, lab)).max() < 0.015
    hysteresis = np.array([f.hysteresis for f in result.sensors])
    assert np.corrcoef(hysteresis, loop)[0, 1] > 0.8


def test_merge_and_figure(tmp_path):
    lab = Lab(2)
    both = merge(lab.flex(bends=0), lab.flex(places=0, bends=12))
    result = fit_flex(both, lab.config)
    assert result.rows.readings.block.tolist() == [0] * 13 + [1] * 15
    assert (np.abs(errors(result, lab)) < 4 * np.array([f.scale_se for f in result.sensors])).all()
    draw(result, tmp_path / "flex.png")
    assert (tmp_path / "flex.png").stat().st_size > 20_000


def scores(first: FlexResult, second: FlexResult) -> list[float]:
    """By how many of their stated errors the scales of two recordings differ."""
    return [
        (a.scale_per_ohm - b.scale_per_ohm)
        / np.hypot(a.scale_se * a.scale_per_ohm, b.scale_se * b.scale_per_ohm)
        for a, b in zip(first.sensors, second.sensors, strict=True)
        if a.healthy and b.healthy
    ]


@pytest.mark.ci
def test_stated_errors_hold_from_sweep_to_sweep_and_half_to_half(many):
    """On sensors whose residuals last, whose gain changes, that curve, and that drop out."""
    halves, single, true = [], [], []
    for seed in range(many(5)):
        lab, sweeps = real_sweeps(seed, bow=0.3, lost=0.28)
        first, second = (
            fit_flex(reduce(merge, part), lab.config) for part in (sweeps[::2], sweeps[1::2])
        )
        halves += scores(first, second)
        single += scores(fit_flex(sweeps[0], lab.config), fit_flex(sweeps[1], lab.config))
        true += [
            (f.scale_per_ohm / scale - 1) / f.scale_se
            for f, scale in zip(first.sensors, lab.scale, strict=True)
            if f.name not in ("left 1", "right 1")
        ]
    for fit in (halves, single, true):
        assert len(fit) >= 40
        assert 0.8 < np.sqrt(np.mean(np.square(fit))) < 1.25


def test_a_sensor_that_drops_out_to_a_plausible_constant_is_told_and_its_rows_left_out():
    lab, sweeps = real_sweeps(7, sweeps=4, lost=0.28)
    result = fit_flex(reduce(merge, sweeps), lab.config)
    said = [note for note in result.verdict.notes if "loose wire" in note and "stands at" in note]
    assert [note[:7] for note in said] == ["left 2 ", "right 2"]
    assert np.abs(errors(result, lab)).max() < 0.05
    sound = real_sweeps(7, sweeps=4)[1]
    notes = fit_flex(reduce(merge, sound), lab.config).verdict.notes
    assert not any("stands at" in note for note in notes)


def test_a_nonlinearity_is_told_and_widens_the_error_that_the_localizer_gets():
    lab, sweeps = real_sweeps(8, sweeps=4, bow=0.58)
    result = fit_flex(reduce(merge, sweeps), lab.config)
    said = [note for note in result.verdict.notes if "curves" in note]
    assert [note.split(" curves")[0] for note in said] == [
        "the answer of left 1", "the answer of right 1",
    ]  # fmt: skip
    assert result.sensors[1].nonlinearity == pytest.approx(0.58, abs=0.06)
    made = result.apply(lab.config).column("left")
    assert made[1].scale_se > 0.1
    assert made[0].scale_se < 0.05


def test_one_sweep_of_one_loop_keeps_a_zero_that_a_sensor_can_have():
    """91 readings over one bend out: loop and zero look alike, but a loop is known to be small."""
    lab = Lab(3)
    k = np.linspace(0.0, 0.03, 91)
    ohm = lab.zero + (k[:, None] + 0.002 * (k[:, None] > 0.005)) / lab.scale
    ohm += lab.rng.normal(0, 40, ohm.shape)
    readings = FlexReadings(
        ("bend",) * 91, np.full((91, 2), np.nan), k, np.zeros(91), ("",) * 91,
        ohm, LENGTH, np.full(91, np.nan),
    )  # fmt: skip
    for fit, zero in zip(fit_flex(readings, lab.config).sensors, lab.zero, strict=True):
        assert fit.zero_ohm == pytest.approx(zero, rel=0.02)


def test_what_is_known_beforehand_is_never_an_outlier():
    rng = np.random.default_rng(0)
    x = np.linspace(0, 1, 30)
    design = np.column_stack([np.ones(30), x, x > 0.1])
    y = 5.0 + 3.0 * x + 20.0 * (x > 0.1) + rng.normal(0, 1e-3, 30)
    # The third coefficient is known to be 0 +- 0.1; the rows say 20.
    design, y = np.vstack([design, [0, 0, 1]]), np.append(y, 0.0)
    known = np.append(np.zeros(30), 0.1)
    assert not fit_linear(design, y, known).used[-1]
    assert fit_linear(design, y, known, firm=1).used[-1]


def test_the_thesis_s_fit_finds_the_constants_and_claims_no_error(tmp_path):
    """Equation 2.12 from tips alone; robot.toml must not call such a scale calibrated."""
    lab = Lab(4, sigma=1e-5)
    config = lab.config
    config.column("left")[0].scale_se = 0.01  # of an earlier calibration of other constants
    path = tmp_path / "flex.csv"
    lab.flex(places=20).write(path, config)
    result = fit_csv("flex", path, config, "thesis")
    assert result.verdict.good
    assert np.abs(errors(result, lab)).max() < 0.12  # small deflections, centres for spans
    made = result.apply(config)
    assert made.column("left")[0].scale_per_ohm == result.sensors[0].scale_per_ohm
    assert min(sensor.scale_se for sensor in made.column("left")) == 0.15
    draw(result, tmp_path / "flex.png")


def test_the_thesis_s_fit_needs_the_straight_robot_and_tips():
    lab = Lab(4)
    with pytest.raises(DataError, match="0 rows of the straight robot"):
        thesis.fit_flex(lab.flex(straight=0), lab.config)


def up_and_back(lab: Lab, back: bool, loop: float) -> FlexReadings:
    """Six sweeps a side, sensors with a loop of that half width (1/cm); `back`: down as well."""
    up = np.linspace(0, 1, 12)
    ramp = np.concatenate([up, up[-2::-1]]) if back else up
    parts, n = [], len(ramp)
    for number in range(12):
        sign, side = ((1, "left"), (-1, "right"))[number % 2]
        k = np.repeat(sign * 0.035 * ramp[:, None], 10, axis=1)
        turned = k + loop * loop_turns(k, np.zeros(n, np.int64), 5e-3)
        turned[:, slice(0, 5) if side == "left" else slice(5, 10)] *= 0.3  # the muscle's side
        parts.append(
            FlexReadings(
                ("bend",) * n, np.full((n, 2), np.nan), k[:, 0], np.full(n, 1e-4), (side,) * n,
                lab.ohm(turned), LENGTH, np.full(n, np.nan), np.full(n, number, np.int64),
            )
        )  # fmt: skip
    return reduce(merge, parts)


@pytest.mark.parametrize("loop", [3e-3, 1e-2])
def test_bends_that_only_grow_do_not_hide_what_the_loop_took(loop):
    lab = Lab(2, sigma=3e-4)
    grew = fit_flex(up_and_back(lab, False, loop), lab.config)
    assert not grew.verdict.good
    assert any("only ever grew" in note for note in grew.verdict.notes)
    wrong = [abs(f.scale_per_ohm / s - 1) for f, s in zip(grew.sensors, lab.scale, strict=True)]
    assert (np.array(wrong) < 2 * np.array([fit.scale_se for fit in grew.sensors])).all()
    both = fit_flex(up_and_back(lab, True, loop), lab.config)
    assert not any("only ever grew" in note for note in both.verdict.notes)
