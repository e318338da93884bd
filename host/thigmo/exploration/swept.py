"""What the sweeps without contact rule out.

Pegs stand still, and the free body bends alike at every length. So a peg that is felt at one length
on a part of the body that had swept the same space before, unfelt, would have been felt then: a
contact that appears lies on the part of the body that has grown since, or at a bend that the
earlier sweep did not reach.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from thigmo.config import Side

# A contact on the earlier tip's rim may slide off it unfelt: one tube radius.
_SLACK_CM = 1.75
# Bends are compared with this much doubt: maps of different body pressures, hysteresis.
_SAME_BEND = 0.95


@dataclass
class SweptSpace:
    """Lengths and bends that were swept without a contact."""

    # (side, everted length in cm, free curvature at the peak in 1/cm) of each
    free: list[tuple[Side, float, float]] = field(default_factory=list)

    def remember(self, side: Side, length_cm: float, peak_curvature: float) -> None:
        """Take a side's sweep on which nothing was touched."""
        self.free.append((side, length_cm, abs(peak_curvature)))

    def nearest_arc(self, side: Side, length_cm: float, touch_curvature: float) -> float:
        """The arc (cm) below which a contact on a side cannot be.

        It was felt at an everted length, from a free curvature (1/cm) on.
        """
        bend = abs(touch_curvature)
        arcs = [
            length - _SLACK_CM
            for other, length, peak in self.free
            if other == side and length < length_cm - 0.5 and bend <= _SAME_BEND * peak
        ]
        return max(arcs, default=0.0)
