"""A fibre as sensors: what its gratings share, what the board sees of it, calibration, strains."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from thigmo import wiring
from thigmo.calibrate.fibre import fit_fibre
from thigmo.calibrate.steps import fit_csv
from thigmo.cli.main import app
from thigmo.config import RobotConfig
from thigmo.design import draft, judge
from thigmo.errors import DataError
from thigmo.reading_errors import errors_of
from thigmo.robot.configuration import parameter_settings
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring

DRAFT = draft(53, 10, 2, kind="fibre")
CONFIG = DRAFT.model_copy(update={"sensors": DRAFT.gratings})  # and nothing on the board
IN_PLANE = [sensor for sensor in CONFIG.gratings if sensor.side]


def test_gratings_share_the_temperature_and_lose_by_twist() -> None:
    errors = errors_of(CONFIG, "left", 0, IN_PLANE)
    assert errors.shared_errors is not None
    assert errors.shared_errors == pytest.approx(np.full((10, 1), IN_PLANE[0].temperature_se))
    twisted = IN_PLANE[0].model_copy(update={"twist_se_rad": 0.6, "scale_se": 0.0})
    assert errors_of(CONFIG, "left", 0, [twisted]).gain_error == pytest.approx(1 - np.cos(0.6))


def test_a_fibre_takes_no_input_of_the_board_and_alone_is_not_explored(tmp_path: Path) -> None:
    CONFIG.save(tmp_path / "robot.toml")
    assert RobotConfig.load(tmp_path / "robot.toml") == CONFIG
    assert len(CONFIG.gratings) == 20  # two a grating
    assert wiring.board_size(CONFIG).name == "mega"
    assert not any(Wiring.laid_out(CONFIG).sensors)
    assert not any(parameter_settings(Wiring.laid_out(CONFIG))["flex_enabled"])
    alone = CONFIG.model_copy(update={"interrogator": "127.0.0.1:7400"})
    assert "no healthy sensor at the base" in (Wiring.laid_out(alone).unexplorable or ("",))[0]
    assert "its trigger sees no fibre" in (Wiring.laid_out(alone).unexplorable or ("", ""))[1]
    said = {(finding.part, finding.mark) for finding in judge(CONFIG)}
    assert {("explore", "warning"), ("fibre", "ok"), ("sweep of left", "warning")} <= said
    both = RobotConfig()
    both.sensors = [*both.sensors, *IN_PLANE]
    assert "no interrogator" in (Wiring.laid_out(both).unexplorable or ("",))[0]
    both.interrogator = "127.0.0.1:7400"
    assert Wiring.laid_out(both).unexplorable is None
    # The flex sensors keep their inputs, and the trigger works on them.
    assert Wiring.laid_out(both).sensors == Wiring.laid_out(RobotConfig()).sensors
    assert ("sweep of left", "warning") not in {
        (finding.part, finding.mark) for finding in judge(both)
    }


def _bends(seed: int = 1) -> tuple[Floats, Floats, Floats, Floats]:
    """Time, curvature, strains of a fibre twisted by 0.1 rad, and true scales of its plane."""
    rng = np.random.default_rng(seed)
    t_s: Floats = np.arange(0.0, 144.0, 6.0)
    bend: Floats = np.tile(np.linspace(-0.03, 0.03, 12), 2).astype(np.float64)
    per_ue: Floats = np.asarray(rng.normal(2.7e-4, 1.35e-5, 10), dtype=np.float64)
    turned = np.stack([np.cos(0.1) / per_ue, np.sin(0.1) / per_ue], axis=1).ravel()
    warm = 0.5 / 2.7e-4 * 1e-4 / 60 * t_s  # 5e-5 1/cm a minute
    strain: Floats = 12.0 + np.outer(bend, turned) + warm[:, None]
    true: Floats = np.asarray(per_ue / np.cos(0.1))
    strain += rng.normal(0, 0.5, strain.shape)
    return t_s, np.asarray(bend, dtype=np.float64), np.asarray(strain), true


def test_free_bends_tell_scale_zero_twist_and_the_drift_that_all_share() -> None:
    t_s, bend, strain, per_ue = _bends()
    result = fit_fibre(t_s, bend, strain, CONFIG)
    assert result.verdict.good
    got = [fit.scale_per_ue for fit in result.sensors]
    assert got == pytest.approx(per_ue, rel=0.03)
    off = [
        (a / b - 1) / fit.scale_se for a, b, fit in zip(got, per_ue, result.sensors, strict=True)
    ]
    assert 0.2 < np.std(off) < 3.0
    assert result.twist_se_rad == pytest.approx(0.1, abs=0.02)
    assert result.temperature_se == pytest.approx(5e-5 / 60 * 20, rel=0.5)
    made = [s for s in result.apply(CONFIG).gratings if s.side]
    assert [s.scale_per_ue for s in made] == got
    assert made[0].noise == pytest.approx(0.5 * 2.7e-4, rel=0.4)
    assert made[0].reading(made[0].zero_ue + 100.0) == pytest.approx(0.027, rel=0.2)


def test_peaks_that_drop_out_cost_their_rows_and_a_lost_grating_is_named() -> None:
    t_s, bend, strain, per_ue = _bends()
    strain[3:6, 0] = np.nan
    strain[:, 4] = np.nan
    strain[:, 6] = np.random.default_rng(0).normal(0, 20, len(t_s))
    result = fit_fibre(t_s, bend, strain, CONFIG)
    assert [fit.index for fit in result.sensors if not fit.healthy] == [4, 6]
    assert "its peak is lost" in result.verdict.notes[0]
    assert "does not follow" in result.verdict.notes[1]
    assert result.sensors[0].scale_per_ue == pytest.approx(per_ue[0], rel=0.03)
    assert not result.apply(CONFIG).gratings[4].healthy
    with pytest.raises(DataError, match="free bends that the camera saw"):
        fit_fibre(t_s[:5], bend[:5], strain[:5], CONFIG)


def test_strains_in_a_file_are_calibrated_and_localized(tmp_path: Path) -> None:
    t_s, bend, strain, _ = _bends()
    names = ["t_s", "curvature", *(f"strain_{n}" for n in range(20))]
    rows = np.column_stack([t_s, bend, strain])
    lines = [",".join(names), *(",".join(f"{v:.8g}" for v in row) for row in rows)]
    (tmp_path / "bends.csv").write_text("\n".join(lines))
    fit_csv("fibre", tmp_path / "bends.csv", CONFIG).apply(CONFIG).save(tmp_path / "robot.toml")
    made = [s for s in RobotConfig.load(tmp_path / "robot.toml").gratings if s.side]
    touch = [3e-4 * max(36.0 - s.center_cm, 0.0) / s.scale_per_ue + s.zero_ue for s in made]
    rows_of = [f"{s.center_cm},{ue:.6g}" for s, ue in zip(made, touch, strict=True)]
    table = tmp_path / "strains.csv"
    table.write_text("\n".join(["position,strain", *rows_of]))
    asked = ["localize", str(table), "--length", "53", "--span", "0.5", "--json"]
    ran = CliRunner().invoke(app, [*asked, "--config", str(tmp_path / "robot.toml")])
    assert ran.exit_code == 0, ran.output
    contact = json.loads(ran.stdout)["contacts"][0]
    assert contact["arc"] == pytest.approx(36.0, abs=2.5)
    assert contact["interval"][0] < 36.0 < contact["interval"][1]
    refused = CliRunner().invoke(app, asked)
    assert "the readings are strains" in str(refused.exception) + refused.output
    with pytest.raises(DataError, match="no fibre sensors"):
        fit_csv("fibre", tmp_path / "bends.csv", RobotConfig())
