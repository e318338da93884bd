"""What must hold of a bent rod, computed from its points alone, and its energy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from thigmo.mechanics import Peg, Solution

Floats = npt.NDArray[np.float64]


def moment_imbalance(solution: Solution) -> float:
    """Largest difference between the carried moment and that of all contacts beyond a node."""
    moment = np.zeros(solution.s.size)
    for c in solution.contacts:
        beyond = solution.s <= c.arc + 1e-9
        moment += beyond * ((c.x - solution.x) * c.force_y - (c.y - solution.y) * c.force_x)
    return float(np.abs(carried_moment(solution) - moment).max())


def carried_moment(solution: Solution) -> Floats:
    """Contact moment at the nodes, for one natural curvature."""
    return np.asarray(solution.curvature - solution.free_curvature)


def bending_energy(solution: Solution) -> float:
    """Energy of the contact moment, linear between nodes (EI = 1, 1/cm); no fold."""
    m, step = carried_moment(solution), np.diff(solution.s)
    return float(np.sum(step * (m[:-1] ** 2 + m[:-1] * m[1:] + m[1:] ** 2)) / 6)


def lagrangian(solution: Solution, pegs: Sequence[Peg], arcs: Floats, turn: Floats) -> float:
    """Bending energy less the contacts' forces times the gaps, of the body turned by `turn`.

    arcs: evenly spaced from 0 to the length; turn: added to the heading there. Contacts on sides.
    """
    free = solution.free_curvature
    step = arcs[1]
    heading = np.array([solution.pose(float(arc))[2] for arc in arcs]) + turn
    middle = (heading[1:] + heading[:-1]) / 2
    x, y = np.cumsum(np.cos(middle)) * step, np.cumsum(np.sin(middle)) * step
    value = float(np.sum((np.diff(heading) / step - free) ** 2)) * step / 2
    for contact in solution.contacts:
        peg = pegs[contact.peg]
        gap = np.hypot(x - peg.x, y - peg.y).min() - solution.tube.radius_cm - peg.radius
        value -= float(np.hypot(contact.normal, contact.tangential) * gap)
    return value
