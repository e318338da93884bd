"""Independent, slower ways to the optimum of one or two contacts, for the tests of the point fits.

`fit` is the compiled fit of a body of length one, with the gap to its proven bound.
`programme_minimum` solves a linear programme (HiGHS) for each choice of intervals between point
sensors and each choice of signs. `grid_minimum` tries arcs on a grid that holds every end of a
span, with all vertices (1-norm) or all active sets (2-norm) of the forces, and zooms in on the best
few. `random_frame` draws layouts that are spread, co-located, overlapping or mixed.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from thigmo.localization import Localizer

Floats = NDArray[np.float64]

LIMIT = 20.0  # |force| of two contacts over the largest reading


@dataclass(frozen=True)
class PointFit:
    objective: float
    gap: float
    arcs: Floats
    forces: Floats
    optimum_set: tuple[tuple[tuple[float, float], ...], ...]


def fit(y: Floats, low: Floats, high: Floats, contacts: int, norm: str) -> PointFit:
    """The compiled fit of readings above a free curvature of 0."""
    options: dict[str, Any] = {"tube_radius": 1e-6, "contacts": contacts, "method": norm}
    options |= {"position": 0.5 * (low + high), "length": 1.0, "span": high - low}
    localizer = Localizer.of(**options)._compiled
    # Readings that are all the same are refused of a body that nothing bends.
    free = np.full(1, 0.5 if np.ptp(y) == 0.0 else 0.0)
    found = localizer.localize(y + free, free, free)
    assert found.problem == 0
    arcs, forces, _, _, sets, *_ = zip(*found.contacts(1.0), strict=True)
    return PointFit(
        found.objective,
        found.gap,
        np.array(arcs),
        np.array(forces),
        tuple(tuple(pieces) for pieces in sets),
    )


def influence(arc: Floats | float, low: Floats, high: Floats) -> Floats:
    """Response of docs/methods.md, written down once more: (..., N) for arcs (...)."""
    reach = np.asarray(arc)[..., None] - low
    span = high - low
    inside = reach**2 / (2.0 * np.where(span > 0.0, span, 1.0))
    beyond = reach - 0.5 * span
    return np.where(reach <= 0.0, 0.0, np.where(reach >= span, beyond, inside))


def misfit(residual: Floats, norm: str) -> Floats:
    return np.asarray(np.abs(residual).sum(-1) if norm == "l1" else (residual**2).sum(-1))


def objective(
    y: Floats, low: Floats, high: Floats, arcs: Floats, forces: Floats, norm: str
) -> float:
    return float(misfit(y - forces @ influence(arcs, low, high), norm))


def random_frame(
    rng: np.random.Generator, most: int, contacts: int, points: bool = False
) -> tuple[Floats, Floats, Floats]:
    """Readings, near and far ends."""
    n = int(rng.integers(1, most + 1))
    both_sides = np.resize(np.linspace(rng.uniform(0.0, 0.1), 0.9, max(1, (n + 1) // 2)), n)
    position = [
        rng.uniform(0.0, 1.0, n),
        both_sides,
        rng.choice(np.arange(0.02, 1.0, 0.1), n),
        rng.uniform(0.4, 0.6, n),
    ][rng.integers(4)]
    span = [
        np.zeros(n),
        np.full(n, 0.1),
        rng.uniform(0.0, 0.4, n),
        rng.choice([0.0, 0.1, 0.2], n),
    ][0 if points else rng.integers(4)]
    low, high = np.maximum(position - span / 2, 0.0), np.minimum(position + span / 2, 1.0)
    middle = (low + high) / 2
    if n > 2 and (np.ptp(middle) == 0.0 or middle.max() < 0.12):
        return random_frame(rng, most, contacts, points)  # a layout that is refused
    y = rng.choice([0.0, 0.03, 0.15]) * rng.standard_normal(n)
    for _ in range(contacts):
        force = rng.choice([-1, 1]) * 10 ** rng.uniform(-1.5, 0.5)
        y = y + force * influence(rng.uniform(0.0, 1.0), low, high)
    kind = rng.integers(6)
    if kind == 0:
        y = np.round(y, 2)
    elif kind == 1:
        y = np.full(n, y[0])
    elif kind == 2:
        y[rng.integers(n)] += 1.0
    return y, low, high


def best_misfit(y: Floats, phi: Floats, limit: float, norm: str) -> Floats:
    """Least misfit over forces of at most `limit`, for responses phi (..., k, N) of k contacts."""
    k, n = phi.shape[-2:]
    best = misfit(np.broadcast_to(y, (*phi.shape[:-2], n)), norm)
    # Conditions row @ forces = value, k of which make a candidate: a residual that vanishes
    # (1-norm), a gradient that does (2-norm), a force that is 0 or at the limit.
    if norm == "l1":
        rows = np.moveaxis(phi, -1, -2)
        values = np.broadcast_to(y, (*phi.shape[:-2], n))
    else:
        rows = phi @ np.moveaxis(phi, -1, -2)
        values = phi @ y
    for j in range(k):
        for value in (0.0, limit, -limit):
            if np.isfinite(value):
                unit = np.broadcast_to(np.eye(k)[j], (*rows.shape[:-2], 1, k))
                rows = np.concatenate([rows, unit], axis=-2)
                fixed = np.full((*values.shape[:-1], 1), value)
                values = np.concatenate([values, fixed], axis=-1)
    for pick in itertools.combinations(range(rows.shape[-2]), k):
        a, b = rows[..., pick, :], values[..., pick]
        if k == 1:
            det = a[..., 0, 0]
            forces = b
        else:
            det = a[..., 0, 0] * a[..., 1, 1] - a[..., 0, 1] * a[..., 1, 0]
            first = b[..., 0] * a[..., 1, 1] - b[..., 1] * a[..., 0, 1]
            second = b[..., 1] * a[..., 0, 0] - b[..., 0] * a[..., 1, 0]
            forces = np.stack([first, second], axis=-1)
        usable = np.abs(det) > 1e-200
        forces = forces / np.where(usable, det, 1.0)[..., None]
        usable &= (np.abs(forces) <= limit * (1.0 + 1e-12)).all(-1)
        model = (forces[..., None] * phi).sum(-2)
        best = np.minimum(best, np.where(usable, misfit(y - model, norm), np.inf))
    return best


def profile(y: Floats, low: Floats, high: Floats, arcs: Floats) -> Floats:
    """Least sum of |r| of one contact at each of some arcs."""
    return best_misfit(y, influence(arcs, low, high)[:, None, :], np.inf, "l1")


def grid_minimum(
    y: Floats, low: Floats, high: Floats, contacts: int, norm: str, held: dict[int, float] | None
) -> float:
    """Least misfit on a grid of arcs that is refined around its best few places.

    Args:
        y: (N,) readings.
        low: (N,) near ends.
        high: (N,) far ends.
        contacts: 1 or 2.
        norm: "l1" or "l2".
        held: arcs of contacts that are given.
    """
    limit = np.inf if contacts == 1 else LIMIT * float(np.abs(y).max())
    count, levels = (200, 5) if contacts == 1 else (20, 6)
    ends = np.clip(np.concatenate([low, high, low + 1e-9]), 0.0, 1.0)
    axes = [np.unique(np.concatenate([np.linspace(0.0, 1.0, count), ends]))] * contacts
    for contact, arc in (held or {}).items():
        axes[contact] = np.array([arc])

    def values(axes: list[Floats]) -> tuple[Floats, Floats]:
        arcs = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, contacts)
        arcs = arcs[(np.diff(arcs, axis=-1) >= 0.0).all(-1)]
        return arcs, best_misfit(y, influence(arcs, low, high), limit, norm)

    arcs, found = values(axes)
    best = float(found.min())
    starts = []
    for k in np.argsort(found):
        if all(np.abs(arcs[k] - s).max() > 1.5 / count for s in starts):
            starts.append(arcs[k])
        if len(starts) == 3:
            break
    for start in starts:
        centre, reach = start, 1.5 / count
        for _ in range(levels):
            near = [
                np.clip(c + reach * np.linspace(-1.0, 1.0, 13), 0.0, 1.0)
                if axes[j].size > 1
                else axes[j]
                for j, c in enumerate(centre)
            ]
            arcs, found = values(near)
            if found.size == 0:
                break
            if found.min() <= best:
                best = float(found.min())
            centre = arcs[int(found.argmin())]
            reach /= 4.0
    return best


def programme_minimum(y: Floats, places: Floats, contacts: int) -> float:
    """Least sum of |r| with point sensors: one linear programme for each intervals and signs."""
    n = len(y)
    limit = 1e6 if contacts == 1 else LIMIT * float(np.abs(y).max())
    edges = np.unique(np.concatenate([[0.0, 1.0], places[(places > 0.0) & (places < 1.0)]]))
    cells = list(itertools.pairwise(edges))
    best = float(np.abs(y).sum())
    for chosen in itertools.combinations_with_replacement(cells, contacts):
        for signs in itertools.product((1.0, -1.0), repeat=contacts):
            # Unknowns: force and moment of each contact, then the size of each residual.
            model = np.zeros((n, 2 * contacts))
            rows, sides = [], []
            for j, ((near, far), sign) in enumerate(zip(chosen, signs, strict=True)):
                reached = places <= near
                model[reached, 2 * j] = -places[reached]
                model[reached, 2 * j + 1] = 1.0
                for force, moment in ((near, -1.0), (-far, 1.0)):
                    row = np.zeros(2 * contacts + n)
                    row[2 * j], row[2 * j + 1] = sign * force, sign * moment
                    rows.append(row)
                    sides.append(0.0)
            bounds = [
                b
                for sign in signs
                for b in (((0.0, limit) if sign > 0 else (-limit, 0.0)), (None, None))
            ] + [(0.0, None)] * n
            above = np.hstack([-model, -np.eye(n)])
            below = np.hstack([model, -np.eye(n)])
            solved = linprog(
                np.r_[np.zeros(2 * contacts), np.ones(n)],
                A_ub=np.vstack([above, below, np.array(rows)]),
                b_ub=np.r_[-y, y, sides],
                bounds=bounds,
            )
            if solved.status == 0:
                best = min(best, float(solved.fun))
    return best
