"""Figures of the experiments, each the counterpart of a figure in the thesis.

They show errors by condition (3.2c, 3.5c, 3.7c), and readings with fits (3.3, 3.6).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thigmo.display.axes import BLUE, GREEN, ORANGE
from thigmo.mechanics import phi
from thigmo_bench.experiments import thesis
from thigmo_bench.experiments.compare import OURS, THEIRS, Solved, answered, workspace_errors
from thigmo_bench.studies import charts

Group = tuple[str, list[Solved]]
_METHODS = ((THEIRS, ORANGE, "thesis's method, here"), (OURS, BLUE, "ours"))


def _groups(solved: Sequence[Solved], attribute: str) -> list[Group]:
    """Trials grouped by `condition` or by `place`, in their order."""
    groups: dict[str, list[Solved]] = {}
    for solution in solved:
        groups.setdefault(getattr(solution.trial, attribute), []).append(solution)
    return list(groups.items())


def _compare(axis: Axes, groups: Sequence[Group], contact: int) -> None:
    """Draw boxes of both methods' errors in the workspace, and the bound, for each group."""
    for position, (_, solved) in enumerate(groups):
        for shift, (method, color, label) in zip((-0.2, 0.2), _METHODS, strict=True):
            errors = [workspace_errors(*pair)[contact] for pair in answered(solved, method)]
            if errors:
                boxes = axis.boxplot(
                    [errors], positions=[position + shift], widths=0.32, patch_artist=True,
                    showfliers=False, medianprops={"color": "black"},
                )  # fmt: skip
                boxes["boxes"][0].set(facecolor=color, alpha=0.6)
                axis.plot(position + shift, np.mean(errors), "D", color="black", markersize=4)
            if position == 0:
                axis.plot([], [], "s", color=color, alpha=0.6, label=label)
        bound = np.array([trial.bound_cm[contact] for trial, _ in solved])
        if np.isfinite(bound).any():
            mean = bound[np.isfinite(bound)].mean()
            legend = "Cramer-Rao bound (mean absolute error)" if position == 0 else None
            span = position - 0.4, position + 0.4
            axis.plot(span, [mean, mean], color=GREEN, linewidth=2, label=legend)
    axis.set_xticks(range(len(groups)), [name for name, _ in groups])
    # Of all panels that share the axis: the one drawn last has the tallest box of all.
    top = max(panel.dataLim.y1 for panel in axis.get_shared_y_axes().get_siblings(axis))
    axis.set(ylabel="|x error| in the workspace (cm)", ylim=(0, 1.05 * top))


def _levels(solved: Sequence[Solved], experiment: str, title: str) -> Figure:
    """Draw a panel for each condition of one contact: errors by place, and the thesis's mean."""
    conditions = _groups(solved, "condition")
    figure, axes = charts.panels(1, len(conditions), size=(5.2, 4.2), title=title)
    for axis, (condition, condition_trials) in zip(axes, conditions, strict=True):
        _compare(axis, _groups(condition_trials, "place"), 0)
        mean, std = thesis.RESULTS[experiment, condition]
        axis.axhline(mean, color="gray", linestyle="--", label="thesis, mean over places")
        axis.set_title(f"{condition} (thesis {mean} +- {std} cm)")
        axis.set_xlabel("where the dowel stands")
    charts.legend_below(figure)
    return figure


