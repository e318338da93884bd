"""Who answers for the robot's surroundings when a program names nobody."""

from __future__ import annotations

from collections.abc import Sequence

from thigmo.errors import DataError
from thigmo.room import Dowel, Operator

__all__ = ["NobodyThere", "Operator"]


class NobodyThere:
    """The operator of a program that named none: every question is a DataError."""

    def everted_length_cm(self) -> float:
        """Refuse."""
        raise DataError("the everted length is unknown", "measure it, and call confirm_length")

    def set_body_pressure(self, pressure_psi: float) -> None:
        """Refuse."""
        raise DataError(
            f"the body pressure must be set to {pressure_psi:g} psi by hand",
            "set the regulator, and call select_zone",
        )

    def place_pegs(self, pegs: Sequence[Dowel]) -> None:
        """Refuse."""
        raise DataError("the room's dowels must be moved by hand", "name an operator to connect()")
