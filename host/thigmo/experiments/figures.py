"""Figures of the experiments, in the places of the thesis's own (3.2a/c, 3.3, 3.5c, 3.6, 3.7c)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thigmo.experiments import conditions, thesis
from thigmo.experiments.compare import (
    Answer,
    Method,
    Row,
    baseline,
    bound_cm,
    camera_errors,
    ours,
    workspace_errors,
)
from thigmo.experiments.specimen import Trial
from thigmo.mechanics import phi

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
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


def _compare(
    axis: Axes, groups: Sequence[tuple[str, list[Trial]]], here: Method, contact: int
) -> None:
    for at, (_, trials) in enumerate(groups):
        first = at == 0
        theirs = np.array([workspace_errors(t, here(t))[contact] for t in trials])
        mine = np.array([workspace_errors(t, ours(t))[contact] for t in trials])
        _box(axis, at - 0.2, theirs, _THEIRS, "thesis's method, here" if first else None)
        _box(axis, at + 0.2, mine, _OURS, "ours" if first else None)
        bound = np.array([bound_cm(t)[contact] for t in trials])
        if np.isfinite(bound).any():
            axis.plot(
                [at - 0.4, at + 0.4],
                [bound[np.isfinite(bound)].mean()] * 2,
                color="tab:green",
                linewidth=2,
                label="Cramer-Rao bound (mean absolute error)" if first else None,
            )
    axis.set_xticks(range(len(groups)), [name for name, _ in groups])
    axis.set(ylabel="|x error| in the workspace (cm)", ylim=(0, None))
    axis.grid(axis="y", alpha=0.2)


def _readings(axis: Axes, trial: Trial, theirs: Answer, mine: Answer) -> None:
    """One trial: readings, and both methods' curvature along the body (thesis, figure 3.3)."""
    s = np.linspace(0.0, thesis.LENGTH_CM, 400)
    axis.plot(trial.position, trial.curvature, "ko", markersize=5, label="readings")
    for answer, color, name in ((theirs, _THEIRS, "thesis's method"), (mine, _OURS, "ours")):
        if not answer.arcs_cm:
            continue
        levers = [phi(arc, s, 0.0) for arc in answer.arcs_cm]
        curve = trial.free + np.column_stack(levers) @ np.array(answer.forces)
        axis.plot(s, curve, color=color, label=name)
        for arc in answer.arcs_cm:
            axis.axvline(arc, color=color, linestyle=":", linewidth=1)
    for index, arc in enumerate(trial.arcs_cm):
        axis.axvline(arc, color="k", linewidth=1, label="true contact" if index == 0 else None)
    for low, high in mine.intervals_cm:
        axis.axvspan(low, high, color=_OURS, alpha=0.08)
    axis.set(xlabel="arc length (cm)", ylabel="curvature (1/cm)", xlim=(0, thesis.LENGTH_CM + 1))
    axis.grid(alpha=0.2)


def _by_arc(trials: Sequence[Trial]) -> list[tuple[str, list[Trial]]]:
    names = {53.0: "L", 0.75 * 53.0: "3L/4", 0.5 * 53.0: "L/2"}
    nearest = [min(names, key=lambda arc: abs(arc - t.arcs_cm[0])) for t in trials]
    return [
        (names[arc], [t for t, n in zip(trials, nearest, strict=True) if n == arc])
        for arc in sorted(set(nearest), reverse=True)
    ]


def single_contact(trials: list[Trial], rows: list[Row]) -> dict[str, Figure]:
    """Errors by place and force (3.2c), fits (3.3), and the residual surface (2.7)."""
    from matplotlib.figure import Figure

    here = baseline("alternating")
    errors = Figure(figsize=(10, 4.2), layout="constrained")
    for axis, level in zip(errors.subplots(1, 2), ("high force", "low force"), strict=True):
        some = [t for t in trials if t.condition == level]
        _compare(axis, _by_arc(some), here, 0)
        told = thesis.published("single-contact", level)
        axis.axhline(told.mean_cm, color="gray", linestyle="--", label="thesis, mean")
        axis.set_title(f"{level} (thesis {told.mean_cm} +- {told.std_cm} cm)")
        axis.legend(fontsize=7)
    errors.suptitle("Single contact, unactuated (thesis, figure 3.2c)")

    fits = Figure(figsize=(10, 4.0), layout="constrained")
    for axis, level in zip(fits.subplots(1, 2), ("high force", "low force"), strict=True):
        trial = _by_arc([t for t in trials if t.condition == level])[-1][1][0]
        _readings(axis, trial, here(trial), ours(trial))
        axis.set_title(f"{level} at L/2")
        axis.legend(fontsize=7)
    fits.suptitle("Readings and fits (thesis, figure 3.3; shaded: our 95 % interval)")

    methods = Figure(figsize=(7.5, 4.0), layout="constrained")
    axis = methods.subplots()
    at = np.arange(len(rows))
    axis.bar(at - 0.3, [r.thesis_mean for r in rows], 0.2, color="lightgray", label="thesis")
    axis.bar(at - 0.1, [r.here_mean for r in rows], 0.2, color=_THEIRS, label="its method, here")
    axis.bar(at + 0.1, [r.ours_mean for r in rows], 0.2, color=_OURS, label="ours")
    axis.bar(at + 0.3, [r.bound_mean for r in rows], 0.2, color="tab:green", label="bound")
    axis.set_xticks(at, [r.condition.replace(", ", ",\n") for r in rows], fontsize=8)
    axis.set(ylabel="mean |a - x of the obstacle| (cm)")
    axis.legend(fontsize=8)
    axis.set_title("Single contact: the thesis's measure")
    return {
        "errors": errors,
        "fits": fits,
        "methods": methods,
        "residual-surface": _surface(trials),
    }


