"""The relaxed fit over one box of the branch and bound, and what is read off it.

In a box every contact lies within one cell, where the vector of influences runs within the convex
hull of two or three Bezier points. A fit over those points is a lower bound; the mixture that it
takes stands for an arc and a force of each contact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_part, compiled_sums
from thigmo.localization.exact.absolute_fit import SignedFit, Simplex, Size, absolute_fit
from thigmo.localization.exact.response import Readings
from thigmo.localization.exact.square_fit import (
    ActiveSet,
    Limits,
    Triangle,
    square_fit,
    triangle,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Room(NamedTuple):
    """Work for the fits: the simplex's, a rotated copy of the data, the active set's."""

    simplex: Simplex
    rotated: Triangle
    active_set: ActiveSet


class Relaxed(NamedTuple):
    """A relaxed fit for C contacts.

    Attributes:
        fit: influences of the Bezier points on the sensors that take part, their readings.
        active: (N,) which sensors those are.
        group: (3 C,) contact of each coefficient.
        offset: (C + 1,) first coefficient of each contact.
        beta: (4 C,) coefficients.
        arc: (C,) arcs that the fit stands for.
        force: (C,) forces, likewise.
    """

    fit: SignedFit
    active: Ints
    group: Ints
    offset: Ints
    beta: Floats
    arc: Floats
    force: Floats


@compiled_sums
def empty_relaxed(n: int, contacts: int) -> tuple[Relaxed, Room]:
    """Room for fits of `contacts` to n readings."""
    c = contacts
    rows = 3 * c
    fit = SignedFit(
        np.empty((rows, n + c)), np.empty(n + c), np.empty(n), np.empty(rows + c, np.int64)
    )
    relaxed = Relaxed(
        fit,
        np.empty(max(n, 1), np.int64),
        np.zeros(rows, np.int64),
        np.zeros(c + 1, np.int64),
        np.zeros(rows + c),
        np.empty(c),
        np.empty(c),
    )
    items = np.empty((4, n + 2 * c + rows), np.int64)
    simplex = Simplex(np.empty((rows + 1, n + c + rows)), np.empty((6, n + c + rows)), items)
    square = np.empty((5, rows + c + 1, rows + c + 1))
    active_set = ActiveSet(items[0], square[2], square[3], square[4])
    return relaxed, Room(simplex, Triangle(square[0], square[1, 0]), active_set)


@compiled_part
def signed_fit(
    relaxed: Relaxed, size: Size, groups: int, limit: float, norm: int, room: Room
) -> tuple[float, bool]:
    """Least sum of |w r| or (w r)^2 over signed coefficients; and whether that is proven.

    Args:
        relaxed: `fit` and `group` are read, `beta` is written.
        size: of the fit; its constraints say the limit to the L1 fit.
        groups: how many groups are limited.
        limit: on the sum of |beta| over each group of one sign.
        norm: 1 or 2.
        room: work.
    """
    fit = relaxed.fit
    if norm == 1:
        return absolute_fit(fit, size, relaxed.beta, room.simplex)
    triangle(fit, size, room.simplex.tableau, room.rotated)
    limits = Limits(relaxed.group, groups, limit)
    value = square_fit(room.rotated, size.m, fit.kind, limits, relaxed.beta, room.active_set)
    return value, True


@compiled_part
def bezier_points(
    node: Floats, bent: Ints, readings: Readings, count: int, relaxed: Relaxed
) -> int:
    """Rows of influences at both ends of each contact's box and, in a span, their middle point.

    Args:
        node: one row of nodes.
        bent: (cells,) whether a cell lies in a span.
        readings: N of them.
        count: how many sensors take part (`relaxed.active`).
        relaxed: rows of its fit, their signs, groups and offsets are written.

    Returns:
        Number of rows.
    """
    c = node.shape[0] // 4
    _, low, span, inverse, _ = readings
    g, kind = relaxed.fit.g, relaxed.fit.kind
    active, group, offset = relaxed.active, relaxed.group, relaxed.offset
    m = 0
    for j in range(c):
        offset[j] = m
        left = node[j]
        right = node[c + j]
        three = bent[int(node[3 * c + j])] == 1 and right > left
        for q in range(count):
            i = active[q]
            a = left - low[i]
            b = right - low[i]
            t = 0.5 * (a + b)
            if t <= 0.0:
                at_left = 0.0
                at_right = 0.0
                middle = 0.0
            elif t >= span[i]:
                at_left = a - 0.5 * span[i]
                at_right = b - 0.5 * span[i]
                middle = t - 0.5 * span[i]
            else:
                at_left = a * a * inverse[i]
                at_right = b * b * inverse[i]
                middle = a * b * inverse[i]
            g[m, q] = at_left
            g[m + 1, q] = at_right
            if three:
                g[m + 2, q] = middle
        rows = 3 if three else 2
        for r in range(m, m + rows):
            kind[r] = int(node[2 * c + j])
            group[r] = j
        m += rows
    offset[c] = m
    return m


@compiled_part
def read_contacts(node: Floats, limit: float, relaxed: Relaxed) -> int:
    """Arcs and forces that a relaxed fit stands for (written into it).

    Returns:
        The contact whose signs are mixed worst (by the base moment that this is worth) or whose
        force passes the limit, sign not yet known; -1 if there is none.
    """
    c = node.shape[0] // 4
    beta, offset = relaxed.beta, relaxed.offset
    arc, force = relaxed.arc, relaxed.force
    mixed = -1
    mixed_by = 0.0
    for j in range(c):
        total = 0.0
        plus = 0.0
        minus = 0.0
        moment = 0.0
        for r in range(offset[j], offset[j + 1]):
            total += beta[r]
            plus += max(beta[r], 0.0)
            minus += max(-beta[r], 0.0)
            place = 0.0 if r == offset[j] else (1.0 if r == offset[j] + 1 else 0.5)
            moment += beta[r] * place
        left = node[j]
        right = node[c + j]
        mixture = max(min(plus, minus) * (right - left), (abs(total) - limit) * right)
        if node[2 * c + j] == 0.0 and mixture > max(mixed_by, 1e-9 * max(plus, minus) * left):
            mixed_by = mixture
            mixed = j
        share = moment / total if total != 0.0 else 0.5
        arc[j] = left + min(max(share, 0.0), 1.0) * (right - left)
        force[j] = total
    return mixed


@compiled_part
def loosest(node: Floats, readings: Readings, count: int, relaxed: Relaxed, least: float) -> int:
    """The contact whose hull is furthest from its curve of influences; -1 if all touch.

    Args:
        node: one row of nodes.
        readings: N of them.
        count: how many sensors take part.
        relaxed: the fit.
        least: boxes no wider than this are not split.
    """
    c = node.shape[0] // 4
    _, low, span, inverse, _ = readings
    beta, offset, active = relaxed.beta, relaxed.offset, relaxed.active
    arc, force, weights = relaxed.arc, relaxed.force, relaxed.fit.w
    widest = 0.0
    split = -1
    for j in range(c):
        left = node[j]
        right = node[c + j]
        if offset[j + 1] - offset[j] < 3 or right - left <= least:
            continue
        spread = 0.0
        for q in range(count):
            i = active[q]
            a = left - low[i]
            b = right - low[i]
            if 0.0 < 0.5 * (a + b) < span[i]:
                t = arc[j] - low[i]
                hull = beta[offset[j]] * a * a + beta[offset[j] + 1] * b * b
                hull += beta[offset[j] + 2] * a * b
                spread += weights[q] * abs(hull - force[j] * t * t) * inverse[i]
        if spread > widest:
            widest = spread
            split = j
    return split
