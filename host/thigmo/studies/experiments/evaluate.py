"""From trials to the three columns: the thesis, the thesis's method here, ours; and the bound.

The same for simulated and for recorded trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import Any

import numpy as np
from scipy import special

from thigmo.errors import DataError
from thigmo.studies.engine import Claim, Context, Outcome
from thigmo.studies.experiments import compare, figures, thesis
from thigmo.studies.experiments.compare import ALONE, OURS, THEIRS, Solved
from thigmo.studies.experiments.trial import Trial
from thigmo.studies.rod import Floats

# The thesis's remedies for a folded base (section 3.2) beside its solver.
_REMEDIES = {"base clamped": "clamped", "coupled": "coupled"}

Row = dict[str, Any]
"""One line of the three-column table (cm), for CSV, JSON and the table of docs/figures.md.

    here_*, ours_*, alone_*: errors (`errors`) of the thesis's method here, of ours, and of ours
        without the readings on the way (NaN where there are none).
    perfect_arc_mean: the thesis's measure of a perfect arc: the foreshortening that it contains.
    bound_mean: mean absolute error of the arc at the Cramer-Rao bound, where that is finite.
    bound_measured_mean: the same estimator's error in the thesis's measure.
    unbounded: number of contacts without a finite bound: nothing fixes their place.
    ambiguous: number of our answers that say so.
    allowed_mean, allowed: what ours may be in the thesis's measure and in the workspace: the larger
        of half the thesis's method's error and 1.2 bounds; mean_beaten, beaten: whether it is.
