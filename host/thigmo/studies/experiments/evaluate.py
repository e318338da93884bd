"""From trials to rows and figures: the same for simulated and for recorded ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from thigmo.errors import DataError
from thigmo.studies.engine import Cell, Claim, Context, Outcome, Table
from thigmo.studies.experiments import figures, thesis
from thigmo.studies.experiments.compare import Row, Solved, row, solve
from thigmo.studies.experiments.trial import Trial

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

# The thesis's remedies for a folded base (section 3.2) beside its solver.
_REMEDIES = {"base clamped": "clamped", "coupled": "coupled"}


@dataclass
class Results:
    """What an experiment gave: rows of the comparison, figures by name, claims, tables, remarks."""

    rows: list[Row] = field(default_factory=list)
    figures: dict[str, Figure] = field(default_factory=dict)
    claims: list[Claim] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def evaluate(name: str, trials: Sequence[Trial], context: Context | None = None) -> Results:
    """Solve every trial by every method that its experiment compares, once; rows and figures.

    Args:
        name: single-contact, two-contacts or actuated.
        trials: of that experiment; conditions without any are left out.
        context: whose processes share the trials; None takes one.

    Raises:
        DataError: no trial.
    """
    if not trials:
        raise DataError("there are no trials to evaluate", "take some, or give another folder")
    rows, every = [], []
    for condition in dict.fromkeys(trial.condition for trial in trials):
        mine = [trial for trial in trials if trial.condition == condition]
        high = name == "single-contact" and condition == thesis.LEVELS[0]
        methods = ("alternating", *(_REMEDIES.values() if high else ()))
        items = [(trial, methods) for trial in mine]
        solved = (context or Context()).map(solve, items, f"{name}, {condition}")
        rows.append(row(name, condition, solved, "alternating"))
        if high:
            rows += [row(name, f"{condition}, {n}", solved, m) for n, m in _REMEDIES.items()]
        every += solved
    results = Results(rows, _FIGURES[name](every, rows), tables=[_answers(every)])
    results.tables.append(
        Table("rows", tuple(rows[0].record()), [tuple(r.record().values()) for r in rows])
    )
    for r in rows:
        for workspace, measure in ((False, "|a - x of the obstacle|"), (True, "workspace x error")):
            value = r.ours.workspace if workspace else r.ours.mean
            text = f"{r.experiment}, {r.condition}: {measure}"
            results.claims.append(Claim(text, value, r.allowed(workspace), unit="cm"))
        results.notes += _remarks(r)
    alone = sum(trial.passed is None for trial in trials)
    if name == "actuated" and alone:
        results.notes.append(
            f"actuated: {alone} of {len(trials)} trials hold no readings on the way (an earlier "
            "version took them) and are evaluated by the last reading only"
        )
    return results


def _remarks(r: Row) -> list[str]:
    """What the row's numbers do not say by themselves."""
    told = []
    if r.experiment == "two-contacts":
        told.append(
            f"{r.experiment}, {r.condition}, closest contact and obstacle paired first (that pair "
            f"/ the other): its method {r.here.nearest:.2f} / {r.here.other:.2f} cm, ours "
            f"{r.ours.nearest:.2f} / {r.ours.other:.2f}"
        )
    if r.unbounded:
        told.append(
            f"{r.experiment}, {r.condition}: no finite bound for {r.unbounded} contacts, which its "
            "mean leaves out"
        )
    if r.alone is not None:
        told.append(
            f"{r.experiment}, {r.condition}: ours without the readings on the way "
            f"{r.alone.workspace:.2f} cm in the workspace, {r.alone.mean:.2f} in the thesis's "
            "measure; the bound is that of all readings"
        )
    if r.perfect > r.bound:
        told.append(
            f"{r.experiment}, {r.condition}: |a - x of the obstacle| of a perfect arc is "
            f"{r.perfect:.2f} cm, for a bent robot's arc is longer than its x; an estimator at the "
            f"bound has {r.measured:.2f} in that measure"
        )
    return told


_FIGURES = {
    "single-contact": figures.single_contact,
    "two-contacts": figures.two_contacts,
    "actuated": figures.actuated,
}


def _answers(solved: Sequence[Solved]) -> Table:
    """One line a trial and method: what `figures.py` draws, for other tools."""
    columns = ("condition", "place", "method", "obstacle_x_cm", "arcs_cm", "forces_per_cm2")

    def listed(values: Sequence[float]) -> str:
        return ";".join(f"{value:.6g}" for value in values)

    lines: list[tuple[Cell, ...]] = [
        (
            one.trial.condition,
            one.trial.place,
            method,
            listed(one.trial.obstacle_x_cm),
            listed(answer.arcs_cm),
            listed(answer.forces),
        )
        for one in solved
        for method, answer in one.answers.items()
    ]
    return Table("answers", columns, lines)


def save(results: Results, name: str, folder: Path) -> None:
    """Write tables, figures and claims into a folder.

    Raises:
        RunFolderError: the folder cannot be written.
    """
    from thigmo.studies.engine import write

    write(Outcome(results.tables, results.figures, results.claims), name, folder)
