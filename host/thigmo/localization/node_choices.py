"""Contacts at a choice of places along the body, forces integrated out, compiled.

The influence of each place is worked out once (`Places`); the likelihood of contacts at any ordered
choice of them then costs a factorisation of as many rows as contacts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled, compiled_inner
from thigmo.localization.frame import Frame, Levels, Work, empty_work
from thigmo.localization.influence import influence
from thigmo.localization.marginal import flip_weight
from thigmo.localization.prior import LEAST_LEVER, BaseMoment

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


class Places(NamedTuple):
    """M places along the body, each the middle of an interval, at S noise levels.

    Attributes:
        arcs: (M,).
        width: (M,) of its interval.
        half: (M,) number of the place in the middle of its lower half, the upper one's is the
            next; -1 if there is none yet.
        phi: (M, N) readings for a unit force.
        slope: (M, N) their mean change with the arc, over the interval.
        lever: (M,) moment at the base for a unit force.
        weighted: (S, M, N) phi times the readings' precision.
        t, t_slope: (S, M, Q) products of phi and of slope with the whitened columns.
        b: (S, M) products of phi with the readings.
        bend: (S, M) product of slope with itself.
    """

    arcs: Array
    width: Array
    half: Indices
    phi: Array
    slope: Array
    lever: Array
    weighted: Array
    t: Array
    t_slope: Array
    b: Array
    bend: Array


class Factor(NamedTuple):
    """Room for C contacts' forces.

    Attributes:
        gram: (C, C) products of their influences, lower triangle.
        G: (C, C) Cholesky factor of the forces' precision.
        force: (C,) posterior means.
        taken: (C,) room for one reading.
    """

    gram: Array
    G: Array
    force: Array
    taken: Array


@compiled
def empty_factor(contacts: int) -> Factor:
    """Room for the forces of `contacts`."""
    c = contacts
    return Factor(np.empty((c, c)), np.empty((c, c)), np.empty(c), np.empty(c))


@compiled
def empty_places(count: int, frame: Frame, levels: Levels) -> Places:
    """Room for `count` places."""
    m = count
    n = frame.y.shape[0]
    s, _, q = levels.white.shape
    return Places(
        np.empty(m),
        np.empty(m),
        np.full(m, -1),
        np.empty((m, n)),
        np.empty((m, n)),
        np.empty(m),
        np.empty((s, m, n)),
        np.empty((s, m, q)),
        np.empty((s, m, q)),
        np.empty((s, m)),
        np.empty((s, m)),
    )


@compiled
def more_room(places: Places, frame: Frame, levels: Levels) -> Places:
    """The same places with room for as many again."""
    m = places.arcs.shape[0]
    out = empty_places(2 * m, frame, levels)
    out.arcs[:m] = places.arcs
    out.width[:m] = places.width
    out.half[:m] = places.half
    out.phi[:m] = places.phi
    out.slope[:m] = places.slope
    out.lever[:m] = places.lever
    out.weighted[:, :m] = places.weighted
    out.t[:, :m] = places.t
    out.t_slope[:, :m] = places.t_slope
    out.b[:, :m] = places.b
    out.bend[:, :m] = places.bend
    return out


@compiled_inner
def spread_influence(arc: float, stretch: float, frame: Frame, room: Array, out: Array) -> float:
    """`influence` of a unit force spread evenly over the arc -+ stretch (cut at the ends)."""
    if stretch <= 0.0:
        return influence(arc, frame.sensors, out)
    near = max(arc - stretch, 0.0)
    far = min(arc + stretch, 1.0)
    reach = 0.0
    out[:] = 0.0
    for r in range(4):
        reach += 0.25 * influence(near + (far - near) * (r + 0.5) / 4, frame.sensors, room)
        for i in range(out.shape[0]):
            out[i] += 0.25 * room[i]
    return reach


# Least step in the arc from which the slope of an influence is taken.
LEAST_STEP = 1e-5


@compiled_inner
def fill_places(
    places: Places,
    first: int,
    last: int,
    frame: Frame,
    levels: Levels,
    stretch: float,
    work: Work,
) -> None:
    """Work out the places first..last-1, whose arcs and widths are given, nuisances integrated out.

    With `stretch` > 0 the unit force is spread evenly over the place -+ stretch (cut at the ends).
    """
    y = frame.y
    W = levels.W
    white = levels.white
    _, _, _, _, _, _, weighted, t, t_slope, b, bend = places
    n = y.shape[0]
    for j in range(first, last):
        arc = places.arcs[j]
        phi = places.phi[j]
        slope = places.slope[j]
        # Over the whole interval, for an influence has a kink at each sensor.
        step = max(0.5 * places.width[j], LEAST_STEP)
        up = min(arc + step, 1.0)
        down = max(arc - step, 0.0)
        spread_influence(up, stretch, frame, work.flips, slope)
        spread_influence(down, stretch, frame, work.flips, work.phi)
        for i in range(n):
            slope[i] = (slope[i] - work.phi[i]) / (up - down)
        reach = spread_influence(arc, stretch, frame, work.flips, phi)
        places.lever[j] = max(abs(reach), LEAST_LEVER)
        for s in range(W.shape[0]):
            value = 0.0
            rise = 0.0
            for i in range(n):
                weighted[s, j, i] = W[s, i] * phi[i]
                value += weighted[s, j, i] * y[i]
                rise += W[s, i] * slope[i] * slope[i]
            for k in range(white.shape[2]):
                part = 0.0
                turn = 0.0
                for i in range(n):
                    part += weighted[s, j, i] * white[s, i, k]
                    turn += W[s, i] * slope[i] * white[s, i, k]
                t[s, j, k] = part
                t_slope[s, j, k] = turn
                value -= part * levels.fit[s, k]
                rise -= turn * turn
            b[s, j] = value
            bend[s, j] = rise


@compiled
def places_at(arcs: Array, frame: Frame, levels: Levels, stretch: float) -> Places:
    """Places at given arcs, without intervals."""
    places = empty_places(arcs.shape[0], frame, levels)
    places.arcs[:] = arcs
    places.width[:] = 0.0
    fill_places(places, 0, arcs.shape[0], frame, levels, stretch, empty_work(frame))
    return places


@compiled_inner
def products(pick: Indices, places: Places, s: int, gram: Array) -> None:
    """Fill the lower triangle of `gram` with the products of the chosen influences."""
    phi = places.phi
    weighted = places.weighted
    t = places.t
    for j in range(pick.shape[0]):
        for r in range(j + 1):
            value = 0.0
            for i in range(phi.shape[1]):
                value += weighted[s, pick[j], i] * phi[pick[r], i]
            for k in range(t.shape[2]):
                value -= t[s, pick[j], k] * t[s, pick[r], k]
            gram[j, r] = value


@compiled_inner
def factorise(
    pick: Indices, places: Places, s: int, spread: float, factor: Factor
) -> tuple[float, float]:
    """Integrate the forces out under a base moment of deviation `spread`; needs `products`.

    Leaves the Cholesky factor in the room's G, and its solution for the forces in `force`.

    Returns:
        Log of the integral is the first of two less the logarithm of the second.
    """
    gram, G, force, _ = factor
    exponent = 0.0
    widths = 1.0
    for j in range(pick.shape[0]):
        tau = spread / places.lever[pick[j]]
        for r in range(j):
            value = gram[j, r]
            for m in range(r):
                value -= G[j, m] * G[r, m]
            G[j, r] = value / G[r, r]
        # Rounding may leave less than nothing of what the columns take.
        whole = max(gram[j, j], 0.0) + 1.0 / (tau * tau)
        value = whole
        half = places.b[s, pick[j]]
        for m in range(j):
            value -= G[j, m] * G[j, m]
            half -= G[j, m] * force[m]
        G[j, j] = np.sqrt(max(value, 1e-14 * whole))
        force[j] = half / G[j, j]
        exponent += 0.5 * force[j] * force[j]
        widths *= tau * G[j, j]
    return exponent, widths


@compiled_inner
def choice(
    pick: Indices,
    places: Places,
    const: Array,
    prior: BaseMoment,
    factor: Factor,
    first: int,
    last: int,
) -> tuple[float, int, int]:
    """Log marginal likelihood of contacts at the places `pick`, over noise levels first..last-1.

    `const` (S,) is that of none.

    Returns:
        Log likelihood; noise level and prior component of the weightiest term.
    """
    top = -1e300
    total = 0.0
    best = 0.0
    best_s = first
    best_k = 0
    for s in range(first, last):
        products(pick, places, s, factor.gram)
        for k in range(prior.spread.shape[0]):
            exponent, widths = factorise(pick, places, s, prior.spread[k], factor)
            exponent += const[s]
            share = prior.weight[k] / widths
            if exponent > top:
                shrink = np.exp(top - exponent) if total > 0.0 else 0.0
                total *= shrink
                best *= shrink
                top = exponent
            else:
                share *= np.exp(exponent - top)
            total += share
            if share > best:
                best = share
                best_s = s
                best_k = k
    return top + np.log(total), best_s, best_k


@compiled_inner
def mean_forces(
    pick: Indices, places: Places, s: int, k: int, prior: BaseMoment, factor: Factor
) -> None:
    """Posterior means of the forces at one noise level and prior component; needs `products`."""
    factorise(pick, places, s, prior.spread[k], factor)
    _, G, force, _ = factor
    c = pick.shape[0]
    for j in range(c - 1, -1, -1):
        for m in range(j + 1, c):
            force[j] -= G[m, j] * force[m]
        force[j] /= G[j, j]


@compiled_inner
def fit_forces(
    pick: Indices, places: Places, const: Array, prior: BaseMoment, factor: Factor
) -> tuple[float, int, int]:
    """As `choice` over all noise levels, with the weightiest term's forces left in the room."""
    value, s, k = choice(pick, places, const, prior, factor, 0, const.shape[0])
    if const.shape[0] > 1:
        products(pick, places, s, factor.gram)
    mean_forces(pick, places, s, k, prior, factor)
    return value, s, k


