"""Small deflections: a straight beam with free curvature, pegs and a fold at the base.

y'' = g + sum_j f_j (a_j - s)+ with x = s (thesis (2.5) to (2.9)), contacts at the pegs' x. Linear,
so contacts are a small complementarity problem. It comes with a bound on the error of positions
against the large-deflection rod: foreshortening (the integral of theta^2 / 2) times a safety
factor. Pegs in the straight body's way make the bound infinite.
"""

from __future__ import annotations

from math import fabs, sqrt

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.mechanics import kernel

Floats = npt.NDArray[np.float64]

# Feedback of foreshortening on contact arcs and forces; held by tests over random scenes.
SAFETY = 2.0


@compiled
def _lift(s: float, a: float) -> float:
    """Deflection at s of a unit force at a (1/cm^2 -> cm)."""
    if s <= a:
        return s * s * (3.0 * a - s) / 6.0
    return a * a * (3.0 * s - a) / 6.0


@compiled
def _fold_lift(s: float, fold: float) -> float:
    """Deflection at s of a unit fold angle spread over [0, fold]."""
    return 0.5 * s * s / fold if s < fold else s - 0.5 * fold


@compiled
def equilibrium(
    g: float,
    length: float,
    tube: float,
    fold: float,
    critical: float,
    pegs: Floats,
    cells: int,
    nodes: Floats,
    who: npt.NDArray[np.int64],
    force: Floats,
    arcs: Floats,
) -> tuple[int, int, float, float]:
    """Contacts and fold by active set. Returns (contacts or -1, nodes, fold angle, error bound).

    force: signed normal forces; arcs: where. nodes: (s, heading, curvature, x, y) table.
    """
    n_pegs = pegs.shape[0]
    side = np.zeros(n_pegs)
    level = np.zeros(n_pegs)
    at = np.zeros(n_pegs)
    active = np.zeros(n_pegs, np.bool_)
    f = np.zeros(n_pegs)
    astray = False
    for j in range(n_pegs):
        x, y, r = pegs[j, 0], pegs[j, 1], pegs[j, 2]
        side[j] = 0.0
        if x <= 0.0 or x >= length + r:
            continue
        at[j] = min(x, length)
        reach = r
        if x > length:
            reach = sqrt(r * r - (x - length) * (x - length))
        side[j] = 1.0 if y < 0.0 else -1.0
        # In the straight body's way: which side it is on, or whether the end's face meets it, is a
        # matter of history that this model does not know.
        if fabs(y) < tube + r:
            astray = True
        level[j] = y + side[j] * (tube + reach)
    psi = 0.0
    folded = 0.0
    size = n_pegs + 1
    a = np.zeros((size, size))
    b = np.zeros(size)
    index = np.zeros(size, np.int64)
    solved = False
    for _ in range(4 * n_pegs + 8):
        n = 0
        for j in range(n_pegs):
            if active[j]:
                index[n] = j
                n += 1
        m = n
        for r in range(n):
            j = index[r]
            for c in range(n):
                a[r, c] = _lift(at[j], at[index[c]])
            b[r] = level[j] - 0.5 * g * at[j] * at[j]
        if folded != 0.0:
            for r in range(n):
                a[r, n] = _fold_lift(at[index[r]], fold)
                a[n, r] = at[index[r]]
            a[n, n] = 0.0
            b[n] = folded * critical
            m = n + 1
        if m > 0 and kernel._solve_small(a, b, m) == 0.0:
            return -1, 0, 0.0, 1e30
        psi = b[n] if folded != 0.0 else 0.0
        for j in range(n_pegs):
            f[j] = 0.0
        worst = -1
        pull = -1e-13
        moment = 0.0
        for r in range(n):
            j = index[r]
            f[j] = b[r]
            moment += f[j] * at[j]
            if side[j] * f[j] < pull:
                pull = side[j] * f[j]
                worst = j
        if worst >= 0:
            active[worst] = False
            continue
        if folded != 0.0 and psi * folded < -1e-12:
            folded = 0.0
            continue
        if folded == 0.0 and fabs(moment) > critical * (1.0 + 1e-12):
            folded = 1.0 if moment > 0.0 else -1.0
            continue
        deepest = -1e-9
        which = -1
        for j in range(n_pegs):
            if side[j] == 0.0 or active[j]:
                continue
            y = 0.5 * g * at[j] * at[j] + psi * _fold_lift(at[j], fold)
            for i in range(n_pegs):
                if active[i]:
                    y += f[i] * _lift(at[j], at[i])
            gap = side[j] * (y - level[j])
            if gap < deepest:
                deepest = gap
                which = j
        if which < 0:
            solved = True
            break
        active[which] = True
    if not solved:
        return -1, 0, 0.0, 1e30
    count = 0
    for j in range(n_pegs):
        if active[j] and count < who.size:
            who[count] = j
            force[count] = f[j]
            arcs[count] = at[j]
            count += 1
    h = length / cells
    shortening = 0.0
    before = 0.0
    for i in range(cells + 1):
        s = i * h
        kappa = g
        slope = g * s + psi * min(s, fold) / fold
        y = 0.5 * g * s * s + psi * _fold_lift(s, fold)
        for c in range(count):
            u = max(arcs[c] - s, 0.0)
            kappa += force[c] * u
            slope += force[c] * 0.5 * (arcs[c] * arcs[c] - u * u)
            y += force[c] * _lift(s, arcs[c])
        nodes[i, kernel.S] = s
        nodes[i, kernel.THETA] = slope
        nodes[i, kernel.KAPPA] = kappa
        nodes[i, kernel.X] = s
        nodes[i, kernel.Y] = y
        if i > 0:
            shortening += 0.25 * h * (slope * slope + before * before)
        before = slope
    return count, cells + 1, psi, 1e30 if astray else SAFETY * shortening
