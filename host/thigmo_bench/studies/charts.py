"""Common parts of the studies' figures: panels in one style, maps of cells, shared legends."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
from numpy.typing import ArrayLike

from thigmo.display.axes import CYCLE, small

# Figures are drawn at their printed width, so that font sizes are true.
_PAGE_IN = 7.5
_FLATTEST = 0.6  # least share of a panel's height if a row of panels shrinks to fit the page


def panels(
    rows: int = 1,
    columns: int = 1,
    *,
    size: tuple[float, float] = (6.0, 4.2),
    title: str = "",
    share: bool | str = False,
) -> tuple[Figure, list[Axes]]:
    """A figure and its panels, row by row.

    `size` is that of a panel in inches; panels are narrowed to fit the page. `share` shares the y
    axes, "all" both axes.
    """
    width = min(size[0] * columns, _PAGE_IN)
    height = size[1] * rows * max(width / (size[0] * columns), _FLATTEST)
    figure = Figure(figsize=(width, height), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=share == "all", sharey=bool(share), squeeze=False)
    axes: list[Axes] = list(grid.ravel())
    for axis in axes:
        axis.set_prop_cycle(color=CYCLE)
        small(axis)
    if title:
        figure.suptitle(title, fontsize=9, wrap=True)
    return figure, axes


Series = Mapping[str, Iterable[tuple[float, float]]]


def curves(axis: Axes, series: Series, **settings: Any) -> None:
    """Draw marked lines of (x, y) points by name, and apply settings of the axis."""
    for name, points in series.items():
        axis.plot(*np.array(list(points)).T, "o-", markersize=4, linewidth=1.1, label=name)
    axis.set(**settings)


def cells(
    axis: Axes,
    values: ArrayLike,
    rows: Sequence[object],
    columns: Sequence[object],
    *,
    texts: Sequence[Sequence[str]],
    **image: Any,
) -> Any:
    """Draw a map of cells with a text in each, and return matplotlib's image.

    `values` and `texts` are (rows, columns); `rows` and `columns` are labels of ticks; `image`
    holds options of `Axes.imshow`.
    """
    array = np.asarray(values, dtype=np.float64)
    axis.grid(visible=False, which="both")
    drawn = axis.imshow(array, aspect="auto", **image)
    fills = np.asarray(drawn.cmap(drawn.norm(array)))
    for (r, c), value in np.ndenumerate(array):
        light = float(np.dot(fills[r, c, :3], (0.299, 0.587, 0.114)))
        ink = "black" if np.isnan(value) or light > 0.5 else "white"
        axis.text(c, r, texts[r][c], ha="center", va="center", fontsize=6, color=ink)
    axis.set_xticks(range(len(columns)), [str(label) for label in columns], fontsize=6)
    axis.set_yticks(range(len(rows)), [str(label) for label in rows], fontsize=6)
    return drawn


def named(
    axis: Axes,
    points: Sequence[tuple[float, float]],
    names: Sequence[str],
    stairs: Sequence[tuple[float, float]],
) -> None:
    """Write each point's name beside it, without covering points, other names or stairs.

    The figure must have been drawn. A name without room covers as little as it can. Stairs are the
    points of a line of steps, each of which follows its point.
    """
    frame = axis.get_window_extent().padded(-1)
    occupied = [Bbox.from_bounds(x - 6, y - 6, 12, 12) for x, y in axis.transData.transform(points)]
    for (x0, y0), (x1, y1) in pairwise(axis.transData.transform(np.reshape(stairs, (-1, 2)))):
        occupied += [Bbox.from_extents(x0, y0 - 2, x1, y0 + 2), Bbox.from_extents(x1, y1, x1, y0)]
    place = (1, 0)  # side and rise
    for name, point in zip(names, points, strict=True):
        text = axis.annotate(
            name, point, (5, 0), textcoords="offset points", fontsize=7, va="center",
            path_effects=[withStroke(linewidth=1.5, foreground="white")],
        )  # fmt: skip
        fewest = np.inf
        for rise, side in product(sorted(range(-88, 89, 4), key=abs), (1, -1)):
            text.set(position=(6 * side, rise), ha="left" if side > 0 else "right")
            box = text.get_window_extent()
            covered = box.count_overlaps(occupied)
            if frame.contains(*box.min) and frame.contains(*box.max) and covered < fewest:
                fewest, place = covered, (side, rise)
            if not fewest:
                break
        side, rise = place
        text.set(position=(6 * side, rise), ha="left" if side > 0 else "right")
        occupied.append(text.get_window_extent().padded(2, 0))
        if rise:
            axis.annotate(
                "", point, text.get_position(), textcoords="offset points",
                arrowprops={"arrowstyle": "-", "color": "0.6", "lw": 0.5},
            )  # fmt: skip


def legend_below(figure: Figure, *panels: Axes, title: str | None = None) -> None:
    """Put the legend of some panels, or of the first, below all panels, where it covers nothing."""
    named = [panel.get_legend_handles_labels() for panel in panels or figure.axes[:1]]
    handles, labels = (
        [item for part in parts for item in part] for parts in zip(*named, strict=True)
    )
    figure.legend(
        handles, labels, loc="outside lower center", ncols=6 if title else 4, fontsize=7,
        title=title, title_fontsize=7, frameon=False,
    )  # fmt: skip
