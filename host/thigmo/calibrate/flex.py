"""Flex sensors: resistance to curvature, for each sensor (thesis, sections 2.3 and 3.1; improved).

Rows are of three kinds: `straight` (the robot at rest), `tip` (the tip pushed aside to a place
that the camera saw; the rod solver gives the curvature under each sensor), and `bend` (a free bend
by one muscle: the camera gives the one curvature that all sensors of the other side share). Ten tip
places alone leave the distal sensors uncertain, because there is little curvature near a pushed
tip; free bends resolve that.

Before any line is fitted the rows are judged together. A tip on the wrong side, a moved camera or a
lost marker disagrees with all sensors at once. A dead sensor disagrees with all rows. A loose wire
gives the same value for many bends. All else is a single outlier. The verdict names each of them,
and they are omitted. The errors stated are those from sweep to sweep (`flex_lines`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, cast

import numpy as np

from thigmo.calibrate.bench import Bench, last_bends, tip_rows
from thigmo.calibrate.columns import mark_health, sensors_of
from thigmo.calibrate.flex_data import FlexReadings
from thigmo.calibrate.flex_lines import (
    Column,
    OrderedFit,
    bend_signs_of,
    dropouts,
    nonlinearities,
    reml_lines,
    working,
)
from thigmo.calibrate.flex_rows import Rows, columns_swapped, judge_rows, mirrored, model_rows
from thigmo.calibrate.overhead import CAMERA_SCALE_SE
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import FlexSensor, RobotConfig
from thigmo.errors import DataError
from thigmo.record.table import Table

_REPORTED = 0.02  # relative error of the scale by one-way bends from which it is reported
BendSign = Literal[-1, 0, 1]

_LEAST_NOISE = 5e-5  # 1/cm
# Bending goes back where it falls by this share of the largest bend. So many such rows at least
# show the hysteresis loop.
_FALL, _LEAST_BACK = 0.02, 3


@dataclass(frozen=True)
class FlexFit:
    """One sensor's calibration."""

    name: str  # of the sensor
    healthy: bool  # usable
    reason: str  # why good or bad
    used: int = 0  # rows that went into the line
    rejected: int = 0  # rows omitted because this sensor's reading is an outlier
    scale_per_ohm: float = 0.0  # 1/cm per ohm, sign included
    scale_se: float = np.inf  # its standard error over sweeps, relative
    sweep_se: float = np.nan  # relative standard deviation of the scale between sweeps
    zero_ohm: float = np.nan  # resistance of the straight sensor
    zero_se_ohm: float = np.nan  # its standard error
    bend_sign: BendSign = 0  # sign of the bends that it can read; 0 = both
    noise: float = np.nan  # standard deviation of a reading about the fit, 1/cm
    lasting: float = np.nan  # share of that variance that neighbouring rows share
    # deviation from a straight line at the largest bend, as a share of the response
    nonlinearity: float = np.nan
    # relative rms deviation of the response curve from the line; 0 if it is straight
    misfit: float = np.nan
    # half width of its hysteresis loop, 1/cm, signed: by how much it reads too high after long
    # bending to the positive side, and too low after bending to the other
    hysteresis: float = np.nan
    hysteresis_se: float = np.nan  # its standard error
    # possible relative error of the scale by the loop if bends only grew; 0 if they went back
    one_way: float = 0.0


@dataclass(frozen=True)
class FlexResult(StepResult):
    """Results of all sensors, faults found, and the curvature over which their loops turn."""

    sensors: tuple[FlexFit, ...]
    verdict: Verdict
    rows: Rows
    loop_width: float
    EVIDENCE: ClassVar = ("rows",)

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        good = self.rows.good
        left_out = np.flatnonzero(~good).tolist()
        return {**super().as_data(), "rows": len(good), "rows_left_out": left_out}

    def write(self, config: RobotConfig) -> None:
        """Put in scales, zeros, signs of the bends, noise and health.

        A sensor found dead keeps its old constants and is marked unhealthy.
        """
        loops = [fit.hysteresis for fit in self.sensors if fit.healthy]
        usual_loop = float(np.sqrt(np.mean(np.square(loops)))) if loops else 0.0
        for fit, sensor in mark_health(config, self.sensors, FlexSensor):
            sensor.scale_per_ohm = fit.scale_per_ohm
            # A single reading has all three errors: the fit's, this sweep's gain and the curve's.
            sensor.scale_se = float(np.hypot(np.hypot(fit.scale_se, fit.sweep_se), fit.misfit))
            sensor.zero_ohm = fit.zero_ohm
            sensor.bend_sign = fit.bend_sign
            # Readings are later used without a model of the loop, so it is part of their error. A
            # few rows measure a loop poorly, so it counts as at least as large as the usual one.
            # Bends do not show how a zero drifts after eversion, so an error that robot.toml states
            # is never reduced.
            loop = max(abs(fit.hysteresis), usual_loop)
            sensor.zero_se = max(
                sensor.zero_se, float(np.hypot(fit.noise * fit.lasting**0.5, loop))
            )
            sensor.noise = fit.noise * (1 - fit.lasting) ** 0.5


