"""How an exploration localizes contacts: by a fit to all sweeps, or by the thesis's solver."""

from __future__ import annotations

from typing import Final

from thigmo.errors import DataError

FIELD: Final = "field"  # one fit to all sweeps of a side
THESIS: Final = "thesis"  # the thesis's alternating solver, at each sweep's peak
METHODS = (FIELD, THESIS)


def check_exploration_method(method: str) -> None:
    """Raises DataError if explorations have no such method."""
    if method not in METHODS:
        raise DataError(
            f"explorations have no method {method!r}", f"choose from {', '.join(METHODS)}"
        )