@compiled_inner
def residual(
    i: int, pick: Indices, s: int, places: Places, y: Array, levels: Levels, factor: Factor
) -> tuple[float, float]:
    """Reading `i` less what fits best, and that fit's variance; needs the forces in the room."""
    phi = places.phi
    t = places.t
    white = levels.white
    _, G, force, taken = factor
    c = pick.shape[0]
    u = y[i]
    h = 0.0
    for j in range(c):
        u -= force[j] * phi[pick[j], i]
        taken[j] = phi[pick[j], i]
    for k in range(white.shape[2]):
        z = white[s, i, k]
        best = levels.fit[s, k]
        for j in range(c):
            best -= force[j] * t[s, pick[j], k]
            taken[j] -= z * t[s, pick[j], k]
        u -= z * best
        h += z * z
    for j in range(c):
        for m in range(j):
            taken[j] -= G[j, m] * taken[m]
        taken[j] /= G[j, j]
        h += taken[j] * taken[j]
    return u, h


@compiled_inner
def pattern_weights(
    pick: Indices, s: int, places: Places, y: Array, levels: Levels, factor: Factor
) -> tuple[float, int, float]:
    """Weights of the outlier patterns one reading away, over that of the present one.

    Needs the forces in the room.

    Returns:
        One plus their sum; the reading that the heaviest of them changes, and its weight.
    """
    extra = 1.0
    heaviest = 0
    most = 0.0
    for i in range(y.shape[0]):
        u, taken = residual(i, pick, s, places, y, levels, factor)
        change = flip_weight(u, taken, levels.W[s, i], levels.flagged[i], False)
        extra += change
        if change > most:
            most = change
            heaviest = i
    return extra, heaviest, most


