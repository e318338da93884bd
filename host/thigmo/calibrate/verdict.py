"""The verdict on a calibration step: whether it is good, why, and what was omitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, cast

from pydantic_core import to_jsonable_python

from thigmo.config import RobotConfig


@dataclass(frozen=True)
class Verdict:
    """The outcome of a step in words."""

    good: bool  # whether the result may be used
    reason: str  # one sentence: why good, or what is wrong and what to do
    notes: tuple[str, ...] = ()  # what was detected and omitted, each a sentence


class StepResult:
    """What every step's fit returns: a dataclass with a verdict."""

    verdict: Verdict
    EVIDENCE: ClassVar[tuple[str, ...]] = ()  # names of the fields that only the figure needs

    def as_data(self) -> dict[str, Any]:
        """Plain data for the calibration folder: every field but the evidence."""
        names = [f.name for f in fields(cast(Any, self)) if f.name not in self.EVIDENCE]
        return cast("dict[str, Any]", plain({name: getattr(self, name) for name in names}))

    def apply(self, config: RobotConfig) -> RobotConfig:
        """A copy of the configuration with this step's results in it."""
        updated = config.model_copy(deep=True)
        self.write(updated)
        return updated

    def write(self, config: RobotConfig) -> None:
        """Put this step's results into a configuration; by default, nothing."""


def plain(value: Any) -> Any:
    """A value as JSON takes it: dataclasses become dicts, arrays lists."""
    return to_jsonable_python(value, fallback=lambda array: array.tolist())


def listed(names: Sequence[str], rows: Sequence[int]) -> str:
    """Names of rows as text, at most eight."""
    suffix = f" and {len(rows) - 8} more" if len(rows) > 8 else ""
    return ", ".join(names[row] for row in rows[:8]) + suffix
