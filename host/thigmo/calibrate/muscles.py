"""The actuator step's result: the maps of both muscles at every body pressure, and one verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from thigmo.calibrate.actuator import ActuatorResult
from thigmo.calibrate.verdict import Verdict
from thigmo.config import SIDES, RobotConfig


@dataclass(frozen=True)
class ActuatorResults:
    """Both muscles at every body pressure that was measured."""

    each: tuple[ActuatorResult, ...]
    verdict: Verdict

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        return {"each": [r.as_data() for r in self.each], "verdict": self.verdict.as_data()}

    def apply(self, config: RobotConfig) -> RobotConfig:
        """All maps into a copy of the configuration."""
        made = config.model_copy(deep=True)
        for result in self.each:
            made = result.apply(made)
        for side in SIDES:
            spreads = [r.offset_se for r in self.each if r.readings.side == side]
            if spreads:
                made.actuators.side(side).offset_se = max(spreads)
        return made


def summary(found: Sequence[ActuatorResult]) -> Verdict:
    """One verdict over several maps."""
    bad = [r for r in found if not r.verdict.good]
    notes = tuple(
        f"{r.readings.side} at {r.readings.body_pressure_psi:g} psi: {text}"
        for r in found
        for text in ((r.verdict.reason,) if r not in bad else ()) + r.verdict.notes
    )
    if bad:
        r = bad[0]
        return Verdict(
            False, f"{r.readings.side} at {r.readings.body_pressure_psi:g} psi: {r.verdict.reason}",
            notes,
        )  # fmt: skip
    worst = max(r.g_se / max(r.full_scale, 1e-9) for r in found)
    return Verdict(True, f"{len(found)} maps, g to {100 * worst:.2f} % or better", notes)
