"""One prediction about a described robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Finding:
    """One prediction."""

    part: str  # of the robot: "board", "muscle left", "units"
    mark: Literal["ok", "warning", "bad"]
    text: str  # the prediction with its number, and the cure
