"""Standard errors of a line whose residuals follow one another.

A flex sensor creeps and lags, so its residuals are alike from row to row, and its scale comes back
a little different in every sweep. Least squares on rows taken as independent then claims errors 5
to 10 times too small. Here the rows' covariance is white noise, plus a part that decays over some
rows, plus one gain for each sweep; how much of each is integrated out on a grid by the restricted
likelihood (REML), with the common variance by Student's t. Sensors of a robot are much alike, so
they tell each other which points of the grid are likely (expectation maximisation of a mixture's
shares). One sweep of one sensor cannot show how far the next one's gain will be off: there the
grid's prior stands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thigmo.calibrate.regression import LinearFit

Array = NDArray[np.float64]

_MOST_ROWS = 60  # of a fit; more are averaged in order
# (share of the variance that lasts, rows over which it decays by e), and their prior.
_LASTING = [(0.0, 1.0), *((share, rows) for share in (0.4, 0.7, 0.95) for rows in (2.0, 6.0, 20.0))]
_LASTING_PRIOR = [0.7] + [0.3 / 9] * 9
# One sigma over sweeps of a sensor's gain, relative [a guess: root mean square 0.9 %].
_SWEEP_GAINS = (0.0, 0.01, 0.02)
_SWEEP_PRIOR = (0.6, 0.25, 0.15)
# So many sensors' worth is the prior against what the others show.
_PRIOR_COUNT = 1.0


@dataclass(frozen=True)
class Candidates:
    """One sensor's line at every point of the grid."""

    line: LinearFit  # its coefficients and residuals
    log_evidence: Array  # (g,) restricted, without the prior
    covariances: Array  # (g, p, p) of the coefficients


@dataclass(frozen=True)
class OrderedFit:
    """A line with errors that hold for rows taken in order."""

    line: LinearFit  # the fit; its covariance is that of the mean over sweeps
    lasting: float  # share of the residuals' variance that lasts over rows
    sweep_gain: float  # one sigma of the gain from sweep to sweep, relative


def candidates(
    fit: LinearFit,
    design: Array,
    y: Array,
    known_se: Array,
    session: NDArray[np.int64],
    sweep: NDArray[np.int64],
    bend: Array,
    prior_se: Array,
) -> Candidates:
    """The line through the rows that a robust fit kept, and its errors over the grid.

    Args:
        fit: robust fit; its kept rows and its scatter are used.
        design: (n, p), rows in the order in which they were taken.
        y: (n,).
        known_se: (n,) errors known beforehand, in units of y.
        session: (n,) what lasts does not last from one session to the next.
        sweep: (n,) number of each row's sweep.
        bend: (n,) the part of y that a sweep's gain multiplies.
        prior_se: (p,) one sigma of each coefficient about zero beforehand; inf = nothing is known.
    """
    used = np.flatnonzero(fit.used)
    parts = _parts(used, session, sweep)
    x, values, error, size = (
        np.array([column[part].mean(axis=0) for part in parts])
        for column in (design, y, known_se, bend)
    )
    firsts = [part[0] for part in parts]
    same_sweep = np.equal.outer(sweep[firsts], sweep[firsts])
    apart = np.abs(np.subtract.outer(np.arange(len(parts)), np.arange(len(parts))))
    same_session = np.equal.outer(session[firsts], session[firsts])
    unit = max(fit.sigma, 0.3 * float(np.median(error)), 1e-9 * float(np.abs(y[used]).max()))
    lasting = np.array([
        (1 - share) * np.eye(len(parts)) + share * np.exp(-apart / rows) * same_session
        for share, rows in _LASTING
    ])  # fmt: skip
    gains = np.square(_SWEEP_GAINS)[:, None, None] * np.outer(size, size) / unit**2 * same_sweep
    covariance = (lasting[:, None] + gains[None] + np.diag((error / unit) ** 2)).reshape(
        -1, len(parts), len(parts)
    )
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, np.column_stack([x, values]))
    known = np.isfinite(prior_se)
    firm = np.zeros((len(prior_se), len(prior_se) + 1))
    firm[known, np.flatnonzero(known)] = unit / prior_se[known]
    white = np.concatenate([white, np.broadcast_to(firm, (len(white), *firm.shape))], axis=1)
    a, b = white[..., :-1], white[..., -1]
    normal = np.einsum("gnp,gnq->gpq", a, a)
    inverse = np.linalg.pinv(normal, hermitian=True)
    rest = b - np.einsum("gnp,gpq,gmq,gm->gn", a, inverse, a, b, optimize=True)
    squares = np.einsum("gn,gn->g", rest, rest)
    freedom = max(len(parts) + int(known.sum()) - len(prior_se), 1)
    evidence = (
        -np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        - 0.5 * np.linalg.slogdet(normal)[1]
        - 0.5 * freedom * np.log(np.maximum(squares, 1e-300))
    )
    # The estimate itself is that of independent rows: where the loop or the curve is not quite what
    # it is taken for, generalised least squares would follow that instead of the slope.
    weight = 1 / (1 + (error / unit) ** 2)
    prior = firm[:, :-1].T @ firm[:, :-1]
    solved = np.linalg.pinv(x.T @ (weight[:, None] * x) + prior, hermitian=True)
    gain = solved @ (x.T * weight)
    spread = gain @ covariance @ gain.T + solved @ prior @ solved
    # Student's t has a variance of nu / (nu - 2) times its scale squared.
    spread *= (squares / max(freedom - 2, 1))[:, None, None]
    coefficients = gain @ values
    line = replace(fit, coefficients=coefficients, residuals=y - design @ coefficients)
    return Candidates(line, evidence, spread)


def mixed(sensors: Sequence[Candidates | None]) -> list[OrderedFit | None]:
    """Each sensor's line, its errors mixed over the grid by what it and the others show."""
    prior = np.outer(_LASTING_PRIOR, _SWEEP_PRIOR).ravel()
    share = prior
    known = [one for one in sensors if one is not None]
    if not known:
        return [None] * len(sensors)
    evidence = np.array([one.log_evidence - one.log_evidence.max() for one in known])
    weights = np.exp(evidence)
    for _ in range(50):
        weights = np.exp(evidence) * share
        weights /= weights.sum(axis=1, keepdims=True)
        # What a single sensor shows is its own: it needs others to move the shares.
        shown = weights.sum(axis=0) - weights.mean(axis=0)
        share = (_PRIOR_COUNT * prior + shown) / (_PRIOR_COUNT + len(known) - 1)
    lasting = np.repeat([share for share, _ in _LASTING], len(_SWEEP_GAINS))
    gains = np.tile(np.square(_SWEEP_GAINS), len(_LASTING))
    weight_of = iter(weights)

    def mixture(one: Candidates, weight: Array) -> OrderedFit:
        total = np.einsum("g,gpq->pq", weight, one.covariances)
        line = replace(one.line, covariance=total)
        return OrderedFit(line, float(weight @ lasting), float(np.sqrt(weight @ gains)))

    return [None if one is None else mixture(one, next(weight_of)) for one in sensors]


def _parts(
    used: NDArray[np.int64], session: NDArray[np.int64], sweep: NDArray[np.int64]
) -> list[NDArray[np.int64]]:
    """Rows to average: in order, of one session and sweep, about `_MOST_ROWS` in all."""
    cuts = np.flatnonzero(np.diff(sweep[used]) | np.diff(session[used])) + 1
    each = max(1, round(len(used) / _MOST_ROWS))
    return [
        part
        for run in np.split(used, cuts)
        for part in np.array_split(run, max(1, round(len(run) / each)))
    ]
