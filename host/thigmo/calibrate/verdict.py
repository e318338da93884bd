"""How a calibration step ends: good or bad, why, and everything that was left out on the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from thigmo.config import RobotConfig


@dataclass(frozen=True)
class Verdict:
    """The outcome of a step in words.

    Attributes:
        good: whether the result may be used.
        reason: one sentence: why good, or what is wrong and what to do.
        notes: what was detected and left out, each a sentence.
    """

    good: bool
    reason: str
    notes: tuple[str, ...] = ()

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        return {"good": self.good, "reason": self.reason, "notes": list(self.notes)}


class StepResult(Protocol):
    """What every step's fit returns."""

    @property
    def verdict(self) -> Verdict:
        """Good or bad, and why."""
        ...

    def as_data(self) -> dict[str, Any]:
        """Plain data for the calibration folder."""
        ...

    def apply(self, config: RobotConfig) -> RobotConfig:
        """A copy of the configuration with this step's results in it."""
        ...


def listed(names: Sequence[str], rows: Sequence[int]) -> str:
    """Names of rows, eight at most."""
    more = f" and {len(rows) - 8} more" if len(rows) > 8 else ""
    return ", ".join(names[row] for row in rows[:8]) + more
