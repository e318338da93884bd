"""Figure of the answers to a table of frames, in their order or over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from thigmo.display.axes import new_axes, plain
from thigmo.display.bars import Bar
from thigmo.extras import require

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_series(
    moments: Sequence[float],
    bars: Sequence[Sequence[Bar]],
    length: float,
    label: str,
    *,
    axes: Axes | None = None,
    unit: str = "",
) -> Axes:
    """Draw each frame's contacts at its moment: places with their 95 % sets.

    A place without a set is drawn alone; a frame without a contact leaves a gap.

    Args:
        moments: of the frames.
        bars: contacts of each frame.
        length: of the body.
        label: what the moments are.
        axes: the axes to draw on; None makes a new figure.
        unit: name of the unit of length.

    Raises:
        NotInstalledError: matplotlib is missing.
    """
    require("plot", "a figure")
    axes = axes or new_axes(7.6, 3.6)
    named: set[str] = set()
    for moment, contacts in zip(moments, bars, strict=True):
        for bar in contacts:
            for piece in bar.pieces:
                axes.plot([moment, moment], piece, color=bar.color, lw=1.4, alpha=0.4)
            status = None if bar.status in named else bar.status
            named.add(bar.status)
            axes.plot(moment, bar.arc, "o", color=bar.color, ms=3.5, label=status)
    arc = f"arc along the body{f' ({unit})' if unit else ''}"
    axes.set(xlabel=label, ylabel=arc, ylim=(0, length))
    plain(axes)
    if named:
        axes.legend(fontsize=8, frameon=False)
    return axes
