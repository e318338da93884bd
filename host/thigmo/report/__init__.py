"""Figures and files of what the localizer or a run found, drawn from its documents alone."""

from thigmo.report.map_figure import draw_map, plot_map

__all__ = ["draw_map", "plot_map"]
