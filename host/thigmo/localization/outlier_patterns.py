"""The best pattern of outliers: searched from several starts, among them a robust fit's."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization.frame import Frame, Levels, Nodes, Tried, empty_levels
from thigmo.localization.influence import influence
from thigmo.localization.marginal import independent_evidence
from thigmo.localization.outlier_search import search_free, search_pattern
from thigmo.localization.prior import BaseMoment

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


@compiled
def robust_flags(frame: Frame, deviation: Array, contact: bool, flagged: Flags) -> None:
    """Flag the readings that lie off the best 1-norm fit by more than 3.5 deviations.

    A start for the search of outlier patterns that one bad reading cannot hide another from.
    With an unknown scale the deviation is taken from the residuals' median.
    """
    y = frame.y
    n = y.shape[0]
    residual = y.copy()
    if contact:
        phi = np.empty(n)
        ratio = np.empty(n)
        best = 1e300
        for g in range(1, 41):
            influence(g / 40.0, frame.sensors, phi)
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
    if not frame.known:
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
    nodes: Nodes, frame: Frame, levels: Levels, prior: BaseMoment, tried: Tried
) -> None:
    """The better of two climbs: from no outlier, and from the 1-norm's outliers.

    Fills the levels and the nodes for the winner.
    """
    flagged = levels.flagged
    flagged[:] = False
    top = search_pattern(nodes, frame, levels, prior, tried)
    # A second start pays only where something is odd: an outlier was found, or the scale is free.
    if frame.known and not flagged.any():
        return
    first = flagged.copy()
    robust_flags(frame, np.sqrt(frame.variance) * levels.sigma[0], True, flagged)
    if (flagged == first).all():
        return
    if search_pattern(nodes, frame, levels, prior, tried) > top:
        return
    flagged[:] = first
    search_pattern(nodes, frame, levels, prior, tried)


@compiled
def free_evidence(frame: Frame, sigma: Array, log_prior: Array, tried: Tried) -> float:
    """Log evidence without a contact: of all patterns, or of the better of two climbs as above."""
    if frame.columns.shape[1] == 0:
        return independent_evidence(frame, sigma, log_prior)
    levels = empty_levels(frame, sigma, log_prior)
    flagged = levels.flagged
    top = search_free(frame, levels, tried)
    if frame.known and not flagged.any():
        return top
    first = flagged.copy()
    robust_flags(frame, np.sqrt(frame.variance) * sigma[0], False, flagged)
    if (flagged == first).all():
        return top
    return max(top, search_free(frame, levels, tried))
