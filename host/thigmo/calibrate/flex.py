"""Flex sensors: ohms to curvature, sensor by sensor (thesis, sections 2.3 and 3.1; improved).

Rows are of three kinds: `straight` (the robot at rest), `tip` (the tip pushed aside to a place
that the camera saw; the rod solver gives the curvature under each sensor), and `bend` (a free bend
by one muscle: the camera gives the one curvature that all sensors of the other side share). Ten tip
places alone leave the distal sensors uncertain, because there is little curvature near a pushed
tip; free bends mend that.

Before any line is fitted the rows are judged together: a tip on the wrong side, a moved camera or
a lost marker disagree with all sensors at once, a dead sensor with all rows, an outlier with
neither, a loose wire stands at one value for many bends. Each is named in the verdict and left out.
The errors stated hold from sweep to sweep (`correlation`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, cast

import numpy as np
from numpy.typing import NDArray

from thigmo.calibrate.columns import places_of
from thigmo.calibrate.correlation import OrderedFit
from thigmo.calibrate.flex_data import FlexReadings
from thigmo.calibrate.flex_lines import (
    directions_of,
    dropouts,
    honest_lines,
    nonlinearities,
    working,
)
from thigmo.calibrate.flex_rows import Rows, columns_swapped, judge_rows, mirrored, model_rows
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import RobotConfig, Side
from thigmo.errors import DataError

Array = NDArray[np.float64]
Direction = Literal[-1, 0, 1]

_CAMERA_SCALE_SE = 0.002  # what the camera's own scale may be off by, common to all rows
_LEAST_NOISE = 5e-5  # 1/cm


@dataclass(frozen=True)
class FlexFit:
    """One sensor's calibration."""

    # side, index: which sensor
    side: Side
    index: int
    healthy: bool  # usable
    reason: str  # why good or bad
    used: int = 0  # rows that went into the line
    rejected: int = 0  # rows left out as outliers of this sensor
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
    # half width of its loop, 1/cm, signed: what it reads too much after long bending to the left,
    # and too little after bending to the right
    hysteresis: float = np.nan
    hysteresis_se: float = np.nan  # its standard error

    @property
    def name(self) -> str:
        """As an operator calls it."""
        return f"{self.side} {self.index}"


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
        for fit in self.sensors:
            sensor = config.sensors.column(fit.side)[fit.index]
            sensor.healthy = fit.healthy
            if not fit.healthy:
                continue
            sensor.scale_per_ohm = fit.scale_per_ohm
            # One reading meets all of them: the fit's error, this sweep's gain, the curve.
            sensor.scale_se = float(np.hypot(np.hypot(fit.scale_se, fit.sweep_se), fit.misfit))
            sensor.zero_ohm = fit.zero_ohm
            sensor.valid_direction = fit.valid_direction
            # Whoever uses a reading knows nothing of the loop.
            sensor.zero_se = float(np.hypot(fit.noise * fit.lasting**0.5, fit.hysteresis))
            sensor.noise = fit.noise * (1 - fit.lasting) ** 0.5


def fit_flex(readings: FlexReadings, config: RobotConfig) -> FlexResult:
    """Fit every sensor; see the module's text.

    Raises:
        DataError: sensors and columns disagree in number, or too few rows to judge anything.
    """
    sensors = places_of(config)
    sides = [side for side, _ in sensors]
    if readings.ohm.shape[1] != len(sensors):
        raise DataError(
            f"{readings.ohm.shape[1]} resistances for {len(sensors)} sensors of the configuration",
            "use the robot.toml of this robot",
        )
    notes: list[str] = []
    rows = model_rows(readings, config, notes)
    if rows.good.sum() < 5:
        raise DataError(
            f"{int(rows.good.sum())} of {len(rows.good)} rows can be used",
            "repeat the step; " + notes[0] if notes else "take at least ten places",
        )
    _leave_out_dropouts(rows, sensors, notes)
    directions = directions_of(rows.columns(), rows.lines(), sides)
    rows.usable &= (directions == 0) | (directions * rows.model >= -1e-12)
    rows.find_loop_width()
    judge_rows(rows, notes)
    swapped = columns_swapped(rows, sides)
    columns = rows.columns()
    lines = honest_lines(columns, [None] * len(columns))
    curves = nonlinearities([
        column if made is None else column._replace(
            ohm=np.where(made.line.used, column.ohm, np.nan))
        for column, made in zip(columns, lines, strict=True)
    ])  # fmt: skip
    fits = []
    for c, (side, k) in enumerate(sensors):
        everted = bool(rows.on_body[c])
        # The slope (ohm cm) that a sensor of this kind has.
        nominal = 1 / abs(config.sensors.column(side)[k].scale_per_ohm or 3.5e-5)
        asked = int((rows.usable[:, c] & rows.good).sum()) if everted else -1
        fits.append(_sensor(side, k, columns[c].seen, asked, lines[c], curves[c],
                            cast(Direction, int(directions[c])), nominal))  # fmt: skip
    verdict = _verdict(fits, notes, swapped, readings)
    return FlexResult(tuple(fits), verdict, rows, rows.loop_width)


