"""The body's mechanics: curvature and shape of a loaded rod, its fold, and its sensors' readings.

EI = 1 everywhere: forces are in 1/cm^2, moments in 1/cm. Iterative solvers are compiled: the C++
files beside these are the extension `_rod`.
"""

from thigmo.mechanics.closed_forms import (
    critical_moment,
    fold_share,
    heading_along,
    phi,
    rest_mean,
    rest_turn,
    traced,
)
from thigmo.mechanics.elastica import (
    Model,
    ModelChoice,
    Obstacle,
    Peg,
    PegContact,
    Rod,
    Solution,
    Sweep,
    Tube,
    Wall,
    peg_for,
    push,
    push_tip,
    solve,
)
from thigmo.mechanics.headings import CurvatureRows, from_headings

__all__ = [
    "CurvatureRows",
    "Model",
    "ModelChoice",
    "Obstacle",
    "Peg",
    "PegContact",
    "Rod",
    "Solution",
    "Sweep",
    "Tube",
    "Wall",
    "critical_moment",
    "fold_share",
    "from_headings",
    "heading_along",
    "peg_for",
    "phi",
    "push",
    "push_tip",
    "rest_mean",
    "rest_turn",
    "solve",
    "traced",
]
