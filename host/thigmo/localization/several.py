"""Posterior over the places of one to three contacts, forces integrated out, compiled.

The same model, noise and priors as the posterior of one contact; the arcs a_1 <= .. <= a_C are a
grid of all ordered choices from one list of nodes, refined where any contact's posterior needs it.
Gram matrices over the nodes are computed once, so a choice costs a C x C factorisation.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization.influence import influence
from thigmo.localization.intervals import median_between, modes, shortest
from thigmo.localization.marginal import prepare_levels
from thigmo.localization.noise_levels import finer_levels, noise_levels
from thigmo.localization.outlier_search import coarse_error
from thigmo.localization.prior import LEAST_LEVER, WIDTH_SHARE

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


@compiled
def node_tables(
    nodes: Array,
    low: Array,
    high: Array,
    table: Array,
    edges: Array,
    y: Array,
    W: Array,
    white: Array,
    fit: Array,
    stretch: float,
    phi: Array,
    lever: Array,
    t: Array,
    gram: Array,
    b: Array,
) -> None:
    """Influence of each node and its products, nuisances integrated out.

    With `stretch` > 0 the unit force is spread evenly over the node -+ stretch (cut at the ends).

    Fills phi (M, N), lever (M,), t (S, M, Q), gram (S, M, M), b (S, M).
    """
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
            reach += influence(place, low, high, table, edges, part_phi) / parts
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
    pick: Indices,
    gram: Array,
    b: Array,
    lever: Array,
    spread: Array,
    log_weight: Array,
    const: Array,
    G: Array,
    force: Array,
) -> tuple[float, int, int]:
    """Log marginal likelihood of contacts at the nodes `pick`.

    Leaves the factor and the forces of the weightiest term in G (C, C) and force (C,).

    Returns:
        Log likelihood; noise level and prior component of the weightiest term.
    """
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
    phi: Array,
    t: Array,
    y: Array,
    flagged: Flags,
    W: Array,
    white: Array,
    fit: Array,
    G: Array,
    force: Array,
    odds: float,
    kappa2: float,
    change: Array,
) -> float:
    """Relative weights (N,) of the outlier patterns one reading away, at one noise level.

    Returns:
        One plus their sum.
    """
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
        d = ((1.0 / kappa2 - 1.0) if flagged[i] else (kappa2 - 1.0)) / w
        grown = max(1.0 + d * h, 1e-12)
        ratio = 1.0 / odds if flagged[i] else odds
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
    pick: Indices,
    gram: Array,
    b: Array,
    lever: Array,
    spread: Array,
    log_weight: Array,
    const: Array,
    sigma: Array,
    n: int,
) -> tuple[Array, Array]:
    """Fine noise levels around those that matter for the choice `pick`."""
    c = pick.shape[0]
    levels = gram.shape[0]
    G = np.empty((c, c))
    force = np.empty(c)
    value = np.empty(levels)
    for s in range(levels):
        value[s], _, _ = choice(
            pick,
            gram[s : s + 1],
            b[s : s + 1],
            lever,
            spread,
            log_weight,
            const[s : s + 1],
            G,
            force,
        )
    return finer_levels(value, sigma, n)


@compiled
def arc_bounds(
    arcs: Array,
    force: Array,
    low: Array,
    high: Array,
    table: Array,
    edges: Array,
    W: Array,
    columns: Array,
) -> Array:
    """Cramer-Rao bounds of the arcs: how well the readings alone can fix the places.

    Args:
        arcs, force: (C,) contacts.
        low, high, table, edges: as for `influence`.
        W: (N,) precision of the readings.
        columns: (N, Q) nuisance columns times their prior deviations.

    Returns:
        (C,) standard deviations; infinite where the information matrix is singular.
    """
    c = arcs.shape[0]
    n = low.shape[0]
    q = columns.shape[1]
    size = 2 * c + q
    J = np.empty((n, size))
    ahead = np.empty(n)
    behind = np.empty(n)
    step = 1e-4
    for j in range(c):
        influence(arcs[j], low, high, table, edges, ahead)
        J[:, j] = ahead
        up = min(arcs[j] + step, 1.0)
        down = max(arcs[j] - step, 0.0)
        influence(up, low, high, table, edges, ahead)
        influence(down, low, high, table, edges, behind)
        for i in range(n):
            J[i, c + j] = force[j] * (ahead[i] - behind[i]) / (up - down)
    for k in range(q):
        J[:, 2 * c + k] = columns[:, k]
    F = np.zeros((size, size))
    for a in range(size):
        for r in range(a + 1):
            value = 0.0
            for i in range(n):
                value += W[i] * J[i, a] * J[i, r]
            F[a, r] = value
            F[r, a] = value
    for k in range(q):
        F[2 * c + k, 2 * c + k] += 1.0
    # Scaled to a unit diagonal, so that singular means singular in any unit.
    scale = np.empty(size)
    for a in range(size):
        scale[a] = np.sqrt(F[a, a])
        if not scale[a] > 1e-150:
            return np.full(c, np.inf)
    for a in range(size):
        for r in range(size):
            F[a, r] /= scale[a] * scale[r]
    # Cholesky; the arcs' variances from the inverse factor.
    for a in range(size):
        for r in range(a + 1):
            value = F[a, r]
            for m in range(r):
                value -= F[a, m] * F[r, m]
            if a == r:
                if value < 1e-11:
                    return np.full(c, np.inf)
                F[a, a] = np.sqrt(value)
            else:
                F[a, r] = value / F[r, r]
    out = np.empty(c)
    column = np.empty(size)
    for j in range(c, 2 * c):
        total = 0.0
        for a in range(size):
            value = 1.0 if a == j else 0.0
            for m in range(a):
                value -= F[a, m] * column[m]
            column[a] = value / F[a, a]
            total += column[a] * column[a]
        out[j - c] = np.sqrt(total) / scale[j]
    return out


@compiled
def place_bound(
    arcs: Array,
    force: Array,
    low: Array,
    high: Array,
    table: Array,
    edges: Array,
    W: Array,
    columns: Array,
) -> float:
    """The largest of `arc_bounds`."""
    worst: float = arc_bounds(arcs, force, low, high, table, edges, W, columns).max()
    return worst


@compiled
def several(
    contacts: int,
    y: Array,
    low: Array,
    high: Array,
    variance: Array,
    known: bool,
    columns: Array,
    table: Array,
    edges: Array,
    spread: Array,
    log_weight: Array,
    odds: float,
    kappa2: float,
    level: float,
    given: Flags,
    stretch: float,
    passes: int,
) -> tuple[float, Array, Array, Array, Array, Indices, Array, Array, Flags, float, float, float]:
    """Posterior of `contacts` contacts.

    Args: as for `posterior.one_contact`; `given` (N,) outliers to start from,
    `stretch` half width of the stretch over which each contact spreads, `passes` how often
    the grid may be refined.

    Returns:
        log evidence; (C,) arcs; (C,) forces; (C, 2) intervals; (C, 12, 3) modes and (C,) how many;
        nodes (M,); (C, M) log marginal densities; (N,) outliers; noise; share of the
        posterior at places that the readings alone do not fix to within the width limit; misfit.
    """
    n = y.shape[0]
    q = columns.shape[1]
    c = contacts
    most = MOST_NODES[c]
    if known:
        sigma = np.ones(1)
        log_prior = np.zeros(1)
    else:
        sigma, log_prior = noise_levels(y, variance)
    levels = sigma.shape[0]
    W = np.empty((levels, n))
    white = np.empty((levels, n, q))
    fit = np.empty((levels, q))
    const = np.empty(levels)
    m = NODES[c]
    nodes = np.linspace(0.0, 1.0, m)
    phi = np.empty((most, n))
    lever = np.empty(most)
    G = np.empty((c, c))
    force = np.empty(c)
    pick = np.empty(c, dtype=np.int64)
    best_pick = np.empty(c, dtype=np.int64)
    change = np.empty(n)
    flagged = given.copy()
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
    fine = not known or error > 0.1 * variance.min()
    if fine:
        passes = max(passes, PASSES)
    for _ in range(passes + n + 4):
        prepare_levels(
            y, variance, sigma, log_prior, columns, flagged, odds, kappa2, W, white, fit, const
        )
        t = np.empty((levels, m, q))
        gram = np.empty((levels, m, m))
        b = np.empty((levels, m))
        node_tables(
            nodes, low, high, table, edges, y, W, white, fit, stretch, phi, lever, t, gram, b
        )
        profile[:, :m] = -1e300
        top = -1e300
        first_pick(pick)
        r = 0
        while True:
            value, _, _ = choice(pick, gram, b, lever, spread, log_weight, const, G, force)
            logp[r] = value
            if value > top:
                top = value
                best_pick[:] = pick
            for j in range(c):
                profile[j, pick[j]] = max(profile[j, pick[j]], value)
            r += 1
            if not next_pick(pick, m):
                break
        _, s, _ = choice(best_pick, gram, b, lever, spread, log_weight, const, G, force)
        # A grid too coarse for the noise misfits everywhere: then judge by what it does reach.
        misfit = 0.0
        for i in range(n):
            u = y[i]
            for j in range(c):
                u -= force[j] * phi[best_pick[j], i]
            misfit += W[s, i] * u * u
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
        if not known and not leveled:
            # Keep the noise levels that matter from here on.
            sigma, log_prior = levels_near(
                best_pick, gram, b, lever, spread, log_weight, const, sigma, n
            )
            levels = sigma.shape[0]
            W = np.empty((levels, n))
            white = np.empty((levels, n, q))
            fit = np.empty((levels, q))
            const = np.empty(levels)
            leveled = True
            continue
        # Outliers, one reading at a time: at once if the grid is fine enough for the noise, else
        # when it has been refined.
        if (done or not fine) and climbs < n + 2:
            flip_weights(
                best_pick, s, phi, t, y, flagged, W, white, fit, G, force, odds, kappa2, change
            )
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
                _, s, _ = choice(pick, gram, b, lever, spread, log_weight, const, G, force)
                value += np.log(
                    flip_weights(
                        pick, s, phi, t, y, flagged, W, white, fit, G, force, odds, kappa2, change
                    )
                )
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
                bound = place_bound(places, force, low, high, table, edges, W[s], columns)
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
        interval[j, 0], interval[j, 1] = shortest(nodes, density[j], m, cumulative, level)
        found[j] = modes(nodes, density[j], m, cumulative, level, pieces[j])
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
    t = np.empty((levels, c, q))
    gram = np.empty((levels, c, c))
    b = np.empty((levels, c))
    node_tables(arcs, low, high, table, edges, y, W, white, fit, stretch, phi, lever, t, gram, b)
    for j in range(c):
        pick[j] = j
    _, s, _ = choice(pick, gram, b, lever, spread, log_weight, const, G, force)
    typical = 0.0
    for i in range(n):
        typical += variance[i] / n
    typical = np.sqrt(typical) * sigma[s]
    return (
        evidence,
        arcs,
        force,
        interval,
        pieces,
        found,
        nodes,
        density,
        flagged,
        typical,
        loose / total,
        misfit,
    )
