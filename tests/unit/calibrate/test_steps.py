"""Buckling, hysteresis, stiffness, noise, encoder, pressure and check against known truth."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibration_truth import CENTERS, LENGTH, SPANS

from thigmo.calibrate import thesis
from thigmo.calibrate.axis import AxisPoints
from thigmo.calibrate.buckling import fit_buckling
from thigmo.calibrate.check import CheckReadings, CheckResult, run_check
from thigmo.calibrate.encoder import fit_encoder
from thigmo.calibrate.hysteresis import CreepRecord, fit_decay, fit_hysteresis
from thigmo.calibrate.noise import fit_noise
from thigmo.calibrate.pressure import PressureResult, fit_pressure_zero
from thigmo.calibrate.step_figures import draw
from thigmo.calibrate.steps import fit_csv
from thigmo.calibrate.stiffness import fit_stiffness
from thigmo.config import Muscle, RobotConfig
from thigmo.errors import DataError
from thigmo.mechanics import push
from thigmo.mechanics.settling import Settling
from thigmo.record.table import write_table

CRITICAL = 0.01108


def pushes(seed: int, trials: int = 5) -> tuple[np.ndarray, float, float]:
    """Folded base: contact moment at the critical value, sides in turn."""
    rng = np.random.default_rng(seed)
    rows = []
    for trial in range(trials):
        sign = 1 if trial % 2 == 0 else -1
        moment = CRITICAL * (1 + rng.normal(0, 0.01))
        force = moment / LENGTH
        for _ in range(3):
            bent = push(sign * force, LENGTH, free_curvature=0.0, length=LENGTH)
            force *= moment / abs(bent.base_moment)
        k = push(sign * force, LENGTH, free_curvature=0, length=LENGTH).averages(CENTERS, SPANS)
        k = k.copy()
        k[[0, 5]] += sign * 0.15 / 5.5 * 0.23  # part of the fold lies under the base sensors
        rows.append(k + rng.normal(0, 3e-4, 10))
    return np.array(rows), 0.49, LENGTH


def test_critical_curvature_within_three_percent_and_within_its_error():
    config = RobotConfig()
    for sensor in (*config.column("left"), *config.column("right")):
        sensor.noise, sensor.zero_se, sensor.scale_se = 3e-4, 0.0, 0.0
    misses = []
    for seed in range(30):
        result = fit_buckling(*pushes(seed), config)
        assert result.verdict.good, result.verdict
        assert result.critical_curvature == pytest.approx(CRITICAL, rel=0.03)
        misses.append((result.critical_curvature - CRITICAL) / result.critical_se)
    assert 0.5 < np.mean(np.square(misses)) < 2.2  # five trials: Student's t


def test_the_thesis_s_line_reads_the_critical_curvature_off_at_the_base():
    config = RobotConfig()
    fits = [thesis.fit_buckling(*pushes(seed), config) for seed in range(30)]
    values = [result.critical_curvature for result in fits]
    assert np.mean(values) == pytest.approx(CRITICAL, rel=0.03)
    assert all(result.critical_se >= 0.1 * result.critical_curvature for result in fits)
    assert all(result.verdict.good and np.mean(result.excess) > 3e-3 for result in fits)


def test_gain_errors_widen_the_error_of_the_critical_curvature():
    config = RobotConfig()
    fits = []
    for gain in (0.0, 0.05):
        for sensor in (*config.column("left"), *config.column("right")):
            sensor.scale_se = gain
        fits.append(fit_buckling(*pushes(1), config).critical_se)
    assert fits[1] > 1.2 * fits[0]


def test_push_without_a_fold_is_left_out_and_an_outlier_trial_named():
    rows = pushes(2, trials=7)[0]
    rows[1] *= 0.5
    rows[1, [0, 5]] = rows[1, 1] * 48 / 38
    rows[4] *= 2.0
    result = fit_buckling(rows, 0.49, LENGTH, RobotConfig())
    assert np.isnan(result.trial_curvature[[1, 4]]).all()
    assert any("did not fold" in note for note in result.verdict.notes)
    assert any("outlier" in note for note in result.verdict.notes)
    assert result.critical_curvature == pytest.approx(CRITICAL, rel=0.03)


def test_base_sensors_at_the_end_of_the_fold_do_not_hide_it():
    """A sensor that begins at 3.45 cm, in a fold of 3.5 cm, shows too little of it to judge by."""
    config = RobotConfig()
    for side in ("left", "right"):
        for sensor in config.column(side):
            sensor.scale_se = 0.0
        config.column(side)[0].center_cm = 6.2
    rows = pushes(3)[0]
    rows[:, [0, 5]] -= np.sign(rows[:, [1]]) * 0.15 / 5.5 * 0.23  # without the fold
    result = fit_buckling(rows, 0.49, LENGTH, config)
    assert result.verdict.good, result.verdict
    assert np.isfinite(result.trial_curvature).all()


def decay(rng: np.random.Generator, tau: float, amplitude: float) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(1.0, 31.0, 0.25)
    return t, 0.003 + amplitude * np.exp(-t / tau) + rng.normal(0, 4e-4, len(t))


def test_decay_is_fitted_within_its_errors_despite_outliers():
    misses = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        t, y = decay(rng, 8.0, 0.02)
        y[rng.choice(len(y), 8, replace=False)] += rng.uniform(0.01, 0.05, 8)
        x, covariance = fit_decay(t, y)
        misses.append((x - [8.0, 0.02, 0.003]) / np.sqrt(np.diag(covariance)))
    assert 0.6 < np.mean(np.square(misses)) < 1.6


def test_hysteresis_law_and_its_use_before_thirty_seconds():
    rng = np.random.default_rng(0)
    config = RobotConfig()
    records = []
    for _ in range(4):
        for index in range(5):
            t, y = decay(rng, 7.5, rng.normal(0.02, 0.005))
            records.append(CreepRecord(f"left {index}", t, y))
    result = fit_hysteresis(records, config)
    assert result.verdict.good
    made = result.apply(config)
    assert [s.settle_tau_s for s in made.column("left")] == pytest.approx([7.5] * 5, rel=0.1)
    assert made.column("right") == config.column("right")
    law = result.sensors[0].law
    misses, plain = [], []
    for _ in range(200):
        t = np.arange(1.0, 5.0, 0.25)
        y = 0.004 + rng.normal(0.02, 0.005) * np.exp(-t / 7.5) + rng.normal(0, 6e-4, len(t))
        settled, error, _ = law.observe(t, y, 6e-4)
        misses.append((settled - 0.004) / error)
        plain.append(y[-1] - 0.004)
    assert 0.6 < np.mean(np.square(misses)) < 1.4
    assert error < 0.25 * np.sqrt(np.mean(np.square(plain)))


def test_a_sensor_without_creep_is_no_failure():
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 30.0, 0.25)
    records = [CreepRecord("left 0", t, rng.normal(0, 4e-4, len(t)))]
    result = fit_hysteresis(records, RobotConfig())
    assert result.verdict.good
    assert "no creep" in result.sensors[0].reason


def test_a_record_that_only_rises_is_no_decay_and_no_traceback():
    t = np.arange(0.0, 30.0, 0.25)
    result = fit_hysteresis([CreepRecord("left 0", t, 1e-3 * t)], RobotConfig())
    assert not result.verdict.good
    assert "left 0: the record shows no decay" in result.verdict.notes


def test_settling_needs_readings():
    with pytest.raises(DataError, match="three or more"):
        Settling(8.0, 1.0, 0.02, 0.01).observe([1.0], [0.01], 1e-3)


def axis(ratio: float, y: float, rng: np.random.Generator, se: float = 0.02) -> AxisPoints:
    """Axis of a cantilever whose gaps are softer by `ratio`, tip pushed to about y."""
    s = np.arange(0, LENGTH + 1e-9, 0.05)
    under = np.zeros(len(s), bool)
    for center in CENTERS[:5]:
        under |= np.abs(s - center) <= 2.75
    soft = np.where(under, 1.0, ratio)
    heading = np.zeros(len(s))
    for _ in range(20):
        lean = np.cos(heading - heading[-1])
        lever = np.cumsum(lean[::-1])[::-1] * 0.05
        k = 3 * y / LENGTH**3 / (1 + 0.7 * (ratio - 1)) * lever * soft
        heading = np.concatenate([[0], np.cumsum((k[1:] + k[:-1]) / 2 * 0.05)])
    x = np.concatenate([[0], np.cumsum(np.cos((heading[1:] + heading[:-1]) / 2) * 0.05)])
    across = np.concatenate([[0], np.cumsum(np.sin((heading[1:] + heading[:-1]) / 2) * 0.05)])
    pick = np.arange(10, len(s), 10)
    points = np.column_stack([x, across])[pick]
    return AxisPoints(points + rng.normal(0, se, points.shape), LENGTH)


@pytest.mark.sim
@pytest.mark.parametrize("ratio", [1.0, 1.3])
def test_stiffness_ratio_is_found(ratio):
    rng = np.random.default_rng(7)
    reach = np.tile([6.0, 9.0, -7.0, -9.0, 8.0], 6)
    result = fit_stiffness([axis(ratio, y, rng, se=0.012) for y in reach], RobotConfig())
    assert abs(result.ratio - ratio) < 3 * result.ratio_se
    assert result.ratio_se < 0.1
    words = "as stiff" if ratio == 1.0 else "stiffer under the sensors"
    assert words in result.verdict.reason


def test_noise_at_rest_and_within_a_sweep():
    rng = np.random.default_rng(2)
    config = RobotConfig()
    t = np.arange(200) * 0.5
    white = np.linspace(4e-4, 9e-4, 10)
    y = rng.normal(0, 1, (200, 10)) * white + 2e-6 * t[:, None]
    y[rng.random(y.shape) < 0.03] += 0.05
    result = fit_noise(t, y, config, loops=8e-4 + rng.normal(0, 1e-4, (40, 10)))
    assert result.verdict.good
    misses = [(s.white - w) / s.white_se for s, w in zip(result.sensors, white, strict=True)]
    assert np.mean(np.square(misses)) < 2.5
    assert all(0.01 < s.dropouts < 0.06 for s in result.sensors)
    assert all(s.hysteresis == pytest.approx(4e-4, rel=0.2) for s in result.sensors)
    assert all(s.drift_per_min == pytest.approx(1.2e-4, abs=4e-4) for s in result.sensors)


def test_encoder_slope_within_its_error():
    config = RobotConfig()
    misses = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        length = np.array([10, 20, 26.5, 30, 35.3, 40, 50, 53.0])
        result = fit_encoder(length * 2 * 71.3, length + rng.normal(0, 0.08, 8), config)
        assert result.verdict.good
        misses.append((result.counts_per_cm - 71.3) / result.counts_se)
    assert 0.6 < np.mean(np.square(misses)) < 1.8


def test_the_motors_constant_is_the_least_that_was_seen_at_each_body_pressure():
    config = RobotConfig()
    length = np.arange(5.0, 53, 5.0)

    def row(body_pressure: int, duty: float) -> dict[str, float]:
        speed = {"dead_zone": 60, "counts_s": 4.0 * 76.0}
        return {"body_pressure": body_pressure, "duty": duty, **speed}

    # 4 cm/s of line at 23.6 cm/s for 740 of duty: 125.4 beyond the dead zone.
    drive = [row(0, 160.0), row(0, 155.0), row(1, 170.0)]
    result = fit_encoder(length * 152, length, config, drive)
    assert result.pull_duty == [pytest.approx(25.4, abs=0.1), pytest.approx(15.4, abs=0.1), None]
    assert "not seen at every body pressure" in result.verdict.notes[-1]
    result.write(config)
    assert [pressure.pull_duty for pressure in config.body.pressures] == [25.4, 15.4, 0.0]


def test_encoder_slip_reversal_and_lost_marker_are_detected():
    config = RobotConfig()
    rng = np.random.default_rng(3)
    length = np.arange(5.0, 53, 5.0)
    measured_cm = length + rng.normal(0, 0.08, len(length))
    slipped = fit_encoder(length * 152 + np.where(length > 27, 304, 0), measured_cm, config)
    assert not slipped.verdict.good
    assert re.search(r"slipped by about (1\.9|2\..) cm before row 6", slipped.verdict.reason)
    backwards = fit_encoder(-length * 152, measured_cm, config)
    assert not backwards.verdict.good
    assert "swap" in backwards.verdict.reason
    measured_cm[3] = np.nan
    lost = fit_encoder(length * 152, measured_cm, config)
    assert lost.verdict.good
    assert "lost the tip" in lost.verdict.notes[0]


NAMES = ["left", "right"]


def test_pressure_zero_and_its_faults():
    rng = np.random.default_rng(4)
    counts = np.column_stack([rng.normal(104.1, 0.5, 300), rng.normal(99.8, 0.5, 300)])
    good = fit_pressure_zero(counts, NAMES)
    assert good.verdict.good
    for zero, true in zip(good.zeros, (104.1, 99.8), strict=True):
        assert abs(zero.zero_count - true) < 4 * zero.zero_se
    assert good.board_values() == pytest.approx([104.1 * 64, 99.8 * 64], abs=8)
    cut = counts.copy()
    cut[:, 1] = 0.5
    assert "broken wire" in " ".join(fit_pressure_zero(cut, NAMES).verdict.notes)
    emptying = counts + np.linspace(20, 0, 300)[:, None]
    assert "wait until vented" in " ".join(fit_pressure_zero(emptying, NAMES).verdict.notes)
    silent = fit_pressure_zero(counts * [1, np.nan], NAMES)
    assert "broken wire" in silent.verdict.notes[0]
    assert silent.as_data()["pressure_zero"][1] == 0
    assert silent.verdict.notes[0].startswith("the pressure sensor of right ")


@pytest.mark.parametrize("names", [["bender"], ["right", "left"], ["up", "left", "down", "right"]])
def test_pressure_zeros_are_those_of_the_muscles_in_the_files_order(tmp_path, names):
    true = {name: 98.0 + 2.0 * n for n, name in enumerate(sorted(names))}
    config = RobotConfig(
        muscles=[Muscle(name=name, angle_deg=80.0 * n) for n, name in enumerate(names)]
    )
    file = tmp_path / "vented.csv"
    rows = [",".join(f"{name}_count" for name in true), *[",".join(map(str, true.values()))] * 12]
    file.write_text("\n".join(rows))
    fit = fit_csv("pressure", file, config)
    assert [zero.muscle for zero in fit.zeros] == names
    assert fit.board_values() == [round(64 * true[name]) for name in names]


def whole(config: RobotConfig) -> CheckReadings:
    """A check of a robot that is as its configuration says."""
    rng = np.random.default_rng(5)
    sensors = [*config.column("left"), *config.column("right")]
    zero = np.array([s.zero_ohm for s in sensors])
    scale = np.array([s.scale_per_ohm for s in sensors])
    bent, curvature, held = {}, {}, {}
    for side, sign, dull in (("left", 1, slice(0, 5)), ("right", -1, slice(5, 10))):
        k = sign * config.muscle(side).maps[2].inflate.curvature(12.0)
        row = np.full(10, k)
        row[dull] *= rng.uniform(-0.3, 0.4, 5)
        bent[side], curvature[side] = zero + row / scale, k
        t = np.arange(0, 4, 0.1)
        held[side] = np.column_stack([t, 12 + rng.normal(0, 0.02, len(t))])
    return CheckReadings(
        zero + rng.normal(0, 10, (8, 10)), bent, 12.0, curvature, held, body_pressure=2
    )


def test_check_passes_a_sound_robot():
    config = RobotConfig()
    result = run_check(whole(config), config)
    assert result.verdict.good, result.verdict


def test_a_check_with_warnings_says_so():
    config = RobotConfig()
    sound = whole(config)
    bends = {side: 0.75 * bend for side, bend in sound.camera_bend.items()}
    checked = run_check(replace(sound, camera_bend=bends), config)
    assert checked.verdict.good
    assert checked.verdict.reason.startswith("the robot can be used, with ")


def test_check_names_each_fault():
    config = RobotConfig()
    sound = whole(config)
    rest = sound.rest_ohm.copy()
    rest[:, 3] = np.nan
    rest[:, 6] += 1000
    bent = {
        side: ohm + np.where(np.arange(10) == 6, 1000, 0) for side, ohm in sound.bend_ohm.items()
    }
    off = run_check(replace(sound, rest_ohm=rest, bend_ohm=bent), config)
    by_part = {f.part: f for f in off.findings}
    assert by_part["sensor left 3"].mark == "bad"
    assert "open circuit" in by_part["sensor left 3"].text
    assert "drifted" in by_part["sensor right 1"].text

    swapped = {side: np.r_[ohm[5:], ohm[:5]] for side, ohm in sound.bend_ohm.items()}
    columns = run_check(replace(sound, bend_ohm=swapped), config)
    assert any("columns are swapped" in f.text for f in columns.findings)

    crossed = {"left": sound.camera_bend["right"], "right": sound.camera_bend["left"]}
    tubes = run_check(replace(sound, camera_bend=crossed), config)
    assert "tubes are swapped" in tubes.verdict.reason

    t = np.arange(0, 4, 0.1)
    leaking = {**sound.hold_psi, "left": np.column_stack([t, 12 - 0.4 * t])}
    leak = run_check(replace(sound, hold_psi=leaking), config)
    assert "a leak" in leak.verdict.reason


@pytest.mark.sim
def test_every_fit_draws_its_figure_and_every_result_makes_plain_data(tmp_path):
    config = RobotConfig()
    rng = np.random.default_rng(6)
    results = [
        fit_buckling(*pushes(0), config),
        fit_hysteresis([CreepRecord("left 0", *decay(rng, 8.0, 0.02))], config),
        fit_stiffness([axis(1.0, y, rng) for y in (7.0, -8.0, 9.0)], config),
        fit_noise(np.arange(40.0), rng.normal(0, 6e-4, (40, 10)), config),
        fit_encoder(np.arange(8) * 700.0 + 700, np.arange(8) * 4.6 + 4.6, config),
        fit_pressure_zero(rng.normal(102, 0.5, (30, 2)), NAMES),
        run_check(whole(config), config),
    ]
    for number, result in enumerate(results):
        path = tmp_path / f"{number}.png"
        draw(result, path)
        fitted = not isinstance(result, PressureResult | CheckResult)
        assert path.exists() == fitted
        assert not fitted or path.stat().st_size > 5_000
        assert result.as_data()["verdict"]["good"] == result.verdict.good
        assert isinstance(result.apply(config), RobotConfig)


def named() -> RobotConfig:
    """The thesis's robot with one muscle, `Port`; nothing lies over its second column."""
    config = RobotConfig()
    config.muscles = config.muscles[:1]
    config.muscles[0].name = "Port"
    return config


