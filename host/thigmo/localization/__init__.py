"""Curvature readings in, contacts out: arrays only, no links, robots or files."""

from __future__ import annotations

from thigmo.localization.batch import BatchResult, localize_batch, localize_rows
from thigmo.localization.bounds import Identifiability, identifiability
from thigmo.localization.estimate import localize
from thigmo.localization.history import ArcFilter, localize_sweep
from thigmo.localization.obstacle import localize_obstacle
from thigmo.localization.point_estimates import METHODS
from thigmo.localization.result import Contact, LocalizeResult
from thigmo.localization.warm import warm_up

__all__ = [
    "METHODS",
    "ArcFilter",
    "BatchResult",
    "Contact",
    "Identifiability",
    "LocalizeResult",
    "identifiability",
    "localize",
    "localize_batch",
    "localize_obstacle",
    "localize_rows",
    "localize_sweep",
    "warm_up",
]
