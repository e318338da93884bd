"""Independent, slower ways to the optimum, for the tests of the exact solvers.

`grid_minimum` scans arcs on a grid that holds every end of a span, with an exact inner fit of the
forces (L1: every vertex of the inner linear programme; L2: normal equations), and zooms in on the
best few. `programme_minimum` solves one linear programme (HiGHS) per interval assignment and sign
pattern, for point sensors. `random_case` draws layouts that are spread, co-located, overlapping or
mixed, with noise, outliers, equal, rounded or no readings at all.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

Floats = NDArray[np.float64]
LENGTH = 53.0


@dataclass
class Case:
    curvature: Floats
    position: Floats
    span: Floats
    weight: Floats
    bounds: tuple[float, float]

    @property
    def scale(self) -> float:
        return float((self.weight * np.abs(self.curvature)).sum())

    @property
    def square_scale(self) -> float:
        return float(((self.weight * self.curvature) ** 2).sum())

    @property
    def limit(self) -> float:
        """The default force limit of several_contacts."""
        return 20.0 * float(np.abs(self.curvature).max()) / LENGTH


def influence(arc: float, position: Floats, span: Floats) -> Floats:
    """phi of METHODS 1, written down once more."""
    reach = arc - (position - span / 2)
    safe = np.where(span > 0, span, 1.0)
    return np.where(reach <= 0, 0.0, np.where(reach >= span, arc - position, reach**2 / (2 * safe)))


def objective(case: Case, arcs: Floats, forces: Floats, norm: int) -> float:
    model = np.zeros(len(case.curvature))
    for arc, force in zip(arcs, forces, strict=True):
        model += force * influence(arc, case.position, case.span)
    residual = case.weight * (case.curvature - model)
    return float(np.abs(residual).sum() if norm == 1 else (residual**2).sum())


def random_case(rng: np.random.Generator, most: int, contacts: int = 1) -> Case:
    n = int(rng.integers(1, most + 1))
    position = [
        rng.uniform(0, LENGTH, n),
        np.resize(np.linspace(rng.uniform(0, 6), 47, max(1, (n + 1) // 2)), n),  # both sides
        rng.choice(np.arange(1, 52, 5.0), n),
        np.linspace(2.75, 50.25, n),
        rng.uniform(20, 30, n),
    ][rng.integers(5)]
    span = [
        np.zeros(n),
        np.full(n, 5.5),
        rng.uniform(0, 20, n),
        rng.choice([0.0, 5.5, 11.0], n),
        np.full(n, 15.0),
    ][rng.integers(5)]
    weight = np.ones(n) if rng.random() < 0.5 else rng.uniform(0.3, 3, n)
    curvature = rng.choice([0, 1e-5, 6e-4, 3e-3]) * rng.standard_normal(n)
    for _ in range(contacts):
        force = rng.choice([-1, 1]) * 10 ** rng.uniform(-5, -3)
        curvature = curvature + force * influence(rng.uniform(0, LENGTH), position, span)
    kind = rng.integers(8)
    if kind == 0:
        curvature = np.round(curvature, 3)
    elif kind == 1:
        curvature = np.full(n, curvature[0])
    elif kind == 2:
        curvature = np.zeros(n)
    elif kind == 3:
        curvature[rng.integers(n)] += 0.02
    bounds = [(-np.inf, np.inf), (-np.inf, np.inf), (0, np.inf), (-3e-4, 2e-4), (1e-4, 5e-4)]
    return Case(curvature, position, span, weight, bounds[rng.integers(5)])


@numba.njit(error_model="numpy")
def _phi(arc, x, span):
    t = arc - x + span / 2
    if t <= 0:
        return 0.0
    if t >= span:
        return arc - x
    return t * t / (2 * span)


@numba.njit(error_model="numpy")
def _cost(y, p, w, f, norm):
    total = 0.0
    for i in range(y.shape[0]):
        r = y[i]
        for j in range(f.shape[0]):
            r -= f[j] * p[j, i]
        total += w[i] * abs(r) if norm == 1 else (w[i] * r) ** 2
    return total


@numba.njit(error_model="numpy")
def _solve(a, b, c, f):
    """Gaussian elimination with pivoting for c <= 3; false if singular."""
    for k in range(c):
        best = k
        for r in range(k + 1, c):
            if abs(a[r, k]) > abs(a[best, k]):
                best = r
        if abs(a[best, k]) < 1e-300:
            return False
        for m in range(c):
            a[k, m], a[best, m] = a[best, m], a[k, m]
        b[k], b[best] = b[best], b[k]
        for r in range(k + 1, c):
            q = a[r, k] / a[k, k]
            for m in range(k, c):
                a[r, m] -= q * a[k, m]
            b[r] -= q * b[k]
    for k in range(c - 1, -1, -1):
        v = b[k]
        for m in range(k + 1, c):
            v -= a[k, m] * f[m]
        f[k] = v / a[k, k]
    return True


@numba.njit(error_model="numpy")
def inner_minimum(arcs, y, x, span, w, low, high, norm):
    """Least cost over forces within [low, high] at fixed arcs, by every vertex or active set."""
    c = arcs.shape[0]
    n = y.shape[0]
    p = np.empty((c, n))
    for j in range(c):
        for i in range(n):
            p[j, i] = _phi(arcs[j], x[i], span[i])
    a = np.empty((3, 3))
    b = np.empty(3)
    f = np.zeros(c)
    for j in range(c):
        f[j] = min(max(0.0, low), high)
    best = _cost(y, p, w, f, norm)
    if norm == 1:
        # Rows: residuals, then f_j = 0, low, high. Every choice of c rows is a vertex.
        rows = n + 3 * c
        pick = np.zeros(3, np.int64)
        for k0 in range(rows):
            for k1 in range(k0 + 1 if c > 1 else 0, rows if c > 1 else 1):
                for k2 in range(k1 + 1 if c > 2 else 0, rows if c > 2 else 1):
                    pick[0] = k0
                    pick[1] = k1
                    pick[2] = k2
                    usable = True
                    for r in range(c):
                        k = pick[r]
                        if k < n:
                            for j in range(c):
                                a[r, j] = p[j, k]
                            b[r] = y[k]
                        else:
                            for j in range(c):
                                a[r, j] = 1.0 if j == (k - n) % c else 0.0
                            which = (k - n) // c
                            b[r] = 0.0 if which == 0 else (low if which == 1 else high)
                            usable = usable and abs(b[r]) < np.inf
                    if not usable or not _solve(a, b, c, f):
                        continue
                    for j in range(c):
                        usable = usable and low <= f[j] <= high
                    if usable:
                        best = min(best, _cost(y, p, w, f, norm))
        return best
    # Each force free, at the low or at the high bound.
    state = np.zeros(3, np.int64)
    free = np.zeros(3, np.int64)
    part = np.zeros(3)
    for code in range(3**c):
        left = code
        count = 0
        usable = True
        for j in range(c):
            state[j] = left % 3
            left //= 3
            if state[j] == 0:
                free[count] = j
                count += 1
            else:
                f[j] = low if state[j] == 1 else high
                usable = usable and abs(f[j]) < np.inf
        if not usable:
            continue
        for r in range(count):
            b[r] = 0.0
            for m in range(count):
                a[r, m] = 0.0
            for i in range(n):
                v = y[i]
                for j in range(c):
                    if state[j] != 0:
                        v -= f[j] * p[j, i]
                b[r] += w[i] ** 2 * p[free[r], i] * v
                for m in range(count):
                    a[r, m] += w[i] ** 2 * p[free[r], i] * p[free[m], i]
        if count > 0:
            if not _solve(a, b, count, part):
                continue
            for r in range(count):
                f[free[r]] = part[r]
        for j in range(c):
            usable = usable and low <= f[j] <= high
        if usable:
            best = min(best, _cost(y, p, w, f, norm))
    return best


@numba.njit(error_model="numpy")
def grid_minimum(y, x, span, w, length, low, high, norm, c, points, starts, levels, fine):
    """Least cost found by a grid over arcs and `levels` of zoom on the best `starts` places."""
    n = y.shape[0]
    grid = np.empty(points + 2 * n + 1)
    m = 0
    for k in range(points):
        grid[m] = length * k / (points - 1)
        m += 1
    for i in range(n):
        for e in (x[i] - span[i] / 2, x[i] + span[i] / 2):
            if 0.0 <= e <= length:
                grid[m] = e
                m += 1
    grid[m] = min(max(np.min(x - span / 2), 0.0) + 1e-7 * length, length)
    m += 1
    grid = np.sort(grid[:m])
    arcs = np.empty(c)
    top = np.full(starts, np.inf)
    place = np.zeros((starts, c))
    apart = 1.2 * length / (points - 1)
    for i0 in range(m):
        for i1 in range(i0 if c > 1 else 0, m if c > 1 else 1):
            for i2 in range(i1 if c > 2 else 0, m if c > 2 else 1):
                arcs[0] = grid[i0]
                if c > 1:
                    arcs[1] = grid[i1]
                if c > 2:
                    arcs[2] = grid[i2]
                value = inner_minimum(arcs, y, x, span, w, low, high, norm)
                if value >= top[starts - 1]:
                    continue
                # Replace a kept place nearby, or the worst one.
                slot = starts - 1
                keep = True
                for s in range(starts):
                    near = top[s] < np.inf
                    for j in range(c):
                        near = near and abs(place[s, j] - arcs[j]) <= apart
                    if near:
                        slot = s
                        keep = value < top[s]
                        break
                if not keep:
                    continue
                top[slot] = value
                for j in range(c):
                    place[slot, j] = arcs[j]
                while slot > 0 and top[slot - 1] > top[slot]:
                    top[slot - 1], top[slot] = top[slot], top[slot - 1]
                    for j in range(c):
                        place[slot - 1, j], place[slot, j] = place[slot, j], place[slot - 1, j]
                    slot -= 1
    best = top[0]
    for s in range(starts):
        if top[s] == np.inf:
            continue
        reach = 1.5 * length / (points - 1)
        centre = place[s].copy()
        here = top[s]
        for _ in range(levels):
            middle = centre.copy()
            for code in range(fine**c):
                left = code
                for j in range(c):
                    step = 2.0 * (left % fine) / (fine - 1) - 1.0
                    left //= fine
                    arcs[j] = min(max(middle[j] + reach * step, 0.0), length)
                value = inner_minimum(arcs, y, x, span, w, low, high, norm)
                if value < here:
                    here = value
                    for j in range(c):
                        centre[j] = arcs[j]
            reach *= 2.2 / (fine - 1)
        best = min(best, here)
    return best


def programme_minimum(case: Case, contacts: int, limit: float) -> float:
    """L1 minimum for point sensors: a linear programme per interval assignment and signs."""
    edges = np.unique(np.concatenate([[0.0, LENGTH], case.position]))
    edges = edges[(edges >= 0) & (edges <= LENGTH)]
    n = len(case.curvature)
    cells = list(itertools.pairwise(edges.tolist()))
    best = case.scale
    for chosen in itertools.combinations_with_replacement(cells, contacts):
        for signs in itertools.product((1.0, -1.0), repeat=contacts):
            # Variables u_j = f_j and v_j = f_j a_j, then the absolute residuals.
            columns, upper, right, bounds = [], [], [], []
            for j, ((left, end), sign) in enumerate(zip(chosen, signs, strict=True)):
                behind = (case.position <= left).astype(float)
                columns += [-case.position * behind, behind]
                for a in (left, end):
                    row = np.zeros(2 * contacts + n)
                    direction = sign if a == end else -sign
                    row[2 * j], row[2 * j + 1] = -direction * a, direction
                    upper.append(row)
                    right.append(0.0)
                bounds += [(0, limit) if sign > 0 else (-limit, 0), (None, None)]
            model = np.column_stack(columns)
            for s in (1.0, -1.0):
                upper += list(np.hstack([s * model, -np.eye(n)]))
                right += list(s * case.curvature)
            found = linprog(
                np.concatenate([np.zeros(2 * contacts), case.weight]),
                A_ub=np.array(upper),
                b_ub=np.array(right),
                bounds=bounds + [(0, None)] * n,
                method="highs",
            )
            if found.status == 0:
                best = min(best, float(found.fun))
    return best
