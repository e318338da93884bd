"""Words for how certain a contact is, shared by results, maps and pictures."""

from __future__ import annotations

from typing import Literal

# Status of a contact by a method that gives a place and no measure of its error.
POINT_ESTIMATE: Literal["point estimate"] = "point estimate"
# Probability of a contact beyond which it is listed, and from which it is sure.
LIKELY, SURE = 0.5, 0.95


def interval_text(status: str, interval: tuple[float, float], number: str, unit: str = "") -> str:
    """An interval for people, its numbers by a format: "36.2 to 43.3"."""
    if status == POINT_ESTIMATE:
        return "no interval"
    low, high = (format(end, number) for end in interval)
    return f"{low} to {high}{unit}"
