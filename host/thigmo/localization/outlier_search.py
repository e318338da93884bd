"""The best pattern of outliers from one start, over arcs and noise levels, by climbing."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization.marginal import evaluate, null_evidence, prepare_levels

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


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
