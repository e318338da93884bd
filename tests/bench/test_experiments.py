"""The repeated experiments: trials are what they say, errors are counted as stated, claims hold."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from thigmo.mechanics import push
from thigmo_bench.experiments import EXPERIMENTS, sensitivity, thesis
from thigmo_bench.experiments.compare import (
    Answer,
    Solved,
    assigned_errors,
    camera_errors,
    ours,
    thesis_method,
    workspace_errors,
)
from thigmo_bench.experiments.evaluate import errors, folded
from thigmo_bench.experiments.fit import misfit, remarks, table
from thigmo_bench.experiments.specimen import Constants, Specimen, frozen
from thigmo_bench.experiments.trial import Planned, Trial
from thigmo_bench.studies.engine import Context, Outcome, write

PERFECT = Constants(noise=0.0, gain_spread=0.0, position_cm=0.0, fold_rad=0.0)


def specimen(constants: Constants = PERFECT, seed: int = 0) -> Specimen:
    return Specimen(constants, np.random.default_rng(seed))


def pressed(robot: Specimen, arcs: tuple[float, ...], forces: tuple[float, ...]) -> Trial:
    return robot.press(Planned("", "test", "", 1, "right", arcs, forces))


def test_a_perfect_robot_reads_the_beam() -> None:
    trial = pressed(specimen(), (40.0,), (1e-5,))
    expected = 1e-5 * np.clip(40.0 - trial.position, 0, None)
    assert trial.curvature == pytest.approx(expected, rel=1e-3, abs=1e-9)
    assert trial.contact_x_cm[0] == pytest.approx(40.0, abs=0.05)


def test_what_a_robot_was_built_with_stays_from_trial_to_trial() -> None:
    crooked = specimen(Constants(0.0, 0.1, 0.5, 0.0))
    first = pressed(crooked, (40.0,), (2e-4,)).curvature
    again = pressed(crooked, (40.0,), (2e-4,)).curvature
    perfect = pressed(specimen(), (40.0,), (2e-4,)).curvature
    assert first == pytest.approx(again)
    assert np.abs(first - perfect).max() > 1e-4


def test_two_opposed_contacts_are_opposed_and_a_gap_apart() -> None:
    for trial in specimen().trials("two-contacts", 1):
        assert trial.forces[0] * trial.forces[1] < 0
        gap = trial.arcs_cm[1] - trial.arcs_cm[0]
        assert trial.place == f"{gap:g} cm apart"
        assert trial.condition == thesis.separation(gap)
        moments = np.abs(trial.curvature)
        assert moments.max() < thesis.CRITICAL


def test_actuated_contacts_start_where_the_dowel_just_touches() -> None:
    trials = specimen().trials("actuated", 1)
    assert len(trials) == 6
    for trial in trials:
        assert trial.curvature.size == 5
        # The contact slides towards the tip as the robot bends on.
        nearest = min(thesis.SINGLE_ARCS_CM, key=lambda arc: abs(arc - trial.arcs_cm[0]))
        assert -0.1 < trial.arcs_cm[0] - nearest < 2.5


def test_intervals_of_actuated_trials_hold_the_truth() -> None:
    """For robots with noise, gains and places of their own."""
    held = []
    for seed in range(3):
        for trial in specimen(frozen(), seed).trials("actuated", 1):
            low, high = ours(trial).intervals_cm[0]
            held.append(low - 0.01 <= trial.arcs_cm[0] <= high + 0.01)
    assert np.mean(held) > 0.8


def case(arcs: tuple[float, ...], obstacles: tuple[float, ...]) -> Trial:
    n, zero = np.zeros(2), (0.0,) * len(arcs)
    return Trial("", "", n, n, n, 0.0, n, n, arcs, zero, obstacles, obstacles, zero)


def test_errors_are_ordered_along_the_arc_or_closest_pair_first() -> None:
    trial = case((34.5, 53.0), (34.4, 53.1))
    # The thesis's labelling: the true proximal contact, found, counts as the distal one.
    answer = Answer((12.0, 34.3), (1.0, 1.0))
    assert camera_errors(trial, answer) == pytest.approx([22.4, 18.8])
    assert assigned_errors(trial, answer) == pytest.approx([0.1, 41.1])
    # A trial without an answer for each contact is left out.
    solved = [Solved(trial, {"it": answer}), Solved(trial, {"it": Answer((1.0,), (1.0,))})]
    row = errors(solved, "it")
    assert row["mean"] == pytest.approx(20.6)
    assert (row["nearest_mean"], row["other_mean"]) == pytest.approx((0.1, 41.1))
    assert np.isnan(errors(solved[1:], "it")["mean"])


def test_a_perfect_answer_has_no_workspace_error() -> None:
    trial = pressed(specimen(), (40.0,), (2.5e-4,))
    answer = Answer((40.0,), (2.5e-4,))
    assert workspace_errors(trial, answer)[0] < 0.1


def test_the_bound_is_infinite_where_the_information_is_singular() -> None:
    noisy = specimen(Constants(6e-4, 0.0, 0.0, 0.0))
    clear = pressed(noisy, (14.0, 53.0), (-1e-3, 2e-4))
    blind = pressed(noisy, (40.0, 53.0), (-1e-3, 6e-4))
    assert np.isfinite(clear.bound_cm).all()
    # Only one sensor sees the region between the contacts.
    assert max(blind.bound_cm) > 20.0


def test_the_bound_in_the_thesis_measure_holds_the_foreshortening() -> None:
    rng = np.random.default_rng(4)
    for offset, spread in ((0.0, 1.0), (5.6, 0.9), (1.0, 2.0)):
        drawn = np.abs(offset + np.sqrt(np.pi / 2) * spread * rng.standard_normal(400_000))
        angle = folded(np.array([offset]), np.array([spread]))[0]
        assert angle == pytest.approx(drawn.mean(), rel=0.01)
        assert angle >= max(offset, spread) - 1e-12


def test_the_bound_is_reached_by_an_efficient_fit() -> None:
    noisy = specimen(Constants(3e-4, 0.0, 0.0, 0.0))
    errors, bounds = [], []
    for _ in range(80):
        trial = pressed(noisy, (40.0,), (2.5e-4,))
        errors.append(camera_errors(trial, ours(trial))[0])
        bounds.append(trial.bound_cm[0])
    assert 0.6 < np.mean(errors) / np.mean(bounds) < 1.3


def test_the_frozen_constants_still_agree_with_section_3_2_better_than_a_perfect_robot() -> None:
    misfits = misfit(table(frozen(), robots=12, seed=3))
    assert misfits < 0.5 * misfit(table(PERFECT, robots=2, seed=3))


def test_the_thesis_cannot_tell_close_contacts_apart_and_we_can() -> None:
    robot = specimen(frozen(), 4)
    trials = [t for t in robot.trials("two-contacts", 6) if t.place == "18.5 cm apart"]
    thesis_cm = np.mean([camera_errors(t, thesis_method(t)).mean() for t in trials])
    ours_cm = np.mean([camera_errors(t, ours(t)).mean() for t in trials])
    assert thesis_cm > 8.0
    assert ours_cm < 5.0


def test_five_sensors_are_the_limit_of_the_solver_with_the_1_norm_not_of_the_norm() -> None:
    (table,) = sensitivity.run(6, Context(seed=0)).tables.values()
    mean_cm = {(r["method"], r["noise"], r["sensors"]): r["mean_cm"] for r in table}
    assert mean_cm["l1", 0.0, 3.0] < 0.2
    assert mean_cm["alternating", 0.0, 3.0] > 3.0
    assert mean_cm["alternating-2-norm", 0.0, 3.0] < 2.0


def run(name: str, out: Path, *, robots: int, trials: int, seed: int, jobs: int = 1) -> Outcome:
    outcome = EXPERIMENTS[name](robots, trials, Context(seed=seed, jobs=jobs))
    write(outcome, name, out)
    return outcome


@pytest.mark.parametrize("name", [n for n in EXPERIMENTS if n != "exploration"])
def test_each_experiment_writes_tables_figures_and_claims(name: str, tmp_path: Path) -> None:
    results = run(name, tmp_path, robots=1, trials=1, seed=0)
    assert set(tmp_path.glob("*.png")) == {tmp_path / f"{name}-{f}.png" for f in results.figures}
    assert results.figures or name == "predictions"
    claims = json.loads((tmp_path / f"{name}-claims.json").read_text())
    assert len(claims) == len(results.claims)
    assert results.claims or results.notes
    assert list(tmp_path.glob(f"{name}-*.csv"))


@pytest.mark.parametrize("name", ["actuated", "sensitivity"])
def test_results_do_not_depend_on_the_number_of_processes(name: str, tmp_path: Path) -> None:
    alone, shared = (
        run(name, tmp_path / str(jobs), robots=2, trials=1, seed=3, jobs=jobs).tables
        for jobs in (1, 2)
    )
    assert alone
    assert str(alone) == str(shared)  # NaN is not equal to itself


def test_the_bound_counts_gains_and_places() -> None:
    plain = pressed(specimen(Constants(3e-4, 0.0, 0.0, 0.0)), (40.0,), (2.5e-4,))
    crooked = pressed(specimen(Constants(3e-4, 0.05, 1.0, 0.0)), (40.0,), (2.5e-4,))
    assert crooked.sigma.min() >= plain.sigma.max()
    assert crooked.bound_cm[0] > 1.1 * plain.bound_cm[0]


def test_predictions_say_what_holds_and_what_fails() -> None:
    columns = "changed", "experiment", "condition", "thesis_cm", "camera_cm", "workspace_cm"
    lines = (
        ("as fitted", "two-contacts", "far", 4.0, 4.4, 4.0),
        ("noise + 50 %", "two-contacts", "far", 4.0, 5.9, 4.0),
        ("as fitted", "actuated", "high", 4.0, 9.0, 4.0),
        ("noise + 50 %", "actuated", "high", 4.0, 9.5, 4.0),
    )
    cells = [dict(zip(columns, line, strict=True)) for line in lines]
    near, far = remarks(cells)
    assert "holds" in near
    assert "noise + 50 %: 5.90" in near
    assert "FAILS" in far


def test_the_untouched_robot_shows_its_gains() -> None:
    """To within the stated deviation, which is below the calibrated gains' own spread."""
    nowhere, off = Planned("", "", "", 1, "right", ()), []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        robot = Specimen(Constants(5e-4, 0.03, 0.0, 0.0), rng)
        free = push(np.zeros(0), np.zeros(0), free_curvature=0.012, length=thesis.LENGTH_CM)
        robot.learn_gains(np.array([robot.read(free) for _ in range(30)]), 0.012)
        more = push(np.zeros(0), np.zeros(0), free_curvature=0.025, length=thesis.LENGTH_CM)
        trial = robot.observe(nowhere, more, robot.read(more), 0.025, ())
        clean = trial.curvature / 0.025  # the gain, and noise of 2 %
        off.append((clean / trial.gain - 1) / np.hypot(5e-4 / 0.025, 0.0075))
    assert 0.8 < np.std(off) < 1.2
