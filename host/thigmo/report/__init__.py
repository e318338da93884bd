"""Figures of what the localizer or a run found, drawn from its documents alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from thigmo.localization import LocalizeResult
from thigmo.record import OccupancyGrid
from thigmo.report.grid_figure import draw_grid
from thigmo.report.map_figure import draw_map, plot_map
from thigmo.report.posterior_figure import draw_posterior

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_grid", "draw_map", "draw_posterior", "plot", "plot_map"]


def plot(
    found: LocalizeResult | OccupancyGrid, axes: Axes | None = None, *, unit: str = ""
) -> Axes:
    """Draw a result of a lower layer: what its own `plot()` calls."""
    if isinstance(found, LocalizeResult):
        return draw_posterior(found, axes, unit=unit)
    return draw_grid(found, axes)
