"""Marginal likelihood of one contact at one arc: force and nuisance columns integrated out.

For a given arc the model is linear with Gaussian priors, so the integral is in closed form, and all
outlier patterns that differ from a given one in one reading come by rank-one updates.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled, compiled_inner
from thigmo.localization.frame import Frame, Levels, Work
from thigmo.localization.influence import influence
from thigmo.localization.prior import LEAST_LEVER, OUTLIER_ODDS, OUTLIER_VARIANCE, BaseMoment

Array = npt.NDArray[np.float64]


@compiled
def prepare_levels(frame: Frame, blur: float, levels: Levels) -> None:
    """Integrate the nuisance columns out at each noise level, once for all arcs.

    Args:
        frame: readings and columns.
        blur: variance that a grid of arcs adds to each reading, where it is coarse; else 0.
        levels: `sigma`, `log_prior` and `flagged` are read; the rest is written.
    """
    y = frame.y
    variance = frame.variance
    columns = frame.columns
    sigma, log_prior, flagged, W, white, fit, const = levels
    n = y.shape[0]
    q = columns.shape[1]
    gram = np.zeros((q, q))
    count = 0
    for i in range(n):
        if flagged[i]:
            count += 1
    for s in range(sigma.shape[0]):
        level = log_prior[s] + count * np.log(OUTLIER_ODDS)
        total = 0.0
        for i in range(n):
            w = 1.0 / (variance[i] * sigma[s] * sigma[s] + blur)
            if flagged[i]:
                w /= OUTLIER_VARIANCE
            W[s, i] = w
            level += 0.5 * np.log(w)
            total += w * y[i] * y[i]
        for k in range(q):
            for m in range(k + 1):
                g = 1.0 if k == m else 0.0
                for i in range(n):
                    g += W[s, i] * columns[i, k] * columns[i, m]
                for r in range(m):
                    g -= gram[k, r] * gram[m, r]
                gram[k, m] = np.sqrt(max(g, 1e-300)) if k == m else g / gram[m, m]
            level -= np.log(gram[k, k])
        for i in range(n):
            for k in range(q):
                value = columns[i, k]
                for r in range(k):
                    value -= gram[k, r] * white[s, i, r]
                white[s, i, k] = value / gram[k, k]
        for k in range(q):
            value = 0.0
            for i in range(n):
                value += W[s, i] * white[s, i, k] * y[i]
            fit[s, k] = value
            total -= value * value
        const[s] = level - 0.5 * total


@compiled_inner
def flip_weight(residual: float, taken: float, w: float, flagged: bool, every: bool) -> float:
    """Weight of the outlier pattern that differs in one reading, over that of the present one.

    A rank-one update. Without `every`, 0 for a reading that lies too near (by less than 2 nats) to
    be worth it.

    Args:
        residual: reading less what fits best.
        taken: variance of that fit at the reading.
        w: present precision of the reading.
        flagged: whether it is an outlier at present.
        every: whether small weights are asked for.
    """
    size = w * residual * residual
    free = 1.0 - w * taken
    if flagged:
        d = 1.0 / OUTLIER_VARIANCE - 1.0
        odds = 1.0 / OUTLIER_ODDS
    else:
        d = OUTLIER_VARIANCE - 1.0
        odds = OUTLIER_ODDS
    grown = max(1.0 + d * free, 1e-12)
    if not (flagged or every) and 0.5 * d * size <= 2.0 * grown:
        return 0.0
    change: float = odds * np.exp(min(0.5 * d * size / grown, 300.0)) / np.sqrt(grown)
    return change


@compiled_inner
def weigh(
    lever: float,
    phi: Array,
    y: Array,
    levels: Levels,
    prior: BaseMoment,
    work: Work,
    want_flips: bool,
) -> tuple[float, float, float]:
    """Log marginal likelihood of a force of known influence, with the force's mean and variance.

    `lever` is its moment at the base, `phi` (N,) its readings, both for a unit force; `y` (N,) what
    was read. With `want_flips`, the work's `flips` get the relative weights of the present outlier
    pattern and of each that differs in one reading.

    Returns:
        log likelihood; posterior mean of the force; its posterior variance.
    """
    _, _, flagged, W, white, fit, const = levels
    moment, spread, weight = prior
    t = work.t
    flips = work.flips
    n = y.shape[0]
    q = white.shape[2]
    scale = 1.0 / max(abs(lever), LEAST_LEVER)
    # Sums of terms share * exp(top): exponents apart from factors, so that one logarithm will do.
    top = -1e300
    total = 0.0
    mean = 0.0
    square = 0.0
    if want_flips:
        flips[:] = 0.0
    for s in range(W.shape[0]):
        A = 0.0
        b = 0.0
        for i in range(n):
            wp = W[s, i] * phi[i]
            A += wp * phi[i]
            b += wp * y[i]
        for k in range(q):
            value = 0.0
            for i in range(n):
                value += W[s, i] * phi[i] * white[s, i, k]
            t[k] = value
            A -= value * value
            b -= value * fit[s, k]
        A = max(A, 0.0)
        best = 0.0
        best_f = 0.0
        best_variance = 1.0
        level_top = -1e300
        level_sum = 0.0
        level_f = 0.0
        level_ff = 0.0
        for c in range(spread.shape[0]):
            tau = spread[c] * scale
            f0 = moment[c] * scale
            # Around the prior's mean: y - f0 phi.
            b0 = b - f0 * A
            shrunk = 1.0 + tau * tau * A
            variance = tau * tau / shrunk
            exponent = f0 * b - 0.5 * f0 * f0 * A + 0.5 * b0 * b0 * variance
            share = weight[c] / np.sqrt(shrunk)
            f = f0 + b0 * variance
            if exponent > level_top:
                shrink = np.exp(level_top - exponent) if c > 0 else 0.0
                level_sum *= shrink
                level_f *= shrink
                level_ff *= shrink
                best *= shrink
                level_top = exponent
            else:
                share *= np.exp(exponent - level_top)
            if share > best:
                best = share
                best_f = f
                best_variance = variance
            level_sum += share
            level_f += share * f
            level_ff += share * (f * f + variance)
        base = const[s] + level_top
        share = level_sum
        if base > top:
            shrink = np.exp(top - base) if s > 0 else 0.0
            total *= shrink
            mean *= shrink
            square *= shrink
            if want_flips:
                flips *= shrink
            top = base
        else:
            shrink = np.exp(base - top)
            share *= shrink
            level_f *= shrink
            level_ff *= shrink
        extra = 1.0
        for i in range(n):
            u = y[i] - best_f * phi[i]
            p = phi[i]
            taken = 0.0
            for k in range(q):
                z = white[s, i, k]
                u -= z * (fit[s, k] - best_f * t[k])
                p -= z * t[k]
                taken += z * z
            taken += p * p * best_variance
            change = flip_weight(u, taken, W[s, i], flagged[i], want_flips)
            extra += change
            if want_flips:
                flips[i] += change * share
        if want_flips:
            flips[n] += share
        total += extra * share
        mean += extra * level_f
        square += extra * level_ff
    mean /= total
    return top + np.log(total), mean, max(square / total - mean * mean, 0.0)


@compiled_inner
def evaluate(
    arc: float, frame: Frame, levels: Levels, prior: BaseMoment, work: Work, want_flips: bool
) -> tuple[float, float, float]:
    """As `weigh`, of a normal force at `arc`; the work's `phi` receives its influence."""
    lever = influence(arc, frame.sensors, work.phi)
    return weigh(lever, work.phi, frame.y, levels, prior, work, want_flips)


@compiled_inner
def null_evidence(y: Array, levels: Levels, flips: Array) -> float:
    """Log evidence without a contact; `flips` (N + 1,) as in `weigh`."""
    _, _, flagged, W, white, fit, const = levels
    n = y.shape[0]
    flips[:] = 0.0
    top = -1e300
    total = 0.0
    for s in range(W.shape[0]):
        share = 1.0
        if const[s] > top:
            shrink = np.exp(top - const[s]) if s > 0 else 0.0
            total *= shrink
            flips *= shrink
            top = const[s]
        else:
            share = np.exp(const[s] - top)
        extra = 1.0
        for i in range(n):
            u = y[i]
            taken = 0.0
            for k in range(white.shape[2]):
                u -= white[s, i, k] * fit[s, k]
                taken += white[s, i, k] ** 2
            change = flip_weight(u, taken, W[s, i], flagged[i], True)
            extra += change
            flips[i] += change * share
        flips[n] += share
        total += extra * share
    evidence: float = top + np.log(total)
    return evidence
