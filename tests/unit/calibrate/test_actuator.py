"""Actuator maps: right within their errors, offsets and lag found, mishaps named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_truth import DEFLATE, INFLATE, bends

from thigmo.calibrate.actuator import (
    BendReadings,
    fit_actuator,
    of_csv,
    readings_of,
    together,
)
from thigmo.calibrate.flex_lines import loop_turns
from thigmo.calibrate.lag import fit_lag
from thigmo.calibrate.step_figures import draw
from thigmo.config import SIDES, FlexSensor, Muscle, MuscleMap, RobotConfig, TanhMap
from thigmo.errors import DataError
from thigmo.record.table import Table, write_table
from thigmo.wiring import Wiring
from thigmo_bench.studies.gallery import gallery_robot

pytestmark = pytest.mark.sim  # sensors are simulated by the hundred

GRID = np.linspace(0.0, 18.0, 19)


def worst(made: TanhMap, true: TanhMap) -> float:
    return max(abs(made.curvature(p) - true.curvature(p)) for p in GRID)


@pytest.mark.parametrize("side", ["left", "right"])
def test_both_branches_within_half_a_percent_without_trial_offsets(side):
    for seed in range(6):
        result = fit_actuator(bends(seed, side, sigma=1e-4, offset=0.0))
        assert result.verdict.good, result.verdict
        assert worst(result.muscle_map.inflate, INFLATE) < 0.005 * result.full_scale
        assert worst(result.muscle_map.deflate, DEFLATE) < 0.005 * result.full_scale


def test_errors_of_g_agree_with_the_stated_ones():
    misses = []
    for seed in range(40):
        result = fit_actuator(bends(seed, offset=0.0))
        error = worst(result.muscle_map.inflate, INFLATE)
        misses.append(error / result.g_se)
    # g_se is the largest standard error over both branches: the largest error over the grid is
    # about one to two of it.
    assert 0.5 < np.sqrt(np.mean(np.square(misses))) < 1.7


def test_spread_of_trials_becomes_the_offset_error():
    errors = [fit_actuator(bends(seed, offset=6e-4, trials=8)).offset_se for seed in range(8)]
    assert np.mean(errors) == pytest.approx(6e-4, rel=0.35)


def test_the_scale_of_a_map_is_uncertain_by_what_trials_differ():
    """The next trial's gain, against the error stated; three trials tell it poorly."""
    scores, stated = [], []
    for seed in range(40):
        muscle_map = fit_actuator(bends(seed, gain=0.015)).muscle_map
        next_one = 1 + np.random.default_rng([seed, 1]).normal(0, 0.015)
        fitted = muscle_map.inflate.curvature(18.0) / INFLATE.curvature(18.0)
        scores.append((fitted - next_one) / muscle_map.scale_se)
        stated.append(fit_actuator(bends(seed)).muscle_map.scale_se)
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.25
    assert np.mean(stated) < 0.018  # trials that agree


