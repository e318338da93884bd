"""Figures of the experiments, in the places of the thesis's own.

What is pressed where (3.2a, 3.4, 3.5a, 3.7a): shapes are the large-deflection rod's under the
planned forces, so these are no sketches. Results: errors by condition (3.2c, 3.5c, 3.7c), readings
and fits (3.3, 3.6), the residual surface (2.7), the muscle's map (2.4c). The flow of an exploration
(3.8) is drawn from the table of states that the exploration walks.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from thigmo.calibrate.actuator import BendReadings, fit_actuator
from thigmo.exploration.states import TRANSITIONS, State
from thigmo.mechanics import Solution, peg_for, phi
from thigmo.report.axes import BLUE, CYCLE, GREEN, ORANGE
from thigmo.studies import charts
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.compare import OURS, THEIRS, Solved, answered, workspace_errors
from thigmo.studies.experiments.specimen import bent, emulated_robot, frozen, pushed
from thigmo.studies.experiments.trial import plan

Group = tuple[str, list[Solved]]
Bodies = list[tuple[str, Solution]]
_PRESSURES_PSI = np.arange(0.0, 20.1, 2.0)
_TRIALS = 3
_CAMERA_SE = 2e-4  # 1/cm, of one picture
_BETWEEN_TRIALS = 2e-4  # 1/cm: the robot never lies quite straight
_METHODS = ((THEIRS, ORANGE, "thesis's method, here"), (OURS, BLUE, "ours"))


def _groups(solved: Sequence[Solved], what: str) -> list[Group]:
    """Trials by `condition` or by `place`, in their order."""
    names = dict.fromkeys(getattr(one.trial, what) for one in solved)
    return [(n, [one for one in solved if getattr(one.trial, what) == n]) for n in names]


def _compare(axis: Axes, groups: Sequence[Group], contact: int) -> None:
    """Boxes of both methods' errors in the workspace, and the bound, a group a place."""
    for at, (_, solved) in enumerate(groups):
        for shift, (method, color, label) in zip((-0.2, 0.2), _METHODS, strict=True):
            found = [workspace_errors(*pair)[contact] for pair in answered(solved, method)]
            if found:
                drawn = axis.boxplot(
                    [found], positions=[at + shift], widths=0.32, patch_artist=True,
                    showfliers=False, medianprops={"color": "black"},
                )  # fmt: skip
                drawn["boxes"][0].set(facecolor=color, alpha=0.6)
                axis.plot(at + shift, np.mean(found), "D", color="black", markersize=4)
            if at == 0:
                axis.plot([], [], "s", color=color, alpha=0.6, label=label)
        bound = np.array([trial.bound_cm[contact] for trial, _ in solved])
        if np.isfinite(bound).any():
            axis.plot(
                [at - 0.4, at + 0.4], [bound[np.isfinite(bound)].mean()] * 2, color=GREEN,
                linewidth=2, label="Cramer-Rao bound (mean absolute error)" if at == 0 else None,
            )  # fmt: skip
    axis.set_xticks(range(len(groups)), [name for name, _ in groups])
    # Of all panels that share the axis: the one drawn last has the tallest box of all.
    top = max(one.dataLim.y1 for one in axis.get_shared_y_axes().get_siblings(axis))
    axis.set(ylabel="|x error| in the workspace (cm)", ylim=(0, 1.05 * top))


def _levels(solved: Sequence[Solved], experiment: str, title: str) -> Figure:
    """A panel a condition of one contact: errors by place, and the thesis's mean."""
    conditions = _groups(solved, "condition")
    figure, axes = charts.panels(1, len(conditions), size=(5.2, 4.2), title=title)
    for axis, (condition, mine) in zip(axes, conditions, strict=True):
        _compare(axis, _groups(mine, "place"), 0)
        mean, std = thesis.RESULTS[experiment, condition]
        axis.axhline(mean, color="gray", linestyle="--", label="thesis, mean over places")
        axis.set_title(f"{condition} (thesis {mean} +- {std} cm)")
        axis.set_xlabel("where the dowel stands")
    charts.legend_below(figure)
    return figure


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
        axis.axvspan(low, high, color=BLUE, alpha=0.08)
    axis.set(
        xlabel="arc length (cm)", ylabel="curvature (1/cm)", xlim=(0, trial.length_cm + 1),
        title=title,
    )  # fmt: skip
    axis.legend(fontsize=7)


def single_contact(solved: Sequence[Solved]) -> dict[str, Figure]:
    """Errors by place and force (3.2c), fits (3.3), and the residual surface (2.7)."""
    levels = _groups(solved, "condition")
    fits, axes = charts.panels(
        1, len(levels), size=(5.2, 4.0),
        title="Readings and fits (thesis, figure 3.3; shaded: our 95 % interval)",
    )  # fmt: skip
    for axis, (level, mine) in zip(axes, levels, strict=True):
        nearest = min(mine, key=lambda one: one.trial.arcs_cm[0])
        _readings(axis, nearest, f"{level} at {nearest.trial.place}")
    title = "Single contact, unactuated (thesis, figure 3.2c)"
    return {
        "schematic": _pressed("single-contact", "Single contact, unactuated (thesis, figure 3.2a)"),
        "fold": _fold(),
        "errors": _levels(solved, "single-contact", title),
        "fits": fits,
        "residual-surface": _surface(solved),
    }


