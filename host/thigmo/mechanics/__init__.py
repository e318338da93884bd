"""The body's mechanics: curvature of a loaded rod, its shape, its fold, and what sensors see of it.

EI = 1 everywhere: forces in 1/cm^2, moments in 1/cm. What is solved step by step is compiled: the
C++ beside these files is the extension `_rod`.
"""

from thigmo.mechanics.closed_forms import critical_moment, fold_share, phi, traced
from thigmo.mechanics.elastica import (
    Model,
    ModelChoice,
    Peg,
    PegContact,
    Rod,
    Solution,
    Tube,
    peg_for,
    push,
    push_tip,
    solve,
)

__all__ = [
    "Model",
    "ModelChoice",
    "Peg",
    "PegContact",
    "Rod",
    "Solution",
    "Tube",
    "critical_moment",
    "fold_share",
    "peg_for",
    "phi",
    "push",
    "push_tip",
    "solve",
    "traced",
]
