"""Figures of the experiments' results, in the places of the thesis's own.

The muscle's map (2.4c), errors by condition (3.2c, 3.5c, 3.7c), readings and fits (3.3, 3.6) and
the residual surface (2.7).
What is pressed where (3.2a, 3.4, 3.5a, 3.7a) is drawn by `schematics.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thigmo.calibrate.actuator import BendReadings, fit_actuator
from thigmo.mechanics import phi
from thigmo.report.axes import BLUE, GREEN, ORANGE
from thigmo.studies import charts
from thigmo.studies.experiments import schematics, thesis
from thigmo.studies.experiments.compare import (
    OURS,
    THEIRS,
    Row,
    Solved,
    workspace_errors,
)
from thigmo.studies.experiments.specimen import emulated_robot

Group = tuple[str, list[Solved]]
_PRESSURES_PSI = np.arange(0.0, 20.1, 2.0)
_TRIALS = 3
_CAMERA_SE = 2e-4  # 1/cm, of one picture
_BETWEEN_TRIALS = 2e-4  # 1/cm: the robot never lies quite straight
_METHODS = ((THEIRS, ORANGE, "thesis's method, here"), (OURS, BLUE, "ours"))


def _compare(axis: Axes, groups: Sequence[Group], contact: int) -> None:
    """Boxes of both methods' errors in the workspace, and the bound, a group a place."""
    for at, (_, solved) in enumerate(groups):
        for shift, (method, color, label) in zip((-0.2, 0.2), _METHODS, strict=True):
            found = np.array(
                [workspace_errors(s.trial, s.answers[method])[contact] for s in solved]
            )
            answered = found[np.isfinite(found)]
            if answered.size:
                drawn = axis.boxplot(
                    [answered], positions=[at + shift], widths=0.32, patch_artist=True,
                    showfliers=False, medianprops={"color": "black"},
                )  # fmt: skip
                drawn["boxes"][0].set(facecolor=color, alpha=0.6)
                axis.plot(at + shift, answered.mean(), "D", color="black", markersize=4)
            if at == 0:
                axis.plot([], [], "s", color=color, alpha=0.6, label=label)
        bound = np.array([one.bound_cm[contact] for one in solved])
        if np.isfinite(bound).any():
            axis.plot(
                [at - 0.4, at + 0.4], [bound[np.isfinite(bound)].mean()] * 2, color=GREEN,
                linewidth=2, label="Cramer-Rao bound (mean absolute error)" if at == 0 else None,
            )  # fmt: skip
    axis.set_xticks(range(len(groups)), [name for name, _ in groups])
    # Of all panels that share the axis: the one drawn last has the tallest box of all.
    top = max(one.dataLim.y1 for one in axis.get_shared_y_axes().get_siblings(axis))
    axis.set(ylabel="|x error| in the workspace (cm)", ylim=(0, 1.05 * top))


def _readings(axis: Axes, one: Solved, title: str) -> None:
    """One trial: readings, and both methods' curvature along the body (thesis, figure 3.3)."""
    trial = one.trial
    s = np.linspace(0.0, trial.length_cm, 400)
    axis.plot(trial.position, trial.curvature, "ko", markersize=5, label="readings")
    for method, color, label in _METHODS:
        answer = one.answers[method]
        ramps = sum(
            (f * phi(a, s, 0.0) for a, f in zip(answer.arcs_cm, answer.forces, strict=True)),
            np.full(s.size, trial.free),
        )
        axis.plot(s, ramps, color=color, label=label)
        for arc in answer.arcs_cm:
            axis.axvline(arc, color=color, linestyle=":", linewidth=1)
    for index, arc in enumerate(trial.arcs_cm):
        axis.axvline(arc, color="k", linewidth=1, label="true contact" if index == 0 else None)
    for low, high in one.answers[OURS].intervals_cm:
        axis.axvspan(low, high, color=_METHODS[1][1], alpha=0.08)
    axis.set(
        xlabel="arc length (cm)", ylabel="curvature (1/cm)", xlim=(0, trial.length_cm + 1),
        title=title,
    )  # fmt: skip
    axis.legend(fontsize=7)


