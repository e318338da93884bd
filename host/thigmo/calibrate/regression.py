"""Robust linear fits with standard errors.

Least trimmed squares finds the line of most readings, even if a fifth of them are wrong. Points
beyond four of its standard deviations are omitted (the caller names them), and the rest is fitted
by weighted least squares. Its standard errors hold for independent rows; `flex_lines` treats rows
that are not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation, norm

from thigmo.errors import DataError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_REJECT = 4.0
_DRAWS = 200
_STARTS, _STEPS = 3, 4  # concentration steps from the best of the draws
_KEEP = 0.75  # share of rows that the first fit must explain


@dataclass(frozen=True)
class LinearFit:
    """Coefficients of `y = design @ coefficients`."""

    coefficients: Array  # (p,)
    covariance: Array  # (p, p) of the coefficients
    sigma: float  # residual standard deviation beyond the known errors, in units of y
    used: Mask  # (n,) rows that were not rejected
    residuals: Array  # (n,) of all rows (nan where the data were not finite)

    def se(self, index: int) -> float:
        """Standard error of a coefficient."""
        return float(np.sqrt(self.covariance[index, index]))


def fit_linear(
    design: Array, y: Array, known_se: Array | float = 0.0, *, reject: bool = True, firm: int = 0
) -> LinearFit:
    """Robust weighted linear least squares of y (n,) on a design (n, p).

    Args:
        known_se: (n,) known standard error of each row, in units of y; the remaining scatter is
            estimated and added.
        reject: omit outliers, not only rows that are not finite.
        firm: number of rows at the end that are priors and never outliers.
    """
    row_se = np.broadcast_to(np.asarray(known_se, float), y.shape)
    rows = np.flatnonzero(np.isfinite(np.column_stack([design, y, row_se])).all(axis=1))
    p = design.shape[1]
    if len(rows) < p + 2:
        raise DataError(f"{len(rows)} usable readings for {p} numbers", "take more readings")
    a, b, e = design[rows], y[rows], row_se[rows]
    if np.linalg.matrix_rank(a / np.maximum(np.abs(a).max(axis=0), 1e-300)) < p:
        raise DataError("the readings do not vary enough to fit a line", "use more places")
    firm_rows = np.arange(len(rows)) >= (len(rows) - firm if reject else 0)
    # Two starts, because each fails where the other works: least trimmed squares if there are
    # outliers, all rows if a few distant ones determine the slope. More rows explained wins.
    starts = [np.ones(len(rows), bool)]
    if reject and len(rows) >= p + 4:
        line, spread = _trimmed_fit(a, b)
        near = (np.abs(b - a @ line) <= 3.0 * np.sqrt(spread**2 + e**2) + 1e-300) | firm_rows
        if near.sum() >= p + 2:
            starts.append(near)
    fits = [_rejecting(a, b, e, start, firm_rows) for start in starts]
    inside, coefficients, covariance, sigma = max(
        fits, key=lambda f: (int(f[0].sum()) if f[3] < 3 * fits[-1][3] else 0, -f[3])
    )
    used, residuals = np.zeros(len(y), bool), np.full(len(y), np.nan)
    used[rows[inside]], residuals[rows] = True, b - a @ coefficients
    return LinearFit(coefficients, covariance, sigma, used, residuals)


def _rejecting(
    a: Array, b: Array, e: Array, start: Mask, firm: Mask
) -> tuple[Mask, Array, Array, float]:
    """Weighted fit without rows beyond four standard deviations, repeated until none changes."""
    near = start
    for _ in range(26):
        inside = near
        coefficients, covariance, sigma = _weighted(a[inside], b[inside], e[inside])
        limit = _REJECT * np.sqrt(sigma**2 + e**2)
        near = (np.abs(b - a @ coefficients) <= limit + 1e-300) | firm
        if near.sum() < a.shape[1] + 2 or (near == inside).all():
            break
    return inside, coefficients, covariance, sigma


def _trimmed_fit(a: Array, b: Array) -> tuple[Array, float]:
    """Least trimmed squares (three quarters of the rows), and its standard deviation.

    Half of the rows would not be enough: most readings of a distal sensor are near zero curvature,
    and half of them agree with any slope.
    """
    n, p = a.shape
    keep = max(p + 1, round(_KEEP * n))
    picks = np.argsort(np.random.default_rng(n * 7919 + p).random((_DRAWS, n)), axis=1)[:, :p]
    squares = a[picks]
    sound = np.abs(np.linalg.det(squares / (np.abs(a).max(axis=0) + 1e-300))) > 1e-6
    starts = np.linalg.solve(squares[sound], b[picks[sound]][..., None])[..., 0]
    best = _least_squares(a, b)
    lines = np.vstack([starts, best])
    costs = np.sort((b - lines @ a.T) ** 2, axis=1)[:, :keep].sum(axis=1)
    lowest_cost = np.inf
    # Concentration steps from the most promising starts.
    for line in lines[np.argsort(costs)[:_STARTS]]:
        for _ in range(_STEPS):
            near = np.argsort(np.abs(b - a @ line))[:keep]
            line = _least_squares(a[near], b[near])
        cost = float(np.sort((b - a @ line) ** 2)[:keep].sum())
        if cost < lowest_cost:
            best, lowest_cost = line, cost
    quantile = np.sort(np.abs(b - a @ best))[keep - 1]
    spread = float(quantile / norm.ppf((1 + keep / n) / 2)) * (1 + 2 / max(1, n - p))
    return best, max(spread, 1e-300)


def _least_squares(a: Array, b: Array) -> Array:
    return np.asarray(np.linalg.lstsq(a, b, rcond=None)[0], float)


def _weighted(a: Array, b: Array, e: Array) -> tuple[Array, Array, float]:
    """Least squares with known errors `e` and an unknown common scatter, found by iteration."""
    freedom = max(1, len(b) - a.shape[1])
    coefficients = _least_squares(a, b)
    residuals = b - a @ coefficients
    sigma2 = float(residuals @ residuals) / freedom
    tiny = 1e-12 * max(sigma2, float(np.max(e**2)))
    for _ in range(40 if e.any() else 0):
        weights = 1.0 / (max(sigma2, tiny) + e**2)
        root = np.sqrt(weights)
        coefficients = _least_squares(a * root[:, None], b * root)
        residuals = b - a @ coefficients
        # Moment estimate: the weighted squares add up to n - p when sigma2 is correct.
        excess = float(weights @ (residuals**2 * len(b) / freedom - e**2))
        previous, sigma2 = sigma2, max(0.0, excess / float(weights.sum()))
        if abs(sigma2 - previous) <= 1e-6 * max(sigma2, tiny):
            break
    variance = np.maximum(sigma2 + e**2, 1e-300)
    normal = (a / variance[:, None]).T @ a
    return coefficients, np.asarray(np.linalg.pinv(normal), float), float(np.sqrt(sigma2))


def outlying(values: Array, limit: float, floor: Array | float) -> Mask:
    """(n,) whether a value is more than `limit` standard deviations from the median.

    The robust standard deviation counts as at least `least`.
    """
    sigma = np.maximum(median_abs_deviation(values, scale="normal"), floor)
    return np.asarray(np.abs(values - np.median(values)) > limit * sigma)


def correlation_factor(residuals: Array, ceiling: float) -> float:
    """Factor, at most `most`, on the variance of residuals (n,) for correlated neighbours."""
    correlation = float(np.corrcoef(residuals[1:], residuals[:-1])[0, 1])
    correlation = min(ceiling, max(0.0, correlation)) if np.isfinite(correlation) else 0.0
    return (1 + correlation) / (1 - correlation)
