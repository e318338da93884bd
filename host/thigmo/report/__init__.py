"""Figures of what the localizer or a run found, drawn from its documents alone."""

from thigmo.report.map_figure import draw_map, plot_map
from thigmo.report.result_figures import draw_grid, draw_posterior, draw_series

__all__ = ["draw_grid", "draw_map", "draw_posterior", "draw_series", "plot_map"]