def _surface(solved: Sequence[Solved]) -> Figure:
    """The thesis's objective over place and force for a high force at 3L/4 (its figure 2.7)."""
    trial, answers = min(
        solved,
        key=lambda s: (s.trial.condition != thesis.LEVELS[0], s.trial.place != "3L/4"),
    )
    theirs = answers[THEIRS]
    # On a real robot the force is known only as the method's own.
    force = trial.forces[0] if np.isfinite(trial.forces[0]) else theirs.forces[0]
    arcs = np.linspace(1.0, trial.length_cm, 261)
    moments = np.linspace(0.1, 3.0, 240) * force * trial.arcs_cm[0]
    levers = np.array([phi(arc, trial.position, 0.0) / arc for arc in arcs])
    rest = (trial.curvature - trial.free) - moments[:, None, None] * levers
    value = np.abs(rest).sum(axis=2)  # (moments, arcs)
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
    axis.axvline(theirs.arcs_cm[0], color=ORANGE, linewidth=1, label="thesis's method, here")
    axis.set(xlabel="arc of the contact (cm)", ylabel="base moment f a (1/cm)")
    axis.legend(fontsize=8, labelcolor="white", facecolor="0.25", loc="upper right")
    return figure


def two_contacts(solved: Sequence[Solved]) -> dict[str, Figure]:
    """Errors of both contacts by separation (3.5c), and one fit at 18.5 cm (3.6)."""
    groups = [(n.removesuffix(" cm apart"), some) for n, some in _groups(solved, "place")]
    conditions = [some[0].trial.condition for _, some in groups]
    errors, axes = charts.panels(
        1, 2, size=(5.5, 4.4), share=True,
        title="Two opposed contacts, ordered along the arc (thesis, figure 3.5c)",
    )  # fmt: skip
    for contact, (axis, name) in enumerate(zip(axes, ("proximal", "distal"), strict=True)):
        _compare(axis, groups, contact)
        for condition in dict.fromkeys(conditions):
            at = [n for n, other in enumerate(conditions) if other == condition]
            mean, _ = thesis.RESULTS["two-contacts", condition]
            axis.plot((min(at) - 0.45, max(at) + 0.45), [mean] * 2, "--", color="gray")
        axis.plot([], [], "--", color="gray", label="thesis, mean over both contacts")
        axis.set(title=f"{name} contact", xlabel="separation (cm)")
    charts.legend_below(errors)
    fit, (axis,) = charts.panels(size=(7, 4.2))
    name, some = min(groups, key=lambda group: abs(float(group[0]) - 18.5))
    _readings(axis, some[0], f"Two contacts {name} cm apart (thesis, figure 3.6)")
    return {
        "schematic": _pressed("two-contacts", "Two opposed contacts (thesis, figure 3.5a)"),
        "errors": errors,
        "fit": fit,
    }


def actuated(solved: Sequence[Solved]) -> dict[str, Figure]:
    """Errors by place and pressure (3.7c)."""
    title = "Single contact with active bending (thesis, figure 3.7c)"
    return {"schematic": _bent_into(), "errors": _levels(solved, "actuated", title)}


def muscle_map(seed: int) -> Figure:
    """The muscle's map from pressure to curvature, measured by a camera and fitted (2.4c)."""
    zone = emulated_robot().muscle("left").maps[-1]
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


def _pressed(experiment: str, title: str) -> Figure:
    """Where dowels press that push to the left (figures 3.2a, 3.5a)."""
    drawn: dict[str, Bodies] = defaultdict(list)
    for one in plan(experiment, 2):
        if one.side == "right":
            moment, *more = np.multiply(one.arcs_cm, one.forces)
            label = f"{one.condition}: base moment {moment:.4f} 1/cm"
            text = "" if more else label + (", folded" if one.folds else "")
            body = pushed(one.arcs_cm, one.forces, fold_rad=one.fold(frozen().fold_rad))
            drawn[text].append((one.place, body))
    return _drawn(drawn, title, 4.2)


def _fold() -> Figure:
    """At the critical moment, and beyond it: only the fold's angle grows (figure 3.4)."""
    force, tip = thesis.CRITICAL / thesis.LENGTH_CM, (thesis.LENGTH_CM,)
    angles = [factor * frozen().fold_rad for factor in (0.0, 1.0, 3.0)]
    bodies = [
        (f"fold {np.degrees(angle):.1f} degrees", pushed(tip, (force,), fold_rad=angle))
        for angle in angles
    ]
    text = f"base curvature stays at {thesis.CRITICAL} 1/cm; the fold turns the rest"
    title = "Tip force at the critical moment of the base (thesis, figure 3.4)"
    return _drawn({text: bodies}, title, 5.2)


