"""Curvature readings in, contacts out: arrays only, no links, robots or files."""

from __future__ import annotations

from thigmo.localization.estimate import localize
from thigmo.localization.result import Contact, LocalizeResult

__all__ = ["Contact", "LocalizeResult", "localize"]
