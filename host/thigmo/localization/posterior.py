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
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled, compiled_inner
from thigmo.localization.frame import (
    TOGETHER,
    Frame,
    Levels,
    Nodes,
    Tried,
    empty_levels,
    empty_tried,
)
from thigmo.localization.information import place_bound
from thigmo.localization.intervals import cell_mass, masses, summary
from thigmo.localization.marginal import evaluate, evaluate_at, prepare_levels
from thigmo.localization.noise_levels import (
    all_levels,
    coarse_levels,
    level_weights,
    levels_with_mass,
)
from thigmo.localization.outlier_patterns import best_pattern, free_evidence
from thigmo.localization.outlier_search import evaluate_all
from thigmo.localization.prior import LEVEL, BaseMoment

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# Log-density fall (nats) below the top at which cells are no longer refined.
REACH = 9.0
MAX_NODES = 900
COARSE = 49


class Cells(NamedTuple):
    """Room for the cells between MAX_NODES nodes.

    Attributes:
        density: (MAX_NODES,) of each node, over that of a node with log likelihood 0.
        split: (MAX_NODES,) which cells are to be halved.
    """

    density: Array
    split: Flags


@compiled_inner
def refine(
    nodes: Nodes,
    count: int,
    cells: Cells,
    frame: Frame,
    levels: Levels,
    prior: BaseMoment,
    tried: Tried,
) -> int:
    """Halve cells until the density is resolved where it matters.

    A cell is split where the density is within REACH nats of the top and changes by more than
    1 nat or holds more than 5 % of the mass, and beside local maxima that may hide a higher one.
    The nodes (MAX_NODES,) hold `count` sorted ones and are grown in place.

    Returns:
        The new count.
    """
    arcs, logp, force = nodes
    density, split = cells
    reference = -1e300
    for _ in range(26):
        top = logp[0]
        for j in range(count):
            top = max(top, logp[j])
        if top > reference + 1.0:
            reference = top
            for j in range(count):
                density[j] = math.exp(logp[j] - reference)
        mass = 0.0
        for j in range(count - 1):
            mass += cell_mass(
                arcs[j + 1] - arcs[j], logp[j + 1] - logp[j], density[j], density[j + 1]
            )
        added = 0
        for j in range(count - 1):
            width = arcs[j + 1] - arcs[j]
            step = logp[j + 1] - logp[j]
            want = False
            if max(logp[j], logp[j + 1]) - top > -REACH:
                want = abs(step) > 1.0
                want = want or cell_mass(width, step, density[j], density[j + 1]) > 0.05 * mass
            if not want:
                # Beside a local maximum the peak may stand higher than its samples.
                for peak in range(j, j + 2):
                    before = logp[peak] - logp[peak - 1] if peak > 0 else 0.0
                    after = logp[peak] - logp[peak + 1] if peak < count - 1 else 0.0
                    if before >= 0.0 and after >= 0.0:
                        drop = max(before, after)
                        if drop > 0.5 and logp[peak] - top + 0.5 * drop > -REACH:
                            want = True
            split[j] = want and width >= 1e-9 and count + added + 1 < MAX_NODES
            if split[j]:
                added += 1
                if added == TOGETHER:
                    split[j + 1 : count] = False
                    break
        if added == 0:
            break
        write = 0
        for j in range(count - 1):
            if split[j]:
                tried.arc[write] = 0.5 * (arcs[j] + arcs[j + 1])
                write += 1
        evaluate(added, frame, levels, prior, tried, False)
        write = count + added - 1
        read = added - 1
        for j in range(count - 1, -1, -1):
            arcs[write] = arcs[j]
            logp[write] = logp[j]
            force[write] = force[j]
            density[write] = density[j]
            write -= 1
            if j > 0 and split[j - 1]:
                arcs[write] = tried.arc[read]
                logp[write] = tried.logp[read]
                force[write] = tried.force[read]
                density[write] = math.exp(logp[write] - reference)
                write -= 1
                read -= 1
        count += added
    return count


