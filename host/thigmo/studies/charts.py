"""What the figures of the studies share: panels in one style, maps of cells, a legend for all."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def panels(
    rows: int = 1,
    columns: int = 1,
    *,
    size: tuple[float, float] = (6.0, 4.2),
    title: str = "",
    share: bool | str = False,
) -> tuple[Figure, list[Axes]]:
    """A figure and its panels, row by row.

    Args:
        rows, columns: how many.
        size: of a panel, inches.
        title: over all of them.
        share: whether panels share their y axis; "all": both axes.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(size[0] * columns, size[1] * rows), layout="constrained")
    found = figure.subplots(rows, columns, sharex=share == "all", sharey=bool(share), squeeze=False)
    axes: list[Axes] = list(found.ravel())
    for axis in axes:
        axis.grid(which="both", alpha=0.2)
    if title:
        figure.suptitle(title)
    return figure, axes


def curves(
    axis: Axes,
    series: Mapping[str, Iterable[tuple[float, float]]],
    *,
    strong: Sequence[str] = (),
    legend: bool = True,
    **settings: Any,
) -> None:
    """Marked lines of (x, y) points by name.

    Args:
        axis: to draw on.
        series: points by name.
        strong: names drawn with thicker lines.
        legend: whether to name them.
        settings: of the axis (`Axes.set`).
    """
    for name, points in series.items():
        x, y = np.array(list(points), dtype=np.float64).reshape(-1, 2).T
        axis.plot(x, y, "o-", markersize=4, linewidth=2.4 if name in strong else 1.1, label=name)
    axis.set(**settings)
    if legend:
        axis.legend(fontsize=8)


def cells(
    axis: Axes,
    values: ArrayLike,
    rows: Sequence[object],
    columns: Sequence[object],
    *,
    texts: Sequence[Sequence[str]] | None = None,
    **image: Any,
) -> Any:
    """A map of cells with each value written into it; returns matplotlib's image.

    Args:
        axis: to draw on.
        values: (rows, columns).
        rows, columns: labels of the ticks.
        texts: what is written; None writes the values.
        image: options of `Axes.imshow`.
    """
    array = np.asarray(values, dtype=np.float64)
    axis.grid(visible=False, which="both")
    drawn = axis.imshow(array, aspect="auto", **image)
    low, high = drawn.get_clim()
    for (r, c), value in np.ndenumerate(array):
        text = texts[r][c] if texts else "-" if np.isnan(value) else f"{value:.3g}"
        middle = abs(value - (low + high) / 2) < 0.3 * (high - low)
        ink = "black" if middle or value > high - 0.2 * (high - low) else "white"
        axis.text(c, r, text, ha="center", va="center", fontsize=7, color=ink)
    axis.set_xticks(range(len(columns)), [str(label) for label in columns], fontsize=8)
    axis.set_yticks(range(len(rows)), [str(label) for label in rows], fontsize=8)
    return drawn


def legend_below(figure: Figure) -> None:
    """One legend for all panels, under them, where it covers nothing."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=7)