def _bent_into() -> Figure:
    """The robot bends itself into a dowel: at 6 psi it just touches (figure 3.7a)."""
    free = emulated_robot().muscle("left").maps[-1].inflate.curvature
    touch = free(thesis.TOUCH_PSI)
    pressures = (thesis.TOUCH_PSI, *sorted(thesis.ACTUATED_PSI.values()))
    drawn = {
        f"touches at {place}": [
            (f"{psi:g} psi", bent(arc, touch, free(psi))[0]) for psi in pressures
        ]
        for place, arc in zip(thesis.PLACES, thesis.SINGLE_ARCS_CM, strict=True)
    }
    return _drawn(drawn, "Single contact with active bending (thesis, figure 3.7a)", 4.2)


def _drawn(drawn: Mapping[str, Bodies], title: str, height: float) -> Figure:
    """A panel a title, with its bodies."""
    figure, axes = charts.panels(1, len(drawn), size=(5.5, height), title=title, share=True)
    for axis, (text, bodies) in zip(axes, drawn.items(), strict=True):
        axis.axvline(0.0, color="k", linewidth=3, alpha=0.3)
        for color, (label, body) in zip(CYCLE, bodies, strict=False):
            _body(axis, body, color, label)
        axis.set(xlabel="x (cm)", ylabel="y (cm)", aspect="equal")
        axis.set_title(fill(text, 44), fontsize=9)
    charts.legend_below(figure)  # the labels of all panels are the same
    return figure


def _body(axis: Axes, body: Solution, color: str, label: str) -> None:
    """Axis, walls and sensors of the body, and the dowels that press on it."""
    x, y, heading = np.array([body.pose(float(s)) for s in np.linspace(0.0, body.length, 200)]).T
    axis.plot(x, y, color=color, label=label)
    across_x, across_y = thesis.DIAMETER_CM / 2 * np.array([-np.sin(heading), np.cos(heading)])
    for side in (-1.0, 1.0):
        axis.plot(x + side * across_x, y + side * across_y, color=color, linewidth=0.5)
    for center in thesis.CENTERS_CM:
        ends = np.linspace(center - thesis.SPAN_CM / 2, center + thesis.SPAN_CM / 2, 10)
        sensor = np.array([body.pose(float(s)) for s in ends])
        axis.plot(sensor[:, 0], sensor[:, 1], color=color, linewidth=4, alpha=0.4)
    for contact in body.contacts:
        peg = peg_for(contact, thesis.DOWEL_CM)
        axis.add_patch(Circle((peg.x, peg.y), peg.radius, facecolor=color, edgecolor="k", zorder=3))


def flow() -> Figure:
    """States from top to bottom in the table's order; arcs with their outcomes (figure 3.8).

    Steps to the next state run down the column, further ones on its right, back ones on its left.
    """
    order = {state: number for number, state in enumerate(State)}
    steps: dict[tuple[int, int], list[str]] = defaultdict(list)
    for step in TRANSITIONS:
        steps[order[step.source], order[step.target]].append(step.outcome)
    figure, (axis,) = charts.panels(
        size=(12.5, 14), title="The exploration's states and transitions (thesis, figure 3.8)"
    )
    for state, row in order.items():
        box = {"boxstyle": "round", "facecolor": "#eef3fa", "edgecolor": "0.3"}
        axis.text(0.0, -row, state.value, ha="center", va="center", bbox=box, zorder=3)
    for number, ((source, target), outcomes) in enumerate(steps.items()):
        color, text, leap = CYCLE[number % len(CYCLE)], " / ".join(outcomes), target - source
        side = 0.0 if leap == 1 else 1.0 if leap > 1 else -1.0
        bend = -0.35 * side * np.sign(leap)
        arrow = {"arrowstyle": "-|>", "color": color, "connectionstyle": f"arc3,rad={bend}"}
        foot, tail = 1.2 * side, 0.15 * (leap != 0)
        axis.annotate("", (foot, tail - target), (foot, -tail - source), arrowprops=arrow)
        # The middle of an arc lies half its bend times its length away.
        axis.text(
            foot + side * (0.1 + 0.18 * abs(leap)), -(source + target) / 2 - 0.07 * (number % 5),
            text, fontsize=8, color=color, va="center", ha="right" if side < 0 else "left",
        )  # fmt: skip
    axis.set(xlim=(-len(order) / 2, len(order) / 2), ylim=(-len(order), 1))
    axis.axis("off")
    return figure


FIGURES: dict[str, Callable[[Sequence[Solved]], dict[str, Figure]]] = {
    "single-contact": single_contact,
    "two-contacts": two_contacts,
    "actuated": actuated,
}