class OnePosterior(NamedTuple):
    """What `one_contact` finds, in units of the length.

    Attributes:
        null, evidence: log evidence without and with the contact.
        arc, force, deviation: place, force there, and the force's deviation.
        low, high: interval of the arc.
        noise: of one reading.
        misfit: sum of squared residuals over variance.
        bound: Cramer-Rao bound of the arc, from the readings alone.
        pieces: (P, 3) modes.
        nodes: (M,) places; log density (normalised) and force over them.
        flagged: (N,) outliers.
    """

    null: float
    evidence: float
    arc: float
    force: float
    deviation: float
    low: float
    high: float
    noise: float
    misfit: float
    bound: float
    pieces: Array
    nodes: Nodes
    flagged: Flags


@compiled
def one_contact(frame: Frame, prior: BaseMoment) -> OnePosterior:
    """Posterior of one contact, and the evidence with and without it."""
    n, q = frame.columns.shape
    y = frame.y
    nodes = Nodes(np.empty(MAX_NODES), np.empty(MAX_NODES), np.empty(MAX_NODES))
    arcs, logp, force = nodes
    count = COARSE
    for j in range(count):
        arcs[j] = j / (count - 1.0)
    grid = Nodes(arcs[:count], logp, force)
    sigma, log_prior = all_levels(frame)
    tried = empty_tried(frame, TOGETHER)
    null = free_evidence(frame, sigma, log_prior, tried)
    sigma, log_prior = coarse_levels(frame)
    levels = empty_levels(frame, sigma, log_prior)
    best_pattern(grid, frame, levels, prior, tried)
    if not frame.known:
        sigma, log_prior = levels_with_mass(grid, frame, levels, prior, tried)
        flagged = levels.flagged
        levels = empty_levels(frame, sigma, log_prior)
        levels.flagged[:] = flagged
        prepare_levels(frame, 0.0, levels)
        evaluate_all(grid, frame, levels, prior, tried)
    cells = Cells(np.empty(MAX_NODES), np.empty(MAX_NODES, dtype=np.bool_))
    count = refine(nodes, count, cells, frame, levels, prior, tried)
    cumulative = np.empty(count)
    evidence = masses(arcs, logp, count, cumulative)
    arc, low, high, pieces = summary(arcs, logp, count, cumulative, LEVEL)
    logp -= evidence
    evaluate_at(arc, frame, levels, prior, tried, False)
    strength = tried.force[0]
    square = tried.variance[0]
    # Spread of the force: within the arc, and as it slides with the arc.
    slide = 0.0
    for j in range(count - 1):
        middle = 0.5 * (force[j] + force[j + 1]) - strength
        slide += (cumulative[j + 1] - cumulative[j]) * middle * middle
    # Noise level with the most weight at the arc, and the misfit there.
    s = 0
    if sigma.shape[0] > 1:
        s = int(level_weights(arc, frame, levels, prior, tried).argmax())
    typical = 0.0
    misfit = 0.0
    phi = tried.phi[:, 0]
    for i in range(n):
        typical += frame.variance[i] / n
        misfit -= levels.W[s, i] * phi[i] * strength * (2.0 * y[i] - strength * phi[i])
        misfit += levels.W[s, i] * y[i] * y[i]
    for k in range(q):
        part = levels.fit[s, k]
        for i in range(n):
            part -= strength * levels.W[s, i] * phi[i] * levels.white[s, i, k]
        misfit -= part * part
    return OnePosterior(
        null,
        evidence,
        arc,
        strength,
        np.sqrt(square + slide),
        low,
        high,
        np.sqrt(typical) * sigma[s],
        misfit,
        place_bound(
            np.array([arc]), np.array([strength]), frame.sensors, levels.W[s], frame.columns
        ),
        pieces,
        Nodes(arcs[:count].copy(), logp[:count].copy(), force[:count].copy()),
        levels.flagged,
    )
