"""From trials to rows and figures: the same for simulated and for recorded ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thigmo.errors import DataError
from thigmo.studies.engine import Claim, Context, Outcome
from thigmo.studies.experiments import figures, thesis
from thigmo.studies.experiments.compare import THEIRS, Row, Solved, row, shown, solve
from thigmo.studies.experiments.trial import Trial

# The thesis's remedies for a folded base (section 3.2) beside its solver.
_REMEDIES = {"base clamped": "clamped", "coupled": "coupled"}


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
        mine = [trial for trial in trials if trial.condition == condition]
        high = name == "single-contact" and condition == thesis.LEVELS[0]
        remedies = _REMEDIES if high else {}
        items = [(trial, (THEIRS, *remedies.values())) for trial in mine]
        solved = (context or Context()).map(solve, items, condition)
        rows.append(row(name, condition, solved, THEIRS))
        rows += [row(name, f"{condition}, {n}", solved, m) for n, m in remedies.items()]
        every += solved
    return Outcome(
        {"answers": _answers(every), "rows": rows},
        figures.FIGURES[name](every, rows),
        [
            Claim(f"{name}, {r['condition']}: {measure}", r[value], r[allowed], unit="cm")
            for r in rows
            for measure, value, allowed in (
                ("|a - x of the obstacle|", "ours_mean", "allowed_mean"),
                ("workspace x error", "ours_workspace_mean", "allowed"),
            )
        ],
        [f"{name}, {r['condition']}{note}" for r in rows for note in _remarks(r)],
        [shown(r) for r in rows],
    )


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

    def listed(values: Sequence[float]) -> str:
        return ";".join(f"{value:.6g}" for value in values)

    return [
        {
            "condition": one.trial.condition,
            "place": one.trial.place,
            "method": method,
            "obstacle_x_cm": listed(one.trial.obstacle_x_cm),
            "arcs_cm": listed(answer.arcs_cm),
            "forces_per_cm2": listed(answer.forces),
        }
        for one in solved
        for method, answer in one.answers.items()
    ]
