"""Marginal likelihood of one contact at given arcs: force and nuisance columns integrated out.

For a given arc the model is linear with Gaussian priors, so the integral is in closed form, and all
outlier patterns that differ from a given one in one reading come by rank-one updates.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled, compiled_inner
from thigmo.localization.frame import Frame, Levels, Tried
from thigmo.localization.influence import influences
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


# Flips that gain less than this (nats, before their odds) are not worth it, nor those at places
# that stay this far below the best one with them.
NEAR = 2.0
HOPELESS = 14.0


@compiled_inner
def flip_weight(residual: float, taken: float, w: float, flagged: bool, every: bool) -> float:
    """Weight of the outlier pattern that differs in one reading, over that of the present one.

    A rank-one update. Without `every`, 0 for a reading that lies too near (by less than NEAR nats)
    to be worth it.

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
    if not (flagged or every) and 0.5 * d * size <= NEAR * grown:
        return 0.0
    change: float = odds * np.exp(min(0.5 * d * size / grown, 300.0)) / np.sqrt(grown)
    return change


@compiled_inner
def _products(count: int, s: int, y: Array, levels: Levels, tried: Tried) -> None:
    """What the readings say of the force at each place, at noise level `s`, columns taken out.

    Its precision and that times the force they ask for are the first two rows of `room`.
    """
    W, white, fit = levels.W, levels.white, levels.fit
    phi, t = tried.phi, tried.t
    A, b = tried.room[0], tried.room[1]
    A[:count] = 0.0
    b[:count] = 0.0
    for i in range(y.shape[0]):
        w = W[s, i]
        wy = w * y[i]
        for j in range(count):
            A[j] += w * phi[i, j] * phi[i, j]
            b[j] += wy * phi[i, j]
    for k in range(white.shape[2]):
        t[k, :count] = 0.0
        for i in range(y.shape[0]):
            wz = W[s, i] * white[s, i, k]
            for j in range(count):
                t[k, j] += wz * phi[i, j]
        for j in range(count):
            A[j] -= t[k, j] * t[k, j]
            b[j] -= t[k, j] * fit[s, k]


@compiled_inner
def _best_flips(count: int, s: int, y: Array, levels: Levels, tried: Tried) -> None:
    """Into the third row of `room`: what the best flip of one reading may gain (nats).

    Its odds are left out. Judged at the force and the variance in the fourth and the fifth row.
    """
    flagged, W, white, fit = levels.flagged, levels.W, levels.white, levels.fit
    phi, t = tried.phi, tried.t
    gain, force, variance = tried.room[2], tried.room[3], tried.room[4]
    gain[:count] = 0.0
    d = OUTLIER_VARIANCE - 1.0
    for i in range(y.shape[0]):
        w = W[s, i]
        rest = y[i]
        taken = 0.0
        for k in range(white.shape[2]):
            rest -= white[s, i, k] * fit[s, k]
            taken += white[s, i, k] * white[s, i, k]
        if flagged[i]:
            # Back among the others it gains no more than its odds.
            for j in range(count):
                gain[j] = max(gain[j], -np.log(OUTLIER_ODDS))
            continue
        for j in range(count):
            p = phi[i, j]
            for k in range(white.shape[2]):
                p -= white[s, i, k] * t[k, j]
            u = rest - force[j] * p
            grown = max(1.0 + d * (1.0 - w * (taken + p * p * variance[j])), 1e-12)
            gain[j] = max(gain[j], 0.5 * d * w * u * u / grown)


@compiled_inner
def _flipped(
    j: int, s: int, y: Array, levels: Levels, tried: Tried, share: float, want_flips: bool
) -> float:
    """Sum of the weights of all patterns that differ in one reading, over the present one's.

    With `want_flips` each is added to `flips`, times `share`.
    """
    flagged, W, white, fit = levels.flagged, levels.W, levels.white, levels.fit
    phi, t = tried.phi, tried.t
    force, variance = tried.room[3, j], tried.room[4, j]
    total = 0.0
    for i in range(y.shape[0]):
        u = y[i]
        p = phi[i, j]
        taken = 0.0
        for k in range(white.shape[2]):
            z = white[s, i, k]
            u -= z * fit[s, k]
            p -= z * t[k, j]
            taken += z * z
        u -= force * p
        taken += p * p * variance
        change = flip_weight(u, taken, W[s, i], flagged[i], want_flips)
        total += change
        if want_flips:
            tried.flips[i] += change * share
    return total