def _groups(solved: Sequence[Solved], what: str) -> list[Group]:
    """Trials by `condition` or by `place`, in their order."""
    names = dict.fromkeys(getattr(one.trial, what) for one in solved)
    return [(n, [one for one in solved if getattr(one.trial, what) == n]) for n in names]


def _levels(solved: Sequence[Solved], rows: Sequence[Row], title: str) -> Figure:
    """A panel a condition of one contact: errors by place, and the thesis's mean."""
    conditions = _groups(solved, "condition")
    figure, axes = charts.panels(1, len(conditions), size=(5.2, 4.2), title=title)
    for axis, (condition, mine) in zip(axes, conditions, strict=True):
        _compare(axis, _groups(mine, "place"), 0)
        told = next(r for r in rows if r["condition"] == condition)
        axis.axhline(
            told["thesis_mean"], color="gray", linestyle="--", label="thesis, mean over places"
        )
        axis.set_title(f"{condition} (thesis {told['thesis_mean']} +- {told['thesis_std']} cm)")
        axis.set_xlabel("where the dowel stands")
    charts.legend_below(figure)
    return figure


def single_contact(solved: Sequence[Solved], rows: Sequence[Row]) -> dict[str, Figure]:
    """Errors by place and force (3.2c), fits (3.3), and the residual surface (2.7)."""
    levels = _groups(solved, "condition")
    fits, axes = charts.panels(
        1, len(levels), size=(5.2, 4.0),
        title="Readings and fits (thesis, figure 3.3; shaded: our 95 % interval)",
    )  # fmt: skip
    for axis, (level, mine) in zip(axes, levels, strict=True):
        nearest = min(mine, key=lambda one: one.trial.arcs_cm[0])
        _readings(axis, nearest, f"{level} at {nearest.trial.place}")

    return {
        "schematic": schematics.single_contact(),
        "fold": schematics.fold(),
        "errors": _levels(solved, rows, "Single contact, unactuated (thesis, figure 3.2c)"),
        "fits": fits,
        "residual-surface": _surface(solved),
    }


def _surface(solved: Sequence[Solved]) -> Figure:
    """The thesis's objective over place and force for a high force at 3L/4 (its figure 2.7)."""
    one = min(
        solved,
        key=lambda s: (s.trial.condition != thesis.LEVELS[0], s.trial.place != "3L/4"),
    )
    trial, answer = one.trial, one.answers[THEIRS]
    # On a real robot the force is known only as the method's own.
    force = trial.forces[0] if np.isfinite(trial.forces[0]) else answer.forces[0]
    arcs = np.linspace(1.0, trial.length_cm, 261)
    moments = np.linspace(0.1, 3.0, 240) * force * trial.arcs_cm[0]
    levers = np.array([phi(arc, trial.position, 0.0) / arc for arc in arcs])
    left = (trial.curvature - trial.free) - moments[:, None, None] * levers
    value = np.abs(left).sum(axis=2)  # (moments, arcs)
    figure, (axis,) = charts.panels(
        size=(7, 4.6),
        title=f"Residuals over place and force, {trial.condition} at {trial.place} (thesis, "
        "figure 2.7)",
    )
    axis.grid(visible=False, which="both")
    image = axis.pcolormesh(arcs, moments, np.log10(value), cmap="viridis", shading="auto")
    figure.colorbar(image, ax=axis, label="log10 of the 1-norm of residuals (1/cm)")
    ravine, floor = value.min(axis=0), moments[value.argmin(axis=0)]
    axis.plot(arcs, floor, "w:", linewidth=1, label="floor of the ravine")
    inner = np.flatnonzero((ravine[1:-1] < ravine[:-2]) & (ravine[1:-1] < ravine[2:])) + 1
    axis.plot(arcs[inner], floor[inner], "wv", label="local minima along it")
    axis.axvline(trial.arcs_cm[0], color="white", linewidth=1, label="true contact")
    axis.axvline(answer.arcs_cm[0], color=ORANGE, linewidth=1, label="thesis's method, here")
    axis.set(xlabel="arc of the contact (cm)", ylabel="base moment f a (1/cm)")
    axis.legend(fontsize=8, labelcolor="white", facecolor="0.25", loc="upper right")
    return figure


