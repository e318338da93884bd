"""A contact as it is drawn on the body, and the colours of its status."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

# Of Okabe and Ito's palette, which people with any common colour blindness tell apart.
COLORS = {"localized": "#d55e00", "ambiguous": "#e69f00"}
OTHER_COLOR = "#5b6b7a"


@dataclass(frozen=True, slots=True)
class Bar:
    """A contact on the body: its place, its interval's pieces (none if unknown), its status."""

    arc: float
    pieces: Sequence[tuple[float, float]]
    status: str
    words: str = ""  # beside it on a figure

    @property
    def color(self) -> str:
        """Colour of its status."""
        return COLORS.get(self.status, OTHER_COLOR)