def _leave_out_dropouts(rows: Rows, sensors: list[tuple[Side, int]], notes: list[str]) -> None:
    for number, (column, (side, k)) in enumerate(zip(rows.columns(), sensors, strict=True)):
        lost, values = dropouts(column.ohm, column.model)
        if values:
            rows.ohm[lost, number] = np.nan
            counted = (rows.usable[:, number] & rows.good & rows.on_body[number]).sum()
            at = " and ".join(f"{value / 1000:.4g}" for value in values)
            notes.append(
                f"{side} {k} stands at {at} kOhm in {lost.sum() / max(1, counted):.0%} of its rows,"
                " however it is bent: those rows are left out; look for a loose wire"
            )


def _sensor(
    side: Side,
    index: int,
    seen: NDArray[np.bool_],
    asked: int,
    made: OrderedFit | None,
    curve: tuple[float, float, float],
    direction: Direction,
    nominal: float,
) -> FlexFit:
    """Nonlinearity, hysteresis, noise and verdict of one sensor.

    `asked` is the number of rows that it should have seen; -1 if it is not everted.
    """

    def dead(reason: str, used: int = 0) -> FlexFit:
        return FlexFit(side, index, False, reason, used)

    if asked < 0:
        return dead("not everted at this length")
    if seen.sum() < 0.5 * asked:
        return dead("is open or shorted (most readings are out of range): check its wire")
    if made is None:
        return dead("has too few readings, or none that vary", int(seen.sum()))
    fit, used = made.line, int(made.line.used.sum())
    if not working(fit):
        if fit.se(1) > 0.1 * nominal:
            return dead("bends too little to tell its scale: take more places and bends")
        return dead("does not answer to bending: check its pouch and its wire", used)
    scale = 1.0 / float(fit.coefficients[1])
    se = float(np.hypot(fit.se(1) * abs(scale), _CAMERA_SCALE_SE))
    left = fit.residuals[fit.used]
    spread = float(np.sqrt(left @ left / max(1, used - 3)))
    bend, bend_se, misfit = curve
    curves = abs(bend) > 0.05 and abs(bend) > 4 * bend_se
    healthy, reason = se <= 0.1, f"scale known to {100 * se:.1f} %"
    if not healthy:
        reason = f"has a scale known to {100 * se:.0f} % only: take more places and bends"
    elif curves:
        reason += f", but its answer curves by {100 * bend:.0f} % at full bend"
    return FlexFit(
        side, index, healthy, reason, used, int((seen & ~fit.used).sum()),
        scale_per_ohm=scale, scale_se=se, sweep_se=made.sweep_gain,
        zero_ohm=float(fit.coefficients[0]), zero_se_ohm=fit.se(0), valid_direction=direction,
        noise=max(spread * abs(scale), _LEAST_NOISE), lasting=made.lasting,
        nonlinearity=bend, misfit=misfit if curves else 0.0,
        hysteresis=float(fit.coefficients[2] * scale), hysteresis_se=fit.se(2) * abs(scale),
    )  # fmt: skip


def _verdict(
    fits: list[FlexFit], notes: list[str], swapped: bool, readings: FlexReadings
) -> Verdict:
    everted = [fit for fit in fits if fit.reason != "not everted at this length"]
    dead = [fit for fit in everted if not fit.healthy]
    dropped = {fit.name: fit.rejected for fit in everted if fit.healthy and fit.rejected}
    total = sum(fit.used + fit.rejected for fit in everted)
    if dropped and not swapped:
        worst_first = sorted(dropped, key=lambda name: -dropped[name])
        each = ", ".join(f"{name}: {dropped[name]}" for name in worst_first)
        notes.append(
            f"left out {sum(dropped.values())} of {total} single readings as outliers ({each}); "
            "many of one sensor mean a loose wire"
        )
    notes.extend(
        f"the answer of {fit.name} curves: {100 * fit.nonlinearity:+.0f} % of it at full bend goes "
        f"beyond a straight line, so {100 * fit.misfit:.0f} % is added to its scale's error; "
        "calibrate over the bends that you use"
        for fit in everted
        if fit.healthy and fit.misfit
    )
    if mirrored(readings):
        reason = (
            "most tips stood on the other side than asked for: the camera's +y is not the robot's "
            "left; mend the cards' places in the sheet file, run `thigmo camera locate` and repeat"
        )
        return Verdict(False, reason, tuple(notes))
    if swapped:
        reason = (
            "left and right are swapped: the side of the active muscle reads well and the other "
            "does not; exchange the sensor columns' plugs, or the muscles' tubes, and repeat"
        )
        return Verdict(False, reason, tuple(notes))
    notes.extend(
        f"left out sensor {fit.name} (0 = at the base), which {fit.reason}; the robot does without "
        "it until flex is repeated"
        for fit in dead
    )
    good = False
    if not any(readings.active):
        notes.append("without free bends it cannot be noticed if left and right are swapped")
    if len(dead) > len(everted) / 2:
        reason = "more than half of the sensors fail; check wiring"
    elif not everted:
        reason = "no sensor is everted; grow the robot first"
    else:
        worst = max((fit for fit in everted if fit.healthy), key=lambda fit: fit.scale_se)
        percent, good = 100 * worst.scale_se, worst.scale_se <= 0.05
        reason = f"scales known to {percent:.1f} % or better ({worst.name} is the worst)"
        if not good:
            reason = (
                f"the scale of {worst.name} is known to {percent:.0f} % only; add free bends or "
                "more places"
            )
    return Verdict(good, reason, tuple(notes))
