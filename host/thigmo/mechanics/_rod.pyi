"""The loaded body: a compiled extension (rod.h, centreline.h and what they need)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from thigmo.mechanics.elastica import Convergence, Kind, Model, ModelChoice

Floats = NDArray[np.float64]
_PegRow = tuple[float, float, float, float, float, float]
_ContactRow = tuple[int, float, Kind, float, float, float, float, float, float, float]

class Rod:
    """A body that remembers: each `step` starts from the last equilibrium, as a real one does."""

    def __init__(
        self,
        diameter: float,
        critical_moment: float | None,
        pegs: Sequence[_PegRow],
        cell: float,
        model: ModelChoice,
        tolerance: float,
        friction: float,
        base_compliance: float,
        tip_rounding: float,
        rest_curvature: Sequence[tuple[float, float]],
    ) -> None:
        """Lay the body down; `elastica.Rod` explains the arguments."""

    def step(self, free_curvature: float, length: float) -> None:
        """Follow the equilibrium to a new free curvature (1/cm) and everted length (cm).

        The elastica cuts the way into pieces in which the free tip would travel at most 1 cm.
        Raises DataError for values that are not finite, or a length that is not positive.
        """

    def assume_free(self, free_curvature: float, length: float) -> None:
        """Start from a body that touches nothing."""

    def _place(self, pegs: Sequence[_PegRow]) -> None: ...
    def press(
        self, force: Floats, place: Floats, fold_angle: float, free_curvature: float, length: float
    ) -> None:
        """Take forces at places around the skin and a fold for given: one integration."""

    def save(self) -> Rod:
        """A copy to come back to with `restore`."""

    def restore(self, saved: Rod) -> None:
        """Return to a saved state."""

    def nodes(self) -> Floats:
        """Copy of the centreline: columns s, heading, curvature, x, y.

        The curvature leaves out the fold and the rest shape.
        """

    def averages_into(self, centers: Floats, spans: Floats, out: Floats) -> None:
        """Mean curvature (1/cm) over spans (cm) around arcs, into `out`; all (N,).

        Fold and rest shape are included. A span of 0 gives the value at the centre; what lies
        beyond the body is cut off.
        """

    def pose(self, arc: float) -> tuple[float, float, float]:
        """(x, y, heading) of the centreline at an arc length."""

    def locate(self, x: float, y: float, radius: float) -> tuple[float, float]:
        """(gap, arc) of a peg: distance from the skin and the arc of the closest point."""

    def _sweep(
        self, bends: Floats, length: float, centers: Floats, spans: Floats
    ) -> tuple[Floats, Floats, Floats, Floats, NDArray[np.uint8]]: ...
    def _contacts(self) -> list[_ContactRow]: ...
    def axial_push(self) -> float:
        """Force (1/cm^2) with which pegs push the tip back towards the base."""

    touching: int  # pegs in contact
    base_moment: float  # of contacts, 1/cm
    fold_angle: float  # at the base, rad
    length: float  # everted, cm; 0 before the first step
    free_curvature: float  # 1/cm
    diameter_cm: float  # inflated
    base_compliance_cm: float
    tip_rounding_cm: float
    rest_curvature: tuple[tuple[float, float], ...]  # see `Tube`
    critical_moment: float | None  # the base folds there, 1/cm; body pressure changes it
    status: Convergence  # how the last equilibrium was found; see `Solution`
    model: Model  # of the last step
    error_bound_cm: float  # of positions in the last step
    counts: dict[str, int]  # steps by each model that was used
