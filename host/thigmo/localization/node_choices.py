"""Contacts at a choice of nodes along the body, forces integrated out, compiled.

Products of the nodes' influences are worked out once (`NodeTables`); the likelihood of contacts at
any ordered choice of nodes then costs a factorisation of as many rows as contacts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization.frame import Frame, Levels
from thigmo.localization.influence import influence
from thigmo.localization.noise_levels import finer_levels
from thigmo.localization.prior import LEAST_LEVER, OUTLIER_ODDS, OUTLIER_VARIANCE, BaseMoment

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


class NodeTables(NamedTuple):
    """Of M nodes at S noise levels.

    Attributes:
        phi: (M or more, N) readings for a unit force.
        lever: (M or more,) its moment at the base.
        t: (S, M, Q) products of phi with the whitened columns.
        gram: (S, M, M) products of phi with one another.
        b: (S, M) products of phi with the readings.
    """

    phi: Array
    lever: Array
    t: Array
    gram: Array
    b: Array


@compiled
def empty_tables(phi: Array, lever: Array, nodes: int, levels: Levels) -> NodeTables:
    """Tables to be filled by `node_tables`; `phi` and `lever` are kept."""
    s, _, q = levels.white.shape
    return NodeTables(
        phi, lever, np.empty((s, nodes, q)), np.empty((s, nodes, nodes)), np.empty((s, nodes))
    )


@compiled
def at_level(tables: NodeTables, s: int) -> NodeTables:
    """The tables of one noise level."""
    return NodeTables(
        tables.phi,
        tables.lever,
        tables.t[s : s + 1],
        tables.gram[s : s + 1],
        tables.b[s : s + 1],
    )


@compiled
def node_tables(
    nodes: Array, frame: Frame, levels: Levels, stretch: float, tables: NodeTables
) -> None:
    """Influence of each node and its products, nuisances integrated out.

    With `stretch` > 0 the unit force is spread evenly over the node -+ stretch (cut at the ends).
    """
    y = frame.y
    _, _, _, W, white, fit, _ = levels
    phi, lever, t, gram, b = tables
    n = y.shape[0]
    q = white.shape[2]
    m = nodes.shape[0]
    part_phi = np.empty(n)
    parts = 8 if stretch > 0.0 else 1
    for j in range(m):
        near = max(nodes[j] - stretch, 0.0)
        far = min(nodes[j] + stretch, 1.0)
        phi[j, :] = 0.0
        reach = 0.0
        for r in range(parts):
            place = near + (far - near) * (r + 0.5) / parts
            reach += influence(place, frame.sensors, part_phi) / parts
            for i in range(n):
                phi[j, i] += part_phi[i] / parts
        lever[j] = max(abs(reach), LEAST_LEVER)
    for s in range(W.shape[0]):
        for j in range(m):
            value = 0.0
            for i in range(n):
                value += W[s, i] * phi[j, i] * y[i]
            for k in range(q):
                part = 0.0
                for i in range(n):
                    part += W[s, i] * phi[j, i] * white[s, i, k]
                t[s, j, k] = part
                value -= part * fit[s, k]
            b[s, j] = value
        for j in range(m):
            for r in range(j + 1):
                value = 0.0
                for i in range(n):
                    value += W[s, i] * phi[j, i] * phi[r, i]
                for k in range(q):
                    value -= t[s, j, k] * t[s, r, k]
                gram[s, j, r] = value
                gram[s, r, j] = value


@compiled
def choice(
    pick: Indices, tables: NodeTables, const: Array, prior: BaseMoment, G: Array, force: Array
) -> tuple[float, int, int]:
    """Log marginal likelihood of contacts at the nodes `pick`; `const` (S,) is that of none.

    Leaves the factor and the forces of the weightiest term in G (C, C) and force (C,).

    Returns:
        Log likelihood; noise level and prior component of the weightiest term.
    """
    _, lever, _, gram, b = tables
    _, spread, log_weight = prior
    c = pick.shape[0]
    top = -1e300
    total = 0.0
    best_s = 0
    best_k = 0
    whole = 0.0
    for s in range(gram.shape[0]):
        for k in range(spread.shape[0]):
            value = const[s] + log_weight[k]
            for j in range(c):
                tau = spread[k] / lever[pick[j]]
                value -= np.log(tau)
                for r in range(j + 1):
                    g = gram[s, pick[j], pick[r]]
                    if r == j:
                        g += 1.0 / (tau * tau)
                        whole = g
                    for m in range(r):
                        g -= G[j, m] * G[r, m]
                    if r == j:
                        G[j, j] = np.sqrt(max(g, 1e-14 * whole))
                    else:
                        G[j, r] = g / G[r, r]
                half = b[s, pick[j]]
                for m in range(j):
                    half -= G[j, m] * force[m]
                force[j] = half / G[j, j]
                value += 0.5 * force[j] * force[j] - np.log(G[j, j])
            if value > top:
                total = total * np.exp(top - value) + 1.0
                top = value
                best_s = s
                best_k = k
            else:
                total += np.exp(value - top)
    # The weightiest term again, for its factor and forces.
    for j in range(c):
        tau = spread[best_k] / lever[pick[j]]
        for r in range(j + 1):
            g = gram[best_s, pick[j], pick[r]]
            if r == j:
                g += 1.0 / (tau * tau)
                whole = g
            for m in range(r):
                g -= G[j, m] * G[r, m]
            if r == j:
                G[j, j] = np.sqrt(max(g, 1e-14 * whole))
            else:
                G[j, r] = g / G[r, r]
        half = b[best_s, pick[j]]
        for m in range(j):
            half -= G[j, m] * force[m]
        force[j] = half / G[j, j]
    for j in range(c - 1, -1, -1):
        for m in range(j + 1, c):
            force[j] -= G[m, j] * force[m]
        force[j] /= G[j, j]
    return top + np.log(total), best_s, best_k


@compiled
def flip_weights(
    pick: Indices,
    s: int,
    tables: NodeTables,
    y: Array,
    levels: Levels,
    G: Array,
    force: Array,
    change: Array,
) -> float:
    """Relative weights (N,) of the outlier patterns one reading away, at the noise level `s`.

    Returns:
        One plus their sum.
    """
    phi = tables.phi
    t = tables.t
    _, _, flagged, W, white, fit, _ = levels
    n = y.shape[0]
    c = pick.shape[0]
    p = np.empty(c)
    extra = 1.0
    for i in range(n):
        w = W[s, i]
        u = y[i]
        h = 0.0
        for j in range(c):
            u -= force[j] * phi[pick[j], i]
            p[j] = phi[pick[j], i]
        for k in range(white.shape[2]):
            z = white[s, i, k]
            best = fit[s, k]
            for j in range(c):
                best -= force[j] * t[s, pick[j], k]
                p[j] -= z * t[s, pick[j], k]
            u -= z * best
            h += z * z
        for j in range(c):
            for m in range(j):
                p[j] -= G[j, m] * p[m]
            p[j] /= G[j, j]
            h += p[j] * p[j]
        u *= w
        h = w - w * w * h
        d = ((1.0 / OUTLIER_VARIANCE - 1.0) if flagged[i] else (OUTLIER_VARIANCE - 1.0)) / w
        grown = max(1.0 + d * h, 1e-12)
        ratio = 1.0 / OUTLIER_ODDS if flagged[i] else OUTLIER_ODDS
        change[i] = ratio * np.exp(min(0.5 * d * u * u / grown, 300.0)) / np.sqrt(grown)
        extra += change[i]
    return extra


@compiled
def first_pick(pick: Indices) -> None:
    """The first ordered choice."""
    for j in range(pick.shape[0]):
        pick[j] = 0


@compiled
def next_pick(pick: Indices, m: int) -> bool:
    """Step to the next choice 0 <= pick_1 <= .. <= pick_C < m; False after the last."""
    j = pick.shape[0] - 1
    while j >= 0 and pick[j] == m - 1:
        j -= 1
    if j < 0:
        return False
    value = pick[j] + 1
    for r in range(j, pick.shape[0]):
        pick[r] = value
    return True


@compiled
def levels_near(
    pick: Indices, tables: NodeTables, levels: Levels, prior: BaseMoment
) -> tuple[Array, Array]:
    """Fine noise levels around those that matter for the choice `pick`."""
    c = pick.shape[0]
    G = np.empty((c, c))
    force = np.empty(c)
    value = np.empty(levels.sigma.shape[0])
    for s in range(value.shape[0]):
        value[s], _, _ = choice(pick, at_level(tables, s), levels.const[s : s + 1], prior, G, force)
    return finer_levels(value, levels.sigma, tables.phi.shape[1])
