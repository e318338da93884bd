"""Whether a second contact could matter at all: the evidence of two on a coarse grid, compiled.

A sum over all pairs of nodes, forces integrated out. The look at the evidence of two contacts that
`several` takes resolves the density, at a hundred times the cost.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled, compiled_inner
from thigmo.localization.frame import TOGETHER, Frame, Levels, Tried, empty_levels, empty_tried
from thigmo.localization.influence import influences
from thigmo.localization.marginal import prepare_levels
from thigmo.localization.outlier_search import coarse_error
from thigmo.localization.prior import LEAST_FOR_TWO, LEAST_LEVER, BaseMoment, least_misfit

Flags = npt.NDArray[np.bool_]

# Nodes of the grid.
NODES = 49
# Pairs that explain less than the best place alone does, by more than this (nats), are left out.
REACH = 6.0
# Two contacts that are both of so rare a size do not matter here.
RARE = 0.01
# What the grid may miss of the evidence (nats), and patterns with a further outlier add.
ROOM = 0.4


@compiled_inner
def _products(count: int, frame: Frame, levels: Levels, tried: Tried) -> None:
    """Each node's precision and product with the readings, columns taken out: `room` 0 and 1."""
    y = frame.y
    n, q = frame.columns.shape
    square, told = tried.room[0], tried.room[1]
    for j in range(count):
        square[j] = 0.0
        told[j] = 0.0
    for i in range(n):
        w = levels.W[0, i]
        for j in range(count):
            square[j] += w * tried.phi[i, j] * tried.phi[i, j]
            told[j] += w * y[i] * tried.phi[i, j]
    for k in range(q):
        for j in range(count):
            tried.t[k, j] = 0.0
        for i in range(n):
            w = levels.W[0, i] * levels.white[0, i, k]
            for j in range(count):
                tried.t[k, j] += w * tried.phi[i, j]
        for j in range(count):
            square[j] -= tried.t[k, j] * tried.t[k, j]
            told[j] -= tried.t[k, j] * levels.fit[0, k]
    for j in range(count):
        square[j] = max(square[j], 1e-300)


@compiled_inner
def _shared(a: int, count: int, frame: Frame, levels: Levels, tried: Tried) -> None:
    """Products of node `a` with the later ones, columns taken out: `room` 2."""
    shared = tried.room[2]
    n, q = frame.columns.shape
    for j in range(a + 1, count):
        shared[j] = 0.0
    for i in range(n):
        w = levels.W[0, i] * tried.phi[i, a]
        for j in range(a + 1, count):
            shared[j] += w * tried.phi[i, j]
    for k in range(q):
        for j in range(a + 1, count):
            shared[j] -= tried.t[k, a] * tried.t[k, j]


@compiled_inner
def _weights(
    a: int, count: int, own: float, spread: float, share: float, top: float, tried: Tried
) -> float:
    """Sum of the marginal likelihoods of node `a` with all later ones, over exp(top).

    Args:
        a, count: nodes.
        own: prior precision of the force at `a`.
        spread: prior deviation of the later one's moment at the base.
        share: weight of these parts of the prior.
        top: pairs that stay REACH below it are left out.
        tried: with `room` 0 to 2 filled.
    """
    square, told, shared = tried.room[0], tried.room[1], tried.room[2]
    gain, size = tried.room[3], tried.room[4]
    precise = square[a] + own
    for j in range(a + 1, count):
        lever = max(abs(tried.lever[j]), LEAST_LEVER) / spread
        later = square[j] + lever * lever
        det = precise * later - shared[j] * shared[j]
        total = later * told[a] * told[a] + precise * told[j] * told[j]
        gain[j] = 0.5 * (total - 2.0 * shared[j] * told[a] * told[j]) / det - top
        size[j] = lever / math.sqrt(det)
    out = 0.0
    for j in range(a + 1, count):
        if gain[j] > -REACH:
            out += size[j] * math.exp(gain[j])
    return share * math.sqrt(own) * out


@compiled_inner
def evidence_on_grid(
    count: int, frame: Frame, levels: Levels, prior: BaseMoment, tried: Tried
) -> float:
    """Log evidence of two contacts, where the density is no finer than the grid.

    Args:
        count: nodes of a uniform grid over the body.
        frame: what was read.
        levels: a single noise level, with its outliers.
        prior: of each contact's moment at the base; their spreads count, not their means.
        tried: room for the nodes.
    """
    for j in range(count):
        tried.arc[j] = j / (count - 1.0)
    influences(count, tried.arc, frame.sensors, tried.lever, tried.phi, tried.room)
    _products(count, frame, levels, tried)
    square, told = tried.room[0], tried.room[1]
    top = 0.0
    for j in range(count):
        top = max(top, 0.5 * told[j] * told[j] / square[j])
    total = 0.0
    parts = prior.spread.shape[0]
    for a in range(count - 1):
        _shared(a, count, frame, levels, tried)
        lever = max(abs(tried.lever[a]), LEAST_LEVER)
        for c in range(parts):
            own = (lever / prior.spread[c]) ** 2
            for d in range(parts):
                share = prior.weight[c] * prior.weight[d]
                if share >= RARE:
                    total += _weights(a, count, own, prior.spread[d], share, top, tried)
    pairs = 0.5 * count * (count - 1)
    evidence: float = levels.const[0] + top + math.log(max(total / pairs, 1e-300))
    return evidence


@compiled
def limit_of_two(frame: Frame, prior: BaseMoment, misfit: float, flagged: Flags) -> float:
    """What the log evidence of two contacts does not pass; inf where only a look at it can tell.

    Args:
        frame: what was read.
        prior: of each contact's moment at the base.
        misfit: what one contact leaves.
        flagged: (N,) outliers beside one contact.
    """
    n = frame.y.shape[0]
    if n < LEAST_FOR_TWO:
        return -np.inf
    if not frame.known or flagged.any():
        return np.inf
    if misfit <= least_misfit(n):
        return -np.inf
    if coarse_error(frame.y, 1.0 / (NODES - 1.0)) ** 2 > 0.1 * frame.variance.min():
        return np.inf
    levels = empty_levels(frame, np.ones(1), np.zeros(1))
    prepare_levels(frame, 0.0, levels)
    tried = empty_tried(frame, TOGETHER)
    evidence: float = evidence_on_grid(NODES, frame, levels, prior, tried)
    return evidence + ROOM
