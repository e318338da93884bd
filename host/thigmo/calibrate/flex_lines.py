"""A flex sensor's line: resistance over curvature, with its loop and the zero of each session.

A sensor lags behind bending by a loop of a few 1e-4 1/cm, and its zero changes with every eversion;
both are fitted along with zero and scale, or the scale would be off by a percent or two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.calibrate.correlation import Candidates, OrderedFit, candidates, mixed
from thigmo.calibrate.regression import LinearFit, fit_linear
from thigmo.config import SIDES, Side
from thigmo.errors import DataError

Array = NDArray[np.float64]

_ONE_WAY = 0.85  # a slope below this share of the other direction's does not count
_LOOP = 5e-4  # 1/cm, one sigma over sensors of the loop's half width and of a session's zero
LOOP_WIDTHS = (2e-3, 5e-3, 1e-2)  # 1/cm
# Drop-outs: readings within this share of the range are the same value; this share of rows is many.
_ALIKE, _MANY = 2e-3, 0.03


def loop_turns(model: Array, block: NDArray[np.int64], width: float = LOOP_WIDTHS[1]) -> Array:
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


class Column(NamedTuple):
    """One sensor's rows, (n,) each: readings (nan where left out), and what they are fitted by."""

    ohm: Array
    model: Array
    error: Array
    turn: Array
    block: NDArray[np.int64]
    sweep: NDArray[np.int64]

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(n,) whether there is a reading."""
        return np.isfinite(self.ohm)

    def design(self, slopes: Array) -> Array:
        """Columns of the line: zero, slopes (n, q), loop, and each later session's zero."""
        later = [(self.block == session).astype(float) for session in np.unique(self.block)[1:]]
        return np.column_stack([np.ones(len(self.turn)), slopes, self.turn, *later])


def fit_line(column: Column, slopes: Array | None = None) -> LinearFit | None:
    """R = R0 + b (k + h turn + z of the session): zero, slope, b h of the loop, and the rest.

    The loop's half width h and the sessions' zeros z are small beforehand (`_LOOP`): one row more
    for each says so, which matters where a sensor was only ever read while bending grew.

    Args:
        column: rows of a sensor.
        slopes: (n, q) what its answer is made of, instead of k.

    Returns:
        None where it cannot be had.
    """
    if column.seen.sum() < 6:
        return None
    slopes = column.model[:, None] if slopes is None else slopes
    n, q = slopes.shape
    design = column.design(slopes)
    extra = design.shape[1] - 1 - q
    prior = np.hstack([np.zeros((extra, 1 + q)), np.eye(extra)])
    try:
        plain = fit_linear(np.column_stack([np.ones(n), column.model]), column.ohm)
        slope = abs(float(plain.coefficients[1]))
        # Errors of the abscissa are carried over by the slope.
        fit = fit_linear(
            np.vstack([design, prior]),
            np.append(column.ohm, np.zeros(extra)),
            np.append(slope * column.error, np.full(extra, slope * _LOOP)),
            firm=extra,
        )
    except DataError:
        return None
    return replace(fit, used=fit.used[:n], residuals=fit.residuals[:n])


def honest_lines(
    columns: Sequence[Column], slopes: Sequence[Array | None]
) -> list[OrderedFit | None]:
    """As `fit_line`, sensor by sensor, with errors that hold from sweep to sweep."""
    return mixed([_candidates(*one) for one in zip(columns, slopes, strict=True)])


