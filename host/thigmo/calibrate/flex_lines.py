"""A flex sensor's line: resistance over curvature, with its loop and the zero of each session.

A sensor lags behind bending by a loop of a few 1e-4 1/cm, and its zero changes with every eversion;
both are fitted along with zero and scale, or the scale would be off by a percent or two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.calibrate.correlation import Candidates, OrderedFit, candidates, mixed
from thigmo.calibrate.regression import LinearFit, fit_linear
from thigmo.config import Side
from thigmo.errors import DataError

Array = NDArray[np.float64]

_ONE_WAY = 0.85  # a slope below this share of the other direction's does not count
_LOOP = 5e-4  # 1/cm, one sigma over sensors of the loop's half width and of a session's zero
_LOOP_WIDTHS = (2e-3, 5e-3, 1e-2)  # 1/cm
# Drop-outs: readings within this share of the range are the same value; this share of rows is many.
_ALIKE, _MANY = 2e-3, 0.03


def loop_turns(model: Array, block: NDArray[np.int64], width: float = _LOOP_WIDTHS[1]) -> Array:
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
            before = k.copy()
        turn[row] = state
    return turn


def loop_width(
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
        fits = fit_each(ohm, model, error, loop_turns(model, block, width), block, rows, on_body)
        scores.append(sum(np.log(max(f.sigma, 1e-9)) for f in fits if working(f) and f is not None))
    return _LOOP_WIDTHS[int(np.argmin(scores))]


def fit_each(
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
        fits.append(fit_line(part, model[:, column], error[:, column], turn[:, column], block))
    return fits


def fit_line(
    ohm: Array, model: Array, error: Array, turn: Array, block: NDArray[np.int64]
) -> LinearFit | None:
    """R = R0 + b (k + h turn + z of the session): zero, slope, b h of the loop, and the rest.

    The loop's half width h and the sessions' zeros z are small beforehand (`_LOOP`): one row more
    for each says so, which matters where a sensor was only ever read while bending grew.
    """
    return _with_loop(ohm, model[:, None], model, error, turn, block)


class Column(NamedTuple):
    """One sensor's rows, (n,) each: readings (nan where left out), and what they are fitted by."""

    ohm: Array
    model: Array
    error: Array
    turn: Array
    block: NDArray[np.int64]
    sweep: NDArray[np.int64]


def honest_lines(columns: Sequence[tuple[Column, Array]]) -> list[OrderedFit | None]:
    """As `fit_line`, sensor by sensor, with errors that hold from sweep to sweep.

    Args:
        columns: rows of each sensor, and (n, q) what its answer is made of.

    Returns:
        None for a sensor whose line cannot be had.
    """
    return mixed([_candidates(column, slopes) for column, slopes in columns])


def _candidates(column: Column, slopes: Array) -> Candidates | None:
    ohm, model, error, turn, block, sweep = column
    if np.isfinite(ohm).sum() < 6:
        return None
    fit = _with_loop(ohm, slopes, model, error, turn, block)
    if fit is None:
        return None
    design = _design(slopes, turn, block)
    slope = abs(float(fit.coefficients[1]))
    prior = np.full(design.shape[1], slope * _LOOP)
    prior[: 1 + slopes.shape[1]] = np.inf
    return candidates(fit, design, ohm, slope * error, block, sweep, slope * model, prior)


def _design(slopes: Array, turn: Array, block: NDArray[np.int64]) -> Array:
    """Columns of the line: zero, slopes, loop, and each later session's zero."""
    later = [(block == session).astype(float) for session in sorted(set(block.tolist()))[1:]]
    return np.column_stack([np.ones(len(turn)), slopes, turn, *later])


def _with_loop(
    ohm: Array, slopes: Array, model: Array, error: Array, turn: Array, block: NDArray[np.int64]
) -> LinearFit | None:
    """Fit of a zero, the columns of `slopes` (n, q), the loop and the sessions' zeros."""
    n, q = slopes.shape
    design = _design(slopes, turn, block)
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
            firm=extra,
        )
    except DataError:
        return None
    return replace(fit, used=fit.used[:n], residuals=fit.residuals[:n])


def sweeps_of(
    block: NDArray[np.int64], kind: Sequence[str], active: Sequence[str], model: Array
) -> NDArray[np.int64]:
    """(n,) number of each row's sweep: one bend out and back, by one muscle, in one session."""
    size = np.nan_to_num(np.abs(model).max(axis=1))
    low, high = 0.1 * size.max(initial=0.0), 0.5 * size.max(initial=0.0)
    found, out = np.zeros(len(kind), np.int64), False
    for row in range(1, len(kind)):
        out |= bool(size[row - 1] >= high)
        same = all(column[row] == column[row - 1] for column in (block, kind, active))
        back = out and kind[row] == "bend" and size[row] <= low
        found[row] = found[row - 1] + (back or not same)
        out &= found[row] == found[row - 1]
    return found