def two_contacts(solved: Sequence[Solved], rows: Sequence[Row]) -> dict[str, Figure]:
    """Errors of both contacts by separation (3.5c), and one fit at 18.5 cm (3.6)."""
    groups = [(n.removesuffix(" cm apart"), some) for n, some in _groups(solved, "place")]
    errors, axes = charts.panels(
        1, 2, size=(5.5, 4.4), share=True,
        title="Two opposed contacts, ordered along the arc (thesis, figure 3.5c)",
    )  # fmt: skip
    for contact, (axis, name) in enumerate(zip(axes, ("proximal", "distal"), strict=True)):
        _compare(axis, groups, contact)
        for r in rows:
            at = [
                n for n, (_, some) in enumerate(groups) if some[0].trial.condition == r["condition"]
            ]
            ends = (min(at) - 0.45, max(at) + 0.45)
            axis.plot(ends, [r["thesis_mean"]] * 2, "--", color="gray")
        axis.plot([], [], "--", color="gray", label="thesis, mean over both contacts")
        axis.set(title=f"{name} contact", xlabel="separation (cm)")
    charts.legend_below(errors)
    fit, (axis,) = charts.panels(size=(7, 4.2))
    name, some = min(groups, key=lambda group: abs(float(group[0]) - 18.5))
    _readings(axis, some[0], f"Two contacts {name} cm apart (thesis, figure 3.6)")
    return {"schematic": schematics.two_contacts(), "errors": errors, "fit": fit}


def actuated(solved: Sequence[Solved], rows: Sequence[Row]) -> dict[str, Figure]:
    """Errors by place and pressure (3.7c)."""
    errors = _levels(solved, rows, "Single contact with active bending (thesis, figure 3.7c)")
    return {"schematic": schematics.actuated(), "errors": errors}


def muscle_map(seed: int) -> Figure:
    """The muscle's map from pressure to curvature, measured and fitted (2.4c).

    Eleven pressures from 0 to 20 psi, three trials, each read by a camera of calibration's
    accuracy; `thigmo.calibrate` fits them as it fits a lab's.
    """
    zone = emulated_robot().actuators.left.maps[-1]
    rng = np.random.default_rng([seed, 24])
    psi = np.tile(_PRESSURES_PSI, _TRIALS)
    trial = np.repeat(np.arange(_TRIALS), _PRESSURES_PSI.size)
    seen = np.array([zone.inflate.curvature(p) for p in psi])
    seen += (_BETWEEN_TRIALS * rng.standard_normal(_TRIALS))[trial]
    seen += _CAMERA_SE * rng.standard_normal(psi.size)
    result = fit_actuator(
        BendReadings(
            "left", zone.body_pressure_psi, psi, seen, np.full(psi.size, _CAMERA_SE),
            ("inflate",) * psi.size, trial,
        )
    )  # fmt: skip
    made, (axis,) = charts.panels(
        title=f"Left muscle at {zone.body_pressure_psi:g} psi body pressure (thesis, figure 2.4c)"
    )
    for number, marker in enumerate("os^"):
        mine = trial == number
        axis.plot(psi[mine], seen[mine], marker, markersize=5, label=f"trial {number + 1}")
    fine = np.linspace(0.0, 20.0, 200)
    for curve, style, label in (
        (result.zone.inflate, "k", "hyperbolic tangent, fitted"),
        (zone.inflate, "r--", "the emulator's own"),
    ):
        axis.plot(fine, [curve.curvature(p) for p in fine], style, label=label)
    axis.set(xlabel="actuator pressure (psi)", ylabel="free curvature (1/cm)")
    axis.legend(fontsize=8)
    return made


FIGURES: dict[str, Callable[[Sequence[Solved], Sequence[Row]], dict[str, Figure]]] = {
    "single-contact": single_contact,
    "two-contacts": two_contacts,
    "actuated": actuated,
}
