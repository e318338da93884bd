"""What is pressed where: the robot's computed shapes in the thesis's conditions.

In the places of its figures 3.2a, 3.4, 3.5a and 3.7a. Shapes are the large-deflection rod's under
the forces that `conditions.py` uses, so these are no sketches.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from thigmo.mechanics import Solution, Tube, peg_for, push
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.conditions import actuated_body, opposed_forces
from thigmo.studies.experiments.fit import frozen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

_COLORS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple", "tab:brown")


def single_contact() -> Figure:
    """Where one contact presses, high force and low (figure 3.2a)."""
    figure, axes = _panels(2, "Single contact, unactuated (thesis, figure 3.2a)", 3.4)
    for axis, level in zip(axes, thesis.LEVELS, strict=True):
        high = level == thesis.LEVELS[0]
        moment = thesis.CRITICAL * (1.0 if high else thesis.LOW_LEVEL)
        for color, place, arc in zip(_COLORS, thesis.PLACES, thesis.SINGLE_ARCS_CM, strict=False):
            fold = frozen().fold_rad if high else 0.0
            _body(axis, _pushed((arc,), (moment / arc,), fold), color, place)
        axis.set_title(f"{level}: base moment {moment:.4f} 1/cm" + (", folded" if high else ""))
        axis.legend(fontsize=8, loc="upper left")
    return figure


def fold() -> Figure:
    """At the critical moment, and beyond it: only the fold's angle grows (figure 3.4)."""
    figure, axes = _panels(
        1, "Tip force at the critical moment of the base (thesis, figure 3.4)", 5.2
    )
    force = thesis.CRITICAL / thesis.LENGTH_CM
    angle = frozen().fold_rad
    for color, factor in zip(_COLORS, (0.0, 1.0, 3.0), strict=False):
        label = f"fold {np.degrees(factor * angle):.1f} degrees"
        body = _pushed((thesis.LENGTH_CM,), (force,), factor * angle)
        _body(axes[0], body, color, label)
    axes[0].set_title(
        f"base curvature stays at {thesis.CRITICAL} 1/cm; the fold turns the rest", fontsize=9
    )
    axes[0].legend(fontsize=8, loc="upper left")
    return figure


def two_contacts() -> Figure:
    """Two opposed contacts, the distal one at the tip (figure 3.5a)."""
    figure, axes = _panels(1, "Two opposed contacts (thesis, figure 3.5a)", 2.9)
    for color, gap in zip(_COLORS, thesis.GAPS_CM, strict=True):
        arcs = (thesis.LENGTH_CM - gap, thesis.LENGTH_CM)
        _body(axes[0], _pushed(arcs, opposed_forces(gap, 1.0), 0.0), color, f"{gap:g} cm apart")
    axes[0].set_ylim(-7, 14)
    axes[0].legend(fontsize=8, ncols=3, loc="upper left")
    return figure


def actuated() -> Figure:
    """The robot bends itself into a dowel: at 6 psi it just touches (figure 3.7a)."""
    figure, axes = _panels(3, "Single contact with active bending (thesis, figure 3.7a)")
    pressures = (thesis.TOUCH_PSI, *sorted(thesis.ACTUATED_PSI.values()))
    for axis, place, arc in zip(axes, thesis.PLACES, thesis.SINGLE_ARCS_CM, strict=True):
        for color, psi in zip(_COLORS, pressures, strict=False):
            body, peg = actuated_body(arc, psi)
            _body(axis, body, color, f"{psi:g} psi", dowels=False)
        axis.add_patch(_circle(peg.x, peg.y, peg.radius, "k"))
        axis.set_title(f"touches at {place}")
        axis.legend(fontsize=8, loc="upper left")
    return figure


def _pushed(arcs: Sequence[float], forces: Sequence[float], fold_rad: float) -> Solution:
    return push(
        np.array(forces),
        np.array(arcs),
        free_curvature=0.0,
        length=thesis.LENGTH_CM,
        tube=Tube(thesis.DIAMETER_CM),
        fold_angle=fold_rad,
    )


def _panels(count: int, title: str, height: float = 4.2) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0 * count + 1.5, height), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(1, count, sharey=True)))
    for axis in axes:
        axis.set(xlabel="x (cm)", aspect="equal")
        axis.axvline(0.0, color="k", linewidth=3, alpha=0.3)
        axis.grid(alpha=0.2)
    axes[0].set_ylabel("y (cm)")
    figure.suptitle(title)
    return figure, axes


def _body(axis: Axes, body: Solution, color: str, label: str, *, dowels: bool = True) -> None:
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
    if dowels:
        for contact in body.contacts:
            peg = peg_for(contact, thesis.DOWEL_CM)
            axis.add_patch(_circle(peg.x, peg.y, peg.radius, color))


def _circle(x: float, y: float, radius: float, color: str) -> Patch:
    from matplotlib.patches import Circle

    return Circle((x, y), radius, facecolor=color, edgecolor="k", zorder=3)
