"""New axes for a notebook's figure, and the manners that all figures share."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito's palette: people with any common colour blindness tell its colours apart.
BLUE, ORANGE, GREEN, RED = "#0072b2", "#e69f00", "#009e73", "#d55e00"
PURPLE, SKY, INK = "#cc79a7", "#56b4e9", "#22313f"
CYCLE = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY, INK)
MUTED = "#5b6b7a"


def new_axes(width_in: float, height_in: float) -> Axes:
    """Axes of a new pyplot figure, which a notebook shows and `pyplot.show` opens."""
    from matplotlib import pyplot

    _, axes = pyplot.subplots(figsize=(width_in, height_in), layout="constrained")
    return axes


def plain(axes: Axes) -> None:
    """No box, and a faint grid behind what is drawn."""
    axes.grid(color="#d9dfe5", lw=0.5)
    axes.set_axisbelow(True)
    for spine in ("top", "right"):
        axes.spines[spine].set_visible(False)


def small(axes: Axes) -> None:
    """A panel of a printed page: letters of its size, and a grid."""
    axes.grid(which="both", alpha=0.2)
    axes.tick_params(labelsize=7)
    axes.title.set_fontsize(9)
    for axis in (axes.xaxis, axes.yaxis):
        axis.label.set_fontsize(8)


def titled(axes: Axes, title: str, statement: str) -> None:
    """A title at the left, and a line of facts below it."""
    axes.set_title(title, loc="left", fontsize=13, color=INK, pad=22)
    axes.text(0, 1.012, statement, transform=axes.transAxes, fontsize=9, color=MUTED, va="bottom")
