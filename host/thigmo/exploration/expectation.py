"""What an effort is expected to take and to give, for an operator who chooses one.

The robot time is computed for the robot at hand. Errors and misses are those that `thigmo bench
exploration` measured with that effort, on emulated robots of the thesis's kind; `tools/figures.py`
keeps them in dial.json.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from math import inf

from thigmo.config import RobotConfig
from thigmo.exploration.effort import EFFORTS, Effort, Planner, within
from thigmo.wiring import Wiring


@dataclass(frozen=True, slots=True)
class Measured:
    """What the study measured in rooms of a kind, with an effort or a budget ("100 s")."""

    kind: str
    setting: str
    rooms: int
    time_s: float  # mean robot time
    error_cm: float  # mean distance in the plane between a contact and the true one
    missed: float  # share of the touched obstacles that are not on the map

    @property
    def budget_s(self) -> float:
        """The budget of robot time; infinite for a named effort."""
        number = self.setting.partition(" ")[0]
        return float(number) if number.isdigit() else inf


@dataclass(frozen=True, slots=True)
class Expectation:
    """What to expect of a run.

    Attributes:
        effort: "quick", "default", "careful", or a budget such as "120 s".
        robot_time_s: robot time that it takes, s.
        skips: what it omits and what that costs; empty if nothing.
        measured: a row for each kind of room; empty for a budget below all that were measured.
        usual: whether a run takes this effort if none is given.
    """

    effort: str
    robot_time_s: float
    skips: str
    measured: tuple[Measured, ...]
    usual: bool


@cache
def dial() -> tuple[Measured, ...]:
    """All rows of dial.json."""
    text = (files("thigmo.exploration") / "dial.json").read_text(encoding="utf-8")
    return tuple(Measured(**row) for row in json.loads(text))


def expectations(config: RobotConfig, time_s: float | None = None) -> list[Expectation]:
    """What to expect of each named effort, or of a budget of robot time (s) alone.

    Raises DataError if the budget is too short for any sweep.
    """
    wiring = Wiring.laid_out(config)
    if time_s is not None:
        return [_expected(wiring, within(time_s, wiring), _budget_rows(time_s))]
    return [
        _expected(wiring, effort, [row for row in dial() if row.setting == name])
        for name, effort in EFFORTS.items()
    ]


def _expected(wiring: Wiring, effort: Effort, rows: Sequence[Measured]) -> Expectation:
    planner = Planner(wiring, effort)
    return Expectation(
        effort.name, planner.whole_run_s(), planner.skips(), tuple(rows), effort.name == "default"
    )


def _budget_rows(time_s: float) -> list[Measured]:
    """The rows of the largest measured budget that is no longer than this one."""
    budgets = [row for row in dial() if row.budget_s <= time_s]
    largest_s = max((row.budget_s for row in budgets), default=inf)
    return [row for row in budgets if row.budget_s == largest_s]