def test_ten_percent_outliers_and_lost_pictures_are_left_out_and_said():
    clean = bends(3, offset=0.0)
    rng = np.random.default_rng(1)
    k = clean.curvature.copy()
    wild = rng.choice(len(k), len(k) // 10, replace=False)
    k[wild] += rng.choice([-1, 1], len(wild)) * rng.uniform(0.004, 0.03, len(wild))
    k[[2, 40]] = np.nan
    result = fit_actuator(replace(clean, curvature=k))
    assert result.verdict.good, result.verdict
    assert not result.used[wild].any()
    assert worst(result.muscle_map.inflate, INFLATE) < 0.01 * result.full_scale
    names = clean.names()
    outliers = next(note for note in result.verdict.notes if "outliers" in note)
    assert all(names[row] in outliers for row in wild if row != 2)
    lost = next(note for note in result.verdict.notes if "camera lost" in note)
    assert names[2] in lost
    assert names[40] in lost


def test_swapped_muscles_are_detected():
    readings = bends(4)
    result = fit_actuator(replace(readings, curvature=-readings.curvature))
    assert not result.verdict.good
    assert "swapped" in result.verdict.reason


def test_camera_moved_between_trials_is_detected():
    readings = bends(5)
    k = readings.curvature + np.where(readings.trial == 2, 6e-3, 0.0)
    result = fit_actuator(replace(readings, curvature=k))
    assert not result.verdict.good
    assert "moved" in result.verdict.reason


def swung(t: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Pressure as the bend feels it: delay, a muscle that empties slower, a body that swings."""
    fine = np.arange(0, t[-1] + 1e-9, 1e-3)
    late = np.interp(fine - 0.033, t, p)
    felt, x, v = late[0], late[0], 0.0
    swing, made = 2 * np.pi * 1.5, np.empty(len(fine))
    for i, value in enumerate(late):
        felt += (value - felt) * 1e-3 / (0.16 if value > felt else 0.22)
        v += 1e-3 * (swing**2 * (felt - x) - 2 * 0.5 * swing * v)
        x += 1e-3 * v
        made[i] = x
    return np.interp(t, fine, made)


@pytest.mark.parametrize(
    ("loop", "pressure_error"),
    [
        pytest.param(0.0, 0.0, marks=pytest.mark.ci),
        pytest.param(8e-4, 0.0, marks=pytest.mark.ci),
        (-4e-4, 0.08),
    ],
)
def test_lags_of_both_directions_are_found_beside_loop_and_pressure_error(
    loop, pressure_error, many
):
    muscle_map = MuscleMap(body_pressure_psi=0.49, inflate=INFLATE, deflate=DEFLATE)
    swing_s = 2 * 0.5 / (2 * np.pi * 1.5)
    corners, psi = [0.0], [2.5]
    for seconds in (0.7, 2.1, 0.7, 2.1):
        for target in (16.0, 2.5):
            corners += [corners[-1] + seconds, corners[-1] + seconds + 1.5]
            psi += [target, target]
    for seed in range(many(1)):
        rng = np.random.default_rng(seed)
        t = np.arange(0, corners[-1], 0.02)
        p = np.interp(t, corners, psi)
        felt = swung(t, p)
        floor, share = felt[0], []
        for value in felt:
            floor = min(max(floor, value - 1.0), value)
            share.append(1 - (value - floor))
        share = np.where(t < 0.5, 0.0, share)
        g = share * [DEFLATE.curvature(v) for v in felt]
        g += (1 - share) * [INFLATE.curvature(v) for v in felt]
        turn = loop_turns(g[:, None], np.zeros(len(g), np.int64))[:, 0]
        k = 1.1 * g - loop * turn + 0.001 + rng.normal(0, 3e-4, len(t))
        measured_psi = p + pressure_error + rng.normal(0, 0.03, len(t))
        lag = fit_lag(t, measured_psi, k, muscle_map)
        assert lag.inflate_s == pytest.approx(0.033 + 0.16 + swing_s, rel=0.03)
        assert lag.deflate_s == pytest.approx(0.033 + 0.22 + swing_s, rel=0.03)
        assert max(lag.inflate_se_s, lag.deflate_se_s) < 0.01


def test_a_ramp_without_a_bend_has_no_lag():
    t = np.arange(0, 12, 0.02)
    muscle_map = MuscleMap(body_pressure_psi=0.49, inflate=INFLATE, deflate=DEFLATE)
    with pytest.raises(DataError, match="no bend to time"):
        fit_lag(t, np.full(len(t), 3.0), np.zeros(len(t)), muscle_map)


def test_a_result_is_the_map_of_its_body_pressure(tmp_path):
    result = fit_actuator(bends(6, "right"))
    made = result.apply(RobotConfig())
    assert made.muscle("right").maps[2] == result.muscle_map
    assert made.muscle("right").maps[0] == RobotConfig().muscle("right").maps[0]
    draw(result, tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 10_000
    elsewhere = replace(bends(6), body_pressure_psi=3.0)
    with pytest.raises(DataError, match="no body pressure"):
        fit_actuator(elsewhere).apply(RobotConfig())


def test_a_map_of_a_body_without_pressure_is_put_in():
    robot = gallery_robot("catheter")
    assert [pressure.pressure_psi for pressure in robot.body.pressures] == [0.0]
    unpressed = fit_actuator(replace(bends(6), body_pressure_psi=0.0))
    assert unpressed.apply(robot).muscle("left").maps == [unpressed.muscle_map]
    with pytest.raises(DataError, match="no body pressure is"):
        fit_actuator(bends(6)).apply(robot)


def test_bends_of_a_lab_are_read_from_its_csv(tmp_path):
    config = RobotConfig()
    config.muscles[1].name = "starboard"
    both = [bends(7, "left"), bends(8, "starboard")]
    towards = {"left": 1.0, "starboard": -1.0}  # the camera's curvature is positive to the left
    columns = {
        "muscle": [r.muscle for r in both for _ in r.trial],
        "curvature": [towards[r.muscle] * k for r in both for k in r.curvature],
        "body_pressure_psi": [r.body_pressure_psi for r in both for _ in r.trial],
        **{
            name: [value for r in both for value in getattr(r, name)]
            for name in ("pressure_psi", "curvature_se", "branch", "trial")
        },
    }
    write_table(tmp_path / "bends.csv", columns)
    again = BendReadings.read_all(Table.read(tmp_path / "bends.csv"), config)
    assert [r.muscle for r in again] == ["left", "starboard"]
    columns["side"] = [SIDES[name == "starboard"] for name in columns.pop("muscle")]
    write_table(tmp_path / "older.csv", columns)
    older = BendReadings.read_all(Table.read(tmp_path / "older.csv"), config)
    assert [r.muscle for r in older] == ["left", "starboard"]
    np.testing.assert_array_equal(older[1].curvature, again[1].curvature)
    first, second = fit_actuator(both[1]), fit_actuator(again[1])
    assert second.muscle_map.inflate.amplitude == pytest.approx(
        first.muscle_map.inflate.amplitude, rel=1e-5
    )


def lifted(lies: float = 180.0) -> RobotConfig:
    """Left, right, and one muscle out of the plane, with four sensors at a direction of theirs."""
    config = RobotConfig()
    config.muscles.append(Muscle(name="up", angle_deg=0.0))
    config.sensors += [
        FlexSensor(angle_deg=lies, center_cm=center) for center in (5.0, 15.0, 25.0, 35.0)
    ]
    return config


def lifted_rows(config: RobotConfig, seed: int, gains: np.ndarray):
    """Bends of that muscle as the bench keeps them; its first sensor broke on the way."""
    rng = np.random.default_rng(seed)
    made, up = bends(seed, "up", sigma=0.0), config.muscles[2]
    reading_sensors = Wiring.laid_out(config).sensors_reading(up)
    rows = []
    for n, (k, psi) in enumerate(zip(made.curvature, made.pressure_psi, strict=True)):
        ohm = rng.normal(0, 500, 16)
        for reading_sensor, gain in zip(reading_sensors, gains, strict=True):
            read = reading_sensor.share * gain * k + rng.normal(0, 5e-4)
            ohm[reading_sensor.number] = read / reading_sensor.sensor.scale_per_ohm
        ohm[reading_sensors[0].number] = np.nan if n > 20 else ohm[reading_sensors[0].number]
        rows.append({"psi": psi, "ohm": ohm, "branch": made.branch[n], "trial": made.trial[n]})
    return rows


@pytest.mark.parametrize("lies", [180.0, 150.0])
def test_a_muscle_out_of_the_plane_is_mapped_by_the_sensors_that_read_its_bend(lies):
    config, scores = lifted(lies), []
    up = config.muscles[2]
    for seed in range(20):
        gains = 1 + np.random.default_rng([seed, 2]).normal(0, 0.15, 4)
        result = fit_actuator(
            readings_of(lifted_rows(config, seed, gains), Wiring.laid_out(config), up, 2)
        )
        assert result.verdict.good, result.verdict
        assert "as 4 sensors read it" in result.verdict.reason
        off = result.muscle_map.inflate.curvature(18.0) / INFLATE.curvature(18.0) - 1
        assert result.muscle_map.scale_se > 0.07
        scores.append(off / result.muscle_map.scale_se)
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.4
    made = together([result]).apply(config)
    assert made.muscles[2].maps[2] == result.muscle_map
    assert made.muscles[2].maps[2].calibrated
    assert made.muscles[:2] == config.muscles[:2]
    assert not any(
        muscle_map.calibrated for muscle in made.muscles[:2] for muscle_map in muscle.maps
    )


def test_sensors_that_see_nothing_of_a_bend_do_not_make_a_map_of_it():
    config = lifted()
    up = config.muscles[2]
    still = fit_actuator(
        readings_of(lifted_rows(config, 0, np.zeros(4)), Wiring.laid_out(config), up, 2)
    )
    assert not still.verdict.good
    assert "does not bend when the up muscle" in still.verdict.reason
    turned = fit_actuator(
        readings_of(lifted_rows(config, 0, -np.ones(4)), Wiring.laid_out(config), up, 2)
    )
    assert "scale_per_ohm of the sensors has the wrong sign" in turned.verdict.reason


@pytest.mark.parametrize("lies", [0.0, 90.0, 60.0, 300.0, 110.0])
def test_sensors_that_wrinkle_or_lie_across_are_no_witnesses(lies):
    config = lifted(lies)
    assert Wiring.laid_out(config).sensors_reading(config.muscles[2]) == []
    left = [
        read.sensor.angle_deg for read in Wiring.laid_out(config).sensors_reading(config.muscles[0])
    ]
    assert left.count(270.0) == 5
    assert set(left) <= {270.0, 300.0}


def soft_bends(top_psi: float, *, pressure: float = 1.0, curvature: float = 1.0) -> str:
    """A CSV of a soft muscle that is measured to a low pressure, in other units if asked for."""
    rng = np.random.default_rng(7)
    rows = ["muscle,body_pressure_psi,pressure_psi,curvature,trial"]
    for trial in range(3):
        for psi in np.linspace(0, top_psi, 12):
            bend = 0.18 * (np.tanh((psi - 6) / 6) + np.tanh(1.0)) + rng.normal(0, 5e-4)
            rows.append(f"left,1.0,{psi * pressure:.4f},{bend * curvature:.6f},{trial}")
    return "\n".join(rows) + "\n"


def test_a_muscle_is_judged_within_its_pressures_and_swept_no_further(tmp_path):
    (tmp_path / "bends.csv").write_text(soft_bends(8.9))
    config = RobotConfig()
    results = of_csv(Table.read(tmp_path / "bends.csv"), config)
    assert results.verdict.good, results.verdict
    assert "no bend was measured above 8.90 psi" in str(results.verdict)
    swept = results.apply(config)
    assert swept.muscle("left").max_pressure_psi == 8.9
    assert swept.muscle("right").max_pressure_psi == config.muscle("right").max_pressure_psi


@pytest.mark.parametrize(
    ("units", "cure"),
    [
        ({"pressure": 6.895}, "divide kPa by 6.895 (then 8.9 psi)"),
        ({"curvature": 100.0}, "divide 1/m by 100"),
    ],
)
def test_other_units_are_noticed(tmp_path, units, cure):
    (tmp_path / "bends.csv").write_text(soft_bends(8.9, **units))
    with pytest.raises(DataError) as refused:
        of_csv(Table.read(tmp_path / "bends.csv"), RobotConfig())
    assert cure in str(refused.value)


def test_bends_at_high_pressures_alone_are_no_map(tmp_path):
    rows = soft_bends(8.9).splitlines()
    high = [row for row in rows[1:] if float(row.split(",")[2]) > 5]
    (tmp_path / "bends.csv").write_text("\n".join([rows[0], *high]) + "\n")
    with pytest.raises(DataError, match="ten pressures from 0"):
        of_csv(Table.read(tmp_path / "bends.csv"), RobotConfig())


def test_bends_that_no_tanh_follows_are_named_and_trials_counted():
    psi = np.linspace(0.0, 8.0, 20)
    step = np.interp(psi, [0.0, 4.5, 4.9, 8.0], [0.0, 0.012, 0.08, 0.226])  # of a sold actuator
    rng = np.random.default_rng(2)
    bent = [step + rng.normal(0, 3e-4, step.size) for _ in range(4)]

    def fitted(count: int) -> str:
        lone = bends(1, trials=1)
        readings = BendReadings(
            lone.muscle, lone.body_pressure_psi, np.tile(psi, count), np.concatenate(bent[:count]),
            np.full(count * psi.size, 2e-4), ("inflate",) * (count * psi.size),
            np.repeat(np.arange(count), psi.size),
        )  # fmt: skip
        return str(fit_actuator(readings).verdict)

    once, often = fitted(1), fitted(4)
    assert "add trials, to " in once
    assert "than its map, a tanh, in all trials" in once
    assert "than its map, a tanh, in all trials" in often
    assert "than its map" not in str(fit_actuator(bends(1)).verdict)
