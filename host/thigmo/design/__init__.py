"""A robot before it is built: made from a few numbers, and judged by mechanics."""

from thigmo.design.draft import draft
from thigmo.design.judge import Finding, judge

__all__ = ["Finding", "draft", "judge"]
