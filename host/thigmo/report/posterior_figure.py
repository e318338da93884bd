"""The figure of a localizer's result: the posterior along the body, and the contacts on it."""

from __future__ import annotations

from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np

from thigmo.display import COLORS, OTHER_COLOR
from thigmo.report.axes import INK, new_axes, plain, titled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from thigmo.localization import Contact, LocalizeResult


def draw_posterior(found: LocalizeResult, axes: Axes | None = None, *, unit: str = "") -> Axes:
    """Draw the most distal contact's posterior, and every contact with its 95 % interval.

    Args:
        found: what `localize` or a `ContactFilter` answered.
        axes: where to; None makes a new figure.
        unit: name of the unit of length, for the labels; the localizer knows none.
    """
    axes = axes or new_axes(7.6, 3.6)
    density = found.probability / np.diff(found.edges) if found.probability.size else np.zeros(0)
    # The body lies below the density, as thick as a fifth of its height.
    height = float(density.max()) if density.size and density.max() > 0 else 1.0
    body = -0.2 * height
    if density.size:
        color = COLORS.get(found.contacts[-1].status if found.contacts else "", OTHER_COLOR)
        axes.stairs(density, found.edges, fill=True, color=color, alpha=0.22)
        axes.stairs(density, found.edges, color=color, lw=1.2, baseline=None)
    axes.plot(
        [0, found.length], [body, body], color="#bcd0e2", lw=11, solid_capstyle="round", zorder=2
    )
    for contact in found.contacts:
        _contact(axes, contact, body, height, point_fit=found.objective is not None)
    length = f" ({unit})" if unit else " (in the unit of the length given)"
    axes.set_xlabel(f"arc along the body{length}")
    axes.set_ylabel(f"probability density{f' (1/{unit})' if unit else ''}")
    axes.set_xlim(-0.04 * found.length, 1.04 * found.length)
    axes.set_ylim(2.1 * body, 1.32 * height)
    axes.set_yticks([tick for tick in axes.get_yticks() if 0 <= tick <= 1.32 * height])
    plain(axes)
    if not density.size:  # a point fit, or no contact: there is no density to read off
        axes.set_yticks([])
        axes.set_ylabel("")
        axes.spines["left"].set_visible(False)
    for arc, name, side in ((0.0, "base", "left"), (found.length, "tip", "right")):
        axes.text(arc, 1.72 * body, name, ha=side, va="center", fontsize=8, color=INK)
    titled(axes, f"{found.status}: {found.hypothesis}", shorten(found.message, 110))
    return axes


def _contact(axes: Axes, contact: Contact, body: float, height: float, *, point_fit: bool) -> None:
    """A contact on the body: its interval's pieces, its place, and its words."""
    color = COLORS.get(contact.status, OTHER_COLOR)
    for low, high in contact.intervals or (contact.interval,):
        axes.plot([low, high], [body, body], color=color, lw=7, solid_capstyle="butt", zorder=3)
    axes.plot(contact.arc, body, "o", color=color, ms=8, mec="white", mew=1.2, zorder=4)
    axes.plot(
        [contact.arc, contact.arc], [body, 1.04 * height], color=color, lw=0.8, ls=(0, (4, 2))
    )
    low, high = contact.interval
    right = contact.arc < 0.5 * axes.dataLim.x1
    words = f"{contact.arc:.4g}"
    if not point_fit:
        words += f"  ({low:.4g} to {high:.4g}, 95 %)\n"
        words += f"probability {contact.probability:.3g}, {contact.status}"
    axes.annotate(
        words,
        (contact.arc, 1.06 * height), xytext=(0, 2), textcoords="offset points",
        ha="left" if right else "right", va="bottom", fontsize=8, color=color,
    )  # fmt: skip
