"""Designs a robot: drafts it from a few numbers, judges the draft, and bounds its layout."""

from thigmo.design.bounds import Identifiability, arc_bounds, identifiability
from thigmo.design.draft import draft
from thigmo.design.finding import Finding
from thigmo.design.judge import judge

__all__ = ["Finding", "Identifiability", "arc_bounds", "draft", "identifiability", "judge"]