def dropouts(ohm: Array, model: Array) -> tuple[NDArray[np.bool_], list[float]]:
    """Rows at which a sensor stands at one value while its neighbours in bending do not, and where.

    A loose wire reads a plausible constant, and often enough to carry a line with it: no robust fit
    can tell a third of the rows from the rest, but no sensor gives one value for many bends.

    Args:
        ohm: (n,) readings; nan where there is none.
        model: (n,) curvature.
    """
    lost = np.zeros(len(ohm), bool)
    values: list[float] = []
    while True:
        rows = np.flatnonzero(np.isfinite(ohm) & np.isfinite(model) & ~lost)
        if len(rows) < 8:
            return lost, values
        rows = rows[np.argsort(ohm[rows])]
        sorted_ohm, reach = ohm[rows], float(np.ptp(model[rows]))
        spread = float(np.ptp(np.quantile(sorted_ohm, [0.05, 0.95])))
        until = np.searchsorted(sorted_ohm, sorted_ohm + _ALIKE * spread, side="right")
        first = int(np.argmax(until - np.arange(len(rows))))
        same = rows[first : until[first]]
        low, high = np.quantile(model[same], [0.1, 0.9])
        between = rows[(model[rows] >= low) & (model[rows] <= high) & ~np.isin(rows, same)]
        if len(same) < max(4, _MANY * len(rows)) or high - low < 0.25 * reach or not len(between):
            return lost, values
        if np.median(np.abs(ohm[between] - np.median(ohm[same]))) < 0.05 * spread:
            return lost, values
        lost[same] = True
        values.append(float(np.median(ohm[same])))


def working(fit: LinearFit | None) -> bool:
    """Whether a sensor's slope stands clear of zero."""
    return fit is not None and abs(fit.coefficients[1]) > 5 * fit.se(1)


def directions_of(
    ohm: Array,
    model: Array,
    error: Array,
    turn: Array,
    block: NDArray[np.int64],
    rows: NDArray[np.bool_],
    fits: list[LinearFit | None],
    sides: list[Side],
    sweep: NDArray[np.int64],
) -> NDArray[np.int64]:
    """(m,) bending direction that each sensor answers to; 0 = both alike.

    A line with a kink at zero gives the ratio of a sensor's slopes to the left and to the right.
    The sensors of a column are mounted alike, so they are asked together: where the weaker side's
    slope is surely below `_ONE_WAY` of the stronger's, only the stronger side counts. A sensor that
    surely differs from its column stands for itself.
    """
    ratio, spread = np.full(len(fits), np.nan), np.full(len(fits), np.inf)
    asked: list[tuple[int, tuple[Column, Array]]] = []
    for column, both in enumerate(fits):
        pick = rows[:, column] & np.isfinite(ohm[:, column])
        k = model[:, column]
        # A side that was hardly bent tells nothing.
        bent = 0.1 * float(np.abs(k[pick]).max(initial=1e-3))
        enough = [int((pick & (sign * k > bent)).sum()) >= 3 for sign in (1, -1)]
        if both is None or not all(enough):
            continue
        halves = np.column_stack([np.clip(k, 0, None), np.clip(k, None, 0)])
        rows_of = Column(
            np.where(pick, ohm[:, column], np.nan), k, error[:, column], turn[:, column], block,
            sweep,
        )  # fmt: skip
        asked.append((column, (rows_of, halves)))
    made = honest_lines([one for _, one in asked])
    for (column, _), fit in zip(asked, made, strict=True):
        if fit is None:
            continue
        split = fit.line
        left, right = (float(v) for v in split.coefficients[1:3])
        strong = max(abs(left), abs(right))
        # A slope that is lost in noise, or of the wrong sign, counts as a tenth of the other.
        sizes = [max(v * np.sign(left + right), 0.1 * strong) for v in (left, right)]
        ratio[column] = np.log(sizes[0] / sizes[1])
        spread[column] = np.hypot(split.se(1) / sizes[0], split.se(2) / sizes[1])
    found = np.zeros(len(fits), np.int64)
    limit = -np.log(_ONE_WAY)
    for side in sorted(set(sides)):
        known = np.array([s == side for s in sides]) & np.isfinite(ratio)
        if not known.any():
            continue
        weights = 1 / np.maximum(spread[known], 0.02) ** 2
        pooled = float((weights * ratio[known]).sum() / weights.sum())
        scatter = float((weights * (ratio[known] - pooled) ** 2).sum()) / max(1, known.sum() - 1)
        column_se = float(np.sqrt(max(1.0, scatter) / weights.sum()))
        alike = np.array([s == side for s in sides])
        if abs(pooled) - 4 * column_se > limit:
            apart = (np.abs(ratio - pooled) > 5 * spread) & (np.abs(ratio) + 2 * spread < limit)
            found[alike & ~apart] = 1 if pooled > 0 else -1
        alone = alike & (np.abs(ratio) - 4 * spread > limit)
        found[alone] = np.sign(ratio[alone]).astype(np.int64)
    return found


def as_direction(direction: np.int64) -> Literal[-1, 0, 1]:
    """A direction as the configuration has it."""
    return 0 if direction == 0 else (1 if direction > 0 else -1)


def nonlinearities(columns: Sequence[Column]) -> list[tuple[float, float, float]]:
    """How far each sensor's quadratic departs from the line.

    Returns:
        Share of the answer at the largest bend that goes beyond a straight line, its standard
        error, and the rows' departure from a line through them (rms, relative).
    """
    slopes = []
    for column in columns:
        size = np.abs(np.where(np.isfinite(column.ohm), column.model, 0.0))
        largest = max(float(np.nan_to_num(size).max(initial=0.0)), 1e-9)
        slopes.append(
            np.column_stack([column.model, np.abs(column.model) * column.model / largest])
        )
    found = []
    for column, bends, made in zip(
        columns, slopes, honest_lines(list(zip(columns, slopes, strict=True))), strict=True
    ):
        if made is None:
            found.append((0.0, 0.0, 0.0))
            continue
        total = float(made.line.coefficients[1:3].sum())
        seen = np.isfinite(column.ohm)
        k, answer = column.model[seen], bends[seen] @ made.line.coefficients[1:3]
        line = np.polynomial.Polynomial.fit(k, answer, 1)
        departure = float(np.std(answer - line(k))) / max(float(np.std(answer)), 1e-300)
        found.append(
            (float(made.line.coefficients[2]) / total, made.line.se(2) / abs(total), departure)
        )
    return found
