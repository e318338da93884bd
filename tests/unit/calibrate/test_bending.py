"""Bending stiffness from pulls of a robot of known EI, and stated from the fold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thigmo.calibrate.bending import fit_bending, from_fold
from thigmo.calibrate.columns import places_of, sensors_of
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.mechanics import push
from thigmo.reading_errors import reading_errors
from thigmo.record.table import write_table
from thigmo_bench.studies.rod import Floats

EI = 430.0  # N cm^2
PULLS = np.array([0.05, 0.1, 0.14, -0.05, -0.1, -0.14])  # N at the tip


def robot() -> RobotConfig:
    config = RobotConfig()
    for sensor in sensors_of(config).values():
        sensor.scale_se = 0.02
    return config


def readings(config: RobotConfig, rng: np.random.Generator, gains: Floats) -> Floats:
    """(t, 10) what the sensors read above the straight robot, gains off."""
    sensors = list(sensors_of(config).values())
    center, span, noise = (
        np.array([getattr(sensor, name) for sensor in sensors])
        for name in ("center_cm", "span_cm", "noise")
    )
    length = config.body.length_cm
    clean = [
        push(force / EI, length, free_curvature=0.0, length=length).averages(center, span)
        for force in PULLS
    ]
    return np.array(clean) * (1.0 + gains) + noise * rng.standard_normal((len(clean), 10))


def test_known_pulls_tell_the_stiffness_with_its_error() -> None:
    deviates = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        config = robot()
        curvature = readings(config, rng, 0.02 * rng.standard_normal(10))
        balance = 1.0 + 0.03 * rng.standard_normal()
        tips = np.full(len(PULLS), config.body.length_cm)
        fit = fit_bending(PULLS * balance, tips, np.full(len(PULLS), 0.03), curvature, config)
        assert fit.verdict.good
        deviates.append((fit.stiffness_n_cm2 - EI) / fit.stiffness_se_n_cm2)
        assert fit.stiffness_se_n_cm2 < 0.06 * EI
    assert 0.5 < np.std(deviates) < 1.5
    assert abs(np.mean(deviates)) < 0.6


def test_a_file_of_pulls_puts_newtons_into_robot_toml(tmp_path: Path) -> None:
    from thigmo.calibrate.session import Session
    from thigmo.calibrate.steps import fit_csv

    config = robot()
    curvature = readings(config, np.random.default_rng(1), np.zeros(10))
    columns = {
        f"curvature_{side}_{k}": curvature[:, n].tolist()
        for n, (side, k) in enumerate(places_of(config))
    }
    write_table(tmp_path / "pulls.csv", {"force_n": PULLS.tolist()} | columns)
    session = Session(tmp_path / "calibration", config)
    assert config.body.stiffness is None
    session.keep("stiffness", fit_csv("stiffness", tmp_path / "pulls.csv", config))
    known = RobotConfig.load(tmp_path / "calibration" / "robot.toml")
    assert known.body.stiffness_n_cm2 == pytest.approx(EI, rel=0.1)
    said = reading_errors(known, "left", 2, [("right", 0)]).arguments()["stiffness"]
    assert said[0] == known.body.stiffness_n_cm2
    assert said[1] == pytest.approx(0.05, abs=0.02)  # the balance is not stated: 5 %


def test_the_fold_states_it_to_about_a_quarter() -> None:
    fit = from_fold(RobotConfig())
    # pi p r^3 of 0.49 psi and 1.75 cm is 5.69 N cm, over 0.01108 1/cm.
    assert fit.stiffness_n_cm2 == pytest.approx(0.75 * 5.69 / 0.01108, rel=2e-3)
    assert 0.2 < fit.stiffness_se_n_cm2 / fit.stiffness_n_cm2 < 0.3


@pytest.mark.parametrize(
    ("force", "arc", "says"),
    [(0.0, 53.0, "force_n is 0"), (np.nan, 53.0, "force_n"), (0.1, 60.0, "off the body"),
     (0.1, 4.0, "no pull is read")],
)  # fmt: skip
def test_pulls_that_tell_nothing_are_refused(force: float, arc: float, says: str) -> None:
    with pytest.raises(DataError, match=says):
        fit_bending(
            np.array([force]), np.array([arc]), np.array([0.05]), np.full((1, 10), 1e-3), robot()
        )
