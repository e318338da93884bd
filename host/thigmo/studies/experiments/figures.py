"""Figures of the experiments' results, in the places of the thesis's own.

Errors by condition (3.2c, 3.5c, 3.7c), readings and fits (3.3, 3.6) and the residual surface (2.7).
What is pressed where (3.2a, 3.4, 3.5a, 3.7a) is drawn by `schematics.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thigmo.mechanics import phi
from thigmo.studies.experiments import schematics, thesis
from thigmo.studies.experiments.compare import (
    OURS,
    Answer,
    Row,
    Solved,
    camera_errors,
    workspace_errors,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Groups = Sequence[tuple[str, list[Solved]]]
_HERE = "alternating"
_THEIRS = "tab:orange"
_OURS = "tab:blue"


def _box(axis: Axes, at: float, errors: Floats, color: str, label: str | None) -> None:
    answered = errors[np.isfinite(errors)]
    if not answered.size:
        return
    drawn = axis.boxplot(
        [answered],
        positions=[at],
        widths=0.32,
        patch_artist=True,
        showfliers=False,
        medianprops={"color": "black"},
    )
    drawn["boxes"][0].set(facecolor=color, alpha=0.6)
    axis.plot(at, answered.mean(), "D", color="black", markersize=4)
    if label:
        axis.plot([], [], "s", color=color, alpha=0.6, label=label)


def _compare(axis: Axes, groups: Groups, contact: int) -> None:
    for at, (_, solved) in enumerate(groups):
        first = at == 0
        theirs = _room(solved, _HERE, contact)
        _box(axis, at - 0.2, theirs, _THEIRS, "thesis's method, here" if first else None)
        _box(axis, at + 0.2, _room(solved, OURS, contact), _OURS, "ours" if first else None)
        bound = np.array([one.bound_cm[contact] for one in solved])
        if np.isfinite(bound).any():
            axis.plot(
                [at - 0.4, at + 0.4],
                [bound[np.isfinite(bound)].mean()] * 2,
                color="tab:green",
                linewidth=2,
                label="Cramer-Rao bound (mean absolute error)" if first else None,
            )
    axis.set_xticks(range(len(groups)), [name for name, _ in groups])
    axis.set(ylabel="|x error| in the workspace (cm)")
    axis.grid(axis="y", alpha=0.2)


def _room(solved: Sequence[Solved], method: str, contact: int) -> Floats:
    return np.array([workspace_errors(s.trial, s.answers[method])[contact] for s in solved])


def _readings(axis: Axes, one: Solved) -> None:
    """One trial: readings, and both methods' curvature along the body (thesis, figure 3.3)."""
    trial = one.trial
    theirs, mine = one.answers[_HERE], one.answers[OURS]
    s = np.linspace(0.0, trial.length_cm, 400)
    axis.plot(trial.position, trial.curvature, "ko", markersize=5, label="readings")
    for answer, color, name in ((theirs, _THEIRS, "thesis's method"), (mine, _OURS, "ours")):
        if not answer.arcs_cm:
            continue
        axis.plot(s, trial.free + _ramps(answer, s), color=color, label=name)
        for arc in answer.arcs_cm:
            axis.axvline(arc, color=color, linestyle=":", linewidth=1)
    for index, arc in enumerate(trial.arcs_cm):
        axis.axvline(arc, color="k", linewidth=1, label="true contact" if index == 0 else None)
    for low, high in mine.intervals_cm:
        axis.axvspan(low, high, color=_OURS, alpha=0.08)
    axis.set(xlabel="arc length (cm)", ylabel="curvature (1/cm)", xlim=(0, trial.length_cm + 1))
    axis.grid(alpha=0.2)


def _ramps(answer: Answer, s: Floats) -> Floats:
    levers = np.column_stack([phi(arc, s, 0.0) for arc in answer.arcs_cm])
    ramps: Floats = levers @ np.array(answer.forces)
    return ramps


def _of(solved: Sequence[Solved], condition: str) -> list[Solved]:
    return [one for one in solved if one.trial.condition == condition]


def _by_place(solved: Sequence[Solved]) -> list[tuple[str, list[Solved]]]:
    places = dict.fromkeys(one.trial.place for one in solved)
    return [(p, [one for one in solved if one.trial.place == p]) for p in places]


