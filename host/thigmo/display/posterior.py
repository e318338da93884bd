"""Figure of a posterior along the body, with its contacts."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thigmo.display.axes import INK, new_axes, plain, titled
from thigmo.display.bars import OTHER_COLOR, Bar
from thigmo.extras import require

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_posterior(
    length: float,
    edges: NDArray[np.float64],
    probability: NDArray[np.float64],
    bars: Sequence[Bar],
    title: str,
    message: str,
    *,
    axes: Axes | None = None,
    unit: str = "",
) -> Axes:
    """Draw a posterior along the body, and every contact with its 95 % interval.

    Args:
        length: of the body.
        edges: (M + 1,) edges of the posterior's cells; empty without one.
        probability: (M,) their masses.
        bars: the contacts, base to tip.
        title: of the figure.
        message: a sentence below it.
        axes: the axes to draw on; None makes a new figure.
        unit: name of the unit of length.

    Raises:
        NotInstalledError: matplotlib is missing.
    """
    require("plot", "a figure")
    axes = axes or new_axes(7.6, 3.6)
    density = probability / np.diff(edges) if probability.size else np.zeros(0)
    # The body lies below the density, as thick as a fifth of its height.
    height = float(density.max()) if density.size and density.max() > 0 else 1.0
    body = -0.2 * height
    if density.size:
        color = bars[-1].color if bars else OTHER_COLOR
        axes.stairs(density, edges, fill=True, color=color, alpha=0.22)
        axes.stairs(density, edges, color=color, lw=1.2, baseline=None)
    axes.plot([0, length], [body, body], color="#bcd0e2", lw=11, solid_capstyle="round", zorder=2)
    for bar in bars:
        _draw_bar(axes, bar, body, height)
    axes.set(
        xlabel=f"arc along the body ({unit or 'in the unit of the length given'})",
        ylabel=f"probability density{f' (1/{unit})' if unit else ''}",
        xlim=(-0.04 * length, 1.04 * length), ylim=(2.1 * body, 1.32 * height),
    )  # fmt: skip
    axes.set_yticks([tick for tick in axes.get_yticks() if 0 <= tick <= 1.32 * height])
    plain(axes)
    if not density.size:  # a point fit, or no contact: there is no density to read off
        axes.set_yticks([])
        axes.set_ylabel("")
        axes.spines["left"].set_visible(False)
    for arc, name, side in ((0.0, "base", "left"), (length, "tip", "right")):
        axes.text(arc, 1.72 * body, name, ha=side, va="center", fontsize=8, color=INK)
    titled(axes, title, shorten(message, 110))
    return axes


def _draw_bar(axes: Axes, bar: Bar, body: float, height: float) -> None:
    """A contact on the body: its interval's pieces, its place, and its words."""
    for low, high in bar.pieces:
        axes.plot([low, high], [body, body], color=bar.color, lw=7, solid_capstyle="butt", zorder=3)
    axes.plot(bar.arc, body, "o", color=bar.color, ms=8, mec="white", mew=1.2, zorder=4)
    axes.plot([bar.arc, bar.arc], [body, 1.04 * height], color=bar.color, lw=0.8, ls=(0, (4, 2)))
    early = bar.arc < 0.5 * axes.dataLim.x1
    axes.annotate(
        bar.words,
        (bar.arc, 1.06 * height), xytext=(0, 2), textcoords="offset points",
        ha="left" if early else "right", va="bottom", fontsize=8, color=bar.color,
    )  # fmt: skip
