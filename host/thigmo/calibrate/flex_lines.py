"""A flex sensor's line: resistance over curvature, with its loop and the zero of each session.

A sensor lags behind bending by a loop of a few 1e-4 1/cm, and its zero changes with every eversion;
both are fitted along with zero and scale, or the scale would be off by a percent or two.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from thigmo.calibrate.regression import LinearFit, fit_linear
from thigmo.config import Side
from thigmo.errors import DataError

Array = NDArray[np.float64]

_ONE_WAY = 0.85  # a slope below this share of the other direction's does not count
_LOOP = 5e-4  # 1/cm, one sigma over sensors of the loop's half width and of a session's zero
_LOOP_WIDTHS = (2e-3, 5e-3, 1e-2)  # 1/cm


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
) -> NDArray[np.int64]:
    """(m,) bending direction that each sensor answers to; 0 = both alike.

    A line with a kink at zero gives the ratio of a sensor's slopes to the left and to the right.
    The sensors of a column are mounted alike, so they are asked together: where the weaker side's
    slope is surely below `_ONE_WAY` of the stronger's, only the stronger side counts. A sensor that
    surely differs from its column stands for itself.
    """
    ratio, spread = np.full(len(fits), np.nan), np.full(len(fits), np.inf)
    for column, both in enumerate(fits):
        pick = rows[:, column] & np.isfinite(ohm[:, column])
        k = model[:, column]
        enough = [int((pick & (sign * k > 1e-4)).sum()) >= 3 for sign in (1, -1)]
        if both is None or not all(enough):
            continue
        halves = np.column_stack([np.clip(k, 0, None), np.clip(k, None, 0)])
        part = np.where(pick, ohm[:, column], np.nan)
        split = _with_loop(part, halves, k, error[:, column], turn[:, column], block)
        if split is None:
            continue
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


def nonlinearity(
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