def _candidates(column: Column, slopes: Array | None) -> Candidates | None:
    fit = fit_line(column, slopes)
    if fit is None:
        return None
    slopes = column.model[:, None] if slopes is None else slopes
    design = column.design(slopes)
    slope = abs(float(fit.coefficients[1]))
    prior = np.full(design.shape[1], slope * _LOOP)
    prior[: 1 + slopes.shape[1]] = np.inf
    return candidates(
        fit, design, column.ohm, slope * column.error, column.block, column.sweep,
        slope * column.model, prior,
    )  # fmt: skip


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
    columns: Sequence[Column], fits: Sequence[LinearFit | None], sides: Sequence[Side]
) -> NDArray[np.int64]:
    """(m,) bending direction that each sensor answers to; 0 = both alike.

    A line with a kink at zero gives the ratio of a sensor's slopes to the left and to the right.
    The sensors of a column are mounted alike, so they are asked together: where the weaker side's
    slope is surely below `_ONE_WAY` of the stronger's, only the stronger side counts. A sensor that
    surely differs from its column stands for itself.
    """
    ratio, spread = np.full(len(fits), np.nan), np.full(len(fits), np.inf)
    asked = []
    for number, (column, fit) in enumerate(zip(columns, fits, strict=True)):
        k = column.model[column.seen]
        # A side that was hardly bent tells nothing.
        bent = 0.1 * float(np.abs(k).max(initial=1e-3))
        if fit is not None and all((sign * k > bent).sum() >= 3 for sign in (1, -1)):
            asked.append(number)
    halves = [
        np.column_stack([np.clip(columns[n].model, 0, None), np.clip(columns[n].model, None, 0)])
        for n in asked
    ]
    made = honest_lines([columns[n] for n in asked], halves)
    for number, split in zip(asked, made, strict=True):
        if split is None:
            continue
        left, right = (float(v) for v in split.line.coefficients[1:3])
        strong = max(abs(left), abs(right))
        # A slope that is lost in noise, or of the wrong sign, counts as a tenth of the other.
        sizes = [max(v * np.sign(left + right), 0.1 * strong) for v in (left, right)]
        ratio[number] = np.log(sizes[0] / sizes[1])
        spread[number] = np.hypot(split.line.se(1) / sizes[0], split.line.se(2) / sizes[1])
    found = np.zeros(len(fits), np.int64)
    limit = -np.log(_ONE_WAY)
    for side in SIDES:
        alike = np.array([s == side for s in sides])
        known = alike & np.isfinite(ratio)
        if not known.any():
            continue
        weights = 1 / np.maximum(spread[known], 0.02) ** 2
        pooled = float((weights * ratio[known]).sum() / weights.sum())
        scatter = float((weights * (ratio[known] - pooled) ** 2).sum()) / max(1, known.sum() - 1)
        column_se = float(np.sqrt(max(1.0, scatter) / weights.sum()))
        if abs(pooled) - 4 * column_se > limit:
            apart = (np.abs(ratio - pooled) > 5 * spread) & (np.abs(ratio) + 2 * spread < limit)
            found[alike & ~apart] = 1 if pooled > 0 else -1
        alone = alike & (np.abs(ratio) - 4 * spread > limit)
        found[alone] = np.sign(ratio[alone]).astype(np.int64)
    return found


def nonlinearities(columns: Sequence[Column]) -> list[tuple[float, float, float]]:
    """How far each sensor's quadratic departs from the line.

    Returns:
        Share of the answer at the largest bend that goes beyond a straight line, its standard
        error, and the rows' departure from a line through them (rms, relative).
    """
    slopes: list[Array] = []
    for column in columns:
        largest = max(
            float(np.abs(np.nan_to_num(column.model[column.seen])).max(initial=0.0)), 1e-9
        )
        slopes.append(
            np.column_stack([column.model, np.abs(column.model) * column.model / largest])
        )
    found = []
    made = honest_lines(columns, slopes)
    for column, bends, fit in zip(columns, slopes, made, strict=True):
        if fit is None:
            found.append((0.0, 0.0, 0.0))
            continue
        straight, curved = fit.line.coefficients[1:3].tolist()
        k, answer = column.model[column.seen], bends[column.seen] @ [straight, curved]
        line = np.polynomial.Polynomial.fit(k, answer, 1)
        departure = float(np.std(answer - line(k))) / max(float(np.std(answer)), 1e-300)
        total = straight + curved
        found.append((curved / total, fit.line.se(2) / abs(total), departure))
    return found
