"""The repeated experiments: trials are what they say, errors are counted as stated, claims hold."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from thigmo.experiments import EXPERIMENTS, conditions, run, thesis
from thigmo.experiments.compare import (
    Answer,
    assigned_errors,
    baseline,
    bound_cm,
    camera_errors,
    ours,
    workspace_errors,
)
from thigmo.experiments.fit import frozen, misfit, table
from thigmo.experiments.sensitivity import cells
from thigmo.experiments.specimen import Constants, Specimen, Trial

PERFECT = Constants(noise=0.0, gain_spread=0.0, position_cm=0.0, fold_rad=0.0)


def specimen(constants: Constants = PERFECT, seed: int = 0) -> Specimen:
    return Specimen(constants, np.random.default_rng(seed))


def test_a_perfect_robot_reads_the_beam() -> None:
    trial = specimen().press("test", (40.0,), (1e-5,))
    expected = 1e-5 * np.clip(40.0 - trial.position, 0, None)
    assert trial.curvature == pytest.approx(expected, rel=1e-3, abs=1e-9)
    assert trial.contact_x_cm[0] == pytest.approx(40.0, abs=0.05)


def test_what_a_robot_was_built_with_stays_from_trial_to_trial() -> None:
    crooked = specimen(Constants(0.0, 0.1, 0.5, 0.0))
    first = crooked.press("a", (40.0,), (2e-4,)).curvature
    again = crooked.press("a", (40.0,), (2e-4,)).curvature
    perfect = specimen().press("a", (40.0,), (2e-4,)).curvature
    assert first == pytest.approx(again)
    assert np.abs(first - perfect).max() > 1e-4


def test_two_opposed_contacts_are_opposed_and_a_gap_apart() -> None:
    for trial in conditions.two_contacts(specimen(), 1, np.random.default_rng(0)):
        assert trial.forces[0] * trial.forces[1] < 0
        assert f"{conditions.gap_of(trial):g}" in trial.condition
        moments = np.abs(trial.curvature)
        assert moments.max() < thesis.CRITICAL


def test_actuated_contacts_start_where_the_dowel_just_touches() -> None:
    trials = conditions.actuated(specimen(), 1)
    assert len(trials) == 6
    for trial in trials:
        assert trial.curvature.size == 5
        # The contact slides towards the tip as the robot bends on.
        nearest = min(thesis.ACTUATED_ARCS_CM, key=lambda arc: abs(arc - trial.arcs_cm[0]))
        assert -0.1 < trial.arcs_cm[0] - nearest < 2.5


def case(arcs: tuple[float, ...], obstacles: tuple[float, ...]) -> Trial:
    n = np.zeros(2)
    return Trial("", n, n, n, 0.0, 0.0, n, arcs, (0.0,) * len(arcs), obstacles, obstacles)


def test_errors_are_ordered_along_the_arc_or_best_assigned() -> None:
    trial = case((34.5, 53.0), (34.4, 53.1))
    # The thesis's labelling: the true proximal contact, found, counts as the distal one.
    answer = Answer((12.0, 34.4), (1.0, 1.0))
    assert camera_errors(trial, answer) == pytest.approx([22.4, 18.7])
    assert assigned_errors(trial, answer).sum() <= camera_errors(trial, answer).sum()
    assert np.isinf(camera_errors(trial, Answer((1.0,), (1.0,)))).all()


def test_a_perfect_answer_has_no_workspace_error() -> None:
    trial = specimen().press("test", (40.0,), (2.5e-4,))
    answer = Answer((40.0,), (2.5e-4,))
    assert workspace_errors(trial, answer)[0] < 0.1


def test_the_bound_is_infinite_where_the_information_is_singular() -> None:
    noisy = specimen(Constants(6e-4, 0.0, 0.0, 0.0))
    clear = noisy.press("test", (14.0, 53.0), (-1e-3, 2e-4))
    blind = noisy.press("test", (40.0, 53.0), (-1e-3, 6e-4))
    assert np.isfinite(bound_cm(clear)).all()
    # Only one sensor sees the region between the contacts.
    assert bound_cm(blind).max() > 20.0


def test_the_bound_is_reached_by_an_efficient_fit() -> None:
    noisy = specimen(Constants(3e-4, 0.0, 0.0, 0.0))
    errors, bounds = [], []
    for _ in range(80):
        trial = noisy.press("test", (40.0,), (2.5e-4,))
        errors.append(camera_errors(trial, ours(trial))[0])
        bounds.append(bound_cm(trial)[0])
    assert 0.6 < np.mean(errors) / np.mean(bounds) < 1.3


def test_the_frozen_constants_still_agree_with_section_3_2_better_than_a_perfect_robot() -> None:
    found = misfit(table(frozen(), robots=6, seed=3))
    assert found < 0.3 * misfit(table(PERFECT, robots=2, seed=3))


def test_the_thesis_cannot_tell_close_contacts_apart_and_we_can() -> None:
    rng = np.random.default_rng(4)
    robot = Specimen(frozen(), rng)
    trials = [
        t for t in conditions.two_contacts(robot, 6, rng) if abs(conditions.gap_of(t) - 18.5) < 0.1
    ]
    here = baseline("alternating")
    theirs = np.mean([camera_errors(t, here(t)).mean() for t in trials])
    mine = np.mean([camera_errors(t, ours(t)).mean() for t in trials])
    assert theirs > 8.0
    assert mine < 4.0


def test_five_sensors_are_the_solvers_limit_not_the_norms() -> None:
    found = {(c.method, c.noise, c.sensors): c.mean_cm for c in cells(trials=6, seed=0)}
    assert found["exact 1-norm", 0.0, 3] < 0.2
    assert found["thesis's solver (1-norm)", 0.0, 3] > 3.0


@pytest.mark.parametrize("name", [n for n in EXPERIMENTS if n != "exploration"])
def test_each_experiment_writes_tables_figures_and_claims(name: str, tmp_path: Path) -> None:
    results = run(name, tmp_path, robots=1, trials=2, seed=0)
    assert results.figures
    claims = json.loads((tmp_path / f"{name}-claims.json").read_text())
    assert len(claims) == len(results.claims) > 0
    assert list(tmp_path.glob(f"{name}-*.png"))
    assert list(tmp_path.glob(f"{name}-*.csv"))
