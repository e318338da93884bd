"""Figures and files of what the localizer or a run found, drawn from its documents alone."""

from thigmo.report.map_figure import draw_map, plot_map
from thigmo.report.series_figure import draw_series

__all__ = ["draw_map", "draw_series", "plot_map"]
