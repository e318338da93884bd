"""Flex sensors: ohms to curvature, sensor by sensor (thesis, sections 2.3 and 3.1; improved).

Rows are of three kinds: `straight` (the robot at rest), `tip` (the tip pushed aside to a place
that the camera saw; the rod solver gives the curvature under each sensor, the thesis's small-
deflection formula (2.12) is an option), and `bend` (a free bend by one muscle: the camera gives
the one curvature that all sensors of the other side share). Ten tip places alone leave the distal
sensors uncertain, because there is little curvature near a pushed tip; free bends mend that.

Before any line is fitted the rows are judged together: a tip on the wrong side, a moved camera or
a lost marker disagree with all sensors at once, a dead sensor with all rows, an outlier with
neither, a loose wire stands at one value for many bends. Each is named in the verdict and left out.
The errors stated hold from sweep to sweep (`correlation`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from thigmo.calibrate.correlation import OrderedFit
from thigmo.calibrate.flex_data import FlexReadings, merge
from thigmo.calibrate.flex_lines import (
    Column,
    as_direction,
    directions_of,
    dropouts,
    fit_each,
    honest_lines,
    loop_turns,
    loop_width,
    nonlinearities,
    sweeps_of,
    working,
)
from thigmo.calibrate.flex_rows import (
    TIP_SE_CM,
    Deflection,
    columns_swapped,
    judge_rows,
    mirrored,
    model_rows,
    tip_curvature,
    usable_readings,
)
from thigmo.calibrate.verdict import Verdict
from thigmo.config import SIDES, RobotConfig, Side
from thigmo.errors import DataError

__all__ = ["FlexFit", "FlexReadings", "FlexResult", "fit_flex", "merge", "tip_curvature"]

Array = NDArray[np.float64]

_CAMERA_SCALE_SE = 0.002  # what the camera's own scale may be off by, common to all rows
_LEAST_NOISE = 5e-5  # 1/cm
_OHM_RANGE = (1_000.0, 300_000.0)  # beyond: open or shorted


@dataclass(frozen=True)
class FlexFit:
    """One sensor's calibration.

    Attributes:
        side, index: which sensor.
        scale_per_ohm: 1/cm per ohm, sign included.
        scale_se: its standard error over sweeps, relative.
        sweep_se: one sigma of the scale from one sweep to the next, relative.
        zero_ohm: resistance of the straight sensor.
        zero_se_ohm: its standard error.
        valid_direction: bending direction that it answers to; 0 = both.
        noise: one sigma of a reading about the fit, 1/cm.
        lasting: share of that variance that lasts over rows.
        nonlinearity: share of the answer at the largest bend that goes beyond a straight line.
        misfit: departure of the readings' curve from the line, rms, relative; 0 if there is none.
        hysteresis: half width of its loop, 1/cm, signed: what it reads too much after long bending
            to the left, and too little after bending to the right.
        hysteresis_se: its standard error.
        used: rows that went into the line.
        rejected: rows left out as outliers of this sensor.
        healthy: usable.
        reason: why good or bad.
    """

    side: Side
    index: int
    scale_per_ohm: float
    scale_se: float
    sweep_se: float
    zero_ohm: float
    zero_se_ohm: float
    valid_direction: Literal[-1, 0, 1]
    noise: float
    lasting: float
    nonlinearity: float
    misfit: float
    hysteresis: float
    hysteresis_se: float
    used: int
    rejected: int
    healthy: bool
    reason: str

    @property
    def name(self) -> str:
        """As an operator calls it."""
        return f"{self.side} {self.index}"


@dataclass(frozen=True)
class FlexResult:
    """All sensors, what was detected on the way, and over which curvature their loops turn."""

    sensors: tuple[FlexFit, ...]
    verdict: Verdict
    model_curvature: Array
    readings: FlexReadings
    row_good: NDArray[np.bool_]
    deflection: Deflection
    loop_width: float

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        keep = (
            "side", "index", "scale_per_ohm", "scale_se", "sweep_se", "zero_ohm", "zero_se_ohm",
            "valid_direction", "noise", "lasting", "nonlinearity", "misfit", "hysteresis",
            "hysteresis_se", "used", "rejected", "healthy", "reason",
        )  # fmt: skip
        return {
            "sensors": [{key: getattr(fit, key) for key in keep} for fit in self.sensors],
            "rows": len(self.row_good),
            "rows_left_out": [int(i) for i in np.nonzero(~self.row_good)[0]],
            "deflection": self.deflection,
            "loop_width": self.loop_width,
            "verdict": self.verdict.as_data(),
        }

    def apply(self, config: RobotConfig) -> RobotConfig:
        """Scales, zeros, directions, noise and health into a copy of the configuration.

        A sensor found dead keeps its old constants and is marked unhealthy.
        """
        made = config.model_copy(deep=True)
        for fit in self.sensors:
            sensor = made.sensors.column(fit.side)[fit.index]
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
        return made


def fit_flex(
    readings: FlexReadings,
    config: RobotConfig,
    *,
    deflection: Deflection = "large",
    tip_se_cm: float = TIP_SE_CM,
) -> FlexResult:
    """Fit every sensor; see the module's text.

    Raises:
        DataError: sensors and columns disagree in number, or too few rows to judge anything.
    """
    sensors = [(side, k) for side in SIDES for k in range(len(config.sensors.column(side)))]
    if readings.ohm.shape[1] != len(sensors):
        raise DataError(
            f"{readings.ohm.shape[1]} resistances for {len(sensors)} sensors of the configuration",
            "use the robot.toml of this robot",
        )
    centers = np.array([config.sensors.column(s)[k].center_cm for s, k in sensors])
    spans = np.array([config.sensors.column(s)[k].span_cm for s, k in sensors])
    on_body = centers + spans / 2 <= readings.length_cm + 1e-6
    notes: list[str] = []
    model, model_se, good = model_rows(
        readings, config, centers, spans, deflection, tip_se_cm, notes
    )
    ohm = np.where((readings.ohm > _OHM_RANGE[0]) & (readings.ohm < _OHM_RANGE[1]),
                   readings.ohm, np.nan)  # fmt: skip
    usable = usable_readings(readings, sensors)
    if good.sum() < 5:
        raise DataError(
            f"{int(good.sum())} of {len(good)} rows can be used",
            "repeat the step; " + notes[0] if notes else "take at least ten places",
        )
    rows = usable & good[:, None] & on_body
    for column, (side, k) in enumerate(sensors):
        lost, values = dropouts(np.where(rows[:, column], ohm[:, column], np.nan), model[:, column])
        if values:
            ohm[lost, column] = np.nan
            share = lost.sum() / max(1, rows[:, column].sum())
            at = " and ".join(f"{value / 1000:.4g}" for value in values)
            notes.append(
                f"{side} {k} stands at {at} kOhm in {share:.0%} of its rows, however it is bent: "
                "those rows are left out; look for a loose wire"
            )
    block = readings.block
    sweep = sweeps_of(block, readings.kind, readings.active, model)
    turn = loop_turns(model, block)
    first = fit_each(ohm, model, model_se, turn, block, usable & good[:, None], on_body)
    sides = [side for side, _ in sensors]
    rows = usable & good[:, None]
    directions = directions_of(ohm, model, model_se, turn, block, rows, first, sides, sweep)
    usable &= (directions == 0) | (directions * model >= -1e-12)
    width = loop_width(ohm, model, model_se, block, usable & good[:, None], on_body)
    turn = loop_turns(model, block, width)
    first = fit_each(ohm, model, model_se, turn, block, usable & good[:, None], on_body)
    good = judge_rows(readings, ohm, model, turn, first, usable, good, on_body, notes)
    swapped = columns_swapped(readings, sensors, ohm, model, good, on_body)
    picked = usable & good[:, None] & on_body
    columns = [
        Column(
            np.where(picked[:, c], ohm[:, c], np.nan), model[:, c], model_se[:, c], turn[:, c],
            block, sweep,
        )
        for c in range(len(sensors))
    ]  # fmt: skip
    lines = honest_lines([(column, column.model[:, None]) for column in columns])
    curves = nonlinearities([
        column if made is None else column._replace(
            ohm=np.where(made.line.used, column.ohm, np.nan))
        for column, made in zip(columns, lines, strict=True)
    ])  # fmt: skip
    fits = []
    for c, (side, k) in enumerate(sensors):
        nominal = 1 / abs(config.sensors.column(side)[k].scale_per_ohm or 3.5e-5)
        fits.append(
            _sensor(side, k, columns[c].ohm, usable[:, c] & good, lines[c], curves[c],
                    bool(on_body[c]), as_direction(directions[c]), nominal)
        )  # fmt: skip
    verdict = _verdict(fits, notes, swapped, readings)
    return FlexResult(tuple(fits), verdict, model, readings, good, deflection, width)


def _sensor(
    side: Side,
    index: int,
    ohm: Array,
    rows: NDArray[np.bool_],
    made: OrderedFit | None,
    curve: tuple[float, float, float],
    on_body: bool,
    direction: Literal[-1, 0, 1],
    nominal: float,
) -> FlexFit:
    """Nonlinearity, hysteresis, noise and verdict of one sensor.

    `nominal` is the slope (ohm cm) that a sensor of this kind has.
    """

    def dead(reason: str, used: int = 0) -> FlexFit:
        no = float("nan")
        return FlexFit(
            side, index, 0.0, np.inf, no, no, no, 0, no, no, no, no, no, no, used, 0, False, reason
        )

    if not on_body:
        return dead("not everted at this length")
    seen = np.isfinite(ohm)
    if rows.sum() and seen.sum() < 0.5 * rows.sum():
        return dead("is open or shorted (most readings are out of range): check its wire")
    if made is None:
        return dead("has too few readings, or none that vary", int(seen.sum()))
    fit = made.line
    if not working(fit):
        if fit.se(1) > 0.1 * nominal:
            return dead("bends too little to tell its scale: take more places and bends")
        return dead("does not answer to bending: check its pouch and its wire",
                    int(fit.used.sum()))  # fmt: skip
    slope, zero = float(fit.coefficients[1]), float(fit.coefficients[0])
    scale = 1.0 / slope
    se = float(np.hypot(fit.se(1) / abs(slope), _CAMERA_SCALE_SE))
    inside = fit.used
    left = fit.residuals[inside]
    spread = float(np.sqrt(left @ left / max(1, inside.sum() - 3)))
    noise = max(spread * abs(scale), _LEAST_NOISE)
    bend, bend_se, misfit = curve
    curves = abs(bend) > 0.05 and abs(bend) > 4 * bend_se
    loop, loop_se = float(fit.coefficients[2] * scale), fit.se(2) * abs(scale)
    rejected = int((seen & ~inside).sum())
    reason = f"scale known to {100 * se:.1f} %"
    healthy = True
    if se > 0.1:
        healthy = False
        reason = f"has a scale known to {100 * se:.0f} % only: take more places and bends"
    elif curves:
        reason += f", but its answer curves by {100 * bend:.0f} % at full bend"
    return FlexFit(
        side, index, scale, se, made.sweep_gain, zero, fit.se(0), direction, noise, made.lasting,
        bend, misfit if curves else 0.0, loop, loop_se, int(inside.sum()), rejected, healthy,
        reason,
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
        return Verdict(
            False,
            "most tips stood on the other side than asked for: the camera's +y is not the robot's "
            "left; mend the cards' places in the sheet file, run `thigmo camera locate` and repeat",
            tuple(notes),
        )
    if swapped:
        return Verdict(
            False,
            "left and right are swapped: the side of the active muscle reads well and the other "
            "does not; exchange the sensor columns' plugs, or the muscles' tubes, and repeat",
            tuple(notes),
        )
    notes.extend(
        f"left out sensor {fit.name} (0 = at the base), which {fit.reason}; the robot does without "
        "it until flex is repeated"
        for fit in dead
    )
    if not any(readings.active):
        notes.append("without free bends it cannot be noticed if left and right are swapped")
    if len(dead) > len(everted) / 2:
        return Verdict(False, "more than half of the sensors fail; check wiring", tuple(notes))
    if not everted:
        return Verdict(False, "no sensor is everted; grow the robot first", tuple(notes))
    worst = max((fit for fit in everted if fit.healthy), key=lambda fit: fit.scale_se)
    good = worst.scale_se <= 0.05
    reason = (
        f"scales known to {100 * worst.scale_se:.1f} % or better ({worst.name} is the worst)"
        if good
        else f"the scale of {worst.name} is known to {100 * worst.scale_se:.0f} % only; "
        "add free bends or more places"
    )
    return Verdict(good, reason, tuple(notes))
