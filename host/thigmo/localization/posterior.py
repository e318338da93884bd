"""Posterior over the place of one contact, force integrated out, compiled.

Readings y_i = f phi_i(a) + nuisance columns + noise; everything is a fraction of the everted length
(curvature times length, arc over length). For a given arc the model is linear with Gaussian priors,
so force and nuisances (common offset, tip moment, fold) are integrated in closed form, and only
the arc is left: a one-dimensional density on an adaptive grid.

Noise: each reading is Gaussian with the calibrated deviation, or, with a small probability, an
outlier that is `sqrt(kappa2)` times wider. Efficient on clean readings (the outlier pattern then
has no weight) and robust with gross ones. Patterns of outliers are summed exactly around the best
one: that pattern and all that differ from it in one reading, by rank-one updates of the marginal
likelihood. An unknown noise scale is one more sum, over levels.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization.intervals import cell_mass, masses, summary
from thigmo.localization.marginal import evaluate, prepare_levels
from thigmo.localization.noise_levels import (
    level_step,
    levels_between,
    levels_with_mass,
    noise_levels,
)
from thigmo.localization.outlier_patterns import best_pattern

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# Log-density fall (nats) below the top at which cells are no longer refined.
REACH = 9.0
MAX_NODES = 900
COARSE = 49


@compiled
def refine(
    low: Array,
    high: Array,
    table: Array,
    edges: Array,
    y: Array,
    flagged: Flags,
    odds: float,
    kappa2: float,
    W: Array,
    white: Array,
    fit: Array,
    const: Array,
    moment: Array,
    spread: Array,
    log_weight: Array,
    arcs: Array,
    logp: Array,
    force: Array,
    count: int,
) -> int:
    """Halve cells until the density is resolved where it matters.

    A cell is split where the density is within REACH nats of the top and changes by more than
    1 nat or holds more than 5 % of the mass, and beside local maxima that may hide a higher one.
    `arcs`, `logp`, `force` (MAX_NODES,) hold `count` sorted nodes and are grown in place.

    Returns:
        The new count.
    """
    n = y.shape[0]
    phi = np.empty(n)
    t = np.empty(white.shape[2])
    flips = np.empty(n + 1)
    split = np.zeros(MAX_NODES, dtype=np.bool_)
    for _ in range(26):
        top = -1e300
        for j in range(count):
            top = max(top, logp[j])
        mass = 0.0
        for j in range(count - 1):
            mass += cell_mass(arcs[j + 1] - arcs[j], logp[j] - top, logp[j + 1] - top)
        added = 0
        for j in range(count - 1):
            width = arcs[j + 1] - arcs[j]
            left = logp[j] - top
            right = logp[j + 1] - top
            want = False
            if max(left, right) > -REACH:
                want = abs(left - right) > 1.0
                want = want or cell_mass(width, left, right) > 0.05 * mass
            if not want and width > 1e-9:
                # Beside a local maximum the peak may stand higher than its samples.
                for peak in range(j, j + 2):
                    before = logp[peak] - logp[peak - 1] if peak > 0 else 0.0
                    after = logp[peak] - logp[peak + 1] if peak < count - 1 else 0.0
                    if before >= 0.0 and after >= 0.0:
                        drop = max(before, after)
                        if drop > 0.5 and logp[peak] - top + 0.5 * drop > -REACH:
                            want = True
            if want and width < 1e-9:
                want = False
            split[j] = want and count + added + 1 < MAX_NODES
            if split[j]:
                added += 1
        if added == 0:
            break
        write = count + added - 1
        for j in range(count - 1, -1, -1):
            arcs[write] = arcs[j]
            logp[write] = logp[j]
            force[write] = force[j]
            write -= 1
            if j > 0 and split[j - 1]:
                arcs[write] = 0.5 * (arcs[j - 1] + arcs[j])
                logp[write], force[write], _ = evaluate(
                    arcs[write],
                    low,
                    high,
                    table,
                    edges,
                    y,
                    flagged,
                    odds,
                    kappa2,
                    W,
                    white,
                    fit,
                    const,
                    moment,
                    spread,
                    log_weight,
                    phi,
                    t,
                    flips,
                    False,
                )
                write -= 1
        count += added
    return count


@compiled
def one_contact(
    y: Array,
    low: Array,
    high: Array,
    variance: Array,
    known: bool,
    columns: Array,
    table: Array,
    edges: Array,
    moment: Array,
    spread: Array,
    log_weight: Array,
    odds: float,
    kappa2: float,
    level: float,
) -> tuple[
    float,
    float,
    float,
    float,
    float,
    float,
    float,
    float,
    float,
    Array,
    Array,
    Array,
    Array,
    Flags,
]:
    """Posterior of one contact, and the evidence with and without it.

    Args:
        y: (N,) readings above the free curvature.
        low: (N,) near end of each sensor.
        high: (N,) far end.
        variance: (N,) noise variance, or its shape when the scale is not known.
        known: whether `variance` is the variance itself.
        columns: (N, Q) nuisance columns times their prior deviations.
        table: (G, 5) shape of the body, no rows for a straight one.
        edges: (N, 4) of `sensor_edges`.
        moment: (K,) prior means of the contact's base moment.
        spread: (K,) prior deviations of it.
        log_weight: (K,) log weights of these.
        odds: prior odds of an outlier.
        kappa2: variance ratio of outliers.
        level: mass of the intervals.

    Returns:
        log evidence without and with the contact; arc; force; its deviation; interval low and
        high; noise; misfit (sum of squared residuals over variance); (M, 3) modes; nodes, log
        density (normalised) and force over them; (N,) outliers.
    """
    n = y.shape[0]
    q = columns.shape[1]
    if known:
        sigma = np.ones(1)
        log_prior = np.zeros(1)
    else:
        sigma, log_prior = noise_levels(y, variance)
        sigma, log_prior = levels_between(np.log(sigma[0]), np.log(sigma[-1]), level_step(n))
    levels = sigma.shape[0]
    W = np.empty((levels, n))
    white = np.empty((levels, n, q))
    fit = np.empty((levels, q))
    const = np.empty(levels)
    flagged = np.zeros(n, dtype=np.bool_)
    arcs = np.empty(MAX_NODES)
    logp = np.empty(MAX_NODES)
    force = np.empty(MAX_NODES)
    count = COARSE
    for j in range(count):
        arcs[j] = j / (count - 1.0)
    null, _ = best_pattern(
        arcs[:count],
        low,
        high,
        table,
        edges,
        y,
        variance,
        sigma,
        log_prior,
        columns,
        odds,
        kappa2,
        moment,
        spread,
        log_weight,
        False,
        known,
        flagged,
        W,
        white,
        fit,
        const,
        logp,
        force,
    )
    if not known:
        sigma, log_prior = noise_levels(y, variance)
        levels = sigma.shape[0]
        W = W[:levels]
        white = white[:levels]
        fit = fit[:levels]
        const = const[:levels]
    _, flagged = best_pattern(
        arcs[:count],
        low,
        high,
        table,
        edges,
        y,
        variance,
        sigma,
        log_prior,
        columns,
        odds,
        kappa2,
        moment,
        spread,
        log_weight,
        True,
        known,
        flagged,
        W,
        white,
        fit,
        const,
        logp,
        force,
    )
    phi = np.empty(n)
    t = np.empty(q)
    flips = np.empty(n + 1)
    if not known:
        sigma, log_prior = levels_with_mass(
            arcs[:count],
            logp,
            low,
            high,
            table,
            edges,
            y,
            flagged,
            odds,
            kappa2,
            W,
            white,
            fit,
            const,
            moment,
            spread,
            log_weight,
            sigma,
            log_prior,
        )
        levels = sigma.shape[0]
        W = np.empty((levels, n))
        white = np.empty((levels, n, q))
        fit = np.empty((levels, q))
        const = np.empty(levels)
        prepare_levels(
            y, variance, sigma, log_prior, columns, flagged, odds, kappa2, W, white, fit, const
        )
        for j in range(count):
            logp[j], force[j], _ = evaluate(
                arcs[j],
                low,
                high,
                table,
                edges,
                y,
                flagged,
                odds,
                kappa2,
                W,
                white,
                fit,
                const,
                moment,
                spread,
                log_weight,
                phi,
                t,
                flips,
                False,
            )
    count = refine(
        low,
        high,
        table,
        edges,
        y,
        flagged,
        odds,
        kappa2,
        W,
        white,
        fit,
        const,
        moment,
        spread,
        log_weight,
        arcs,
        logp,
        force,
        count,
    )
    cumulative = np.empty(count)
    evidence = masses(arcs, logp, count, cumulative)
    arc, start, end, pieces = summary(arcs, logp, count, cumulative, level)
    logp -= evidence
    _, strength, square = evaluate(
        arc,
        low,
        high,
        table,
        edges,
        y,
        flagged,
        odds,
        kappa2,
        W,
        white,
        fit,
        const,
        moment,
        spread,
        log_weight,
        phi,
        t,
        flips,
        False,
    )
    # Spread of the force: within the arc, and as it slides with the arc.
    slide = 0.0
    for j in range(count - 1):
        middle = 0.5 * (force[j] + force[j + 1]) - strength
        slide += (cumulative[j + 1] - cumulative[j]) * middle * middle
    # Noise level with the most weight at the arc, and the misfit there.
    s = 0
    if levels > 1:
        best = -1e300
        for k in range(levels):
            value, _, _ = evaluate(
                arc,
                low,
                high,
                table,
                edges,
                y,
                flagged,
                odds,
                kappa2,
                W[k : k + 1],
                white[k : k + 1],
                fit[k : k + 1],
                const[k : k + 1],
                moment,
                spread,
                log_weight,
                phi,
                t,
                flips,
                False,
            )
            if value > best:
                best = value
                s = k
    typical = 0.0
    misfit = 0.0
    for i in range(n):
        typical += variance[i] / n
        misfit -= W[s, i] * phi[i] * strength * (2.0 * y[i] - strength * phi[i])
        misfit += W[s, i] * y[i] * y[i]
    for k in range(q):
        part = fit[s, k]
        for i in range(n):
            part -= strength * W[s, i] * phi[i] * white[s, i, k]
        misfit -= part * part
    return (
        null,
        evidence,
        arc,
        strength,
        np.sqrt(square + slide),
        start,
        end,
        np.sqrt(typical) * sigma[s],
        misfit,
        pieces,
        arcs[:count].copy(),
        logp[:count].copy(),
        force[:count].copy(),
        flagged,
    )
