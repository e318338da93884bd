"""Curvature readings in, contacts out: arrays only, no links, robots or files."""

from __future__ import annotations

from thigmo.localization.batch import BatchResult
from thigmo.localization.localizer import METHODS, Localizer, check_method, localize, localize_batch
from thigmo.localization.newtons import Newtons, Quantity
from thigmo.localization.options import Body, Errors, Priors, Sensors
from thigmo.localization.result import Contact, LocalizeResult

__all__ = [
    "METHODS",
    "BatchResult",
    "Body",
    "Contact",
    "Errors",
    "LocalizeResult",
    "Localizer",
    "Newtons",
    "Priors",
    "Quantity",
    "Sensors",
    "check_method",
    "localize",
    "localize_batch",
]