"""


def evaluate(name: str, trials: Sequence[Trial], context: Context | None = None) -> Outcome:
    """Solve every trial by every method that its experiment compares, once; rows and figures.

    Conditions without trials are left out.

    Raises:
        DataError: no trial.
    """
    if not trials:
        raise DataError("there are no trials to evaluate", "take some, or give another folder")
    rows: list[Row] = []
    every: list[Solved] = []
    for condition in dict.fromkeys(trial.condition for trial in trials):
        high = name == "single-contact" and condition == thesis.LEVELS[0]
        remedies = _REMEDIES if high else {}
        methods = (THEIRS, *remedies.values())
        items = [(trial, methods) for trial in trials if trial.condition == condition]
        solved = (context or Context()).map(compare.solve, items, condition)
        rows.append(_row(name, condition, solved, THEIRS))
        rows += [_row(name, f"{condition}, {n}", solved, m) for n, m in remedies.items()]
        every += solved
    return Outcome(
        {"answers": _answers(every), "rows": rows},
        figures.FIGURES[name](every),
        [
            Claim(f"{name}, {r['condition']}: {measure}", r[value], r[allowed], unit="cm")
            for r in rows
            for measure, value, allowed in (
                ("|a - x of the obstacle|", "ours_mean", "allowed_mean"),
                ("workspace x error", "ours_workspace_mean", "allowed"),
            )
        ],
        [f"{name}, {r['condition']}{note}" for r in rows for note in _remarks(r)],
        [_shown(r) for r in rows],
    )


def errors(solved: Sequence[Solved], method: str) -> dict[str, float]:
    """A method's errors over trials, cm; trials without an answer are left out.

    Mean and std are in the thesis's measure; nearest_mean and other_mean of the closest pair of
    contact and obstacle, and of the others; workspace_mean is of the x in the workspace.
    """
    measures = compare.camera_errors, compare.assigned_errors, compare.workspace_errors
    pairs = compare.answered(solved, method)
    names = "mean", "std", "nearest_mean", "other_mean", "workspace_mean"
    if not pairs:
        return dict.fromkeys(names, nan)
    camera, assigned, room = (np.array([measure(*pair) for pair in pairs]) for measure in measures)
    nearest, other = assigned[:, 0].mean(), assigned[:, -1].mean()
    values = camera.mean(), camera.std(), nearest, other, room.mean()
    return dict(zip(names, map(float, values), strict=True))


def folded(offset: Floats, spread: Floats) -> Floats:
    """Mean absolute values (K,) of Gaussians of means `offset` >= 0 and mean deviations `spread`.

    Both are (K,); a mean deviation is sqrt(2 / pi) standard deviations.
    """
    share = offset / np.maximum(np.sqrt(np.pi / 2) * spread, 1e-9)
    return np.asarray(spread * np.exp(-0.5 * share**2) + offset * special.erf(share / np.sqrt(2.0)))


def _row(experiment: str, condition: str, solved: Sequence[Solved], here: str) -> Row:
    """The line of one condition: the baseline `here` and ours over its trials."""
    thesis_mean, thesis_std = thesis.RESULTS[experiment, condition]
    bounds = np.concatenate([trial.bound_cm for trial, _ in solved])
    finite = np.isfinite(bounds)
    ahead = np.concatenate([np.abs(np.subtract(t.arcs_cm, t.obstacle_x_cm)) for t, _ in solved])
    bound, measured = (
        float(values[finite].mean()) if finite.any() else float("inf")
        for values in (bounds, folded(ahead, bounds))
    )
    every = {
        f"{who}_{what}": value
        for who, method in (("here", here), ("ours", OURS), ("alone", ALONE))
        for what, value in errors(solved, method).items()
    }
    allowed_mean, allowed = (
        max(0.5 * every[f"here_{what}"], 1.2 * (least if np.isfinite(least) else 0.0))
        for what, least in (("mean", measured), ("workspace_mean", bound))
    )
    return {
        "experiment": experiment,
        "condition": condition,
        "trials": len(solved),
        "thesis_mean": thesis_mean,
        "thesis_std": thesis_std,
        **every,
        "perfect_arc_mean": float(ahead.mean()),
        "bound_mean": bound,
        "bound_measured_mean": measured,
        "unbounded": int(bounds.size - finite.sum()),
        "ambiguous": sum(answers[OURS].status == "ambiguous" for _, answers in solved),
        "allowed_mean": allowed_mean,
        "mean_beaten": bool(every["ours_mean"] <= allowed_mean),
        "allowed": allowed,
        "beaten": bool(every["ours_workspace_mean"] <= allowed),
    }


def _shown(r: Row) -> Row:
    """The columns that people look at first."""

    def spread(who: str) -> str:
        return f"{r[f'{who}_mean']:.2f} +- {r[f'{who}_std']:.2f}"

    return {
        "|a - x of the obstacle|, cm": f"{r['experiment']}, {r['condition']}",
        "trials": r["trials"],
        "thesis": spread("thesis"),
        "its method, here": spread("here"),
        "ours": spread("ours"),
        "perfect arc": r["perfect_arc_mean"],
        "at the bound": r["bound_measured_mean"],
        "x in the room: its": r["here_workspace_mean"],
        "ours, x": r["ours_workspace_mean"],
        "bound": r["bound_mean"],
    }


def _remarks(r: Row) -> list[str]:
    """What the row's numbers do not say by themselves."""
    told = []
    if r["experiment"] == "two-contacts":
        told.append(
            ", closest contact and obstacle paired first (that pair / the other): its method "
            f"{r['here_nearest_mean']:.2f} / {r['here_other_mean']:.2f} cm, ours "
            f"{r['ours_nearest_mean']:.2f} / {r['ours_other_mean']:.2f}"
        )
    if r["unbounded"]:
        told.append(f": no finite bound for {r['unbounded']} contacts, which its mean leaves out")
    if np.isfinite(r["alone_mean"]):
        told.append(
            f": ours without the readings on the way {r['alone_workspace_mean']:.2f} cm in the "
            f"workspace, {r['alone_mean']:.2f} in the thesis's measure; the bound is that of all "
            "readings"
        )
    if r["perfect_arc_mean"] > r["bound_mean"]:
        told.append(
            f": |a - x of the obstacle| of a perfect arc is {r['perfect_arc_mean']:.2f} cm, for a "
            "bent robot's arc is longer than its x; an estimator at the bound has "
            f"{r['bound_measured_mean']:.2f} in that measure"
        )
    return told


def _answers(solved: Sequence[Solved]) -> list[dict[str, str]]:
    """One line a trial and method: what `figures.py` draws, for other tools."""
    return [
        {"condition": trial.condition, "place": trial.place, "method": method}
        | {
            what: ";".join(f"{value:.6g}" for value in values)
            for what, values in (
                ("obstacle_x_cm", trial.obstacle_x_cm),
                ("arcs_cm", answer.arcs_cm),
                ("forces_per_cm2", answer.forces),
            )
        }
        for trial, answers in solved
        for method, answer in answers.items()
    ]
