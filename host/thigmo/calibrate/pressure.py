"""Zeros of the pressure sensors with vented muscles, which the board stores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thigmo.calibrate.bench import Bench
from thigmo.calibrate.columns import Array
from thigmo.calibrate.regression import outlying
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.record.table import Table

_LEAST_COUNT = 0.05 * 1024
NOMINAL_COUNT = 102.4  # at 0 psi by the data sheet: 10 % of the supply


@dataclass(frozen=True)
class PressureZero:
    """One pressure sensor with its muscle vented."""

    muscle: str  # its name
    zero_count: float  # ADC count at 0 psi
    zero_se: float  # its standard error
    good: bool  # it may be used
    reason: str  # why


@dataclass(frozen=True)
class PressureResult(StepResult):
    """The pressure sensors' zeros in the order of the muscles."""

    zeros: tuple[PressureZero, ...]
    verdict: Verdict

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        return {**super().as_data(), "pressure_zero": self.board_values()}

    def board_values(self) -> list[int]:
        """The board's parameter `pressure_zero`, in 1/64 count, by output."""
        return [round(np.nan_to_num(z.zero_count) * 64) for z in self.zeros]


def guided(bench: Bench) -> PressureResult:
    """Measure the zeros of all pressure sensors at vent, and store them on the board.

    The board needs these zeros to know that a muscle is vented, so it is not asked. Instead, the
    fit refuses pressures that still change, and zeros too far from the data sheet.
    """
    robot = bench.robot
    robot.vent(wait=False)
    robot.wait(3.0)
    record = robot.record(3.0)
    zero, span = (
        np.array(robot.parameter(f"pressure_{name}"), float) / 64 for name in ("zero", "span")
    )
    full = robot.parameter("pressure_full_cpsi")[0] / 100
    names = [muscle.name for muscle in bench.config.muscles]
    used, spare = np.split(zero, [len(names)])
    counts = used + record.pressure_psi * span[: len(names)] / full
    result = fit_pressure_zero(counts, names, float(span.mean()), full)
    if result.verdict.good:
        spare_counts = (spare * 64).round().astype(int).tolist()  # of outputs without a muscle
        robot.set_parameter("pressure_zero", [*result.board_values(), *spare_counts])
        robot.save()
    return result


def of_csv(table: Table, config: RobotConfig) -> PressureResult:
    """Fit ADC counts at vent from a CSV with a column for each muscle, by name."""
    names = [muscle.name for muscle in config.muscles]
    return fit_pressure_zero(
        np.column_stack([table.numbers(f"{name}_count") for name in names]), names
    )


def fit_pressure_zero(
    counts: Array, names: Sequence[str], span: float = 819.2, full_psi: float = 60.0
) -> PressureResult:
    """Zeros from ADC counts (n, muscles) with all muscles vented; `span` counts are `full_psi`."""
    if len(counts) < 10:
        raise DataError("ten or more readings of each pressure sensor are needed", "read longer")
    zeros = []
    for muscle, muscle_counts in zip(names, counts.T, strict=True):
        values, zero, se, fall_psi = muscle_counts[np.isfinite(muscle_counts)], np.nan, np.inf, 0.0
        if len(values) > 1:
            calm = values[~outlying(values, 5, 0.5)]
            half = len(calm) // 2
            zero, se = float(calm.mean()), float(calm.std(ddof=1) / np.sqrt(len(calm)))
            fall_psi = abs(float(calm[:half].mean() - calm[half:].mean())) * full_psi / span
        offset_psi = (zero - NOMINAL_COUNT) * full_psi / span
        good = False
        if not zero >= _LEAST_COUNT:
            reason = "reads below 5 % of its supply: broken wire"
        elif abs(offset_psi) > 3.0:
            reason = f"is {offset_psi:+.1f} psi from its data sheet: not vented, or wrong type"
        elif fall_psi > 0.15:
            reason = f"still moves by {fall_psi:.2f} psi: wait until vented"
        else:
            good, reason = (
                True,
                f"zero at {zero:.2f} counts ({offset_psi:+.2f} psi of the data sheet)",
            )
        zeros.append(PressureZero(muscle, zero, se, good, reason))
    notes = tuple(f"the pressure sensor of {z.muscle} {z.reason}" for z in zeros if not z.good)
    reason = "vent, shut the air, check the wires, and repeat" if notes else "zeros taken"
    return PressureResult(tuple(zeros), Verdict(not notes, reason, notes))
