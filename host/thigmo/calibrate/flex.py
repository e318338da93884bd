"""Flex sensors: ohms to curvature, sensor by sensor (thesis, sections 2.3 and 3.1; improved).

Rows are of three kinds: `straight` (the robot at rest), `tip` (the tip pushed aside to a place
that the camera saw; the rod solver gives the curvature under each sensor), and `bend` (a free bend
by one muscle: the camera gives the one curvature that all sensors of the other side share). Ten tip
places alone leave the distal sensors uncertain, because there is little curvature near a pushed
tip; free bends resolve that.

Before any line is fitted the rows are judged together: a tip on the wrong side, a moved camera or
a lost marker disagree with all sensors at once, a dead sensor with all rows, an outlier with
neither, a loose wire stands at one value for many bends. Each is named in the verdict and omitted.
The errors stated hold from sweep to sweep (`flex_lines`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, cast

import numpy as np

from thigmo.calibrate.bench import Bench, last_bends, tip_rows
from thigmo.calibrate.columns import sensors_of
from thigmo.calibrate.flex_data import FlexReadings
from thigmo.calibrate.flex_lines import (
    Column,
    OrderedFit,
    directions_of,
    dropouts,
    honest_lines,
    nonlinearities,
    working,
)
from thigmo.calibrate.flex_rows import Rows, columns_swapped, judge_rows, mirrored, model_rows
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import FlexSensor, RobotConfig
from thigmo.errors import DataError
from thigmo.record.table import Table

_REPORTED = 0.02  # share of the scale from which one-way bends are reported
Direction = Literal[-1, 0, 1]

_CAMERA_SCALE_SE = 0.002  # what the camera's own scale may be off by, common to all rows
_LEAST_NOISE = 5e-5  # 1/cm
# A bend goes back if it falls by this share of the largest. This many such rows show the loop.
_FALL, _LEAST_BACK = 0.02, 3


@dataclass(frozen=True)
class FlexFit:
    """One sensor's calibration."""

    name: str  # of the sensor
    healthy: bool  # usable
    reason: str  # why good or bad
    used: int = 0  # rows that went into the line
    rejected: int = 0  # rows omitted as outliers of this sensor
    scale_per_ohm: float = 0.0  # 1/cm per ohm, sign included
    scale_se: float = np.inf  # its standard error over sweeps, relative
    sweep_se: float = np.nan  # one sigma of the scale from one sweep to the next, relative
    zero_ohm: float = np.nan  # resistance of the straight sensor
    zero_se_ohm: float = np.nan  # its standard error
    valid_direction: Direction = 0  # bending direction that it answers to; 0 = both
    noise: float = np.nan  # one sigma of a reading about the fit, 1/cm
    lasting: float = np.nan  # share of that variance that lasts over rows
    # share of the answer at the largest bend that goes beyond a straight line
    nonlinearity: float = np.nan
    # departure of the readings' curve from the line, rms, relative; 0 if there is none
    misfit: float = np.nan
    # half width of its loop, 1/cm, signed: what it reads too much after long bending to
    # one side (positive), and too little after bending to the other
    hysteresis: float = np.nan
    hysteresis_se: float = np.nan  # its standard error
    # share of the scale that the loop may have taken, where bends only grew; 0 where they went back
    one_way: float = 0.0


@dataclass(frozen=True)
class FlexResult(StepResult):
    """All sensors, what was detected on the way, and over which curvature their loops turn."""

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
        """Scales, zeros, directions, noise and health.

        A sensor found dead keeps its old constants and is marked unhealthy.
        """
        loops = [fit.hysteresis for fit in self.sensors if fit.healthy]
        usual_loop = float(np.sqrt(np.mean(np.square(loops)))) if loops else 0.0
        sensors = sensors_of(config)
        for fit in self.sensors:
            sensor = sensors[fit.name]
            if not isinstance(sensor, FlexSensor):
                continue
            sensor.healthy = fit.healthy
            if not fit.healthy:
                continue
            sensor.scale_per_ohm = fit.scale_per_ohm
            # One reading meets all of them: the fit's error, this sweep's gain, the curve.
            sensor.scale_se = float(np.hypot(np.hypot(fit.scale_se, fit.sweep_se), fit.misfit))
            sensor.zero_ohm = fit.zero_ohm
            sensor.valid_direction = fit.valid_direction
            # What uses a reading later knows nothing of the loop. A few rows measure one poorly, so
            # it counts as large as its neighbours'. Bends do not show how a zero drifts once the
            # sensor has everted: an error that robot.toml states is never made smaller.
            loop = max(abs(fit.hysteresis), usual_loop)
            sensor.zero_se = max(
                sensor.zero_se, float(np.hypot(fit.noise * fit.lasting**0.5, loop))
            )
            sensor.noise = fit.noise * (1 - fit.lasting) ** 0.5


Fit = Callable[[FlexReadings, RobotConfig], FlexResult]


