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

import math

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization.influence import influence
from thigmo.localization.intervals import cell_mass, masses, median_between, modes, shortest
from thigmo.localization.prior import LEAST_LEVER

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# Log-density fall (nats) below the top at which cells are no longer refined.
REACH = 9.0
MAX_NODES = 900
COARSE = 49
# Prior of an unknown noise deviation times the length: 0.032 for flex sensors after averaging,
# 1e-3..1e-2 for fibre gratings.
SIGMA_MEDIAN = 0.01
SIGMA_FACTOR = 6.0
# Levels are first searched this many times farther apart.
COARSER = 3.0


@compiled
def prepare_levels(
    y: Array,
    variance: Array,
    sigma: Array,
    log_sigma_prior: Array,
    columns: Array,
    flagged: Flags,
    odds: float,
    kappa2: float,
    W: Array,
    white: Array,
    fit: Array,
    const: Array,
) -> None:
    """Integrate the nuisance columns out at each noise level, once for all arcs.

    Args:
        y: (N,) readings.
        variance: (N,) of each reading at noise level one.
        sigma: (S,) noise levels.
        log_sigma_prior: (S,) log weight of each.
        columns: (N, Q) nuisance columns times their prior deviations.
        flagged: (N,) readings taken for outliers.
        odds: prior odds of a reading being an outlier.
        kappa2: variance ratio of outliers.
        W: (S, N) written: precision of each reading.
        white: (S, N, Q) written: columns, whitened by their posterior factor.
        fit: (S, Q) written: whitened best nuisances without a contact.
        const: (S,) written: log marginal likelihood without a contact.
    """
    n = y.shape[0]
    q = columns.shape[1]
    gram = np.zeros((q, q))
    count = 0
    for i in range(n):
        if flagged[i]:
            count += 1
    for s in range(sigma.shape[0]):
        level = log_sigma_prior[s] + count * np.log(odds)
        total = 0.0
        for i in range(n):
            w = 1.0 / (variance[i] * sigma[s] * sigma[s])
            if flagged[i]:
                w /= kappa2
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
    t: Array,
    flips: Array,
    want_flips: bool,
) -> tuple[float, float, float]:
    """Log marginal likelihood of a force of known influence, with the force's mean and variance.

    `lever` is its moment at the base, `phi` (N,) its readings, both for a unit force.
    The base moment of the contact has the prior sum_k exp(log_weight_k) N(moment_k, spread_k^2).
    With `want_flips`, `flips` (N + 1,) gets the log weights of the present outlier pattern (last)
    and of each pattern that differs in one reading.

    Returns:
        log likelihood; posterior mean of the force; its posterior variance.
    """
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
            d = ((1.0 / kappa2 - 1.0) if flagged[i] else (kappa2 - 1.0)) / w
            grown = max(1.0 + d * h, 1e-12)
            gain = 0.5 * d * u * u / grown
            if flagged[i]:
                change = np.exp(min(gain, 300.0)) / (np.sqrt(grown) * odds)
            elif gain > 2.0 or want_flips:
                change = odds * np.exp(min(gain, 300.0)) / np.sqrt(grown)
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
    arc: float,
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
    phi: Array,
    t: Array,
    flips: Array,
    want_flips: bool,
) -> tuple[float, float, float]:
    """As `weigh`, of a normal force at `arc`; `phi` (N,) receives its influence."""
    lever = influence(arc, low, high, table, edges, phi)
    return weigh(
        lever,
        phi,
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
        t,
        flips,
        want_flips,
    )


@compiled
def null_evidence(
    y: Array,
    flagged: Flags,
    odds: float,
    kappa2: float,
    W: Array,
    white: Array,
    fit: Array,
    const: Array,
    flips: Array,
) -> float:
    """Log evidence without a contact; `flips` (N + 1,) as in `evaluate`."""
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
            d = ((1.0 / kappa2 - 1.0) if flagged[i] else (kappa2 - 1.0)) / w
            grown = max(1.0 + d * h, 1e-12)
            ratio = 1.0 / odds if flagged[i] else odds
            change = ratio * np.exp(min(0.5 * d * u * u / grown, 300.0)) / np.sqrt(grown)
            extra += change
            value = base + np.log(max(change, 1e-300))
            flips[i] = max(flips[i], value) + np.log1p(np.exp(-abs(flips[i] - value)))
        flips[n] = max(flips[n], base) + np.log1p(np.exp(-abs(flips[n] - base)))
        base += np.log(extra)
        top = max(top, base) + np.log1p(np.exp(-abs(top - base)))
    return top


