"""Tables of an experiment from its trials, simulated or recorded.

Each row has the thesis's result, the thesis's method here, our method and the bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import Any

import numpy as np
from scipy import special

from thigmo.errors import DataError
from thigmo_bench.experiments import compare, plots, thesis
from thigmo_bench.experiments.compare import OURS, THEIRS, Solved
from thigmo_bench.experiments.trial import Trial
from thigmo_bench.studies.engine import Claim, Context, Outcome
from thigmo_bench.studies.rod import Floats

# The thesis's remedies for a folded base (section 3.2) beside its solver.
_REMEDIES = {"base clamped": "clamped", "coupled": "coupled"}

Row = dict[str, Any]
"""One line of the three-column table (cm), for CSV, JSON and the table of docs/figures.md.

    here_*, ours_*: errors (`errors`) of the thesis's method here, and of ours.
    ours_se: standard error over the robots of our error of x in the workspace.
    less_mean, less_se: the baseline's error of x in the workspace less ours, and its standard
        error over robots (NaN for one robot), because the trials of a robot share its errors.
    by_place: mean error of x in the workspace at each place, the baseline's and ours.
    perfect_arc_mean: the thesis's measure for the true arc, that is, its foreshortening alone.
    bound_mean: mean absolute error of the arc at the Cramer-Rao bound, where that is finite.
    bound_measured_mean: the same estimator's error in the thesis's measure.
    unbounded: number of contacts without a finite bound: nothing fixes their place.
    ambiguous: number of our answers that say so.
    allowed_mean, allowed: limits of our error in the thesis's measure and in the workspace: half of
        the baseline's error or 1.2 bounds, whichever is larger.
    mean_beaten, beaten: whether our errors keep these limits.
"""


def evaluate(name: str, trials: Sequence[Trial], context: Context | None = None) -> Outcome:
    """Solve each trial once by each method that its experiment compares; return rows and figures.

    Conditions without trials are omitted.

    Raises:
        DataError: there is no trial.
    """
    if not trials:
        raise DataError("there are no trials to evaluate", "take some, or give another folder")
    rows: list[Row] = []
    all_solved: list[Solved] = []
    for condition in dict.fromkeys(trial.condition for trial in trials):
        high = name == "single-contact" and condition == thesis.LEVELS[0]
        remedies = _REMEDIES if high else {}
        methods = (THEIRS, *remedies.values())
        items = [(trial, methods) for trial in trials if trial.condition == condition]
        solved = (context or Context()).map(compare.solve, items, condition)
        rows.append(_row(name, condition, solved, THEIRS))
        rows += [_row(name, f"{condition}, {n}", solved, m) for n, m in remedies.items()]
        all_solved += solved
    return Outcome(
        {"answers": _answers(all_solved), "rows": rows},
        plots.FIGURES[name](all_solved),
        [
            Claim(
                f"{name}, {r['condition']}: {measure}",
                r[value],
                r[allowed],
                unit="cm",
                standard_error=r["ours_se"],
            )
            for r in rows
            for measure, value, allowed in (
                ("|a - x of the obstacle|", "ours_mean", "allowed_mean"),
                ("workspace x error", "ours_workspace_mean", "allowed"),
            )
        ],
        [f"{name}, {r['condition']}{note}" for r in rows for note in _remarks(r)],
        [_printed_row(row) for row in rows],
    )


def errors(solved: Sequence[Solved], method: str) -> dict[str, float]:
    """A method's errors over trials, cm; trials without an answer are omitted.

    `mean` and `std` are of the thesis's measure, `nearest_mean` of the closest pair of contact and
    obstacle, `other_mean` of the other pairs, and `workspace_mean` of x in the workspace.
    """
    measures = compare.camera_errors, compare.assigned_errors, compare.workspace_errors
    pairs = compare.answered(solved, method)
    names = "mean", "std", "nearest_mean", "other_mean", "workspace_mean"
    if not pairs:
        return dict.fromkeys(names, nan)
    camera, assigned, workspace = (
        np.array([measure(*pair) for pair in pairs]) for measure in measures
    )
    nearest, second = assigned[:, 0].mean(), assigned[:, -1].mean()
    values = camera.mean(), camera.std(), nearest, second, workspace.mean()
    return dict(zip(names, map(float, values), strict=True))


def folded(offset: Floats, spread: Floats) -> Floats:
    """Mean absolute values (K,) of Gaussians with means `offset` >= 0 and mean deviations `spread`.

    Both arguments are (K,). A mean deviation is sqrt(2 / pi) standard deviations.
    """
    share = offset / np.maximum(np.sqrt(np.pi / 2) * spread, 1e-9)
    return np.asarray(spread * np.exp(-0.5 * share**2) + offset * special.erf(share / np.sqrt(2.0)))


def _row(experiment: str, condition: str, solved: Sequence[Solved], baseline: str) -> Row:
    """The row of one condition: errors of the baseline `here` and of our method over its trials."""
    thesis_mean, thesis_std = thesis.RESULTS[experiment, condition]
    bounds = np.concatenate([trial.bound_cm for trial, _ in solved])
    finite = np.isfinite(bounds)
    foreshortening = np.concatenate(
        [np.abs(np.subtract(t.arcs_cm, t.obstacle_x_cm)) for t, _ in solved]
    )
    bound, bound_measured = (
        float(values[finite].mean()) if finite.any() else float("inf")
        for values in (bounds, folded(foreshortening, bounds))
    )
    all_errors = {
        f"{prefix}_{measure}": value
        for prefix, method in (("here", baseline), ("ours", OURS))
        for measure, value in errors(solved, method).items()
    }
    allowed_mean, allowed = (
        max(0.5 * all_errors[f"here_{measure}"], 1.2 * (bound_cm if np.isfinite(bound_cm) else 0.0))
        for measure, bound_cm in (("mean", bound_measured), ("workspace_mean", bound))
    )
    return {
        "experiment": experiment,
        "condition": condition,
        "trials": len(solved),
        "thesis_mean": thesis_mean,
        "thesis_std": thesis_std,
        **all_errors,
        **_paired_comparison(solved, baseline),
        "perfect_arc_mean": float(foreshortening.mean()),
        "bound_mean": bound,
        "bound_measured_mean": bound_measured,
        "unbounded": int(bounds.size - finite.sum()),
        "ambiguous": sum(answers[OURS].status == "ambiguous" for _, answers in solved),
        "allowed_mean": allowed_mean,
        "mean_beaten": bool(all_errors["ours_mean"] <= allowed_mean),
        "allowed": allowed,
        "beaten": bool(all_errors["ours_workspace_mean"] <= allowed),
    }


def _paired_comparison(solved: Sequence[Solved], baseline: str) -> Row:
    """Our method compared with a baseline, robot by robot and place by place."""

    def error(trial: Trial, answer: compare.Answer) -> float:
        return float(compare.workspace_errors(trial, answer).mean())

    pairs = [
        (trial, error(trial, answers[baseline]), error(trial, answers[OURS]))
        for trial, answers in solved
        if all(len(answers[m].arcs_cm) == len(trial.arcs_cm) for m in (baseline, OURS))
    ]
    robots = {trial.robot for trial, _, _ in pairs}
    per_robot = np.array([
        np.mean([errors for trial, *errors in pairs if trial.robot == n], axis=0) for n in robots
    ]).reshape(-1, 2)  # fmt: skip
    excess, ours = per_robot[:, 0] - per_robot[:, 1], per_robot[:, 1]
    places = dict.fromkeys(trial.place for trial, _, _ in pairs)
    return {
        "ours_se": _standard_error(ours),
        "less_mean": float(excess.mean()) if excess.size else nan,
        "less_se": _standard_error(excess),
        "by_place": {
            place: np.mean([(a, b) for t, a, b in pairs if t.place == place], axis=0).tolist()
            for place in places
        },
    }


def _standard_error(of_robots: Floats) -> float:
    """Standard error of the mean over robots; NaN if there is only one robot."""
    n = of_robots.size
    return float(of_robots.std(ddof=1) / np.sqrt(n)) if n > 1 else nan


def _printed_row(r: Row) -> Row:
    """Columns of the printed table: means in the thesis's measure, then errors of x in the room."""
    return {
        "mean error, cm": r["condition"],
        "n": r["trials"],
        "thesis": r["thesis_mean"],
        "its": r["here_mean"],
        "ours": r["ours_mean"],
        "bound": r["bound_measured_mean"],
        "x: its": r["here_workspace_mean"],
        "x: ours": r["ours_workspace_mean"],
        "x: bound": r["bound_mean"],
    }


