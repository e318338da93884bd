"""Figures of what the localizer or a run found, drawn from its documents alone."""

from thigmo.report.map_figure import draw_map, plot_map
from thigmo.report.result_figures import draw_grid, draw_posterior

__all__ = ["draw_grid", "draw_map", "draw_posterior", "plot_map"]
