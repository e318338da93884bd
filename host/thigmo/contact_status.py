"""How certain a contact is: limits and words, shared by results, maps and pictures."""

from __future__ import annotations

from typing import Literal

# Status of a contact by a method that gives a place and no measure of its error.
POINT_ESTIMATE: Literal["point estimate"] = "point estimate"
# Probability of a contact beyond which it is listed, and from which it is sure.
LIKELY, SURE = 0.5, 0.95
# A contact is localized if its interval is no wider than this share of the length: 10 cm of 53.
WIDTH_SHARE = 10.0 / 53.0
# Contacts of two runs that are at most so far apart are taken for one.
SAME_CONTACT_CM = 4.0


def narrow(interval: tuple[float, float], length: float) -> bool:
    """Whether an interval is short enough, on a body of this length, to count as localized."""
    return interval[1] - interval[0] <= WIDTH_SHARE * length + 1e-9


def interval_text(status: str, interval: tuple[float, float], number: str, unit: str = "") -> str:
    """An interval for people, its numbers by a format: "36.2 to 43.3"."""
    if status == POINT_ESTIMATE:
        return "no interval"
    low, high = (format(end, number) for end in interval)
    return f"{low} to {high}{unit}"