def _surface(trials: list[Trial]) -> Figure:
    """The thesis's objective over place and force for a high force at 3L/4 (its figure 2.7)."""
    from matplotlib.figure import Figure

    high = [t for t in trials if t.condition == "high force"]
    trial = min(high, key=lambda t: abs(t.arcs_cm[0] - 0.75 * thesis.LENGTH_CM))
    arcs = np.linspace(1.0, thesis.LENGTH_CM, 261)
    moments = np.linspace(0.1, 3.0, 240) * trial.forces[0] * trial.arcs_cm[0]
    value = np.empty((moments.size, arcs.size))
    for column, arc in enumerate(arcs):
        lever = phi(arc, trial.position, trial.span)
        left = trial.curvature[:, None] - np.outer(lever, moments / arc)
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
    axis.set(xlabel="arc of the contact (cm)", ylabel="base moment f a (1/cm)")
    axis.legend(fontsize=8, labelcolor="black")
    axis.set_title("Residuals over place and force (thesis, figure 2.7)")
    return figure


def two_contacts(trials: list[Trial]) -> dict[str, Figure]:
    """Errors of both contacts by separation (3.5c), and one fit at 18.5 cm (3.6)."""
    from matplotlib.figure import Figure

    here = baseline("alternating")
    groups = [
        (f"{gap:g}", [t for t in trials if abs(conditions.gap_of(t) - gap) < 0.1])
        for gap in thesis.GAPS_CM
    ]
    errors = Figure(figsize=(11, 4.4), layout="constrained")
    for axis, contact, name in zip(
        errors.subplots(1, 2), (0, 1), ("proximal", "distal"), strict=True
    ):
        _compare(axis, groups, here, contact)
        axis.set_title(f"{name} contact")
        axis.set_xlabel("separation (cm)")
        axis.legend(fontsize=7)
    errors.suptitle("Two opposed contacts (thesis, figure 3.5c)")
    fits = Figure(figsize=(7, 4.2), layout="constrained")
    axis = fits.subplots()
    trial = next(g for name, g in groups if name == "18.5")[0]
    _readings(axis, trial, here(trial), ours(trial))
    axis.legend(fontsize=8)
    axis.set_title("Two contacts 18.5 cm apart (thesis, figure 3.6)")
    return {"errors": errors, "fit": fits}


def actuated(trials: list[Trial]) -> dict[str, Figure]:
    """Errors by place and pressure (3.7c), as the thesis measures and in the workspace."""
    from matplotlib.figure import Figure

    here = baseline("alternating")
    errors = Figure(figsize=(11, 4.4), layout="constrained")
    for axis, level in zip(errors.subplots(1, 2), ("high force", "low force"), strict=True):
        _compare(axis, _by_arc([t for t in trials if t.condition == level]), here, 0)
        psi = thesis.ACTUATED_PSI[level.split()[0]]
        axis.set_title(f"{level} ({psi:g} psi)")
        axis.set_xlabel("where the dowel touches at 6 psi")
        axis.legend(fontsize=7)
    errors.suptitle("Single contact with active bending (thesis, figure 3.7c)")

    mixture = Figure(figsize=(7, 4.2), layout="constrained")
    axis = mixture.subplots()
    true = [t.arcs_cm[0] - t.obstacle_x_cm[0] for t in trials]
    theirs = [float(camera_errors(t, here(t))[0]) for t in trials]
    mine = [float(camera_errors(t, ours(t))[0]) for t in trials]
    axis.plot(true, theirs, "o", color=_THEIRS, alpha=0.4, label="thesis's method, here")
    axis.plot(true, mine, "o", color=_OURS, alpha=0.4, label="ours")
    top = max(true) * 1.1
    axis.plot([0, top], [0, top], "k--", linewidth=1, label="a perfect arc, by this measure")
    axis.set(
        xlabel="arc - x of the obstacle: foreshortening (cm)", ylabel="|a - x of the obstacle| (cm)"
    )
    axis.grid(alpha=0.2)
    axis.legend(fontsize=8)
    axis.set_title("The thesis's measure holds the bent robot's foreshortening")
    return {"errors": errors, "measure": mixture}