SENSORS = [f"Port {k}" for k in range(5)] + [f"270 deg {k}" for k in range(5)]


def test_results_call_sensors_and_muscles_as_robot_toml_does(tmp_path: Path) -> None:
    config, rng = named(), np.random.default_rng(3)
    level = rng.normal(0, 4e-4, (60, 10))
    level[:, 7] *= 10
    noise = fit_noise(np.arange(60.0), level, config)
    assert [sensor.name for sensor in noise.sensors] == SENSORS
    assert any(note.startswith("270 deg 2 is loud") for note in noise.verdict.notes)
    assert noise.apply(config).column("right")[2].noise == noise.sensors[7].white
    draw(noise, tmp_path / "noise.png")

    t, y = decay(rng, 7.5, 0.02)
    crept = fit_hysteresis([CreepRecord("270 deg 1", t, y)], config)
    assert crept.apply(config).column("right")[1].settle_tau_s == pytest.approx(7.5, rel=0.2)
    with pytest.raises(DataError, match="no sensor right 1 in robot"):
        fit_hysteresis([CreepRecord("right 1", t, y)], config)

    two = whole(RobotConfig())
    left_only = {"left": two.bend_ohm["left"]}
    checked = run_check(replace(two, bend_ohm=left_only), config)
    parts = [finding.part for finding in checked.findings]
    assert parts == [
        *(f"sensor {name}" for name in SENSORS), "Port muscle", "Port muscle's tightness",
    ]  # fmt: skip


