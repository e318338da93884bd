"""Linear fits that outliers cannot bend, with standard errors that hold.

Least trimmed squares finds the line of most, whatever a fifth of the readings do; points beyond
four of its sigmas are left out (and named by the caller), and what remains is fitted by
weighted least squares, whose standard errors are the textbook's: those of independent rows (see
`correlation` for rows that are not).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from thigmo.errors import DataError

Array = NDArray[np.float64]

_REJECT = 4.0
_DRAWS = 200
_STARTS, _STEPS = 3, 4  # concentration steps from the best of the draws
_KEEP = 0.75  # share of rows that the first fit must explain


@dataclass(frozen=True)
class LinearFit:
    """Coefficients of `y = design @ coefficients`."""

    coefficients: Array  # (p,)
    covariance: Array  # (p, p)
    sigma: float  # residual standard deviation beyond the known errors, in units of y
    used: NDArray[np.bool_]  # (n,) rows that were not rejected
    residuals: Array  # (n,) of all rows (nan where the data were not finite)

    def se(self, index: int) -> float:
        """Standard error of a coefficient."""
        return float(np.sqrt(self.covariance[index, index]))


def fit_linear(
    design: Array,
    y: Array,
    known_se: Array | float = 0.0,
    *,
    reject: bool = True,
    firm: int = 0,
) -> LinearFit:
    """Robust weighted linear least squares.

    Args:
        design: (n, p).
        y: (n,); rows with a value that is not finite are left out.
        known_se: (n,) standard error of each row that is known beforehand; the remaining scatter
            is estimated and added.
        reject: leave outliers out.
        firm: so many rows at the end say what is known beforehand and are never outliers.

    Raises:
        DataError: fewer than p + 2 usable rows, or a design that does not determine p numbers.
    """
    design, y = np.asarray(design, float), np.asarray(y, float)
    known = np.broadcast_to(np.asarray(known_se, float), y.shape)
    finite = np.isfinite(y) & np.isfinite(design).all(axis=1) & np.isfinite(known)
    rows = np.nonzero(finite)[0]
    p = design.shape[1]
    if len(rows) < p + 2:
        raise DataError(f"{len(rows)} usable readings for {p} numbers", "take more readings")
    a, b, e = design[rows], y[rows], known[rows]
    if np.linalg.matrix_rank(a / np.maximum(np.abs(a).max(axis=0), 1e-300)) < p:
        raise DataError("the readings do not vary enough to fit a line", "use more places")
    everything = np.ones(len(rows), bool)
    prior = np.arange(len(rows)) >= len(rows) - firm
    if not reject:
        inside, (coefficients, covariance, sigma) = everything, _weighted(a, b, e)
    else:
        # From two starts, for each fails where the other holds: least trimmed squares where there
        # are outliers, all rows where a few far ones carry the slope. More rows explained wins.
        starts = [everything]
        if len(rows) >= p + 4:
            line, spread = _trimmed_fit(a, b)
            near = (np.abs(b - a @ line) <= 3.0 * np.sqrt(spread**2 + e**2) + 1e-300) | prior
            if near.sum() >= p + 2:
                starts.append(near)
        found = [_rejecting(a, b, e, start, prior) for start in starts]
        inside, coefficients, covariance, sigma = max(
            found, key=lambda f: (int(f[0].sum()) if f[3] < 3 * found[-1][3] else 0, -f[3])
        )
    used = np.zeros(len(y), bool)
    used[rows[inside]] = True
    residuals = np.full(len(y), np.nan)
    residuals[rows] = b - a @ coefficients
    return LinearFit(coefficients, covariance, sigma, used, residuals)


def _rejecting(
    a: Array, b: Array, e: Array, start: NDArray[np.bool_], prior: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], Array, Array, float]:
    """Weighted fit, leaving out rows beyond four sigmas, until none changes."""
    inside = start
    coefficients, covariance, sigma = _weighted(a[inside], b[inside], e[inside])
    for _ in range(25):
        limit = _REJECT * np.sqrt(sigma**2 + e**2)
        kept = (np.abs(b - a @ coefficients) <= limit + 1e-300) | prior
        if kept.sum() < a.shape[1] + 2 or (kept == inside).all():
            break
        inside = kept
        coefficients, covariance, sigma = _weighted(a[inside], b[inside], e[inside])
    return inside, coefficients, covariance, sigma


def _trimmed_fit(a: Array, b: Array) -> tuple[Array, float]:
    """Least trimmed squares (three quarters of the rows), and its sigma.

    Half the rows would not do: most readings of a distal sensor stand near zero curvature, and
    half of them agree with any slope.
    """
    n, p = a.shape
    keep = max(p + 1, round(_KEEP * n))
    rng = np.random.default_rng(n * 7919 + p)
    picks = np.argsort(rng.random((_DRAWS, n)), axis=1)[:, :p]
    squares = a[picks]
    size = np.abs(a).max(axis=0) + 1e-300
    sound = np.abs(np.linalg.det(squares / size)) > 1e-6
    starts = np.linalg.solve(squares[sound], b[picks[sound]][..., None])[..., 0]
    everything: Array = np.asarray(np.linalg.lstsq(a, b, rcond=None)[0], float)
    lines = np.vstack([starts, everything])
    costs = np.sort((b - lines @ a.T) ** 2, axis=1)[:, :keep].sum(axis=1)
    best, least = everything, np.inf
    # Concentration steps from the most promising starts.
    for start in lines[np.argsort(costs)[:_STARTS]]:
        line = start
        for _ in range(_STEPS):
            near = np.argsort(np.abs(b - a @ line))[:keep]
            line = np.asarray(np.linalg.lstsq(a[near], b[near], rcond=None)[0], float)
        cost = float(np.sort((b - a @ line) ** 2)[:keep].sum())
        if cost < least:
            best, least = line, cost
    quantile = np.sort(np.abs(b - a @ best))[keep - 1]
    spread = float(quantile / norm.ppf((1 + keep / n) / 2)) * (1 + 2 / max(1, n - p))
    return best, max(spread, 1e-300)


def _weighted(a: Array, b: Array, e: Array) -> tuple[Array, Array, float]:
    """Least squares with known errors `e` and an unknown common scatter, found by iteration."""
    n, p = a.shape
    coefficients: Array = np.asarray(np.linalg.lstsq(a, b, rcond=None)[0], float)
    rest = b - a @ coefficients
    sigma2 = float(rest @ rest) / max(1, n - p)
    if e.any():
        tiny = 1e-12 * max(sigma2, float(np.max(e**2)))
        for _ in range(40):
            weights = 1.0 / (max(sigma2, tiny) + e**2)
            scaled = a * np.sqrt(weights)[:, None]
            coefficients = np.asarray(
                np.linalg.lstsq(scaled, b * np.sqrt(weights), rcond=None)[0], float
            )
            rest = b - a @ coefficients
            # Moment estimate: the weighted squares add up to n - p when sigma2 is right.
            excess = float(weights @ (rest**2 * n / max(1, n - p) - e**2))
            new = max(0.0, excess / float(weights.sum()))
            done = abs(new - sigma2) <= 1e-6 * max(new, tiny)
            sigma2 = new
            if done:
                break
    variance = np.maximum(sigma2 + e**2, 1e-300)
    normal = (a / variance[:, None]).T @ a
    return coefficients, np.asarray(np.linalg.pinv(normal), float), float(np.sqrt(sigma2))


def lasting(residuals: Array, most: float) -> float:
    """Factor on the variance of residuals (n,) in order that last: neighbours err together.

    Args:
        residuals: of a fit that took them as independent.
        most: correlation of neighbours above which it is not believed.
    """
    along = float(np.corrcoef(residuals[1:], residuals[:-1])[0, 1])
    along = min(most, max(0.0, along)) if np.isfinite(along) else 0.0
    return (1 + along) / (1 - along)
