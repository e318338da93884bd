"""A flex sensor's line: resistance over curvature, with its loop and the zero of each session.

A sensor has a hysteresis loop of a few 1e-4 1/cm, and its zero changes with every eversion. Both
are fitted together with zero and scale; otherwise the scale would be off by one or two percent.

A sensor also creeps, so residuals of neighbouring rows are correlated, and its scale differs a
little from sweep to sweep. Least squares with independent rows then states errors 5 to 10 times too
small. In `reml_lines` the covariance of the rows is white noise, plus a part that decays over
some rows, plus one gain for each sweep. The amounts are integrated out on a grid by the restricted
likelihood (REML), with the common variance by Student's t. The sensors of a robot are much alike,
so together they determine which points of the grid are likely (expectation maximisation of the
shares of a mixture). One sweep of one sensor cannot show how much the next gain will differ; the
prior of the grid then remains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.calibrate.regression import Array, LinearFit, Mask, fit_linear
from thigmo.config import SIDES, Side
from thigmo.errors import DataError

_ONE_WAY = 0.85  # a direction whose slope is below this share of the other's is not used
_LOOP = 5e-4  # 1/cm, prior standard deviation of a loop's half width and of a session's zero
LOOP_WIDTHS = (2e-3, 5e-3, 1e-2)  # 1/cm
# Drop-outs: readings within this share of the range count as the same value, and this share of rows
# as many.
_ALIKE, _MANY = 2e-3, 0.03

_MOST_ROWS = 60  # rows in a REML fit; more are averaged in order
# (share of the variance that lasts, rows over which it decays by e), and their prior.
_LASTING = [(0.0, 1.0), *((share, rows) for share in (0.4, 0.7, 0.95) for rows in (2.0, 6.0, 20.0))]
_LASTING_PRIOR = [0.7] + [0.3 / 9] * 9
# Relative standard deviation of a sensor's gain between sweeps [a guess: root mean square 0.9 %].
_SWEEP_GAINS = (0.0, 0.01, 0.02)
_SWEEP_PRIOR = (0.6, 0.25, 0.15)
_PRIOR_COUNT = 1.0  # weight of the prior, in sensors


def loop_turns(model: Array, block: NDArray[np.int64], width: float = LOOP_WIDTHS[1]) -> Array:
    """(n, m) state of each sensor's loop: 1 after long positive bending, -1 after negative.

    It changes over a curvature of `width` (Dahl's model of friction), and starts at 0 in every
    session.

    Args:
        model: (n, m) curvature at each sensor, 1/cm.
        block: (n,) session of each row.
        width: curvature over which the loop turns, 1/cm.
    """
    turn = np.zeros(model.shape)
    state = previous = np.zeros(model.shape[1])
    for row, k in enumerate(model):
        if row and block[row] != block[row - 1]:
            state = previous = np.zeros(model.shape[1])
        if np.isfinite(k).all():
            sign = np.sign(k - previous)
            next_state = sign + (state - sign) * np.exp(-abs(k - previous) / width)
            state, previous = np.where(sign == 0, state, next_state), k
        turn[row] = state
    return turn


class Column(NamedTuple):
    """The n rows of one sensor: readings (nan where omitted), and the regressors of their fit."""

    ohm: Array
    model: Array  # curvature that it should show, 1/cm
    error: Array
    turn: Array
    block: NDArray[np.int64]
    sweep: NDArray[np.int64]
    bends: Array  # (n, q) what its answer is made of: `model`, or its parts

    @property
    def finite(self) -> Mask:
        """(n,) whether there is a reading."""
        return np.isfinite(self.ohm)

    def design(self) -> Array:
        """Regressors of the line: zero, bends, loop, and the zero of each later session."""
        later = [(self.block == session).astype(float) for session in np.unique(self.block)[1:]]
        return np.column_stack([np.ones(len(self.turn)), self.bends, self.turn, *later])


@dataclass(frozen=True)
class OrderedFit(LinearFit):
    """A line with standard errors for correlated rows: those of the mean over sweeps."""

    lasting: float  # share of the residuals' variance that neighbouring rows share
    sweep_gain: float  # relative standard deviation of the gain between sweeps


def fit_line(column: Column) -> LinearFit | None:
    """Fit R = R0 + b (k + h turn + z): R0, b, b h of the loop, and b z of each later session.

    The loop's half width h and the sessions' zeros z have a prior (`_LOOP`), which is a further row
    for each. It matters if a sensor was only read while bending grew. Returns None if there are too
    few readings, or none that vary.
    """
    if column.finite.sum() < 6:
        return None
    design, n = column.design(), len(column.ohm)
    loose = 1 + column.bends.shape[1]
    extra = design.shape[1] - loose
    try:
        plain = fit_linear(np.column_stack([np.ones(n), column.model]), column.ohm)
        slope = abs(float(plain.coefficients[1]))
        # Errors of the abscissa are carried over by the slope.
        fit = fit_linear(
            np.vstack([design, np.eye(extra, design.shape[1], loose)]),
            np.append(column.ohm, np.zeros(extra)),
            slope * np.append(column.error, np.full(extra, _LOOP)),
            firm=extra,
        )
    except DataError:
        return None
    return replace(fit, used=fit.used[:n], residuals=fit.residuals[:n])


def reml_lines(columns: Sequence[Column]) -> list[OrderedFit | None]:
    """As `fit_line` for each sensor, with errors mixed over the grid by the evidence of all."""
    fits = [fit_line(column) for column in columns]
    pairs = zip(columns, fits, strict=True)
    grid_fits = [_grid_fit(column, fit) for column, fit in pairs if fit is not None]
    if not grid_fits:
        return [None] * len(fits)
    prior = share = np.outer(_LASTING_PRIOR, _SWEEP_PRIOR).ravel()
    evidence = np.exp([log_evidence - log_evidence.max() for _, log_evidence, _ in grid_fits])
    for _ in range(50):
        weights = evidence * share
        weights /= weights.sum(axis=1, keepdims=True)
        # A single sensor cannot change the shares: that takes several.
        effective_counts = weights.sum(axis=0) - weights.mean(axis=0)
        share = (_PRIOR_COUNT * prior + effective_counts) / (_PRIOR_COUNT + len(grid_fits) - 1)
    lasting = np.repeat([share for share, _ in _LASTING], len(_SWEEP_GAINS))
    gains = np.tile(np.square(_SWEEP_GAINS), len(_LASTING))
    mixed = (
        OrderedFit(
            **{**vars(line), "covariance": np.einsum("g,gpq->pq", weight, covariances)},
            lasting=float(weight @ lasting), sweep_gain=float(np.sqrt(weight @ gains)),
        )
        for (line, _, covariances), weight in zip(grid_fits, weights, strict=True)
    )  # fmt: skip
    return [None if fit is None else next(mixed) for fit in fits]


def _grid_fit(column: Column, fit: LinearFit) -> tuple[LinearFit, Array, Array]:
    """The line through the rows that a robust fit kept, and its errors at g points of the grid.

    Of each point, the restricted log evidence (g,) without the prior, and the covariance (g, p, p).
    """
    design, slope = column.design(), abs(float(fit.coefficients[1]))
    # In order, of one session and sweep, about `_MOST_ROWS` in all.
    used = np.flatnonzero(fit.used)
    cuts = np.flatnonzero(np.diff(column.sweep[used]) | np.diff(column.block[used])) + 1
    stride = max(1, round(len(used) / _MOST_ROWS))
    parts = [
        part
        for run in np.split(used, cuts)
        for part in np.array_split(run, max(1, round(len(run) / stride)))
    ]
    x, values, error, size, sweep, block = (
        np.array([rows[part].mean(axis=0) for part in parts])
        for rows in (design, column.ohm, slope * column.error, slope * column.model,
                     column.sweep, column.block)
    )  # fmt: skip
    n, p = x.shape
    floor = 1e-9 * float(np.abs(column.ohm[used]).max())
    unit = max(fit.sigma, 0.3 * float(np.median(error)), floor)
    distance = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    lasting = np.array([
        (1 - share) * np.eye(n) + share * np.exp(-distance / rows) * np.equal.outer(block, block)
        for share, rows in _LASTING
    ])  # fmt: skip
    sweep_covariance = np.outer(size, size) / unit**2 * np.equal.outer(sweep, sweep)
    gains = np.square(_SWEEP_GAINS)[:, None, None] * sweep_covariance
    covariance = (lasting[:, None] + gains + np.diag((error / unit) ** 2)).reshape(-1, n, n)
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, np.column_stack([x, values]))
    # The prior of loop and sessions' zeros.
    small = np.arange(p) > column.bends.shape[1]
    prior_root = np.diag(np.where(small, unit / (slope * _LOOP), 0.0))
    a = np.concatenate([white[..., :p], np.broadcast_to(prior_root, (len(white), p, p))], axis=1)
    b = np.concatenate([white[..., p], np.zeros((len(white), p))], axis=1)
    normal = np.einsum("gnp,gnq->gpq", a, a)
    inverse = np.linalg.pinv(normal, hermitian=True)
    residuals = b - np.einsum("gnp,gpq,gmq,gm->gn", a, inverse, a, b, optimize=True)
    squares = np.einsum("gn,gn->g", residuals, residuals)
    freedom = max(n + int(small.sum()) - p, 1)
    evidence = (
        -np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        - 0.5 * np.linalg.slogdet(normal)[1]
        - 0.5 * freedom * np.log(np.maximum(squares, 1e-300))
    )
    # The estimate itself is that of independent rows. If loop or curve differ from their models,
    # generalised least squares would follow the difference instead of the slope.
    weight = 1 / (1 + (error / unit) ** 2)
    prior = prior_root @ prior_root
    solved = np.linalg.pinv(x.T @ (weight[:, None] * x) + prior, hermitian=True)
    gain = solved @ (x.T * weight)
    # Student's t has a variance of nu / (nu - 2) times its scale squared.
    spread = gain @ covariance @ gain.T + solved @ prior @ solved
    spread *= (squares / max(freedom - 2, 1))[:, None, None]
    coefficients = gain @ values
    residuals = column.ohm - design @ coefficients
    return replace(fit, coefficients=coefficients, residuals=residuals), evidence, spread


def sweeps_of(
    block: NDArray[np.int64], kind: Sequence[str], active: Sequence[str], model: Array
) -> NDArray[np.int64]:
    """(n,) number of each row's sweep: one bend out and back, by one muscle, in one session."""
    size = np.nan_to_num(np.abs(model).max(axis=1))
    low, high = 0.1 * size.max(initial=0.0), 0.5 * size.max(initial=0.0)
    signs, out = np.zeros(len(kind), np.int64), False
    for row in range(1, len(kind)):
        out |= bool(size[row - 1] >= high)
        same = all(column[row] == column[row - 1] for column in (block, kind, active))
        back = out and kind[row] == "bend" and size[row] <= low
        signs[row] = signs[row - 1] + (back or not same)
        out &= signs[row] == signs[row - 1]
    return signs


def dropouts(ohm: Array, model: Array) -> tuple[Mask, list[float]]:
    """(n,) whether a sensor repeats a value that other rows of such bends lack; those values.

    A loose wire reads a plausible constant, often in enough rows to change a line: no robust fit
    separates a third of the rows from the others. A sound sensor never gives one value for many
    bends.
    """
    dropped = np.zeros(len(ohm), bool)
    values: list[float] = []
    while True:
        rows = np.flatnonzero(np.isfinite(ohm) & np.isfinite(model) & ~dropped)
        if len(rows) < 8:
            return dropped, values
        rows = rows[np.argsort(ohm[rows])]
        sorted_ohm, reach = ohm[rows], float(np.ptp(model[rows]))
        spread = float(np.ptp(np.quantile(sorted_ohm, [0.05, 0.95])))
        ends = np.searchsorted(sorted_ohm, sorted_ohm + _ALIKE * spread, side="right")
        first = int(np.argmax(ends - np.arange(len(rows))))
        repeats = rows[first : ends[first]]
        low, high = np.quantile(model[repeats], [0.1, 0.9])
        neighbours = rows[(model[rows] >= low) & (model[rows] <= high) & ~np.isin(rows, repeats)]
        if (
            len(repeats) < max(4, _MANY * len(rows))
            or high - low < 0.25 * reach
            or not len(neighbours)
        ):
            return dropped, values
        if np.median(np.abs(ohm[neighbours] - np.median(ohm[repeats]))) < 0.05 * spread:
            return dropped, values
        dropped[repeats] = True
        values.append(float(np.median(ohm[repeats])))


def working(fit: LinearFit) -> bool:
    """Whether a sensor's slope differs significantly from zero."""
    return bool(abs(fit.coefficients[1]) > 5 * fit.se(1))


def bend_signs_of(columns: Sequence[Column], sides: Sequence[Side]) -> NDArray[np.int64]:
    """(m,) sign of the bends that each sensor can read; 0 = both.

    A line with a kink at zero gives the ratio of a sensor's slopes on both sides. The sensors of a
    column are mounted alike, so they are judged together: if the weaker slope is significantly
    below `_ONE_WAY` of the stronger, only the stronger side is used. A sensor that differs
    significantly from its column is judged by itself.
    """
    ratio, spread = np.full(len(columns), np.nan), np.full(len(columns), np.inf)
    judged, halves = [], []
    for number, column in enumerate(columns):
        k = column.model[column.finite]
        # A side that was hardly bent is not judged.
        threshold = 0.1 * float(np.abs(k).max(initial=1e-3))
        if min((k > threshold).sum(), (-k > threshold).sum()) >= 3:
            judged.append(number)
            sides_apart = [np.clip(column.model, 0, None), np.clip(column.model, None, 0)]
            halves.append(column._replace(bends=np.column_stack(sides_apart)))
    for number, split in zip(judged, reml_lines(halves), strict=True):
        if split is None:
            continue
        slopes = split.coefficients[1:3]
        # A slope below the noise, or of the wrong sign, counts as a tenth of the other.
        sizes = np.maximum(slopes * np.sign(slopes.sum()), 0.1 * np.abs(slopes).max())
        ratio[number] = np.log(sizes[0] / sizes[1])
        spread[number] = np.hypot(split.se(1) / sizes[0], split.se(2) / sizes[1])
    signs = np.zeros(len(columns), np.int64)
    limit = -np.log(_ONE_WAY)
    for side in SIDES:
        in_column = np.array([s == side for s in sides])
        has_ratio = in_column & np.isfinite(ratio)
        if not has_ratio.any():
            continue
        weights = 1 / np.maximum(spread[has_ratio], 0.02) ** 2
        pooled = float((weights * ratio[has_ratio]).sum() / weights.sum())
        scatter = float((weights * (ratio[has_ratio] - pooled) ** 2).sum()) / max(
            1, has_ratio.sum() - 1
        )
        column_se = float(np.sqrt(max(1.0, scatter) / weights.sum()))
        if abs(pooled) - 4 * column_se > limit:
            deviating = (np.abs(ratio - pooled) > 5 * spread) & (np.abs(ratio) + 2 * spread < limit)
            signs[in_column & ~deviating] = 1 if pooled > 0 else -1
        one_sided = in_column & (np.abs(ratio) - 4 * spread > limit)
        signs[one_sided] = np.sign(ratio[one_sided]).astype(np.int64)
    return signs


def nonlinearities(columns: Sequence[Column]) -> list[tuple[float, float, float]]:
    """For each sensor's quadratic fit, three numbers.

    They are the deviation from a straight line at the largest bend, as a share of the response; its
    standard error; and the relative rms deviation from a line through the curve.
    """
    curved = []
    for column in columns:
        k = column.model
        largest = max(float(np.abs(k[column.finite]).max(initial=0.0)), 1e-9)
        curved.append(column._replace(bends=np.column_stack([k, np.abs(k) * k / largest])))
    picks = []
    for column, fit in zip(curved, reml_lines(curved), strict=True):
        if fit is None:
            picks.append((0.0, 0.0, 0.0))
            continue
        k, answer = column.model[column.finite], column.bends[column.finite] @ fit.coefficients[1:3]
        line = np.polynomial.Polynomial.fit(k, answer, 1)
        departure = float(np.std(answer - line(k))) / max(float(np.std(answer)), 1e-300)
        total = float(fit.coefficients[1:3].sum())
        share, se = float(fit.coefficients[2]) / total, fit.se(2) / abs(total)
        picks.append((share, se, departure))
    return picks
