"""The best pattern of outliers from one start, over arcs and noise levels, by climbing."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled, compiled_inner
from thigmo.localization.frame import TOGETHER, Frame, Levels, Nodes, Tried
from thigmo.localization.marginal import evaluate, evaluate_at, null_evidence, prepare_levels
from thigmo.localization.prior import BaseMoment

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


@compiled
def coarse_error(y: Array, step: float) -> float:
    """Deviation that half a grid step in the arc can feign in a reading, roughly."""
    error: float = 0.75 * step * np.abs(y).max()
    return error


@compiled_inner
def evaluate_all(
    nodes: Nodes, frame: Frame, levels: Levels, prior: BaseMoment, tried: Tried
) -> int:
    """Fill the nodes' log likelihood and force; returns the node with the most."""
    arcs, logp, force = nodes
    best = 0
    first = 0
    while first < arcs.shape[0]:
        count = min(arcs.shape[0] - first, TOGETHER)
        for j in range(count):
            tried.arc[j] = arcs[first + j]
        evaluate(count, frame, levels, prior, tried, False)
        for j in range(count):
            logp[first + j] = tried.logp[j]
            force[first + j] = tried.force[j]
            if logp[first + j] > logp[best]:
                best = first + j
        first += count
    return best


@compiled_inner
def climb_arc(
    start: float, end: float, frame: Frame, levels: Levels, prior: BaseMoment, tried: Tried
) -> float:
    """Arc of the highest density between two arcs (golden section)."""
    ratio = 0.6180339887498949
    a = end - ratio * (end - start)
    b = start + ratio * (end - start)
    at_a = evaluate_at(a, frame, levels, prior, tried, False)
    at_b = evaluate_at(b, frame, levels, prior, tried, False)
    for _ in range(18):
        if at_a >= at_b:
            end = b
            b = a
            at_b = at_a
            a = end - ratio * (end - start)
            at_a = evaluate_at(a, frame, levels, prior, tried, False)
        else:
            start = a
            a = b
            at_a = at_b
            b = start + ratio * (end - start)
            at_b = evaluate_at(b, frame, levels, prior, tried, False)
    return a if at_a >= at_b else b


@compiled_inner
def heaviest(flips: Array) -> int:
    """The pattern with the most weight; the present one unless another is clearly better."""
    best: int = flips.shape[0] - 1
    for i in range(flips.shape[0] - 1):
        if flips[i] > flips[best] * (1.0 + 1e-9):
            best = i
    return best


@compiled
def too_many(flagged: Flags) -> bool:
    """Whether with one more outlier most readings would be outliers."""
    outliers: int = 1 + flagged.sum()
    return 2 * outliers > len(flagged)


@compiled
def changed(flips: Array, flagged: Flags) -> bool:
    """Move to the heaviest pattern of outliers; false if that is the present one or not allowed."""
    best = heaviest(flips)
    if best == len(flagged) or (not flagged[best] and too_many(flagged)):
        return False
    flagged[best] = not flagged[best]
    return True


@compiled
def search_pattern(
    nodes: Nodes, frame: Frame, levels: Levels, prior: BaseMoment, tried: Tried
) -> float:
    """Climb to the outlier pattern with the most weight, one reading at a time.

    Readings much finer than the grid of arcs would all look like outliers on it: the place is then
    sought with the grid's own error added to the noise, and climbed to without it.

    Args:
        nodes: filled.
        frame: what was read.
        levels: its `flagged` is the start and becomes the pattern that was found.
        prior: of the base moment.
        tried: room.

    Returns:
        The best log density over the arcs.
    """
    n = frame.y.shape[0]
    top = -1e300
    count = nodes.arcs.shape[0]
    error = coarse_error(frame.y, 1.0 / (count - 1.0)) ** 2
    fine = frame.known and error > 0.1 * frame.variance.min()
    for turn in range(n + 2):
        prepare_levels(frame, error if fine else 0.0, levels)
        at = evaluate_all(nodes, frame, levels, prior, tried)
        if fine:
            prepare_levels(frame, 0.0, levels)
        arc = nodes.arcs[at]
        # Only a reading that is off at the best arc itself is an outlier.
        for look in range(2):
            if look == 1 or fine or not frame.known:
                before = nodes.arcs[max(at - 1, 0)]
                after = nodes.arcs[min(at + 1, count - 1)]
                arc = climb_arc(before, after, frame, levels, prior, tried)
            top = evaluate_at(arc, frame, levels, prior, tried, True)
            if heaviest(tried.flips) == n or fine or not frame.known:
                break
        if turn == n + 1 or not changed(tried.flips, levels.flagged):
            break
    if fine:
        evaluate_all(nodes, frame, levels, prior, tried)
    return top


@compiled
def search_free(frame: Frame, levels: Levels, tried: Tried) -> float:
    """As `search_pattern` without a contact; returns the log evidence."""
    top = -1e300
    for _ in range(frame.y.shape[0] + 2):
        prepare_levels(frame, 0.0, levels)
        top = null_evidence(frame.y, levels, tried.flips)
        if not changed(tried.flips, levels.flagged):
            break
    return top
