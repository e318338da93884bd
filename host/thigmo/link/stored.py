"""How a board's stored configuration fits the firmware that runs: what was kept, new, left out.

A board stores each parameter under an id that never changes its meaning, so its configuration
survives an update of the firmware. `thigmo flash` and `thigmo params` print it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from thigmo.link import protocol as wire

_BY_ID = {**wire.PARAMETER_NAMES, wire.MAP_ID: "maps"}


@dataclass(frozen=True, slots=True)
class StoredConfiguration:
    """How much of the stored configuration the running firmware uses."""

    generation: int  # of the stored configuration; 0 = none
    kept: int  # number of stored parameters in use, the maps as one
    # names of parameters that were not stored and are at their defaults (the first 8)
    new: tuple[str, ...]
    new_count: int  # their number
    # ids of stored parameters that this firmware does not have (the first 8)
    unknown: tuple[int, ...]
    unknown_count: int  # their number

    @classmethod
    def of(cls, report: wire.ConfigReport) -> Self:
        """From the board's report."""
        return cls(
            report.generation,
            report.kept,
            tuple(_BY_ID[i] for i in report.new_ids[: report.new_count]),
            report.new_count,
            report.unknown_ids[: report.unknown_count],
            report.unknown_count,
        )

    @property
    def remark(self) -> str:
        """A sentence for the operator, if stored and running configuration differ; else empty."""
        parts = []
        if self.new_count:
            ellipsis = ", ..." if self.new_count > len(self.new) else ""
            names = ", ".join(self.new)
            parts.append(f"new in this firmware and at its default: {names}{ellipsis}")
        if self.unknown_count:
            ids = ", ".join(map(str, self.unknown))
            ellipsis = ", ..." if self.unknown_count > len(self.unknown) else ""
            parts.append(f"stored, but unknown to this firmware and left out: id {ids}{ellipsis}")
        return "; ".join(parts)