def guided(bench: Bench, fit: Fit | None = None) -> FlexResult:
    """From tip places and free bends (which it takes if there are none yet)."""
    readings = FlexReadings.of_rows(
        [*tip_rows(bench), *last_bends(bench)], bench.config.body.length_cm
    )
    result = (fit or fit_flex)(readings, bench.config)
    readings.write(bench.session.folder / "flex.csv", bench.config)
    return result


def of_csv(table: Table, config: RobotConfig, fit: Fit | None = None) -> FlexResult:
    """Rows of any kinds; see `FlexReadings.read`."""
    return (fit or fit_flex)(FlexReadings.read(table, config), config)


def fit_flex(readings: FlexReadings, config: RobotConfig) -> FlexResult:
    """Fit every sensor; see the module's text."""
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
        lost, values = dropouts(column.ohm, column.model)
        if values:
            rows.ohm[lost, number] = np.nan
            at = " and ".join(f"{value / 1000:.4g}" for value in values)
            share = lost.sum() / max(1, rows.asked(number))
            rows.notes.append(
                f"{name} stands at {at} kOhm in {share:.0%} of its rows, however it is bent: "
                "those rows are omitted; look for a loose wire"
            )
    directions = directions_of(rows.columns(), rows.sides)
    rows.usable &= (directions == 0) | (directions * rows.model >= -1e-12)
    rows.find_loop_width()
    judge_rows(rows)
    columns = rows.columns()
    lines = honest_lines(columns)
    curves = nonlinearities([
        column if line is None else column._replace(ohm=np.where(line.used, column.ohm, np.nan))
        for column, line in zip(columns, lines, strict=True)
    ])  # fmt: skip
    fits = []
    for number, (name, column, line) in enumerate(zip(sensors, columns, lines, strict=True)):
        # The slope (ohm cm) that a sensor of this kind has.
        nominal = 1 / abs(sensors[name].scale_per_ohm)
        reason, used = "not everted at this length", 0
        if rows.on_body[number]:
            reason, used = _fault(column, line, rows.asked(number), nominal)
        if reason or line is None:
            fits.append(FlexFit(name, False, reason, used))
        else:
            direction = cast(Direction, int(directions[number]))
            fits.append(_sensor(name, column, line, curves[number], direction))
    verdict = _verdict([fit for fit, on in zip(fits, rows.on_body, strict=True) if on], rows)
    return FlexResult(tuple(fits), verdict, rows, rows.loop_width)


def _fault(column: Column, line: OrderedFit | None, asked: int, nominal: float) -> tuple[str, int]:
    """Why a sensor cannot be used ("" if it can), and how many rows tell so."""
    seen = int(column.seen.sum())
    if seen < 0.5 * asked:
        return "is open or shorted (most readings are out of range): check its wire", 0
    if line is None:
        return "has too few readings, or none that vary", seen
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
    direction: Direction,
) -> FlexFit:
    """Nonlinearity, hysteresis and noise of a sensor that answers."""
    used = int(line.used.sum())
    scale = 1.0 / float(line.coefficients[1])
    one_way = _one_way(column, line)
    se = float(np.hypot(np.hypot(line.se(1) * abs(scale), _CAMERA_SCALE_SE), one_way))
    rest = line.residuals[line.used]
    spread = float(np.sqrt(rest @ rest / max(1, used - 3)))
    bend, bend_se, misfit = curve
    curves = abs(bend) > 0.05 and abs(bend) > 4 * bend_se
    reason = f"scale known to {100 * se:.1f} %"
    if se > 0.1:
        cure = "read bends on the way back, too" if one_way > 0.05 else "take more places and bends"
        reason = f"has a scale known to {100 * se:.0f} % only: {cure}"
    elif curves:
        reason += f", but its answer curves by {100 * bend:.0f} % at full bend"
    return FlexFit(
        name, se <= 0.1, reason, used, int((column.seen & ~line.used).sum()),
        scale_per_ohm=scale, scale_se=se, sweep_se=line.sweep_gain,
        zero_ohm=float(line.coefficients[0]), zero_se_ohm=line.se(0), valid_direction=direction,
        noise=max(spread * abs(scale), _LEAST_NOISE), lasting=line.lasting,
        nonlinearity=bend, misfit=misfit if curves else 0.0,
        hysteresis=float(line.coefficients[2] * scale), hysteresis_se=line.se(2) * abs(scale),
        one_way=one_way,
    )  # fmt: skip


def _one_way(column: Column, line: OrderedFit) -> float:
    """Share of the scale that the loop may have taken from it; 0 where bends went both ways.

    Where bends only grow, the loop stands at one end. Only the first few thousandths of curvature
    then separate the slope from it: what the fit gave to the loop may be the slope's.
    """
    rows = np.flatnonzero(column.seen)
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
        each = ", ".join(f"{fit.name}: {fit.rejected}" for fit in dropped)
        notes.append(
            f"omitted {sum(fit.rejected for fit in dropped)} of {total} single readings as "
            f"outliers ({each}); many of one sensor mean a loose wire"
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
