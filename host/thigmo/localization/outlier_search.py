"""The best pattern of outliers from one start, over arcs and noise levels, by climbing."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled, compiled_inner
from thigmo.localization.frame import Frame, Levels, Nodes, Work, empty_work
from thigmo.localization.marginal import evaluate, null_evidence, prepare_levels
from thigmo.localization.prior import BaseMoment

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


@compiled
def coarse_error(y: Array, step: float) -> float:
    """Deviation that half a grid step in the arc can feign in a reading, roughly."""
    error: float = 0.75 * step * np.abs(y).max()
    return error


@compiled_inner
def evaluate_all(nodes: Nodes, frame: Frame, levels: Levels, prior: BaseMoment, work: Work) -> int:
    """Fill the nodes' log likelihood and force; returns the node with the most."""
    best = 0
    for j in range(nodes.arcs.shape[0]):
        nodes.logp[j], nodes.force[j], _ = evaluate(
            nodes.arcs[j], frame, levels, prior, work, False
        )
        if nodes.logp[j] > nodes.logp[best]:
            best = j
    return best


@compiled_inner
def climb_arc(
    start: float, end: float, frame: Frame, levels: Levels, prior: BaseMoment, work: Work
) -> float:
    """Arc of the highest density between two arcs (golden section)."""
    ratio = 0.6180339887498949
    a = end - ratio * (end - start)
    b = start + ratio * (end - start)
    at_a, _, _ = evaluate(a, frame, levels, prior, work, False)
    at_b, _, _ = evaluate(b, frame, levels, prior, work, False)
    for _ in range(18):
        if at_a >= at_b:
            end = b
            b = a
            at_b = at_a
            a = end - ratio * (end - start)
            at_a, _, _ = evaluate(a, frame, levels, prior, work, False)
        else:
            start = a
            a = b
            at_a = at_b
            b = start + ratio * (end - start)
            at_b, _, _ = evaluate(b, frame, levels, prior, work, False)
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
def search_pattern(
    nodes: Nodes, frame: Frame, levels: Levels, prior: BaseMoment, contact: bool
) -> float:
    """Climb to the outlier pattern with the most weight, one reading at a time.

    Readings much finer than the grid of arcs would all look like outliers on it: the place is then
    sought with the grid's own error added to the noise, and climbed to without it.

    Args:
        nodes: filled if there is a contact.
        frame: what was read.
        levels: its `flagged` is the start and becomes the pattern that was found.
        prior: of the base moment.
        contact: whether there is one.

    Returns:
        The best log density over the arcs (or the evidence without contact).
    """
    n = frame.y.shape[0]
    work = empty_work(frame)
    flagged = levels.flagged
    top = -1e300
    count = nodes.arcs.shape[0]
    error = coarse_error(frame.y, 1.0 / (count - 1.0)) ** 2
    fine = contact and frame.known and error > 0.1 * frame.variance.min()
    for turn in range(n + 2):
        prepare_levels(frame, error if fine else 0.0, levels)
        if contact:
            at = evaluate_all(nodes, frame, levels, prior, work)
            if fine:
                prepare_levels(frame, 0.0, levels)
            best = n
            arc = nodes.arcs[at]
            # Only a reading that is off at the best arc itself is an outlier.
            for look in range(2):
                if look == 1 or fine or not frame.known:
                    before = nodes.arcs[max(at - 1, 0)]
                    after = nodes.arcs[min(at + 1, count - 1)]
                    arc = climb_arc(before, after, frame, levels, prior, work)
                top, _, _ = evaluate(arc, frame, levels, prior, work, True)
                best = heaviest(work.flips)
                if best == n or fine or not frame.known:
                    break
        else:
            top = null_evidence(frame.y, levels, work.flips)
            best = heaviest(work.flips)
        if best == n or turn == n + 1:
            break
        if not flagged[best] and too_many(flagged):
            break
        flagged[best] = not flagged[best]
    if fine:
        evaluate_all(nodes, frame, levels, prior, work)
    return top
