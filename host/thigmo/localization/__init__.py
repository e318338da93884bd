"""Curvature readings in, contacts out: arrays only, no links, robots or files."""

from __future__ import annotations

from thigmo.localization.batch import BatchResult, localize_batch
from thigmo.localization.bounds import Identifiability, arc_bounds, identifiability
from thigmo.localization.estimate import METHODS, localize
from thigmo.localization.frames import ContactFilter
from thigmo.localization.result import Contact, LocalizeResult

__all__ = [
    "METHODS",
    "BatchResult",
    "Contact",
    "ContactFilter",
    "Identifiability",
    "LocalizeResult",
    "arc_bounds",
    "identifiability",
    "localize",
    "localize_batch",
]
