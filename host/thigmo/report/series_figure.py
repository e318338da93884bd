"""Figure of the answers to a table of frames, over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from thigmo.contact_status import POINT_ESTIMATE
from thigmo.display.axes import new_axes, plain
from thigmo.display.bars import COLORS, OTHER_COLOR

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from thigmo.localization import LocalizeResult


def draw_series(results: Sequence[tuple[float, LocalizeResult]]) -> Axes:
    """Each answer's contacts over time (or line): places with their 95 % intervals.

    A place without an interval is drawn alone; answers without a contact leave a gap.
    """
    axes = new_axes(7.6, 3.6)
    named: set[str] = set()
    for moment, result in results:
        for contact in result.contacts:
            color = COLORS.get(contact.status, OTHER_COLOR)
            label = None if contact.status in named else contact.status
            named.add(contact.status)
            if contact.status != POINT_ESTIMATE:
                axes.plot([moment, moment], contact.interval, color=color, lw=1.4, alpha=0.4)
            axes.plot(moment, contact.arc, "o", color=color, ms=3.5, label=label)
    length = max((result.length for _, result in results), default=1.0)
    axes.set(xlabel="time (s), or line of the file", ylabel="arc along the body", ylim=(0, length))
    plain(axes)
    if named:
        axes.legend(fontsize=8, frameon=False)
    return axes