@compiled_inner
def weigh(
    count: int, y: Array, levels: Levels, prior: BaseMoment, tried: Tried, want_flips: bool
) -> None:
    """Log marginal likelihood of a force at each of `count` places, with its mean and variance.

    Args:
        count: M or fewer.
        y: (N,) what was read.
        levels: at which noise, with which outliers.
        prior: of the force's moment at the base.
        tried: `lever` and `phi` are read; `logp`, `force` and `variance` are written.
        want_flips: whether to write `flips` too, of the first place.
    """
    moment, spread, weight = prior
    A, b, gain, best_f, best_variance = (
        tried.room[0], tried.room[1], tried.room[2], tried.room[3], tried.room[4]
    )  # fmt: skip
    # Sums of terms share * exp(top): exponents apart from factors, so that one logarithm will do.
    top, total, own_top = tried.room[5], tried.room[6], tried.room[7]
    own, own_f, own_ff = tried.room[8], tried.room[9], tried.room[10]
    mean, square = tried.force, tried.variance
    flips = tried.flips
    if want_flips:
        flips[:] = 0.0
    for s in range(levels.W.shape[0]):
        _products(count, s, y, levels, tried)
        for j in range(count):
            scale = 1.0 / max(abs(tried.lever[j]), LEAST_LEVER)
            precision = max(A[j], 0.0)
            best = 0.0
            level_top = -1e300
            level_sum = 0.0
            level_f = 0.0
            level_ff = 0.0
            for c in range(spread.shape[0]):
                tau = spread[c] * scale
                f0 = moment[c] * scale
                # Around the prior's mean: y - f0 phi.
                b0 = b[j] - f0 * precision
                shrunk = 1.0 / (1.0 + tau * tau * precision)
                variance = tau * tau * shrunk
                exponent = f0 * b[j] - 0.5 * f0 * f0 * precision + 0.5 * b0 * b0 * variance
                share = weight[c] * np.sqrt(shrunk)
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
                    best_f[j] = f
                    best_variance[j] = variance
                level_sum += share
                level_f += share * f
                level_ff += share * (f * f + variance)
            own_top[j] = levels.const[s] + level_top
            own[j] = level_sum
            own_f[j] = level_f
            own_ff[j] = level_ff
        _best_flips(count, s, y, levels, tried)
        most = own_top[0]
        for j in range(count):
            most = max(most, own_top[j])
        hopeless = most - HOPELESS - np.log(OUTLIER_ODDS)
        for j in range(count):
            share = 1.0
            if s == 0 or own_top[j] > top[j]:
                shrink = np.exp(top[j] - own_top[j]) if s > 0 else 0.0
                total[j] = total[j] * shrink if s > 0 else 0.0
                mean[j] = mean[j] * shrink if s > 0 else 0.0
                square[j] = square[j] * shrink if s > 0 else 0.0
                if want_flips and j == 0:
                    flips *= shrink
                top[j] = own_top[j]
            else:
                share = np.exp(own_top[j] - top[j])
            extra = share
            if want_flips or (gain[j] > NEAR and own_top[j] + gain[j] > hopeless):
                extra += share * _flipped(j, s, y, levels, tried, share * own[j], want_flips)
            if want_flips and j == 0:
                flips[y.shape[0]] += share * own[j]
            total[j] += extra * own[j]
            mean[j] += extra * own_f[j]
            square[j] += extra * own_ff[j]
    for j in range(count):
        mean[j] /= total[j]
        square[j] = max(square[j] / total[j] - mean[j] * mean[j], 0.0)
        tried.logp[j] = top[j] + np.log(total[j])


@compiled_inner
def evaluate(
    count: int, frame: Frame, levels: Levels, prior: BaseMoment, tried: Tried, want_flips: bool
) -> None:
    """As `weigh`, of normal forces at the places in `arc`."""
    influences(count, tried.arc, frame.sensors, tried.lever, tried.phi, tried.room)
    weigh(count, frame.y, levels, prior, tried, want_flips)


@compiled_inner
def evaluate_at(
    arc: float, frame: Frame, levels: Levels, prior: BaseMoment, tried: Tried, want_flips: bool
) -> float:
    """`evaluate` of one place, the first in `tried`; returns its log marginal likelihood."""
    tried.arc[0] = arc
    evaluate(1, frame, levels, prior, tried, want_flips)
    logp: float = tried.logp[0]
    return logp


@compiled
def independent_evidence(frame: Frame, sigma: Array, log_prior: Array) -> float:
    """Log evidence without a contact where there are no columns: the sum over all patterns.

    Nothing then ties the readings together, so that it is a product. As with a contact, half of the
    readings and one more may be outliers: beyond that, those that gain least by it are none.
    """
    n = frame.y.shape[0]
    top = -1e300
    total = 0.0
    broader = OUTLIER_ODDS / np.sqrt(OUTLIER_VARIANCE)
    gain = np.empty(n)
    for s in range(sigma.shape[0]):
        value = log_prior[s]
        outliers = 0
        for i in range(n):
            w = 1.0 / (frame.variance[i] * sigma[s] * sigma[s])
            size = 0.5 * w * frame.y[i] * frame.y[i]
            value += 0.5 * np.log(w) - size
            wide = size * (1.0 - 1.0 / OUTLIER_VARIANCE)
            if wide < 30.0:
                gain[i] = np.log(1.0 + broader * np.exp(wide))
            else:
                gain[i] = wide + np.log(broader)
            if gain[i] > np.log(2.0):
                outliers += 1
        most = n // 2 + 1
        if outliers > most:
            gain.sort()
            gain[: n - most] = 0.0
        value += gain.sum()
        if value > top:
            total *= np.exp(top - value) if s > 0 else 0.0
            top = value
        total += np.exp(value - top)
    evidence: float = top + np.log(total)
    return evidence


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