Fit = Callable[[FlexReadings, RobotConfig], FlexResult]


def guided(bench: Bench, fit: Fit | None = None) -> FlexResult:
    """Fit tip places and free bends, after taking those that are missing."""
    readings = FlexReadings.of_rows(
        [*tip_rows(bench), *last_bends(bench)], bench.config.body.length_cm
    )
    result = (fit or fit_flex)(readings, bench.config)
    readings.write(bench.session.folder / "flex.csv", bench.config)
    return result


def of_csv(table: Table, config: RobotConfig, fit: Fit | None = None) -> FlexResult:
    """Fit rows of a CSV, as `FlexReadings.read` takes them."""
    return (fit or fit_flex)(FlexReadings.read(table, config), config)


def fit_flex(readings: FlexReadings, config: RobotConfig) -> FlexResult:
    """Fit every sensor, as the module describes. Raises DataError if too few rows are usable."""
    sensors = sensors_of(config)
    if readings.ohm.shape[1] != len(sensors):
        raise DataError(
            f"{readings.ohm.shape[1]} resistances for {len(sensors)} sensors of the configuration",
            "use the robot.toml of this robot",
        )
    rows = model_rows(readings, config)
    if rows.good.sum() < 5:
        raise DataError(
            f"{int(rows.good.sum())} of {len(rows.good)} rows can be used",
            "repeat the step; " + rows.notes[0] if rows.notes else "take at least ten places",
        )
    for number, (column, name) in enumerate(zip(rows.columns(), sensors, strict=True)):
        dropped, values = dropouts(column.ohm, column.model)
        if values:
            rows.ohm[dropped, number] = np.nan
            constants = " and ".join(f"{value / 1000:.4g}" for value in values)
            share = dropped.sum() / max(1, rows.expected_readings(number))
            rows.notes.append(
                f"{name} stands at {constants} kOhm in {share:.0%} of its rows, however it is "
                "bent: those rows are omitted; look for a loose wire"
            )
    bend_signs = bend_signs_of(rows.columns(), rows.sides)
    rows.usable &= (bend_signs == 0) | (bend_signs * rows.model >= -1e-12)
    rows.find_loop_width()
    judge_rows(rows)
    columns = rows.columns()
    lines = reml_lines(columns)
    curves = nonlinearities([
        column if line is None else column._replace(ohm=np.where(line.used, column.ohm, np.nan))
        for column, line in zip(columns, lines, strict=True)
    ])  # fmt: skip
    fits = []
    for number, (name, column, line) in enumerate(zip(sensors, columns, lines, strict=True)):
        # The usual slope of such a sensor, ohm cm.
        nominal = 1 / abs(sensors[name].raw_scale)
        reason, used = "not everted at this length, or no flex sensor", 0
        if rows.to_fit[number]:
            reason, used = _fault(column, line, rows.expected_readings(number), nominal)
        if reason or line is None:
            fits.append(FlexFit(name, False, reason, used))
        else:
            bend_sign = cast(BendSign, int(bend_signs[number]))
            fits.append(_sensor(name, column, line, curves[number], bend_sign))
    verdict = _verdict(
        [fit for fit, is_fitted in zip(fits, rows.to_fit, strict=True) if is_fitted], rows
    )
    return FlexResult(tuple(fits), verdict, rows, rows.loop_width)


def _fault(
    column: Column, line: OrderedFit | None, expected: int, nominal: float
) -> tuple[str, int]:
    """Why a sensor cannot be used ("" if it can), and how many rows show it."""
    count = int(column.finite.sum())
    if count < 0.5 * expected:
        return "is open or shorted (most readings are out of range): check its wire", 0
    if line is None:
        return "has too few readings, or none that vary", count
    if working(line):
        return "", 0
    if line.se(1) > 0.1 * nominal:
        return "bends too little to tell its scale: take more places and bends", 0
    return "does not answer to bending: check its pouch and its wire", int(line.used.sum())


