"""Curvature readings in, contacts out: arrays only, no links, robots or files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from thigmo.localization.batch import BatchResult, localize_batch, localize_rows
from thigmo.localization.bounds import Identifiability, identifiability
from thigmo.localization.estimate import localize
from thigmo.localization.history import ArcFilter, localize_sweep
from thigmo.localization.obstacle import localize_obstacle
from thigmo.localization.result import Contact, LocalizeResult
from thigmo.localization.warm import warm_up

if TYPE_CHECKING:
    METHODS: tuple[str, ...]

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


def __getattr__(name: str) -> Any:
    """`METHODS`: every name that `localize(method=)` knows; baselines load on first use."""
    if name == "METHODS":
        from thigmo.localization.baselines import BASELINES

        return ("exact", "l1", "l2", *BASELINES)
    raise AttributeError(f"module 'thigmo.localization' has no attribute {name!r}")