@compiled_inner
def slopes(
    pick: Indices,
    s: int,
    places: Places,
    y: Array,
    levels: Levels,
    factor: Factor,
    work: Work,
    gradient: Array,
    curvature: Array,
) -> None:
    """How the log likelihood changes with each contact's place, forces and nuisances refitted.

    Needs the forces in the room. Fills the gradient (C,), and its expected fall per unit of the
    arc, `curvature` (C,). The slow change of the forces' own spread is left out.
    """
    _, G, force, taken = factor
    _, _, _, phi, slope, _, weighted, t, t_slope, _, bend = places
    W = levels.W
    white = levels.white
    c = pick.shape[0]
    n = y.shape[0]
    q = white.shape[2]
    for k in range(q):
        best = levels.fit[s, k]
        for j in range(c):
            best -= force[j] * t[s, pick[j], k]
        work.t[k] = best
    for i in range(n):
        u = y[i]
        for j in range(c):
            u -= force[j] * phi[pick[j], i]
        for k in range(q):
            u -= work.t[k] * white[s, i, k]
        work.phi[i] = W[s, i] * u
    for j in range(c):
        at = pick[j]
        rise = 0.0
        for i in range(n):
            rise += work.phi[i] * slope[at, i]
        fall = bend[s, at]
        # What the refitted forces take of it.
        for m in range(c):
            part = 0.0
            for i in range(n):
                part += weighted[s, pick[m], i] * slope[at, i]
            for k in range(q):
                part -= t[s, pick[m], k] * t_slope[s, at, k]
            for r in range(m):
                part -= G[m, r] * taken[r]
            taken[m] = part / G[m, m]
            fall -= taken[m] * taken[m]
        gradient[j] = rise * force[j]
        curvature[j] = max(fall, 0.0) * force[j] * force[j]


@compiled_inner
def misfit_at(
    pick: Indices, s: int, places: Places, y: Array, levels: Levels, factor: Factor
) -> float:
    """Squared residuals over variance; needs the forces in the room."""
    total = 0.0
    for i in range(y.shape[0]):
        u = y[i]
        for j in range(pick.shape[0]):
            u -= factor.force[j] * places.phi[pick[j], i]
        total += levels.W[s, i] * u * u
    return total