def _sensor(
    name: str,
    column: Column,
    line: OrderedFit,
    curve: tuple[float, float, float],
    bend_sign: BendSign,
) -> FlexFit:
    """The fit of a working sensor, with nonlinearity, hysteresis and noise."""
    used = int(line.used.sum())
    scale = 1.0 / float(line.coefficients[1])
    one_way = _one_way(column, line)
    se = float(np.hypot(np.hypot(line.se(1) * abs(scale), CAMERA_SCALE_SE), one_way))
    residuals = line.residuals[line.used]
    spread = float(np.sqrt(residuals @ residuals / max(1, used - 3)))
    bend, bend_se, misfit = curve
    curves = abs(bend) > 0.05 and abs(bend) > 4 * bend_se
    reason = f"scale known to {100 * se:.1f} %"
    if se > 0.1:
        cure = "read bends on the way back, too" if one_way > 0.05 else "take more places and bends"
        reason = f"has a scale known to {100 * se:.0f} % only: {cure}"
    elif curves:
        reason += f", but its answer curves by {100 * bend:.0f} % at full bend"
    return FlexFit(
        name, se <= 0.1, reason, used, int((column.finite & ~line.used).sum()),
        scale_per_ohm=scale, scale_se=se, sweep_se=line.sweep_gain,
        zero_ohm=float(line.coefficients[0]), zero_se_ohm=line.se(0), bend_sign=bend_sign,
        noise=max(spread * abs(scale), _LEAST_NOISE), lasting=line.lasting,
        nonlinearity=bend, misfit=misfit if curves else 0.0,
        hysteresis=float(line.coefficients[2] * scale), hysteresis_se=line.se(2) * abs(scale),
        one_way=one_way,
    )  # fmt: skip


def _one_way(column: Column, line: OrderedFit) -> float:
    """Possible relative error of the scale by the loop; 0 if bends went both ways.

    If bends only grow, the loop soon stays at one end. Only the first few thousandths of curvature
    then separate slope and loop, so what the fit assigns to the loop may belong to the slope.
    """
    rows = np.flatnonzero(column.finite)
    k, block = column.model[rows], column.block[rows]
    top = float(np.abs(k).max(initial=0.0))
    falls = np.abs(k[:-1]) - np.abs(k[1:]) > _FALL * top
    back = falls & (k[:-1] * k[1:] >= 0.0) & (block[:-1] == block[1:]) & (k[1:] != 0.0)
    if back.sum() >= _LEAST_BACK or top == 0.0:
        return 0.0
    return float(abs(line.coefficients[2] / line.coefficients[1])) / top


def _verdict(everted: Sequence[FlexFit], rows: Rows) -> Verdict:
    swapped, notes = columns_swapped(rows), rows.notes
    healthy = [fit for fit in everted if fit.healthy]
    dropped = sorted((f for f in healthy if f.rejected), key=lambda fit: -fit.rejected)
    if dropped and not swapped:
        total = sum(fit.used + fit.rejected for fit in everted)
        reasons = ", ".join(f"{fit.name}: {fit.rejected}" for fit in dropped)
        notes.append(
            f"omitted {sum(fit.rejected for fit in dropped)} of {total} single readings as "
            f"outliers ({reasons}); many of one sensor mean a loose wire"
        )
    grew = [fit for fit in everted if fit.one_way > _REPORTED]
    if grew:
        worst_loop = max(grew, key=lambda fit: fit.one_way)
        notes.append(
            f"bends of {len(grew)} sensor{'s'[: len(grew) > 1]} only ever grew, so their scale "
            f"cannot be separated from their loop: up to {100 * worst_loop.one_way:.0f} % "
            f"({worst_loop.name}) is added to its error; read the sensors on the way back, too"
        )
    notes.extend(
        f"the answer of {fit.name} curves: {100 * fit.nonlinearity:+.0f} % of it at full bend goes "
        f"beyond a straight line, so {100 * fit.misfit:.0f} % is added to its scale's error; "
        "calibrate over the bends that you use"
        for fit in healthy
        if fit.misfit
    )
    if mirrored(rows.readings):
        reason = (
            "most tips stood on the other side than asked for: the camera's +y is not the robot's "
            "left; correct the cards' places in the sheet file, run `thigmo camera locate`, repeat"
        )
        return Verdict(False, reason, tuple(notes))
    if swapped:
        reason = (
            "the two columns are swapped: the side of the active muscle reads well and the other "
            "does not; exchange the sensor columns' plugs, or the muscles' tubes, and repeat"
        )
        return Verdict(False, reason, tuple(notes))
    notes.extend(
        f"omitted sensor {fit.name} (0 = at the base), which {fit.reason}; the robot does without "
        "it until flex is repeated"
        for fit in everted
        if not fit.healthy
    )
    if not any(rows.readings.active):
        notes.append("without free bends it cannot be noticed if the two columns are swapped")
    if len(healthy) < len(everted) / 2:
        return Verdict(False, "more than half of the sensors fail; check wiring", tuple(notes))
    if not everted:
        return Verdict(False, "no sensor is everted; grow the robot first", tuple(notes))
    worst = max(healthy, key=lambda fit: fit.scale_se)
    name, percent = worst.name, 100 * worst.scale_se
    reason = f"the scale of {name} is known to {percent:.0f} % only; add free bends or more places"
    if percent <= 5:
        reason = f"scales known to {percent:.1f} % or better ({name} is the worst)"
    return Verdict(percent <= 5, reason, tuple(notes))
