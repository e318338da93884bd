"""Posterior over the places of one to three contacts, forces integrated out, compiled.

The same model, noise and priors as the posterior of one contact; the arcs a_1 <= .. <= a_C are a
grid of all ordered choices from one list of nodes, refined where any contact's posterior needs it.
Gram matrices over the nodes are computed once, so a choice costs a C x C factorisation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization.frame import Frame, empty_levels
from thigmo.localization.information import place_bound
from thigmo.localization.intervals import median_between, modes, shortest
from thigmo.localization.marginal import prepare_levels
from thigmo.localization.node_choices import (
    choice,
    empty_tables,
    first_pick,
    flip_weights,
    levels_near,
    next_pick,
    node_tables,
)
from thigmo.localization.noise_levels import coarse_levels
from thigmo.localization.outlier_search import coarse_error
from thigmo.localization.prior import LEVEL, WIDTH_SHARE, BaseMoment

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]

REACH = 9.0
FLIP_REACH = 6.0
NODES = (0, 81, 33, 23)  # first nodes, by number of contacts
MOST_NODES = (0, 400, 150, 52)
# How often the grid may be refined, and for a first look at the evidence.
PASSES = 14
LOOK = 1


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
def several(
    contacts: int, frame: Frame, prior: BaseMoment, stretch: float, passes: int
) -> SeveralPosterior:
    """Posterior of `contacts` contacts.

    Args:
        contacts: C.
        frame: what was read.
        prior: of each contact's moment at the base; their spreads count, not their means.
        stretch: half width of the stretch over which each contact spreads.
        passes: how often the grid may be refined.
    """
    y = frame.y
    variance = frame.variance
    n = y.shape[0]
    c = contacts
    most = MOST_NODES[c]
    sigma, log_prior = coarse_levels(frame)
    levels = empty_levels(frame, sigma, log_prior)
    m = NODES[c]
    nodes = np.linspace(0.0, 1.0, m)
    phi = np.empty((most, n))
    lever = np.empty(most)
    G = np.empty((c, c))
    force = np.empty(c)
    pick = np.empty(c, dtype=np.int64)
    best_pick = np.empty(c, dtype=np.int64)
    change = np.empty(n)
    choices = 1
    for j in range(c):
        choices = choices * (most + j) // (j + 1)
    logp = np.empty(choices)
    profile = np.empty((c, most))
    top = -1e300
    climbs = 0
    refined = 0
    leveled = False
    error = coarse_error(y, 1.0 / (NODES[c] - 1.0)) ** 2
    fine = not frame.known or error > 0.1 * variance.min()
    if fine:
        passes = max(passes, PASSES)
    for _ in range(passes + n + 4):
        prepare_levels(frame, variance, levels)
        tables = empty_tables(phi, lever, m, levels)
        node_tables(nodes, frame, levels, stretch, tables)
        profile[:, :m] = -1e300
        top = -1e300
        first_pick(pick)
        r = 0
        while True:
            value, _, _ = choice(pick, tables, levels.const, prior, G, force)
            logp[r] = value
            if value > top:
                top = value
                best_pick[:] = pick
            for j in range(c):
                profile[j, pick[j]] = max(profile[j, pick[j]], value)
            r += 1
            if not next_pick(pick, m):
                break
        _, s, _ = choice(best_pick, tables, levels.const, prior, G, force)
        # A grid too coarse for the noise misfits everywhere: then judge by what it does reach.
        misfit = 0.0
        for i in range(n):
            u = y[i]
            for j in range(c):
                u -= force[j] * phi[best_pick[j], i]
            misfit += levels.W[s, i] * u * u
        reach = REACH * max(1.0, misfit / n)
        added = 0
        grown = np.empty(most)
        write = 0
        for j in range(m):
            grown[write] = nodes[j]
            write += 1
            if j == m - 1:
                break
            want = False
            for k in range(c):
                left = profile[k, j]
                right = profile[k, j + 1]
                if max(left, right) > top - reach and abs(left - right) > 1.0:
                    want = True
            if want and nodes[j + 1] - nodes[j] > 1e-7 and m + added < most:
                grown[write] = 0.5 * (nodes[j] + nodes[j + 1])
                write += 1
                added += 1
        done = added == 0 or refined == passes
        if not frame.known and not leveled:
            # Keep the noise levels that matter from here on.
            sigma, log_prior = levels_near(best_pick, tables, levels, prior)
            flagged = levels.flagged
            levels = empty_levels(frame, sigma, log_prior)
            levels.flagged[:] = flagged
            leveled = True
            continue
        # Outliers, one reading at a time: at once if the grid is fine enough for the noise, else
        # when it has been refined.
        if (done or not fine) and climbs < n + 2:
            flip_weights(best_pick, s, tables, y, levels, G, force, change)
            flagged = levels.flagged
            best = 0
            count = 0
            for i in range(n):
                if change[i] > change[best]:
                    best = i
                if flagged[i]:
                    count += 1
            if change[best] > 1.0 and (flagged[best] or 2 * (count + 1) <= n):
                flagged[best] = not flagged[best]
                climbs += 1
                continue
        if done:
            break
        refined += 1
        m += added
        nodes = grown[:m].copy()
    # Outlier patterns around the best one, where it matters.
    weight = np.empty(m)
    for j in range(m):
        weight[j] = 0.5 * (nodes[min(j + 1, m - 1)] - nodes[max(j - 1, 0)])
    marginal = np.zeros((c, m))
    total = 0.0
    loose = 0.0
    places = np.empty(c)
    first_pick(pick)
    r = 0
    while True:
        value = logp[r] - top
        if value > -30.0:
            if value > -FLIP_REACH:
                _, s, _ = choice(pick, tables, levels.const, prior, G, force)
                value += np.log(flip_weights(pick, s, tables, y, levels, G, force, change))
            mass = np.exp(value)
            repeat = 1.0
            for j in range(c):
                mass *= weight[pick[j]]
                if j > 0 and pick[j] == pick[j - 1]:
                    repeat += 1.0
                else:
                    repeat = 1.0
                mass /= repeat
            total += mass
            for j in range(c):
                marginal[j, pick[j]] += mass
                places[j] = nodes[pick[j]]
            if value > -FLIP_REACH:
                bound = place_bound(places, force, frame.sensors, levels.W[s], frame.columns)
                if not bound < WIDTH_SHARE:
                    loose += mass
        r += 1
        if not next_pick(pick, m):
            break
    factorial = 1.0
    for j in range(c):
        factorial *= j + 1.0
    evidence = top + np.log(total * factorial)
    arcs = np.empty(c)
    interval = np.empty((c, 2))
    pieces = np.zeros((c, 12, 3))
    found = np.empty(c, dtype=np.int64)
    density = np.empty((c, m))
    cumulative = np.empty(m)
    for j in range(c):
        for k in range(m):
            density[j, k] = np.log(max(marginal[j, k] / (total * weight[k]), 1e-300))
        cumulative[0] = 0.0
        for k in range(m - 1):
            half = np.exp(density[j, k]) + np.exp(density[j, k + 1])
            cumulative[k + 1] = cumulative[k] + 0.5 * half * (nodes[k + 1] - nodes[k])
        cumulative /= cumulative[m - 1]
        interval[j, 0], interval[j, 1] = shortest(nodes, density[j], m, cumulative, LEVEL)
        found[j] = modes(nodes, density[j], m, cumulative, LEVEL, pieces[j])
        start = 0.0
        end = 1.0
        if found[j] > 1:
            best = 0
            for k in range(found[j]):
                if pieces[j, k, 2] > pieces[j, best, 2]:
                    best = k
            start = pieces[j, best, 0]
            end = pieces[j, best, 1]
        arcs[j] = median_between(nodes, density[j], m, cumulative, start, end)
    # Forces at the reported arcs.
    tables = empty_tables(phi, lever, c, levels)
    node_tables(arcs, frame, levels, stretch, tables)
    for j in range(c):
        pick[j] = j
    _, s, _ = choice(pick, tables, levels.const, prior, G, force)
    typical = 0.0
    for i in range(n):
        typical += variance[i] / n
    typical = np.sqrt(typical) * sigma[s]
    return SeveralPosterior(
        evidence,
        arcs,
        force,
        interval,
        pieces,
        found,
        nodes,
        density,
        levels.flagged,
        typical,
        loose / total,
        misfit,
    )
