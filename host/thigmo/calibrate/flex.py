"""Flex sensors: ohms to curvature, sensor by sensor (thesis, sections 2.3 and 3.1; improved).

Rows are of three kinds: `straight` (the robot at rest), `tip` (the tip pushed aside to a place
that the camera saw; the rod solver gives the curvature under each sensor, the thesis's small-
deflection formula (2.12) is an option), and `bend` (a free bend by one muscle: the camera gives
the one curvature that all sensors of the other side share). Ten tip places alone leave the distal
sensors uncertain, because there is little curvature near a pushed tip; free bends mend that.

Before any line is fitted the rows are judged together: a tip on the wrong side, a moved camera or
a lost marker disagree with all sensors at once, a dead sensor with all rows, an outlier with
neither. Each is named in the verdict and left out.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from thigmo.calibrate.regression import LinearFit, fit_linear
from thigmo.calibrate.table import Table, write_table
from thigmo.calibrate.verdict import Verdict
from thigmo.config import SIDES, RobotConfig, Side
from thigmo.errors import DataError
from thigmo.mechanics import push
from thigmo.mechanics.spans import phi

Array = NDArray[np.float64]
Deflection = Literal["large", "small"]
KINDS = ("straight", "tip", "bend")

_TIP_SE_CM = 0.08  # one sigma of a camera place across the robot
_CAMERA_SCALE_SE = 0.002  # what the camera's own scale may be off by, common to all rows
_OHM_RANGE = (1_000.0, 300_000.0)  # beyond: open or shorted
_ONE_WAY = 0.85  # a slope below this share of the other direction's does not count
_WRONG_SIDE = -0.3
_LOOP = 5e-4  # 1/cm, one sigma over sensors of the loop's half width and of a session's zero
_LOOP_WIDTHS = (2e-3, 5e-3, 1e-2)  # 1/cm


@dataclass(frozen=True)
class FlexReadings:
    """What was done and what was read.

    Attributes:
        kind: (n,) of "straight", "tip", "bend".
        t_s: (n,) time, in order.
        tip_cm: (n, 2) tip by camera; nan where the marker was not seen or there is none.
        curvature: (n,) of free bends, by camera, 1/cm; nan elsewhere.
        curvature_se: (n,) its one sigma.
        active: (n,) muscle in use: "left", "right" or "".
        ohm: (n, m) resistances, left base first.
        length_cm: everted length.
        intended_y_cm: (n,) where the operator was asked to put the tip (sign used); nan = free.
        block: (n,) session of each row: after an eversion the sensors' zeros are others.
    """

    kind: tuple[str, ...]
    t_s: Array
    tip_cm: Array
    curvature: Array
    curvature_se: Array
    active: tuple[str, ...]
    ohm: Array
    length_cm: float
    intended_y_cm: Array
    block: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def __post_init__(self) -> None:
        n = len(self.kind)
        if not len(self.block):
            object.__setattr__(self, "block", np.zeros(n, np.int64))
        shapes = {
            "t_s": self.t_s.shape == (n,),
            "tip_cm": self.tip_cm.shape == (n, 2),
            "curvature": self.curvature.shape == (n,),
            "curvature_se": self.curvature_se.shape == (n,),
            "active": len(self.active) == n,
            "ohm": self.ohm.ndim == 2 and len(self.ohm) == n,
            "intended_y_cm": self.intended_y_cm.shape == (n,),
            "block": self.block.shape == (n,),
        }
        for name, good in shapes.items():
            if not good:
                raise DataError(f"flex readings: {name} does not have {n} rows", "check the arrays")
        unknown = set(self.kind) - set(KINDS)
        if unknown:
            raise DataError(f"unknown kind '{unknown.pop()}'", f"use one of {', '.join(KINDS)}")

    @classmethod
    def read(cls, path: str | os.PathLike[str], config: RobotConfig) -> FlexReadings:
        """From a CSV: kind, tip_x_cm, tip_y_cm, curvature, ohm_left_0 .. ohm_right_N.

        Optional: t_s, curvature_se, active, length_cm, intended_y_cm, block.

        Raises:
            DataError: missing or malformed columns.
        """
        table = Table.read(path)
        ohm = np.hstack(
            [table.block(f"ohm_{side}_", len(config.sensors.column(side))) for side in SIDES]
        )
        length = table.numbers("length_cm", config.body.length_cm)
        if not np.isfinite(length).all() or np.ptp(length) > 1e-9:
            raise DataError(f"{path}: length_cm varies", "calibrate at one length")
        none = float("nan")
        return cls(
            tuple(table.words("kind")),
            np.nan_to_num(table.numbers("t_s")) if "t_s" in table
            else np.arange(table.rows, dtype=float),
            np.column_stack([table.numbers("tip_x_cm", none), table.numbers("tip_y_cm", none)]),
            table.numbers("curvature", none),
            table.numbers("curvature_se", 0.0),
            tuple(table.words("active", "")),
            ohm,
            float(length[0]),
            table.numbers("intended_y_cm", none),
            np.nan_to_num(table.numbers("block", 0.0)).astype(np.int64),
        )  # fmt: skip

    def write(self, path: str | os.PathLike[str], config: RobotConfig) -> None:
        """To a CSV that `read` takes."""
        columns: dict[str, Any] = {
            "kind": self.kind,
            "t_s": self.t_s.tolist(),
            "tip_x_cm": self.tip_cm[:, 0].tolist(),
            "tip_y_cm": self.tip_cm[:, 1].tolist(),
            "curvature": self.curvature.tolist(),
            "curvature_se": self.curvature_se.tolist(),
            "active": self.active,
            "length_cm": [self.length_cm] * len(self.kind),
            "intended_y_cm": self.intended_y_cm.tolist(),
            "block": self.block.tolist(),
        }
        column = 0
        for side in SIDES:
            for k in range(len(config.sensors.column(side))):
                columns[f"ohm_{side}_{k}"] = self.ohm[:, column].tolist()
                column += 1
        write_table(path, columns)


@dataclass(frozen=True)
class FlexFit:
    """One sensor's calibration.

    Attributes:
        side, index: which sensor.
        scale_per_ohm: 1/cm per ohm, sign included.
        scale_se: its standard error, relative.
        zero_ohm: resistance of the straight sensor.
        zero_se_ohm: its standard error.
        valid_direction: bending direction that it answers to; 0 = both.
        noise: one sigma of a reading, 1/cm.
        nonlinearity: departure from the line at the largest curvature seen, relative.
        hysteresis: half the gap between loading and unloading, 1/cm.
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
    zero_ohm: float
    zero_se_ohm: float
    valid_direction: Literal[-1, 0, 1]
    noise: float
    nonlinearity: float
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
    """All sensors, and what was detected on the way."""

    sensors: tuple[FlexFit, ...]
    verdict: Verdict
    model_curvature: Array
    readings: FlexReadings
    row_good: NDArray[np.bool_]
    deflection: Deflection

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        keep = (
            "side", "index", "scale_per_ohm", "scale_se", "zero_ohm", "zero_se_ohm",
            "valid_direction", "noise", "nonlinearity", "hysteresis", "hysteresis_se", "used",
            "rejected", "healthy", "reason",
        )  # fmt: skip
        return {
            "sensors": [{key: getattr(fit, key) for key in keep} for fit in self.sensors],
            "rows": len(self.row_good),
            "rows_left_out": [int(i) for i in np.nonzero(~self.row_good)[0]],
            "deflection": self.deflection,
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
            sensor.scale_se = fit.scale_se
            sensor.zero_ohm = fit.zero_ohm
            sensor.valid_direction = fit.valid_direction
            sensor.noise = fit.noise
        return made

    def figure(self, path: Path) -> None:
        """Resistance against curvature, one panel a sensor."""
        from thigmo.calibrate.figures import flex_figure

        flex_figure(self, path)


def tip_curvature(
    y_tip: float,
    x_tip: float,
    length_cm: float,
    centers: Array,
    spans: Array,
    deflection: Deflection = "large",
) -> Array:
    """Mean curvature (m,) under each sensor when the tip is pushed to y_tip.

    `large`: the rod is bent by a force normal to it at its tip until the tip stands at y_tip.
    `small`: F/EI = 3 y_tip / x_tip^3 and k = F/EI (x_tip - s) (thesis, (2.12) and (2.9)).

    Raises:
        DataError: a place that the tip cannot reach.
    """
    if deflection == "small":
        force = 3 * y_tip / x_tip**3
        return np.asarray(force * phi(x_tip, centers, spans), float)
    if abs(y_tip) >= 0.75 * length_cm:
        raise DataError(
            f"the tip cannot stand {y_tip:.1f} cm aside at {length_cm:.1f} cm of length",
            "check the camera and the length",
        )
    if y_tip == 0:
        return np.zeros(len(centers))

    def miss(force: float) -> float:
        return push(force, length_cm, free_curvature=0.0, length=length_cm).pose(length_cm)[
            1
        ] - abs(y_tip)

    first = 3 * abs(y_tip) / length_cm**3
    force = float(brentq(miss, 0.0, 4 * first + 1e-9, xtol=1e-12, rtol=1e-6))
    bent = push(force, length_cm, free_curvature=0.0, length=length_cm)
    return np.asarray(np.sign(y_tip) * bent.averages(centers, spans), float)


def fit_flex(
    readings: FlexReadings,
    config: RobotConfig,
    *,
    deflection: Deflection = "large",
    tip_se_cm: float = _TIP_SE_CM,
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
    model, model_se, good = _model_rows(
        readings, config, centers, spans, deflection, tip_se_cm, notes
    )
    ohm = np.where((readings.ohm > _OHM_RANGE[0]) & (readings.ohm < _OHM_RANGE[1]),
                   readings.ohm, np.nan)  # fmt: skip
    usable = _usable(readings, sensors)
    if good.sum() < 5:
        raise DataError(
            f"{int(good.sum())} of {len(good)} rows can be used",
            "repeat the step; " + notes[0] if notes else "take at least ten places",
        )
    block = readings.block
    width = _loop_width(ohm, model, model_se, block, usable & good[:, None], on_body)
    turn = _turns(model, block, width)
    first = _each(ohm, model, model_se, turn, block, usable & good[:, None], on_body)
    directions = _directions(ohm, model, model_se, turn, block, usable & good[:, None], first)
    usable &= (directions == 0) | (directions * model >= -1e-12)
    first = _each(ohm, model, model_se, turn, block, usable & good[:, None], on_body)
    good = _judge_rows(readings, ohm, model, first, usable, good, on_body, notes)
    final = _each(ohm, model, model_se, turn, block, usable & good[:, None], on_body)
    swapped = _swapped(readings, sensors, ohm, model, good, on_body)
    fits = []
    for column, (side, k) in enumerate(sensors):
        rows = usable[:, column] & good
        fits.append(
            _sensor(side, k, ohm[:, column], model[:, column], model_se[:, column], rows,
                    final[column], bool(on_body[column]), _way(directions[column]),
                    1 / abs(config.sensors.column(side)[k].scale_per_ohm or 3.5e-5))
        )  # fmt: skip
    verdict = _verdict(fits, notes, swapped)
    return FlexResult(tuple(fits), verdict, model, readings, good, deflection)


def _model_rows(
    readings: FlexReadings,
    config: RobotConfig,
    centers: Array,
    spans: Array,
    deflection: Deflection,
    tip_se_cm: float,
    notes: list[str],
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Curvature (n, m) that each row should show, its standard error, and which rows have one."""
    n = len(readings.kind)
    model = np.full((n, len(centers)), np.nan)
    error = np.zeros((n, len(centers)))
    length = readings.length_cm
    lost, wrong, folded = [], [], []
    # The straight robot, as the camera sees it, is y = 0.
    straight = np.array([k == "straight" for k in readings.kind])
    aside = readings.tip_cm[straight, 1]
    aside = aside[np.isfinite(aside)]
    ahead = float(np.median(aside)) if len(aside) else 0.0
    if abs(ahead) > 2.0:
        notes.append(
            f"the straight robot's tip stands {ahead:+.1f} cm aside: lay the robot straight, or "
            "measure the cards' places again"
        )
    # The fold at the base: F L = critical moment, y = F L^3 / 3.
    reach = config.body.critical_curvature * length**2 / 3 if deflection == "large" else np.inf
    for row, kind in enumerate(readings.kind):
        x, y = readings.tip_cm[row] - np.array([0.0, ahead])
        if kind == "straight":
            model[row] = 0.0
        elif kind == "bend":
            model[row] = readings.curvature[row]
            error[row] = readings.curvature_se[row]
            if not np.isfinite(readings.curvature[row]):
                lost.append(row)
        elif not (np.isfinite(y) and (np.isfinite(x) or deflection == "large")):
            lost.append(row)
        else:
            asked = readings.intended_y_cm[row]
            if np.isfinite(asked) and asked * y < 0 and min(abs(asked), abs(y)) > 3 * tip_se_cm:
                wrong.append(row)
                continue
            if abs(y) > 1.02 * reach:
                folded.append(row)
                continue
            model[row] = tip_curvature(y, x, length, centers, spans, deflection)
            per_cm = phi(length, centers, spans) * 3 / length**3
            error[row] = per_cm * tip_se_cm
    _note(notes, lost, "the camera lost the marker or the body")
    _note(notes, wrong, "the tip stood on the other side than asked for")
    _note(notes, folded, "the tip was pushed so far that the base folds")
    return model, error, np.isfinite(model).all(axis=1)


def _note(notes: list[str], rows: list[int], what: str) -> None:
    if rows:
        listed = ", ".join(str(row + 1) for row in rows[:8]) + (" ..." if len(rows) > 8 else "")
        notes.append(f"{len(rows)} row(s) left out, {what}: {listed}")


def _usable(readings: FlexReadings, sensors: list[tuple[Side, int]]) -> NDArray[np.bool_]:
    """(n, m): in a free bend only the side opposite to the active muscle reads well."""
    return np.array([[side != active for side, _ in sensors] for active in readings.active])


def _turns(model: Array, block: NDArray[np.int64], width: float) -> Array:
    """(n, m) where each sensor is in its loop: 1 after long bending to the left, -1 to the right.

    It turns over within `width` of curvature (Dahl's model of friction), and starts between the
    two in every session.
    """
    turn = np.zeros(model.shape)
    state, before = np.zeros(model.shape[1]), np.zeros(model.shape[1])
    for row, k in enumerate(model):
        if row and block[row] != block[row - 1]:
            state[:], before[:] = 0.0, 0.0
        if np.isfinite(k).all():
            way = np.sign(k - before)
            state = np.where(
                way == 0, state, way + (state - way) * np.exp(-abs(k - before) / width)
            )
            before = k
        turn[row] = state
    return turn


def _each(
    ohm: Array,
    model: Array,
    error: Array,
    turn: Array,
    block: NDArray[np.int64],
    rows: NDArray[np.bool_],
    on_body: NDArray[np.bool_],
) -> list[LinearFit | None]:
    """A robust line for each sensor; None where it cannot be had."""
    fits: list[LinearFit | None] = []
    for column in range(ohm.shape[1]):
        pick = rows[:, column] & np.isfinite(ohm[:, column])
        if not on_body[column] or pick.sum() < 6:
            fits.append(None)
            continue
        part = np.where(pick, ohm[:, column], np.nan)
        fits.append(_line(part, model[:, column], error[:, column], turn[:, column], block))
    return fits


def _line(
    ohm: Array, model: Array, error: Array, turn: Array, block: NDArray[np.int64]
) -> LinearFit | None:
    """R = R0 + b (k + h turn + z of the session): zero, slope, b h of the loop, and the rest.

    The loop's half width h and the sessions' zeros z are small beforehand (`_LOOP`): one row more
    for each says so, which matters where a sensor was only ever read while bending grew.
    """
    return _with_loop(ohm, model[:, None], model, error, turn, block)


def _with_loop(
    ohm: Array, slopes: Array, model: Array, error: Array, turn: Array, block: NDArray[np.int64]
) -> LinearFit | None:
    """Fit of a zero, the columns of `slopes` (n, q), the loop and the sessions' zeros."""
    n, q = slopes.shape
    later = [(block == session).astype(float) for session in sorted(set(block.tolist()))[1:]]
    design = np.column_stack([np.ones(n), slopes, turn, *later])
    extra = design.shape[1] - 1 - q
    prior = np.hstack([np.zeros((extra, 1 + q)), np.eye(extra)])
    try:
        plain = fit_linear(np.column_stack([np.ones(n), model]), ohm)
        slope = abs(float(plain.coefficients[1]))
        # Errors of the abscissa are carried over by the slope.
        fit = fit_linear(
            np.vstack([design, prior]),
            np.append(ohm, np.zeros(extra)),
            np.append(slope * error, np.full(extra, slope * _LOOP)),
        )
    except DataError:
        return None
    return replace(fit, used=fit.used[:n], residuals=fit.residuals[:n])


def _loop_width(
    ohm: Array,
    model: Array,
    error: Array,
    block: NDArray[np.int64],
    rows: NDArray[np.bool_],
    on_body: NDArray[np.bool_],
) -> float:
    """The curvature over which the sensors' loops turn over, of a few, by the least scatter."""
    scores = []
    for width in _LOOP_WIDTHS:
        fits = _each(ohm, model, error, _turns(model, block, width), block, rows, on_body)
        scores.append(
            sum(np.log(max(f.sigma, 1e-9)) for f in fits if _working(f) and f is not None)
        )
    return _LOOP_WIDTHS[int(np.argmin(scores))]


def _working(fit: LinearFit | None) -> bool:
    return fit is not None and abs(fit.coefficients[1]) > 5 * fit.se(1)


def _judge_rows(
    readings: FlexReadings,
    ohm: Array,
    model: Array,
    fits: list[LinearFit | None],
    usable: NDArray[np.bool_],
    good: NDArray[np.bool_],
    on_body: NDArray[np.bool_],
    notes: list[str],
) -> NDArray[np.bool_]:
    """Rows on which the sensors agree among themselves but not with the camera.

    For each row the factor `share` by which the curvature seen by the sensors differs from the
    camera's is their weighted median. Alone and near -1: the tip stood on the other side. From
    some row on: the camera (or the base) has moved. Alone otherwise: the place is wrong.
    """
    live = [c for c in range(len(fits)) if _working(fits[c])]
    n = len(good)
    share, scatter = np.full(n, np.nan), np.full(n, np.nan)
    offset = np.full(n, np.nan)
    for row in np.nonzero(good)[0]:
        columns = [c for c in live if usable[row, c] and np.isfinite(ohm[row, c])]
        if len(columns) < 3:
            continue
        lines = [fits[c] for c in columns]
        seen = np.array(
            [(ohm[row, c] - f.coefficients[0]) / f.coefficients[1]
             for c, f in zip(columns, lines, strict=True) if f is not None]
        )  # fmt: skip
        noise = np.array([f.sigma / abs(f.coefficients[1]) for f in lines if f is not None])
        noise = np.maximum(noise, 1e-6)
        should = model[row, columns]
        size = float(np.abs(should).max())
        if size > 3 * float(np.median(noise)):
            ratios, weights = seen / should, np.abs(should) / noise
            share[row] = _weighted_median(ratios, weights)
            scatter[row] = 1.25 / np.sqrt(float((weights**2).sum()))
            offset[row] = share[row] - 1
    wrong_side = [
        int(r) for r in np.nonzero(share < _WRONG_SIDE)[0] if share[r] + 3 * scatter[r] < 0
    ]
    _note(notes, wrong_side, "the sensors say that the robot was bent to the other side")
    kept = good.copy()
    kept[wrong_side] = False
    tips = np.array([k == "tip" for k in readings.kind])
    moved = _moved(readings, ohm, model, fits, usable & kept[:, None], tips & kept, live)
    if moved is not None:
        since, shift = moved
        kept[since:] &= ~tips[since:]
        notes.append(
            f"the camera or the base moved by about {abs(shift):.1f} cm before row {since + 1}: "
            "that row and all later tip places left out"
        )
    rows = np.nonzero(kept & np.isfinite(offset) & tips)[0]
    miss_cm = offset[rows] * readings.tip_cm[rows, 1]
    miss_se = np.hypot(scatter[rows] * np.abs(readings.tip_cm[rows, 1]), _TIP_SE_CM)
    if len(rows) >= 4:
        middle = float(np.median(miss_cm))
        odd = [
            int(r)
            for r, m, e in zip(rows, miss_cm, miss_se, strict=True)
            if abs(m - middle) > max(4.5 * e, 0.5)
        ]
        if odd and len(odd) <= 0.35 * len(rows):
            _note(notes, odd, "the sensors agree that the tip stood elsewhere")
            kept[odd] = False
    return kept


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


def _moved(
    readings: FlexReadings,
    ohm: Array,
    model: Array,
    fits: list[LinearFit | None],
    usable: NDArray[np.bool_],
    tips: NDArray[np.bool_],
    live: list[int],
) -> tuple[int, float] | None:
    """Row from which the tip's places are shifted sideways (cm) for all sensors; None = none.

    For each possible row, each sensor's line gets a step in the pattern that a shifted place
    leaves; the sensors must agree on its size.
    """
    places = np.nonzero(tips)[0]
    best: tuple[float, int, float] | None = None
    for first in places[3:-2].tolist():
        late = tips & (np.arange(len(tips)) >= first)
        shifts, errors = [], []
        for column in live:
            fit = fits[column]
            rows = usable[:, column] & np.isfinite(ohm[:, column])
            if fit is None or rows.sum() < 8:
                continue
            calm = np.abs(fit.residuals) < 8 * max(fit.sigma, 1e-9)
            rows &= np.nan_to_num(calm, nan=0.0).astype(bool)
            # Curvature at this sensor for each cm that the tip stands aside.
            size = np.abs(readings.tip_cm[:, 1])
            pattern = np.where(
                late & (size > 0.5), np.abs(model[:, column]) / np.maximum(size, 0.5), 0.0
            )
            if np.ptp(pattern[rows]) == 0:
                continue
            design = np.column_stack([np.ones(len(rows)), model[:, column], pattern])[rows]
            line, _, rank, _ = np.linalg.lstsq(design, ohm[rows, column], rcond=None)
            if rank < 3:
                continue
            rest = ohm[rows, column] - design @ line
            variance = float(rest @ rest) / max(1, int(rows.sum()) - 3)
            covariance = np.linalg.inv(design.T @ design) * variance
            shifts.append(line[2] / line[1])
            errors.append(float(np.sqrt(covariance[2, 2])) / abs(line[1]))
        if len(shifts) < 3:
            continue
        weights = 1 / np.square(errors)
        shift = float((weights * shifts).sum() / weights.sum())
        certainty = abs(shift) * float(np.sqrt(weights.sum()))
        agree = float((weights * (np.array(shifts) - shift) ** 2).sum()) / len(shifts) < 6
        if abs(shift) > 0.4 and certainty > 6 and agree and (best is None or certainty > best[0]):
            best = (certainty, first, shift)
    return None if best is None else (best[1], best[2])


def _swapped(
    readings: FlexReadings,
    sensors: list[tuple[Side, int]],
    ohm: Array,
    model: Array,
    good: NDArray[np.bool_],
    on_body: NDArray[np.bool_],
) -> bool:
    """Whether the columns of sensors are exchanged.

    In a free bend the side of the active muscle wrinkles. If instead the other side's readings
    scatter about their lines far more than the active side's, left and right are swapped.
    """
    ratios: list[float] = []
    for side in SIDES:
        rows = good & np.array([a == side for a in readings.active])
        spread = {}
        for which in SIDES:
            values = []
            for column, (of, _) in enumerate(sensors):
                if of != which or not on_body[column] or rows.sum() < 6:
                    continue
                design = np.column_stack([np.ones(len(good)), model[:, column]])
                try:
                    fit = fit_linear(design, np.where(rows, ohm[:, column], np.nan))
                except DataError:
                    continue
                reach = np.ptp(model[rows, column])
                steep = abs(float(fit.coefficients[1])) * reach
                scatter = float(np.sqrt(np.nanmean(fit.residuals**2)))
                values.append(scatter / max(steep, 1e-9))
            spread[which] = float(np.median(values)) if values else np.nan
        other: Side = "right" if side == "left" else "left"
        ratios.append(spread[other] / max(spread[side], 1e-9))
    known = [r for r in ratios if np.isfinite(r)]
    return len(known) > 0 and min(known) > 3.0


def _sensor(
    side: Side,
    index: int,
    ohm: Array,
    model: Array,
    error: Array,
    rows: NDArray[np.bool_],
    fit: LinearFit | None,
    on_body: bool,
    direction: Literal[-1, 0, 1],
    nominal: float,
) -> FlexFit:
    """Nonlinearity, hysteresis, noise and verdict of one sensor.

    `nominal` is the slope (ohm cm) that a sensor of this kind has.
    """

    def dead(reason: str, used: int = 0) -> FlexFit:
        no = float("nan")
        return FlexFit(side, index, 0.0, np.inf, no, no, 0, no, no, no, no, used, 0, False, reason)

    if not on_body:
        return dead("not everted at this length")
    seen = rows & np.isfinite(ohm)
    if rows.sum() and seen.sum() < 0.5 * rows.sum():
        return dead("open or shorted: most readings are out of range")
    if fit is None:
        return dead("too few readings, or none that vary", int(seen.sum()))
    if not _working(fit):
        if fit.se(1) > 0.1 * nominal:
            return dead("bends too little to tell its scale: take more places and bends")
        return dead("does not answer to bending", int(fit.used.sum()))
    slope, zero = float(fit.coefficients[1]), float(fit.coefficients[0])
    scale = 1.0 / slope
    se = float(np.hypot(fit.se(1) / abs(slope), _CAMERA_SCALE_SE))
    inside = fit.used
    noise = fit.sigma * abs(scale)
    bend, bend_se = _curving(ohm, model, error, inside, fit)
    loop, loop_se = abs(float(fit.coefficients[2] * scale)), fit.se(2) * abs(scale)
    rejected = int((rows & np.isfinite(ohm) & ~inside).sum())
    reason = f"scale known to {100 * se:.1f} %"
    healthy = True
    if se > 0.1:
        healthy, reason = False, f"scale known to {100 * se:.0f} % only: take more places and bends"
    elif abs(bend) > 0.05 and abs(bend) > 4 * bend_se:
        reason += f", but its answer curves by {100 * bend:.0f} % at full bend"
    return FlexFit(
        side, index, scale, se, zero, fit.se(0), direction, noise, bend,
        loop, loop_se, int(inside.sum()), rejected, healthy, reason,
    )  # fmt: skip


def _directions(
    ohm: Array,
    model: Array,
    error: Array,
    turn: Array,
    block: NDArray[np.int64],
    rows: NDArray[np.bool_],
    fits: list[LinearFit | None],
) -> NDArray[np.int64]:
    """(m,) bending direction that each sensor answers to; 0 = both alike.

    One line with a kink at zero: where the weaker side's slope is surely below `_ONE_WAY` of the
    stronger's, only the stronger side counts.
    """
    found, told = np.zeros(len(fits), np.int64), np.zeros(len(fits), np.bool_)
    for column, both in enumerate(fits):
        pick = rows[:, column] & np.isfinite(ohm[:, column])
        k = model[:, column]
        enough = [int((pick & (sign * k > 1e-4)).sum()) >= 4 for sign in (1, -1)]
        if both is None or not all(enough):
            continue
        sides = np.column_stack([np.clip(k, 0, None), np.clip(k, None, 0)])
        part = np.where(pick, ohm[:, column], np.nan)
        split = _with_loop(part, sides, k, error[:, column], turn[:, column], block)
        if split is None:
            continue
        slopes = split.coefficients[1:3]
        strong = int(np.argmax(np.abs(slopes)))
        if abs(slopes[strong]) < 5 * split.se(1 + strong):
            continue
        ratio = slopes[1 - strong] / slopes[strong]
        ratio_se = np.hypot(split.se(2 - strong), ratio * split.se(1 + strong))
        spread = 4 * float(ratio_se) / abs(slopes[strong])
        if ratio + spread < _ONE_WAY:
            found[column] = 1 if strong == 0 else -1
        told[column] = ratio + spread < _ONE_WAY or ratio - spread > _ONE_WAY - 0.35
    # Where a sensor is bent too little to tell, it is like the others of its column.
    half = len(fits) // 2
    for part in (slice(0, half), slice(half, None)):
        known = found[part][told[part]]
        if len(known) > 0.5 * len(found[part]) and (known == known[0]).all():
            found[part] = known[0]
    return found


def _way(direction: np.int64) -> Literal[-1, 0, 1]:
    return 0 if direction == 0 else (1 if direction > 0 else -1)


def _curving(
    ohm: Array, model: Array, error: Array, inside: NDArray[np.bool_], fit: LinearFit
) -> tuple[float, float]:
    """Share by which a quadratic departs from the line at the largest bend, and its error."""
    largest = float(np.abs(model[inside]).max())
    unit = model / largest
    design = np.column_stack([np.ones(len(ohm)), unit, np.abs(unit) * unit])
    known = np.abs(fit.coefficients[1]) * error
    try:
        curved = fit_linear(design, np.where(inside, ohm, np.nan), known, reject=False)
    except DataError:
        return 0.0, 0.0
    total = float(curved.coefficients[1] + curved.coefficients[2])
    return float(curved.coefficients[2]) / total, curved.se(2) / abs(total)


def _verdict(fits: list[FlexFit], notes: list[str], swapped: bool) -> Verdict:
    everted = [fit for fit in fits if fit.reason != "not everted at this length"]
    dead = [fit for fit in everted if not fit.healthy]
    notes.extend(f"sensor {fit.name} {fit.reason}; it is marked unhealthy" for fit in dead)
    dropped = sum(fit.rejected for fit in everted)
    total = sum(fit.used + fit.rejected for fit in everted)
    if dropped:
        notes.append(f"{dropped} of {total} single readings left out as outliers")
    if swapped:
        return Verdict(
            False,
            "left and right are swapped: the side of the active muscle reads well and the other "
            "does not; exchange the sensor columns' plugs, or the muscles' tubes, and repeat",
            tuple(notes),
        )
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


def merge(first: FlexReadings, second: FlexReadings) -> FlexReadings:
    """Rows of two recordings at the same length, the second after the first."""
    if abs(first.length_cm - second.length_cm) > 0.1:
        raise DataError("the recordings are of different lengths", "calibrate at one length")
    later = float(first.t_s.max(initial=0.0)) + 1.0 - float(second.t_s.min(initial=0.0))
    return replace(
        first,
        kind=first.kind + second.kind,
        t_s=np.concatenate([first.t_s, second.t_s + later]),
        tip_cm=np.vstack([first.tip_cm, second.tip_cm]),
        curvature=np.concatenate([first.curvature, second.curvature]),
        curvature_se=np.concatenate([first.curvature_se, second.curvature_se]),
        active=first.active + second.active,
        ohm=np.vstack([first.ohm, second.ohm]),
        intended_y_cm=np.concatenate([first.intended_y_cm, second.intended_y_cm]),
        block=np.concatenate([first.block, second.block + first.block.max(initial=0) + 1]),
    )
