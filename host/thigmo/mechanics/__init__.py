"""The body's mechanics: curvature of a loaded rod, its shape, its fold, and what sensors see of it.

EI = 1 everywhere: forces in 1/cm^2, moments in 1/cm. Names are imported on first use, because the
solvers bring numba along.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from thigmo.mechanics.buckling import critical_moment, fold_share
    from thigmo.mechanics.choice import Body, Model, ModelChoice
    from thigmo.mechanics.contact import Peg, PegContact
    from thigmo.mechanics.elastica import (
        PointForce,
        Residuals,
        Rod,
        Solution,
        Tube,
        peg_for,
        push,
        solve,
    )
    from thigmo.mechanics.shape import Shape, from_curvature, skin_point
    from thigmo.mechanics.spans import mean_curvature, phi

_HOME = {
    "Body": "choice",
    "Model": "choice",
    "ModelChoice": "choice",
    "Peg": "contact",
    "PegContact": "contact",
    "PointForce": "elastica",
    "Residuals": "elastica",
    "Rod": "elastica",
    "Shape": "shape",
    "Solution": "elastica",
    "Tube": "elastica",
    "critical_moment": "buckling",
    "fold_share": "buckling",
    "from_curvature": "shape",
    "mean_curvature": "spans",
    "peg_for": "elastica",
    "phi": "spans",
    "push": "elastica",
    "skin_point": "shape",
    "solve": "elastica",
}

__all__ = [
    "Body",
    "Model",
    "ModelChoice",
    "Peg",
    "PegContact",
    "PointForce",
    "Residuals",
    "Rod",
    "Shape",
    "Solution",
    "Tube",
    "critical_moment",
    "fold_share",
    "from_curvature",
    "mean_curvature",
    "peg_for",
    "phi",
    "push",
    "skin_point",
    "solve",
]


def __getattr__(name: str) -> Any:
    """Import a public name from its home on first use."""
    if name in _HOME:
        value = getattr(import_module(f"thigmo.mechanics.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'thigmo.mechanics' has no attribute {name!r}")