def _levels(solved: Sequence[Solved], rows: Sequence[Row]) -> Figure:
    """A panel a condition of one contact: errors by place, and the thesis's mean."""
    from matplotlib.figure import Figure

    conditions = list(dict.fromkeys(one.trial.condition for one in solved))
    figure = Figure(figsize=(5.2 * len(conditions), 4.2), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(conditions)))
    for axis, condition in zip(axes, conditions, strict=True):
        _compare(axis, _by_place(_of(solved, condition)), 0)
        told = next(r for r in rows if r.condition == condition)
        mean = told.thesis_mean
        axis.axhline(mean, color="gray", linestyle="--", label="thesis, mean over places")
        axis.set_title(f"{condition} (thesis {mean} +- {told.thesis_std} cm)", fontsize=10)
        axis.set_xlabel("where the dowel stands")
        axis.set_ylim(bottom=0)
    _legend_below(figure)
    return figure


def _legend_below(figure: Figure) -> None:
    """One legend for all panels, under them, where it covers nothing."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=7)


def single_contact(solved: Sequence[Solved], rows: Sequence[Row]) -> dict[str, Figure]:
    """Errors by place and force (3.2c), fits (3.3), and the residual surface (2.7)."""
    from matplotlib.figure import Figure

    errors = _levels(solved, rows)
    errors.suptitle("Single contact, unactuated (thesis, figure 3.2c)")
    levels = list(dict.fromkeys(one.trial.condition for one in solved))

    fits = Figure(figsize=(5.2 * len(levels), 4.0), layout="constrained")
    for axis, level in zip(np.atleast_1d(fits.subplots(1, len(levels))), levels, strict=True):
        nearest = min(_of(solved, level), key=lambda one: one.trial.arcs_cm[0])
        _readings(axis, nearest)
        axis.set_title(f"{level} at {nearest.trial.place}")
        axis.legend(fontsize=7)
    fits.suptitle("Readings and fits (thesis, figure 3.3; shaded: our 95 % interval)")

    methods = Figure(figsize=(7.5, 4.0), layout="constrained")
    axis = methods.subplots()
    at = np.arange(len(rows))
    axis.bar(at - 0.3, [r.thesis_mean for r in rows], 0.2, color="lightgray", label="thesis")
    axis.bar(at - 0.1, [r.here.mean for r in rows], 0.2, color=_THEIRS, label="its method, here")
    axis.bar(at + 0.1, [r.ours.mean for r in rows], 0.2, color=_OURS, label="ours")
    bounds = [r.bound if np.isfinite(r.bound) else 0.0 for r in rows]
    axis.bar(at + 0.3, bounds, 0.2, color="tab:green", label="bound")
    axis.set_xticks(at, [r.condition.replace(", ", ",\n") for r in rows], fontsize=8)
    axis.set(ylabel="mean |a - x of the obstacle| (cm)")
    axis.legend(fontsize=8)
    axis.set_title("Single contact: the thesis's measure")
    return {
        "schematic": schematics.single_contact(),
        "fold": schematics.fold(),
        "errors": errors,
        "fits": fits,
        "methods": methods,
        "residual-surface": _surface(solved),
    }


def _surface(solved: Sequence[Solved]) -> Figure:
    """The thesis's objective over place and force for a high force at 3L/4 (its figure 2.7)."""
    from matplotlib.figure import Figure

    one = min(
        solved,
        key=lambda s: (s.trial.condition != thesis.LEVELS[0], s.trial.place != "3L/4"),
    )
    trial, answer = one.trial, one.answers[_HERE]
    # On a real robot the force is known only as the method's own.
    force = trial.forces[0] if np.isfinite(trial.forces[0]) else answer.forces[0]
    arcs = np.linspace(1.0, trial.length_cm, 261)
    moments = np.linspace(0.1, 3.0, 240) * force * trial.arcs_cm[0]
    value = np.empty((moments.size, arcs.size))
    for column, arc in enumerate(arcs):
        lever = phi(arc, trial.position, 0.0)
        left = (trial.curvature - trial.free)[:, None] - np.outer(lever, moments / arc)
        value[:, column] = np.abs(left).sum(axis=0)
    figure = Figure(figsize=(7, 4.6), layout="constrained")
    axis = figure.subplots()
    image = axis.pcolormesh(arcs, moments, np.log10(value), cmap="viridis", shading="auto")
    figure.colorbar(image, ax=axis, label="log10 of the 1-norm of residuals (1/cm)")
    ravine = value.min(axis=0)
    axis.plot(arcs, moments[value.argmin(axis=0)], "w:", linewidth=1, label="floor of the ravine")
    inner = np.flatnonzero((ravine[1:-1] < ravine[:-2]) & (ravine[1:-1] < ravine[2:])) + 1
    axis.plot(
        arcs[inner], moments[value.argmin(axis=0)][inner], "wv", label="local minima along it"
    )
    axis.axvline(trial.arcs_cm[0], color="r", linewidth=1, label="true contact")
    axis.axvline(answer.arcs_cm[0], color=_THEIRS, linewidth=1, label="thesis's method, here")
    axis.set(xlabel="arc of the contact (cm)", ylabel="base moment f a (1/cm)")
    axis.legend(fontsize=8, labelcolor="white", facecolor="0.25", loc="upper right")
    axis.set_title(
        f"Residuals over place and force, {trial.condition} at {trial.place} (thesis, figure 2.7)",
        fontsize=10,
    )
    return figure


