"""The best pattern of outliers: searched from several starts, among them a robust fit's."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization.influence import influence
from thigmo.localization.outlier_search import search_pattern

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


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
