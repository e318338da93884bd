"""Figures of results: a posterior along the body with its contacts, and an occupancy grid."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np

from thigmo.display import COLORS, OTHER_COLOR, POINT_ESTIMATE
from thigmo.record.occupancy import FREE, OCCUPIED
from thigmo.report.axes import INK, new_axes, plain, titled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from thigmo.localization import Contact, LocalizeResult
    from thigmo.record import OccupancyGrid

_FREE, _UNKNOWN = "#ffffff", "#d3d9df"


def draw_posterior(found: LocalizeResult, axes: Axes | None = None, *, unit: str = "") -> Axes:
    """Draw the most distal contact's posterior, and every contact with its 95 % interval.

    Axes None makes a new figure; `unit` names the unit of length, for the localizer knows none.
    """
    axes = axes or new_axes(7.6, 3.6)
    density = found.mass / np.diff(found.edges) if found.mass.size else np.zeros(0)
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
    axes.set(
        xlabel=f"arc along the body ({unit or 'in the unit of the length given'})",
        ylabel=f"probability density{f' (1/{unit})' if unit else ''}",
        xlim=(-0.04 * found.length, 1.04 * found.length), ylim=(2.1 * body, 1.32 * height),
    )  # fmt: skip
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
    color, arc = COLORS.get(contact.status, OTHER_COLOR), contact.arc
    whole = () if point_fit else (contact.interval,)
    for low, high in contact.intervals or whole:
        axes.plot([low, high], [body, body], color=color, lw=7, solid_capstyle="butt", zorder=3)
    axes.plot(arc, body, "o", color=color, ms=8, mec="white", mew=1.2, zorder=4)
    axes.plot([arc, arc], [body, 1.04 * height], color=color, lw=0.8, ls=(0, (4, 2)))
    early = arc < 0.5 * axes.dataLim.x1
    words = f"{arc:.4g}"
    if point_fit:
        words += f"  ({contact.interval_text})"
    else:
        words += f"  ({contact.interval_text}, 95 %)\n"
        words += f"probability {contact.probability:.3g}, {contact.status}"
    axes.annotate(
        words,
        (arc, 1.06 * height), xytext=(0, 2), textcoords="offset points",
        ha="left" if early else "right", va="bottom", fontsize=8, color=color,
    )  # fmt: skip


def draw_grid(grid: OccupancyGrid, axes: Axes | None = None) -> Axes:
    """Draw the cells in the robot's frame; `axes` None makes a new figure."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch
    from matplotlib.transforms import Affine2D

    axes = axes or new_axes(7.2, 6.0)
    rows, columns = grid.cells.shape
    free, occupied = grid.cells == FREE, grid.cells == OCCUPIED
    x, y, yaw = grid.origin
    size = grid.resolution_cm
    turn = Affine2D().rotate(yaw).translate(x, y)
    axes.imshow(
        np.select([free, occupied], [0.0, 2.0], 1.0), origin="lower", vmin=0, vmax=2,
        cmap=ListedColormap([_FREE, _UNKNOWN, INK]), interpolation="nearest",
        extent=(0, columns * size, 0, rows * size), transform=turn + axes.transData,
    )  # fmt: skip
    corners = np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)], dtype=np.float64) * size
    turned = turn.transform(corners)
    low, high = turned.min(axis=0), turned.max(axis=0)
    axes.set(
        xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal",
        xlabel="x, along the straight robot (cm)", ylabel="y, to its left (cm)",
    )  # fmt: skip
    plain(axes)
    axes.grid(visible=False)
    area = (size / 100.0) ** 2
    titled(
        axes,
        "Occupancy grid",
        f"{columns} x {rows} cells of {size:.4g} cm; free {area * free.sum():.2f} m², "
        f"occupied {area * occupied.sum():.3f} m²",
    )
    names = (("free", _FREE), ("unknown", _UNKNOWN), ("occupied", INK))
    axes.legend(
        handles=[Patch(facecolor=color, edgecolor="#9aa6b2", label=name) for name, color in names],
        loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8,
    )  # fmt: skip
    return axes


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