@compiled
def robust_flags(
    y: Array,
    deviation: Array,
    low: Array,
    high: Array,
    table: Array,
    edges: Array,
    known: bool,
    contact: bool,
    flagged: Flags,
) -> None:
    """Flag the readings that lie off the best 1-norm fit by more than 3.5 deviations.

    A start for the search of outlier patterns that one bad reading cannot hide another from.
    With an unknown scale the deviation is taken from the residuals' median.
    """
    n = y.shape[0]
    residual = y.copy()
    if contact:
        phi = np.empty(n)
        ratio = np.empty(n)
        best = 1e300
        for g in range(1, 41):
            influence(g / 40.0, low, high, table, edges, phi)
            half = 0.0
            for i in range(n):
                ratio[i] = y[i] / phi[i] if phi[i] > 0.0 else 1e300
                half += 0.5 * phi[i] / deviation[i]
            order = np.argsort(ratio)
            seen = 0.0
            f = 0.0
            for r in range(n):
                i = order[r]
                seen += phi[i] / deviation[i]
                if seen >= half and phi[i] > 0.0:
                    f = ratio[i]
                    break
            objective = 0.0
            for i in range(n):
                objective += abs(y[i] - f * phi[i]) / deviation[i]
            if objective < best:
                best = objective
                for i in range(n):
                    residual[i] = y[i] - f * phi[i]
    size = np.abs(residual) / deviation
    unit = 1.0
    if not known:
        unit = max(1.4826 * np.median(size), 1e-300)
    count = 0
    for i in range(n):
        flagged[i] = size[i] > 3.5 * unit
        if flagged[i]:
            count += 1
    if 2 * count > n:
        flagged[:] = False


@compiled
def coarse_error(y: Array, step: float) -> float:
    """Deviation that half a grid step in the arc can feign in a reading, roughly."""
    error: float = 0.75 * step * np.abs(y).max()
    return error


