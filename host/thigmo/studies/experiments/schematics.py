"""What is pressed where, and how an exploration goes on: the thesis's drawings, computed.

In the places of its figures 3.2a, 3.4, 3.5a and 3.7a. Shapes are the large-deflection rod's under
the forces that `conditions.py` uses, so these are no sketches. Figure 3.8, the flow of an
exploration, is drawn from the table of states that the exploration walks.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from thigmo.exploration.states import TRANSITIONS, State
from thigmo.mechanics import Solution, peg_for
from thigmo.report.axes import CYCLE
from thigmo.studies import charts
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.conditions import actuated_body
from thigmo.studies.experiments.fit import frozen
from thigmo.studies.experiments.plan import opposed_forces
from thigmo.studies.experiments.specimen import emulated_robot, pushed

Bodies = list[tuple[str, Solution]]


def single_contact() -> Figure:
    """Where one contact presses, high force and low (figure 3.2a)."""
    drawn: dict[str, Bodies] = {}
    for level, share in zip(thesis.LEVELS, (1.0, thesis.LOW_LEVEL), strict=True):
        moment, high = share * thesis.CRITICAL, level == thesis.LEVELS[0]
        fold = frozen().fold_rad if high else 0.0
        drawn[f"{level}: base moment {moment:.4f} 1/cm" + (", folded" if high else "")] = [
            (place, pushed((arc,), (moment / arc,), fold_rad=fold))
            for place, arc in zip(thesis.PLACES, thesis.SINGLE_ARCS_CM, strict=True)
        ]
    return _figure(drawn, "Single contact, unactuated (thesis, figure 3.2a)", 3.4)


def fold() -> Figure:
    """At the critical moment, and beyond it: only the fold's angle grows (figure 3.4)."""
    force, angle = thesis.CRITICAL / thesis.LENGTH_CM, frozen().fold_rad
    bodies = [
        (
            f"fold {np.degrees(factor * angle):.1f} degrees",
            pushed((thesis.LENGTH_CM,), (force,), fold_rad=factor * angle),
        )
        for factor in (0.0, 1.0, 3.0)
    ]
    text = f"base curvature stays at {thesis.CRITICAL} 1/cm; the fold turns the rest"
    title = "Tip force at the critical moment of the base (thesis, figure 3.4)"
    return _figure({text: bodies}, title, 5.2)


def two_contacts() -> Figure:
    """Two opposed contacts, the distal one at the tip (figure 3.5a)."""
    bodies = [
        (
            f"{gap:g} cm apart",
            pushed((thesis.LENGTH_CM - gap, thesis.LENGTH_CM), opposed_forces(gap)),
        )
        for gap in thesis.GAPS_CM
    ]
    return _figure({"": bodies}, "Two opposed contacts (thesis, figure 3.5a)", 3.4)


def actuated() -> Figure:
    """The robot bends itself into a dowel: at 6 psi it just touches (figure 3.7a)."""
    pressures = (thesis.TOUCH_PSI, *sorted(thesis.ACTUATED_PSI.values()))
    muscle = emulated_robot().actuators.left.maps[-1].inflate
    drawn = {
        f"touches at {place}": [
            (f"{psi:g} psi", actuated_body(arc, psi, muscle)[0]) for psi in pressures
        ]
        for place, arc in zip(thesis.PLACES, thesis.SINGLE_ARCS_CM, strict=True)
    }
    return _figure(drawn, "Single contact with active bending (thesis, figure 3.7a)", 4.2)


def _figure(drawn: dict[str, Bodies], title: str, height: float) -> Figure:
    """A panel a title, with its bodies."""
    figure, axes = charts.panels(1, len(drawn), size=(5.5, height), title=title, share=True)
    for axis, (text, bodies) in zip(axes, drawn.items(), strict=True):
        axis.axvline(0.0, color="k", linewidth=3, alpha=0.3)
        for number, (label, body) in enumerate(bodies):
            _body(axis, body, CYCLE[number], label)
        axis.set(xlabel="x (cm)", ylabel="y (cm)", aspect="equal")
        axis.set_title(text, fontsize=9)
    charts.legend_below(figure)  # the labels of all panels are the same
    return figure


def _body(axis: Axes, body: Solution, color: str, label: str) -> None:
    """Axis, walls and sensors of the body, and the dowels that press on it."""
    points = np.array([body.pose(float(s)) for s in np.linspace(0.0, body.length, 200)])
    x, y, heading = points.T
    axis.plot(x, y, color=color, label=label)
    across = thesis.DIAMETER_CM / 2 * np.column_stack([-np.sin(heading), np.cos(heading)])
    for side in (-1.0, 1.0):
        axis.plot(x + side * across[:, 0], y + side * across[:, 1], color=color, linewidth=0.5)
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