def _remarks(r: Row) -> list[str]:
    """Sentences that the numbers of a row do not show: ties, missing bounds, foreshortening."""
    lines = []
    if r["experiment"] == "two-contacts":
        lines.append(
            ", closest contact and obstacle paired first (that pair / the other): its method "
            f"{r['here_nearest_mean']:.2f} / {r['here_other_mean']:.2f} cm, ours "
            f"{r['ours_nearest_mean']:.2f} / {r['ours_other_mean']:.2f}"
        )
    if r["unbounded"]:
        lines.append(f": no finite bound for {r['unbounded']} contacts, which its mean leaves out")
    if np.isfinite(r["less_se"]) and abs(r["less_mean"]) < 2 * r["less_se"]:
        lines.append(
            f": a tie: the two differ by {r['less_mean']:.2f} +- {r['less_se']:.2f} cm over the "
            "robots"
        )
    if r["perfect_arc_mean"] > r["bound_mean"]:
        lines.append(
            f": |a - x of the obstacle| of a perfect arc is {r['perfect_arc_mean']:.2f} cm, for a "
            "bent robot's arc is longer than its x; an estimator at the bound has "
            f"{r['bound_measured_mean']:.2f} in that measure"
        )
    return lines


def _answers(solved: Sequence[Solved]) -> list[dict[str, str]]:
    """One row for each trial and method: what `plots.py` draws, as a table for other tools."""
    return [
        {"condition": trial.condition, "place": trial.place, "method": method}
        | {
            column: ";".join(f"{value:.6g}" for value in values)
            for column, values in (
                ("obstacle_x_cm", trial.obstacle_x_cm),
                ("arcs_cm", answer.arcs_cm),
                ("forces_per_cm2", answer.forces),
            )
        }
        for trial, answers in solved
        for method, answer in answers.items()
    ]
