"""Designs a robot before it is built: drafts it from a few numbers, and judges the draft."""

from thigmo.design.draft import draft
from thigmo.design.judge import Finding, judge

__all__ = ["Finding", "draft", "judge"]