def _readings(axis: Axes, solved: Solved, title: str) -> None:
    """Draw one trial: readings, and both methods' curvature along the body (thesis, figure 3.3)."""
    trial = solved.trial
    s = np.linspace(0.0, trial.length_cm, 400)
    axis.plot(trial.position, trial.curvature, "ko", markersize=5, label="readings")
    for method, color, label in _METHODS:
        answer = solved.answers[method]
        ramps = sum(
            (f * phi(a, s, 0.0) for a, f in zip(answer.arcs_cm, answer.forces, strict=True)),
            np.full(s.size, trial.free),
        )
        axis.plot(s, ramps, color=color, label=label)
        for arc in answer.arcs_cm:
            axis.axvline(arc, color=color, linestyle=":", linewidth=1)
    for index, arc in enumerate(trial.arcs_cm):
        axis.axvline(arc, color="k", linewidth=1, label="true contact" if index == 0 else None)
    for low, high in solved.answers[OURS].intervals_cm:
        axis.axvspan(low, high, color=BLUE, alpha=0.08)
    axis.set(
        xlabel="arc length (cm)", ylabel="curvature (1/cm)", xlim=(0, trial.length_cm + 1),
        title=title,
    )  # fmt: skip
    axis.legend(fontsize=7)


def single_contact(solved: Sequence[Solved]) -> dict[str, Figure]:
    """Errors by place and force (3.2c), and fits (3.3)."""
    levels = _groups(solved, "condition")
    fits, axes = charts.panels(
        1, len(levels), size=(5.2, 4.0),
        title="Readings and fits (thesis, figure 3.3; shaded: our 95 % interval)",
    )  # fmt: skip
    for axis, (level, level_trials) in zip(axes, levels, strict=True):
        nearest = min(level_trials, key=lambda candidate: candidate.trial.arcs_cm[0])
        _readings(axis, nearest, f"{level} at {nearest.trial.place}")
    title = "Single contact, unactuated (thesis, figure 3.2c)"
    return {
        "errors": _levels(solved, "single-contact", title),
        "fits": fits,
    }


def _two_contacts_title(solved: Sequence[Solved]) -> str:
    """The mean error of both methods, over both contacts and all separations."""
    said = [
        f"{np.mean([workspace_errors(*pair) for pair in answered(solved, method)]):.1f} cm {whose}"
        for method, whose in ((OURS, "ours"), (THEIRS, "by the thesis's method"))
    ]
    return f"Two opposed contacts: mean error {', '.join(said)} (thesis, figure 3.5c)"


def two_contacts(solved: Sequence[Solved]) -> dict[str, Figure]:
    """Errors of both contacts by separation (3.5c), and one fit at 18.5 cm (3.6)."""
    groups = [(n.removesuffix(" cm apart"), group) for n, group in _groups(solved, "place")]
    conditions = [group[0].trial.condition for _, group in groups]
    errors, axes = charts.panels(
        1, 2, size=(5.5, 4.4), share=True,
        title=_two_contacts_title(solved),
    )  # fmt: skip
    for contact, (axis, name) in enumerate(zip(axes, ("proximal", "distal"), strict=True)):
        _compare(axis, groups, contact)
        for condition in dict.fromkeys(conditions):
            columns = [
                n for n, name_of_column in enumerate(conditions) if name_of_column == condition
            ]
            mean, _ = thesis.RESULTS["two-contacts", condition]
            axis.plot((min(columns) - 0.45, max(columns) + 0.45), [mean] * 2, "--", color="gray")
        axis.plot([], [], "--", color="gray", label="thesis, mean over both contacts")
        axis.set(title=f"{name} contact", xlabel="separation (cm)")
    charts.legend_below(errors)
    fit, (axis,) = charts.panels(size=(7, 4.2))
    name, group = min(groups, key=lambda group: abs(float(group[0]) - 18.5))
    _readings(axis, group[0], f"Two contacts {name} cm apart (thesis, figure 3.6)")
    return {
        "errors": errors,
        "fit": fit,
    }


def actuated(solved: Sequence[Solved]) -> dict[str, Figure]:
    """Errors by place and pressure (3.7c)."""
    title = "Single contact with active bending (thesis, figure 3.7c)"
    return {"errors": _levels(solved, "actuated", title)}


FIGURES: dict[str, Callable[[Sequence[Solved]], dict[str, Figure]]] = {
    "single-contact": single_contact,
    "two-contacts": two_contacts,
    "actuated": actuated,
}