def two_contacts(solved: Sequence[Solved], rows: Sequence[Row]) -> dict[str, Figure]:
    """Errors of both contacts by separation (3.5c), and one fit at 18.5 cm (3.6)."""
    from matplotlib.figure import Figure

    groups = [(name.removesuffix(" cm apart"), some) for name, some in _by_place(solved)]
    errors = Figure(figsize=(11, 4.4), layout="constrained")
    for axis, contact, name in zip(
        errors.subplots(1, 2, sharey=True), (0, 1), ("proximal", "distal"), strict=True
    ):
        _compare(axis, groups, contact)
        for r in rows:
            mine = [one.trial.place for one in _of(solved, r.condition)]
            at = [n for n, (place, _) in enumerate(groups) if f"{place} cm apart" in mine]
            ends = (min(at) - 0.45, max(at) + 0.45)
            axis.plot(ends, [r.thesis_mean] * 2, "--", color="gray")
        axis.plot([], [], "--", color="gray", label="thesis, mean over both contacts")
        axis.set_title(f"{name} contact")
        axis.set_xlabel("separation (cm)")
    _legend_below(errors)
    errors.axes[0].set_ylim(bottom=0)
    errors.suptitle("Two opposed contacts, ordered along the arc (thesis, figure 3.5c)")
    fits = Figure(figsize=(7, 4.2), layout="constrained")
    axis = fits.subplots()
    name, some = min(groups, key=lambda group: abs(float(group[0]) - 18.5))
    _readings(axis, some[0])
    axis.legend(fontsize=8)
    axis.set_title(f"Two contacts {name} cm apart (thesis, figure 3.6)")
    return {"schematic": schematics.two_contacts(), "errors": errors, "fit": fits}


def actuated(solved: Sequence[Solved], rows: Sequence[Row]) -> dict[str, Figure]:
    """Errors by place and pressure (3.7c), as the thesis measures and in the workspace."""
    from matplotlib.figure import Figure

    errors = _levels(solved, rows)
    errors.suptitle("Single contact with active bending (thesis, figure 3.7c)")

    mixture = Figure(figsize=(7, 4.2), layout="constrained")
    axis = mixture.subplots()
    true = np.array([one.trial.arcs_cm[0] - one.trial.obstacle_x_cm[0] for one in solved])
    jitter = np.random.default_rng(0).uniform(-0.15, 0.15, true.size)
    for method, color, label in (
        (_HERE, _THEIRS, "thesis's method, here"),
        (OURS, _OURS, "ours"),
    ):
        found = [float(camera_errors(one.trial, one.answers[method])[0]) for one in solved]
        axis.plot(true + jitter, found, "o", color=color, alpha=0.3, markersize=4, label=label)
    top = float(true.max()) * 1.1
    axis.plot([0, top], [0, top], "k--", linewidth=1, label="a perfect arc, by this measure")
    axis.set(
        xlabel="arc - x of the obstacle: foreshortening (cm)", ylabel="|a - x of the obstacle| (cm)"
    )
    axis.grid(alpha=0.2)
    axis.legend(fontsize=8)
    axis.set_title("The thesis's measure holds the bent robot's foreshortening")
    return {"schematic": schematics.actuated(), "errors": errors, "measure": mixture}
