"""The body that picks its own model: arc, beam or elastica, whichever is enough.

`arc` is exact while nothing touches and the natural curvature is one number; `beam` serves when its
error bound meets the tolerance; else `elastica`. The choice is made at every step, counted, and can
be overridden. The emulator's plant drives this class.
"""

from __future__ import annotations

from collections.abc import Sequence

from thigmo.mechanics.contact import Peg
from thigmo.mechanics.elastica import ModelChoice, Rod, Tube


class Body(Rod):
    """A robot body among pegs, followed through time with the least model that is good enough.

    Args:
        tube: section and fold.
        pegs: obstacles.
        model: "auto", or one model for all steps ("arc" feels no pegs).
        tolerance_cm: error in position that the automatic choice may make.
        cell_cm: mesh width.
    """

    def __init__(
        self,
        tube: Tube,
        pegs: Sequence[Peg] = (),
        *,
        model: ModelChoice = "auto",
        tolerance_cm: float = 0.05,
        cell_cm: float = 1.0,
    ) -> None:
        super().__init__(tube, pegs, cell_cm=cell_cm, model=model, tolerance_cm=tolerance_cm)