def test_a_csv_calls_sensors_as_robot_toml_does(tmp_path: Path) -> None:
    config, rng = named(), np.random.default_rng(4)
    t, y = decay(rng, 7.5, 0.02)
    columns = [f"curvature_port_{k}" for k in range(5)]
    columns += [f"curvature_270deg_{k}" for k in range(5)]
    rest = rng.normal(0, 4e-4, (60, 10))
    file = tmp_path / "rest.csv"
    write_table(file, {"t_s": np.arange(60.0)} | dict(zip(columns, rest.T, strict=True)))
    noise = fit_csv("noise", file, config)
    assert [sensor.name for sensor in noise.sensors] == SENSORS
    assert noise.sensors[7].white == pytest.approx(4e-4, rel=0.3)
    write_table(file, {"sensor": ["270deg_2"] * len(t), "t_s": t, "curvature": y})
    (fit,) = fit_csv("hysteresis", file, config).sensors
    assert fit.name == "270 deg 2"


def test_a_csv_with_an_unknown_sensor_is_told_which_there_are(tmp_path: Path) -> None:
    config, file = named(), tmp_path / "rest.csv"
    file.write_text("t_s,curvature_starboard_0\n0,0\n")
    with pytest.raises(DataError, match="no column 'curvature_Port_0'") as refused:
        fit_csv("noise", file, config)
    assert "sensors of this robot: Port_0, Port_1" in "\n".join(refused.value.__notes__)
    file.write_text("sensor,t_s,curvature\nstarboard_0,0,0\n")
    with pytest.raises(DataError, match=r"no sensor starboard_0 in robot\.toml; use Port_0,"):
        fit_csv("hysteresis", file, config)
