"""IMUs as sensors: what neighbours share, what the board gets, and calibration by free bends."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thigmo import from_headings
from thigmo.calibrate.heading import fit_heading
from thigmo.calibrate.step_figures import draw
from thigmo.calibrate.steps import fit_csv
from thigmo.config import RAD_PER_OHM, FlexSensor, HeadingSensor, RobotConfig
from thigmo.design import draft, judge
from thigmo.emulator.imus import ImuString
from thigmo.emulator.scene import Imu, Scene
from thigmo.errors import ConfigError, DataError
from thigmo.reading_errors import reading_errors
from thigmo.robot import SensorTable
from thigmo.robot.configuration import parameter_settings
from thigmo.wiring import Wiring

CONFIG = draft(100, 12, 2, kind="heading")
TABLE = SensorTable.laid_out(Wiring.laid_out(CONFIG))
STRING = [sensor for sensor in CONFIG.sensors if isinstance(sensor, HeadingSensor)]
ROWS = np.flatnonzero(TABLE.healthy)[np.argsort(TABLE.center_cm[TABLE.healthy])]


def test_what_neighbours_share_is_what_from_headings_says() -> None:
    arc = [0.0, *(sensor.ends_cm[1] for sensor in STRING)]
    error = [0.0] + [STRING[0].heading_se_rad] * len(STRING)
    said = from_headings(np.zeros(len(arc)), arc, error)
    assert TABLE.center_cm[ROWS] == pytest.approx(said.position)
    assert TABLE.span_cm[ROWS] == pytest.approx(said.span)
    shared = TABLE.shared[ROWS] @ TABLE.shared[ROWS].T
    assert shared == pytest.approx(said.shared_errors @ said.shared_errors.T)
    assert np.diag(shared) + TABLE.white[ROWS] ** 2 == pytest.approx(TABLE.noise[ROWS] ** 2)
    side = STRING[0].side
    assert side
    errors = reading_errors(CONFIG, "left", 0, [(side, n) for n in range(len(STRING))])
    assert errors.shared_errors is not None
    assert errors.shared_errors @ errors.shared_errors.T == pytest.approx(shared)
    assert not errors.zero_error.any()
    flex = reading_errors(RobotConfig(), "left", 0, [("right", 0)])
    assert flex.shared_errors is None


def test_a_string_serves_both_muscles_and_its_base_counts_while_either_bends() -> None:
    all_sensors = (1 << len(TABLE.healthy)) - 1
    assert TABLE.usable("left", all_sensors).sum() == TABLE.usable("right", all_sensors).sum() == 12
    answer = parameter_settings(Wiring.laid_out(CONFIG))
    assert [mask for mask in answer["trigger_when"] if mask] == [0b10000011]
    # The fold must not lie on an IMU; between two of them it may.
    first = Wiring.laid_out(CONFIG).base_inputs[0]
    assert answer["flex_center_um"][first] == round(STRING[0].ends_cm[1] * 1e4)
    assert answer["flex_span_um"][first] == 12_000


def test_a_file_without_kinds_has_flex_sensors_and_an_unknown_kind_is_named(
    tmp_path: Path,
) -> None:
    file = tmp_path / "robot.toml"
    file.write_text("version = 2\n[[sensor]]\ncenter_cm = 5.0\n")
    assert RobotConfig.load(file).sensors == [FlexSensor(center_cm=5.0)]
    file.write_text('version = 2\n[[sensor]]\nkind = "headng"\ncenter_cm = 5.0\n')
    with pytest.raises(ConfigError, match=r"sensor\.0: .* kind is flex, heading or fibre"):
        RobotConfig.load(file)
    CONFIG.save(tmp_path / "new.toml")
    assert RobotConfig.load(tmp_path / "new.toml") == CONFIG


def test_the_check_says_what_bus_and_trigger_can() -> None:
    said = {finding.part: finding for finding in judge(CONFIG)}
    assert said["board"].text.startswith("large")
    assert said["bus"].text.startswith("12 IMUs behind a multiplexer, 0.60 ms each at 400 kHz")
    assert said["trigger"].mark == "ok"
    drifting = CONFIG.model_copy(deep=True)
    for sensor in drifting.sensors:
        assert isinstance(sensor, HeadingSensor)
        sensor.heading_se_rad = 0.02
    assert {finding.part: finding.mark for finding in judge(drifting)}["trigger"] == "bad"


def test_a_lab_believes_each_imu_in_one_place() -> None:
    scene = Scene(robot=CONFIG)
    scene.belief.position_spread_cm = 0.3
    believed = [s for s in scene.believed(1).sensors if isinstance(s, HeadingSensor)]
    ends = np.array([sensor.ends_cm for sensor in believed])
    assert ends[1:, 0] == pytest.approx(ends[:-1, 1])
    assert 0.1 < np.std(ends[:, 1] - [sensor.ends_cm[1] for sensor in STRING]) < 0.6


def _string(known: Imu) -> ImuString:
    return ImuString(known, STRING, 22_000.0, 0.01, np.random.default_rng(0))


def _turns(
    counts: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    ohm = 22_000.0 * (1024.0 - counts) / counts
    return (ohm - HeadingSensor.straight_ohm) * RAD_PER_OHM


def test_an_imu_says_its_turn_drifts_and_takes_both_spans_with_it_when_it_hangs() -> None:
    still = Imu(drift_deg_min=0.0, walk_deg_root_s=0.0, noise_deg=0.0, seat_deg=0.0)
    bend = np.full(12, 0.01)
    spans = np.array([sensor.span_cm for sensor in STRING])
    calm = _string(still)
    assert _turns(calm.counts(bend, 100.0)) == pytest.approx(0.01 * spans)
    # The fold is between the fifth IMU and the sixth: the one in the tail looks back.
    assert np.argmax(np.abs(_turns(calm.counts(0 * bend, 42.0)))) == 5
    drifting = _string(Imu(walk_deg_root_s=0.0, noise_deg=0.0, seat_deg=0.0))
    for _ in range(6000):
        last = _turns(drifting.counts(0 * bend, 100.0))
    # 0.5 degrees a minute of each IMU; what one adds to a span it takes from the next.
    assert 0.2 < np.degrees(np.cumsum(last)).std() < 1.0
    calm.hung.add(calm.imu_at(STRING[3].ends_cm[1]))
    assert np.flatnonzero(calm.counts(bend, 100.0) == 0.0).tolist() == [3, 4]


def test_free_bends_tell_scale_zero_and_drift(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    t_s = np.arange(24) * 6.0
    bend = np.tile(np.linspace(-0.03, 0.03, 12), 2)
    scale = 1 + 0.03 * rng.standard_normal(12)
    drift = np.radians(0.5) / 60 * rng.standard_normal(13)
    drift[0] = 0.0
    spans = np.array([sensor.span_cm for sensor in STRING])
    turn = bend[:, None] * spans / scale + np.outer(t_s, np.diff(drift)) + 0.02
    turn += np.diff(np.radians(0.02) * rng.standard_normal((24, 13)), axis=1)
    result = fit_heading(t_s, bend, 12_000.0 + turn / RAD_PER_OHM, CONFIG)
    assert result.verdict.good
    misses = [
        (fit.scale / s - 1) / fit.scale_se for fit, s in zip(result.sensors, scale, strict=True)
    ]
    assert np.abs(misses).max() < 4
    assert np.std(misses) > 0.1
    made = result.apply(CONFIG)
    assert [span.scale for span in made.sensors if isinstance(span, HeadingSensor)] == [
        fit.scale for fit in result.sensors
    ]
    # 20 s after the zeros at half a degree a minute, and the scatter.
    assert result.heading_se_rad == pytest.approx(2.9e-3, rel=0.4)
    assert "turns" not in result.as_data()["sensors"][0]
    draw(result, tmp_path / "heading.png")
    assert (tmp_path / "heading.png").stat().st_size > 10_000
    turn[:, 4] *= -1
    turn[:, 7] = np.nan
    worse = fit_heading(t_s, bend, 12_000.0 + turn / RAD_PER_OHM, CONFIG)
    assert [n for n, fit in enumerate(worse.sensors) if not fit.healthy] == [4, 7]
    assert "turns the other way" in worse.verdict.notes[0]
    assert "does not answer" in worse.verdict.notes[1]


def test_a_step_for_sensors_that_the_robot_does_not_have_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no flex sensors"):
        fit_csv("flex", tmp_path / "flex.csv", CONFIG)
    with pytest.raises(DataError, match="no heading sensors"):
        fit_csv("heading", tmp_path / "heading.csv", RobotConfig())
