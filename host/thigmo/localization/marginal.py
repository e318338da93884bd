"""Marginal likelihood of one contact at one arc: force and nuisance columns integrated out.

For a given arc the model is linear with Gaussian priors, so the integral is in closed form, and all
outlier patterns that differ from a given one in one reading come by rank-one updates.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization.frame import Frame, Levels, Work
from thigmo.localization.influence import influence
from thigmo.localization.prior import LEAST_LEVER, OUTLIER_ODDS, OUTLIER_VARIANCE, BaseMoment

Array = npt.NDArray[np.float64]


@compiled
def prepare_levels(frame: Frame, variance: Array, levels: Levels) -> None:
    """Integrate the nuisance columns out at each noise level, once for all arcs.

    Args:
        frame: readings and columns.
        variance: (N,) of each reading at noise level one; the frame's own, or more where a grid of
            arcs adds an error.
        levels: `sigma`, `log_prior` and `flagged` are read; the rest is written.
    """
    y = frame.y
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
            w = 1.0 / (variance[i] * sigma[s] * sigma[s])
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


@compiled
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
    was read. With `want_flips`, the work's `flips` get the log weights of the present outlier
    pattern and of each that differs in one reading.

    Returns:
        log likelihood; posterior mean of the force; its posterior variance.
    """
    _, _, flagged, W, white, fit, const = levels
    moment, spread, log_weight = prior
    t = work.t
    flips = work.flips
    n = y.shape[0]
    q = white.shape[2]
    components = moment.shape[0]
    scale = 1.0 / max(abs(lever), LEAST_LEVER)
    top = -1e300
    total = 0.0
    mean = 0.0
    square = 0.0
    if want_flips:
        for i in range(n + 1):
            flips[i] = -1e300
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
        best = -1e300
        best_f = 0.0
        best_G = 1.0
        level_top = -1e300
        level_sum = 0.0
        level_f = 0.0
        level_ff = 0.0
        for c in range(components):
            tau = spread[c] * scale
            f0 = moment[c] * scale
            # Around the prior's mean: y - f0 phi.
            b0 = b - f0 * A
            G = A + 1.0 / (tau * tau)
            value = log_weight[c] - 0.5 * np.log1p(tau * tau * A)
            value += f0 * b - 0.5 * f0 * f0 * A + 0.5 * b0 * b0 / G
            f = f0 + b0 / G
            if value > best:
                best = value
                best_f = f
                best_G = G
            if value > level_top:
                shrink = np.exp(level_top - value)
                level_sum = level_sum * shrink + 1.0
                level_f = level_f * shrink + f
                level_ff = level_ff * shrink + f * f + 1.0 / G
                level_top = value
            else:
                share = np.exp(value - level_top)
                level_sum += share
                level_f += share * f
                level_ff += share * (f * f + 1.0 / G)
        extra = 1.0
        base = const[s] + level_top + np.log(level_sum)
        for i in range(n):
            w = W[s, i]
            u = y[i] - best_f * phi[i]
            p = phi[i]
            h = 0.0
            for k in range(q):
                z = white[s, i, k]
                u -= z * (fit[s, k] - best_f * t[k])
                p -= z * t[k]
                h += z * z
            u *= w
            h = w - w * w * (h + p * p / best_G)
            d = ((1.0 / OUTLIER_VARIANCE - 1.0) if flagged[i] else (OUTLIER_VARIANCE - 1.0)) / w
            grown = max(1.0 + d * h, 1e-12)
            gain = 0.5 * d * u * u / grown
            if flagged[i]:
                change = np.exp(min(gain, 300.0)) / (np.sqrt(grown) * OUTLIER_ODDS)
            elif gain > 2.0 or want_flips:
                change = OUTLIER_ODDS * np.exp(min(gain, 300.0)) / np.sqrt(grown)
            else:
                continue
            extra += change
            if want_flips:
                log_change = base + np.log(max(change, 1e-300))
                flips[i] = max(flips[i], log_change) + np.log1p(np.exp(-abs(flips[i] - log_change)))
        if want_flips:
            flips[n] = max(flips[n], base) + np.log1p(np.exp(-abs(flips[n] - base)))
        base += np.log(extra)
        f = level_f / level_sum
        ff = level_ff / level_sum
        if base > top:
            shrink = np.exp(top - base)
            total = total * shrink + 1.0
            mean = mean * shrink + f
            square = square * shrink + ff
            top = base
        else:
            share = np.exp(base - top)
            total += share
            mean += share * f
            square += share * ff
    mean /= total
    return top + np.log(total), mean, max(square / total - mean * mean, 0.0)


@compiled
def evaluate(
    arc: float, frame: Frame, levels: Levels, prior: BaseMoment, work: Work, want_flips: bool
) -> tuple[float, float, float]:
    """As `weigh`, of a normal force at `arc`; the work's `phi` receives its influence."""
    lever = influence(arc, frame.sensors, work.phi)
    return weigh(lever, work.phi, frame.y, levels, prior, work, want_flips)


@compiled
def null_evidence(y: Array, levels: Levels, flips: Array) -> float:
    """Log evidence without a contact; `flips` (N + 1,) as in `weigh`."""
    _, _, flagged, W, white, fit, const = levels
    n = y.shape[0]
    q = white.shape[2]
    for i in range(n + 1):
        flips[i] = -1e300
    top = -1e300
    for s in range(W.shape[0]):
        base = const[s]
        extra = 1.0
        for i in range(n):
            w = W[s, i]
            u = y[i]
            h = 0.0
            for k in range(q):
                u -= white[s, i, k] * fit[s, k]
                h += white[s, i, k] ** 2
            u *= w
            h = w - w * w * h
            d = ((1.0 / OUTLIER_VARIANCE - 1.0) if flagged[i] else (OUTLIER_VARIANCE - 1.0)) / w
            grown = max(1.0 + d * h, 1e-12)
            ratio = 1.0 / OUTLIER_ODDS if flagged[i] else OUTLIER_ODDS
            change = ratio * np.exp(min(0.5 * d * u * u / grown, 300.0)) / np.sqrt(grown)
            extra += change
            value = base + np.log(max(change, 1e-300))
            flips[i] = max(flips[i], value) + np.log1p(np.exp(-abs(flips[i] - value)))
        flips[n] = max(flips[n], base) + np.log1p(np.exp(-abs(flips[n] - base)))
        base += np.log(extra)
        top = max(top, base) + np.log1p(np.exp(-abs(top - base)))
    return top
