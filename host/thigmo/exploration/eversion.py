"""Whether the tip grew as far as the line was paid out, by the sensors that should have everted.

The spool only pays out line; nothing measures its tension. If a peg stands ahead, the tip stalls,
the tail goes slack, and the length that the encoder tells is too long from there on. But a sensor
that everts passes through the tip's fold, the tightest bend there is: its reading rises and falls
again. A sensor that lies behind the believed tip and shows no such thing has not come out. How far
it got says where the tip is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from thigmo.exploration.plan import FOLD_MARGIN_CM
from thigmo.robot import SensorTable
from thigmo.robot.readings import Floats

# A rise of so much (1/cm) is the fold's. The fold's own curvature is of the order of one
# over the tube's radius, ten times that even where a sensor averages it; creep and noise are less.
_FOLD_PER_CM = 0.03
_PASSED = 0.5  # share of the rise by which a reading falls once the fold has left; creep is less
_SETTLED = 5  # last frames, a quarter of a second
_SAME_PLACE_CM = 1.0
_LEVEL = 0.03  # share of the rise by which a reading may differ from its last and count as that
_ONSET_CM = 1.0  # a fold that has entered a sensor by less may go unseen


@dataclass(frozen=True, slots=True)
class Stall:
    """Growth that stopped before the line did."""

    arc_cm: float  # where the tip is, by the best guess
    interval_cm: tuple[float, float]  # it is within these
    sensors: int  # how many should have everted and did not
    force_per_cm2: float = 0.0  # it bends nothing


def stall(length_cm: Floats, bend: Floats, table: SensorTable) -> Stall | None:
    """What a growth's readings say of its tip; None if every sensor that was due has everted.

    Args:
        length_cm: (n,) believed lengths, ascending.
        bend: (n, 10) what the sensors read there, 1/cm, from any zero.
    """
    if len(length_cm) <= 2 * _SETTLED:
        return None
    start = table.center_cm - table.span_cm / 2
    end = table.center_cm + table.span_cm / 2
    due = table.healthy & (start > length_cm[0]) & (end + FOLD_MARGIN_CM <= length_cm[-1] + 0.05)
    due &= np.isfinite(bend).all(axis=0)
    for place in sorted(set(table.center_cm[due].tolist())):
        here = np.flatnonzero(due & (np.abs(table.center_cm - place) < _SAME_PLACE_CM))
        stalls = [_stalled(length_cm, bend[:, i], float(start[i]), float(end[i])) for i in here]
        stuck = [found for found in stalls if found is not None]
        if len(stuck) == len(here):
            tip = float(np.mean([found[0] for found in stuck]))
            low = min(found[1] for found in stuck)
            high = max(found[2] for found in stuck)
            return Stall(tip, (low, high), len(here))
    return None


def _stalled(
    length_cm: Floats, reading: Floats, start: float, end: float
) -> tuple[float, float, float] | None:
    """(tip, low, high) of a sensor that the fold did not pass through; None if it did."""
    before = float(np.median(reading[length_cm < start][-_SETTLED:]))
    last = float(np.median(reading[-_SETTLED:]))
    rise = np.abs(reading - before)
    top = int(rise.argmax())
    if rise[top] < _FOLD_PER_CM:  # it has not reached the fold
        low = float(length_cm[0])
        high = start + _ONSET_CM
        return (low + high) / 2, low, high
    if abs(reading[top] - last) >= _PASSED * rise[top]:
        return None
    # It lies in the fold: from where on its reading stayed as it is, the tip stood still.
    noise = float(np.std(reading[-_SETTLED:]))
    level = np.abs(median_filter(reading, _SETTLED, mode="nearest") - last)
    off = np.flatnonzero(level > _LEVEL * rise[top] + 3 * noise)
    tip = float(np.clip(length_cm[off[-1]] if off.size else start, start, end))
    return tip, start, end
