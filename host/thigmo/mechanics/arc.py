"""The smallest model: a free body with one natural curvature is exactly a circular arc.

Used wherever nothing touches; `clearance` says whether that is so.
"""

from __future__ import annotations

from math import cos, sin

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.mechanics import kernel

Floats = npt.NDArray[np.float64]


def pose(curvature: float, arc: float) -> tuple[float, float, float]:
    """(x, y, heading) at an arc length of a circle that starts at (0, 0) along x."""
    turn = curvature * arc
    if abs(turn) < 1e-4:
        return arc * (1 - turn**2 / 6), arc * turn / 2 * (1 - turn**2 / 12), turn
    return sin(turn) / curvature, (1 - cos(turn)) / curvature, turn


@compiled
def fill(curvature: float, length: float, cells: int, nodes: Floats) -> int:
    """Fill a node table (s, heading, curvature, x, y); returns the number of nodes."""
    for i in range(cells + 1):
        s = length * i / cells
        turn = curvature * s
        nodes[i, kernel.S] = s
        nodes[i, kernel.THETA] = turn
        nodes[i, kernel.KAPPA] = curvature
        if abs(turn) < 1e-4:
            nodes[i, kernel.X] = s * (1.0 - turn * turn / 6.0)
            nodes[i, kernel.Y] = 0.5 * s * turn * (1.0 - turn * turn / 12.0)
        else:
            nodes[i, kernel.X] = np.sin(turn) / curvature
            nodes[i, kernel.Y] = (1.0 - np.cos(turn)) / curvature
    return cells + 1


@compiled
def clearance(
    curvature: float, length: float, tube: float, pegs: Floats, nodes: Floats, n_nodes: int
) -> float:
    """Smallest gap (cm) between the arc in `nodes` and any peg; 1e30 without pegs."""
    least = 1e30
    for i in range(pegs.shape[0]):
        gap, _ = kernel.gap_to(pegs[i, 0], pegs[i, 1], pegs[i, 2], tube, nodes, n_nodes, 0.0, 1.0)
        least = min(least, gap)
    return least