@compiled
def climb_arc(
    start: float,
    end: float,
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
    phi: Array,
    t: Array,
    flips: Array,
) -> float:
    """Arc of the highest density between two arcs (golden section)."""
    ratio = 0.6180339887498949
    a = end - ratio * (end - start)
    b = start + ratio * (end - start)
    at_a, _, _ = evaluate(
        a,
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
    at_b, _, _ = evaluate(
        b,
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
    for _ in range(18):
        if at_a >= at_b:
            end = b
            b = a
            at_b = at_a
            a = end - ratio * (end - start)
            at_a, _, _ = evaluate(
                a,
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
        else:
            start = a
            a = b
            at_a = at_b
            b = start + ratio * (end - start)
            at_b, _, _ = evaluate(
                b,
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
    return a if at_a >= at_b else b


@compiled
def search_pattern(
    arcs: Array,
    low: Array,
    high: Array,
    table: Array,
    edges: Array,
    y: Array,
    variance: Array,
    known: bool,
    sigma: Array,
    log_sigma_prior: Array,
    columns: Array,
    odds: float,
    kappa2: float,
    moment: Array,
    spread: Array,
    log_weight: Array,
    contact: bool,
    flagged: Flags,
    W: Array,
    white: Array,
    fit: Array,
    const: Array,
    logp: Array,
    force: Array,
) -> float:
    """Climb to the outlier pattern with the most weight, one reading at a time.

    Readings much finer than the grid of arcs would all look like outliers on it: the place is then
    sought with the grid's own error added to the noise, and climbed to without it.

    Returns:
        The best log density over `arcs` (or the evidence without contact).
    """
    n = y.shape[0]
    q = columns.shape[1]
    phi = np.empty(n)
    t = np.empty(q)
    flips = np.empty(n + 1)
    top = -1e300
    count = arcs.shape[0]
    error = coarse_error(y, 1.0 / (count - 1.0)) ** 2
    fine = contact and known and error > 0.1 * variance.min()
    rough = variance + error
    for turn in range(n + 2):
        prepare_levels(
            y,
            rough if fine else variance,
            sigma,
            log_sigma_prior,
            columns,
            flagged,
            odds,
            kappa2,
            W,
            white,
            fit,
            const,
        )
        if contact:
            at = 0
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
                if logp[j] > logp[at]:
                    at = j
            if fine:
                prepare_levels(
                    y,
                    variance,
                    sigma,
                    log_sigma_prior,
                    columns,
                    flagged,
                    odds,
                    kappa2,
                    W,
                    white,
                    fit,
                    const,
                )
            best = n
            arc = arcs[at]
            # Only a reading that is off at the best arc itself is an outlier.
            for look in range(2):
                if look == 1 or fine or not known:
                    arc = climb_arc(
                        arcs[max(at - 1, 0)],
                        arcs[min(at + 1, count - 1)],
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
                    )
                top, _, _ = evaluate(
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
                    True,
                )
                best = n
                for i in range(n):
                    if flips[i] > flips[best] + 1e-9:
                        best = i
                if best == n or fine or not known:
                    break
        else:
            top = null_evidence(y, flagged, odds, kappa2, W, white, fit, const, flips)
            best = n
            for i in range(n):
                if flips[i] > flips[best] + 1e-9:
                    best = i
        if best == n or turn == n + 1:
            break
        if not flagged[best]:
            outliers = 1
            for i in range(n):
                if flagged[i]:
                    outliers += 1
            if 2 * outliers > n:
                break
        flagged[best] = not flagged[best]
    if fine:
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
    return top


@compiled
def best_pattern(
    arcs: Array,
    low: Array,
    high: Array,
    table: Array,
    edges: Array,
    y: Array,
    variance: Array,
    sigma: Array,
    log_sigma_prior: Array,
    columns: Array,
    odds: float,
    kappa2: float,
    moment: Array,
    spread: Array,
    log_weight: Array,
    contact: bool,
    known: bool,
    given: Flags,
    W: Array,
    white: Array,
    fit: Array,
    const: Array,
    logp: Array,
    force: Array,
) -> tuple[float, Flags]:
    """The better of two climbs: from no outlier, and from the 1-norm's outliers.

    Fills W, white, fit, const and logp for the winner.

    Returns:
        Best log density (or evidence); (N,) its flags.
    """
    n = y.shape[0]
    flagged = given.copy()
    top = search_pattern(
        arcs,
        low,
        high,
        table,
        edges,
        y,
        variance,
        known,
        sigma,
        log_sigma_prior,
        columns,
        odds,
        kappa2,
        moment,
        spread,
        log_weight,
        contact,
        flagged,
        W,
        white,
        fit,
        const,
        logp,
        force,
    )
    # A second start pays only where something is odd: an outlier was found, or the scale is free.
    odd = not known
    for i in range(n):
        odd = odd or flagged[i]
    if not odd:
        return top, flagged
    other = np.zeros(n, dtype=np.bool_)
    robust_flags(y, np.sqrt(variance) * sigma[0], low, high, table, edges, known, contact, other)
    same = True
    for i in range(n):
        same = same and other[i] == flagged[i]
    if same:
        return top, flagged
    rival = search_pattern(
        arcs,
        low,
        high,
        table,
        edges,
        y,
        variance,
        known,
        sigma,
        log_sigma_prior,
        columns,
        odds,
        kappa2,
        moment,
        spread,
        log_weight,
        contact,
        other,
        W,
        white,
        fit,
        const,
        logp,
        force,
    )
    if rival > top:
        return rival, other
    search_pattern(
        arcs,
        low,
        high,
        table,
        edges,
        y,
        variance,
        known,
        sigma,
        log_sigma_prior,
        columns,
        odds,
        kappa2,
        moment,
        spread,
        log_weight,
        contact,
        flagged,
        W,
        white,
        fit,
        const,
        logp,
        force,
    )
    return top, flagged


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


@compiled
def summary(
    arcs: Array, logp: Array, count: int, cumulative: Array, level: float
) -> tuple[float, float, float, Array]:
    """Median (of the heaviest mode), shortest interval and modes of a density on nodes.

    Returns:
        arc; interval low and high; (M, 3) modes.
    """
    start, end = shortest(arcs, logp, count, cumulative, level)
    pieces = np.empty((12, 3))
    found = modes(arcs, logp, count, cumulative, level, pieces)
    first = 0.0
    last = 1.0
    if found > 1:
        best = 0
        for m in range(found):
            if pieces[m, 2] > pieces[best, 2]:
                best = m
        first = pieces[best, 0]
        last = pieces[best, 1]
    arc = median_between(arcs, logp, count, cumulative, first, last)
    return arc, start, end, pieces[:found].copy()


@compiled
def mixed(arcs: Array, logp: Array, level: float) -> tuple[float, float, float, Array]:
    """Summary of any density on sorted nodes; `logp` is normalised in place."""
    cumulative = np.empty(arcs.shape[0])
    logp -= masses(arcs, logp, arcs.shape[0], cumulative)
    return summary(arcs, logp, arcs.shape[0], cumulative, level)


@compiled
def median(arcs: Array, logp: Array) -> float:
    """Median of any density on sorted nodes."""
    count = arcs.shape[0]
    cumulative = np.empty(count)
    masses(arcs, logp, count, cumulative)
    return median_between(arcs, logp, count, cumulative, 0.0, 1.0)


@compiled
def noise_levels(y: Array, variance: Array) -> tuple[Array, Array]:
    """Levels of an unknown noise scale over its whole range, COARSER times too far apart."""
    most = 0.0
    for i in range(y.shape[0]):
        most = max(most, abs(y[i]) / np.sqrt(variance[i]))
    top = np.log(max(3.0 * most, 1e-7))
    bottom = np.log(max(1e-5 * most, 1e-9))
    return levels_between(bottom, top, COARSER * level_step(y.shape[0]))


@compiled
def level_step(n: int) -> float:
    """Spacing of log noise levels that resolves what N readings can tell."""
    return min(0.35, 1.3 / math.sqrt(n))


@compiled
def levels_between(bottom: float, top: float, step: float) -> tuple[Array, Array]:
    """Noise levels and their log prior weights.

    Prior of sigma times length: log-normal, median SIGMA_MEDIAN, a factor SIGMA_FACTOR a
    deviation.
    """
    count = int((top - bottom) / step) + 2
    sigma = np.empty(count)
    log_prior = np.empty(count)
    scale = np.log(SIGMA_FACTOR)
    for s in range(count):
        x = bottom + s * step
        sigma[s] = np.exp(x)
        z = (x - np.log(SIGMA_MEDIAN)) / scale
        log_prior[s] = -0.5 * z * z + np.log(step / (scale * np.sqrt(2.0 * np.pi)))
    return sigma, log_prior


@compiled
def finer_levels(value: Array, sigma: Array, n: int) -> tuple[Array, Array]:
    """Levels at full resolution around those whose log weight `value` is within 9 of the best.

    A coarse grid of arcs overstates the noise of a narrow peak, so more room is left below.
    """
    best = value.max()
    first = value.shape[0] - 1
    last = 0
    for s in range(value.shape[0]):
        if value[s] > best - 9.0:
            first = min(first, s)
            last = max(last, s)
    step = level_step(n)
    bottom = np.log(sigma[first]) - 1.5 * COARSER * step
    top = np.log(sigma[last]) + 0.7 * COARSER * step
    return levels_between(bottom, top, step)


@compiled
def levels_with_mass(
    arcs: Array,
    logp: Array,
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
    sigma: Array,
    log_prior: Array,
) -> tuple[Array, Array]:
    """Fine noise levels around those that hold weight at some arc of the coarse grid."""
    n = y.shape[0]
    levels = sigma.shape[0]
    phi = np.empty(n)
    t = np.empty(white.shape[2])
    flips = np.empty(n + 1)
    value = np.full(levels, -1e300)
    top = logp[: arcs.shape[0]].max()
    for j in range(arcs.shape[0]):
        if logp[j] < top - 30.0:
            continue
        for s in range(levels):
            part, _, _ = evaluate(
                arcs[j],
                low,
                high,
                table,
                edges,
                y,
                flagged,
                odds,
                kappa2,
                W[s : s + 1],
                white[s : s + 1],
                fit[s : s + 1],
                const[s : s + 1],
                moment,
                spread,
                log_weight,
                phi,
                t,
                flips,
                False,
            )
            value[s] = max(value[s], part)
    return finer_levels(value, sigma, n)
