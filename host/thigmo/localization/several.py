"""Posterior over the places of one to three contacts, forces integrated out, compiled.

The same model, noise and priors as the posterior of one contact. The density over the ordered
places a_1 <= .. <= a_C is cut into cells (`place_cells`), whose masses are summed for the evidence
and for each contact's own density.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization.frame import Frame, Levels, empty_levels
from thigmo.localization.information import place_bound
from thigmo.localization.intervals import median_between, modes, shortest
from thigmo.localization.marginal import prepare_levels
from thigmo.localization.node_choices import (
    choice,
    empty_factor,
    fit_forces,
    misfit_at,
    pattern_weights,
    places_at,
)
from thigmo.localization.noise_levels import coarse_levels, finer_levels
from thigmo.localization.place_cells import Leaves, Model, cell_masses, cut
from thigmo.localization.prior import LEVEL, WIDTH_SHARE, BaseMoment

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]

# Change of the log density over a cell: for places and intervals, and for a look at the evidence.
FINE = 1.0
LOOK = 2.0
# Cells this far below the densest one are not asked whether the readings fix their places.
LOOSE_REACH = 2.5


class SeveralPosterior(NamedTuple):
    """What `several` finds of C contacts, in units of the length.

    Attributes:
        evidence: log.
        arcs, forces: (C,).
        intervals: (C, 2).
        pieces: (C, 12, 3) modes, and `modes` (C,) how many of them.
        nodes: (M,), and `density` (C, M) log marginal densities over them.
        flagged: (N,) outliers.
        noise: of one reading.
        loose: share of the posterior at places that the readings alone do not fix to within the
            width limit.
        misfit: sum of squared residuals over variance.
    """

    evidence: float
    arcs: Array
    forces: Array
    intervals: Array
    pieces: Array
    modes: Indices
    nodes: Array
    density: Array
    flagged: Flags
    noise: float
    loose: float
    misfit: float


@compiled
def settled(
    contacts: int,
    frame: Frame,
    prior: BaseMoment,
    stretch: float,
    tolerance: float,
) -> tuple[Leaves, Levels]:
    """Cells and noise levels under the best pattern of outliers, found one reading at a time."""
    n = frame.y.shape[0]
    sigma, log_prior = coarse_levels(frame)
    levels = empty_levels(frame, sigma, log_prior)
    pick = np.arange(contacts)
    factor = empty_factor(contacts)
    leveled = frame.known
    for turn in range(n + 4):
        model = Model(frame, levels, prior, stretch)
        leaves = cut(contacts, model, tolerance if leveled else LOOK)
        best = leaves.logp.argmax()
        places = places_at(leaves.arcs[best].copy(), frame, levels, stretch)
        flagged = levels.flagged
        if not leveled:
            # Keep the noise levels that matter from here on.
            value = np.empty(levels.sigma.shape[0])
            for s in range(value.shape[0]):
                value[s], _, _ = choice(pick, places, levels.const, prior, factor, s, s + 1)
            sigma, log_prior = finer_levels(value, levels.sigma, n)
            levels = empty_levels(frame, sigma, log_prior)
            levels.flagged[:] = flagged
            leveled = True
            continue
        _, s, _ = fit_forces(pick, places, levels.const, prior, factor)
        _, at, most = pattern_weights(pick, s, places, frame.y, levels, factor)
        if most <= 1.0 or turn == n + 3 or (not flagged[at] and 2 * (flagged.sum() + 1) > n):
            break
        flagged[at] = not flagged[at]
    return leaves, levels


@compiled
def several_evidence(contacts: int, frame: Frame, prior: BaseMoment) -> float:
    """Log evidence of `contacts` contacts, to a fraction of a nat."""
    leaves, _ = settled(contacts, frame, prior, 0.0, LOOK)
    _, total, top = cell_masses(leaves)
    evidence: float = top + np.log(total)
    return evidence


@compiled
def densities(leaves: Leaves, mass: Array) -> tuple[Array, Array, Array]:
    """Each contact's own density from the cells' masses (K,).

    Returns:
        (M,) nodes at the cells' borders; (C, M) log density there; (C, M) mass below.
    """
    count, c = leaves.arcs.shape
    finest = leaves.width.min()
    bins = int(np.rint(1.0 / finest))
    border = np.zeros(bins + 1, dtype=np.bool_)
    border[0] = True
    border[bins] = True
    step = np.zeros((c, bins + 1))
    total = mass.sum()
    for r in range(count):
        for j in range(c):
            width = leaves.width[r, j]
            size = int(np.rint(width / finest))
            first = int(np.rint((leaves.arcs[r, j] - 0.5 * width) / finest))
            height = mass[r] / (total * width)
            step[j, first] += height
            step[j, first + size] -= height
            border[first] = True
            border[first + size] = True
    at = np.flatnonzero(border)
    m = at.shape[0]
    nodes = at * finest
    logp = np.empty((c, m))
    below = np.zeros((c, m))
    for j in range(c):
        left = 0.0
        height = 0.0
        for k in range(m):
            for b in range(at[k - 1] + 1 if k > 0 else 0, at[k] + 1):
                height += step[j, b]
            right = max(height, 0.0)
            if k == 0:
                left = right
            if k == m - 1:
                right = left
            logp[j, k] = np.log(max(0.5 * (left + right), 1e-300))
            if k < m - 1:
                below[j, k + 1] = below[j, k] + right * (nodes[k + 1] - nodes[k])
            left = right
        below[j] /= below[j, m - 1]
    return nodes, logp, below


@compiled
def several(contacts: int, frame: Frame, prior: BaseMoment, stretch: float) -> SeveralPosterior:
    """Posterior of `contacts` contacts.

    Args:
        contacts: C.
        frame: what was read.
        prior: of each contact's moment at the base; their spreads count, not their means.
        stretch: half width of the stretch over which each contact spreads.
    """
    n = frame.y.shape[0]
    c = contacts
    leaves, levels = settled(c, frame, prior, stretch, FINE)
    prepare_levels(frame, 0.0, levels)
    mass, total, top = cell_masses(leaves)
    loose = 0.0
    asked = 0.0
    for r in range(mass.shape[0]):
        if leaves.logp[r] > top - LOOSE_REACH:
            W = levels.W[leaves.level[r]]
            bound = place_bound(leaves.arcs[r], leaves.force[r], frame.sensors, W, frame.columns)
            asked += mass[r]
            if not bound < WIDTH_SHARE:
                loose += mass[r]
    nodes, density, below = densities(leaves, mass)
    m = nodes.shape[0]
    arcs = np.empty(c)
    interval = np.empty((c, 2))
    pieces = np.zeros((c, 12, 3))
    found = np.empty(c, dtype=np.int64)
    for j in range(c):
        interval[j, 0], interval[j, 1] = shortest(nodes, density[j], m, below[j], LEVEL)
        found[j] = modes(nodes, density[j], m, below[j], LEVEL, pieces[j])
        start = 0.0
        end = 1.0
        if found[j] > 1:
            best = 0
            for k in range(found[j]):
                if pieces[j, k, 2] > pieces[j, best, 2]:
                    best = k
            start = pieces[j, best, 0]
            end = pieces[j, best, 1]
        arcs[j] = median_between(nodes, density[j], m, below[j], start, end)
    # Forces at the reported arcs.
    pick = np.arange(c)
    factor = empty_factor(c)
    places = places_at(arcs, frame, levels, stretch)
    _, s, _ = fit_forces(pick, places, levels.const, prior, factor)
    typical = 0.0
    for i in range(n):
        typical += frame.variance[i] / n
    return SeveralPosterior(
        top + np.log(total),
        arcs,
        factor.force,
        interval,
        pieces,
        found,
        nodes,
        density,
        levels.flagged,
        np.sqrt(typical) * levels.sigma[s],
        loose / asked,
        misfit_at(pick, s, places, frame.y, levels, factor),
    )
