"""Figures of what a run found, drawn from its documents alone."""

from thigmo.report.map_figure import draw_map

__all__ = ["draw_map"]
