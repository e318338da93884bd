"""Least absolute deviations from a vertex nearby: min over free beta of sum w |y - beta G|.

Refinement fits the same readings hundreds of times with columns that have moved by little, so the
readings that were met exactly before are nearly those that are now. Descent starts there, as in
Bloomfield and Steiger, Least Absolute Deviations (1983): give up one of them, follow the edge to
the weighted median of the places where residuals vanish, meet the one that vanishes there instead.
An edge costs a few passes over the readings, and few are needed. Called by `refinement`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_inner
from thigmo.localization.exact.absolute_fit import SignedFit, crossing
from thigmo.localization.exact.response import plain

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

EDGES = 60  # followed at most; then the fit is done from scratch
DUAL = 1e-10  # of a weight: by so much a dual variable may exceed it
SINGULAR = 1e-11  # of a column's largest entry


class Descent(NamedTuple):
    """Work of a fit of N readings by up to M coefficients.

    Attributes:
        residual: (N,).
        pull: (N,) weight with the residual's sign, 0 for readings that are met.
        key: (N,) how far along an edge each residual vanishes.
        amount: (N,) what the slope gains there.
        edge: (N,) what the residuals lose per step along it.
        order: (N,) items of the median.
        matrix: (M, 2 M) columns of the readings that are met, then their inverse.
        inverse: (M, M) row b moves beta so that only reading `basis[b]` is left, by 1.
        balance: (M,) sums of pulls times columns.
    """

    residual: Floats
    pull: Floats
    key: Floats
    amount: Floats
    edge: Floats
    order: Ints
    matrix: Floats
    inverse: Floats
    balance: Floats


@compiled_inner
def inverted(g: Floats, m: int, basis: Ints, matrix: Floats, inverse: Floats) -> bool:
    """Inverse of the columns of the readings in `basis`; false if they are dependent."""
    for k in range(m):
        for b in range(m):
            matrix[k, b] = g[k, basis[b]]
            matrix[k, m + b] = 1.0 if k == b else 0.0
    for b in range(m):
        pivot = b
        largest = 0.0
        for k in range(m):
            largest = max(largest, abs(g[k, basis[b]]))
        for k in range(b + 1, m):
            if abs(matrix[k, b]) > abs(matrix[pivot, b]):
                pivot = k
        if abs(matrix[pivot, b]) <= SINGULAR * largest:
            return False
        scale = 1.0 / matrix[pivot, b]
        for q in range(b, 2 * m):
            value = matrix[pivot, q] * scale
            matrix[pivot, q] = matrix[b, q]
            matrix[b, q] = value
        for k in range(m):
            factor = matrix[k, b]
            if k != b and factor != 0.0:
                for q in range(b, 2 * m):
                    matrix[k, q] -= factor * matrix[b, q]
    for b in range(m):
        for k in range(m):
            inverse[b, k] = matrix[b, m + k]
    return True


@compiled_inner
def descend(fit: SignedFit, m: int, basis: Ints, beta: Floats, room: Descent) -> float:
    """Least objective over free coefficients of the first m rows of g; inf if it is not reached.

    Args:
        fit: data and coefficients; no constraints, `kind` is not looked at.
        m: coefficients.
        basis: (>= m,) readings that are met at the start, distinct; written: those at the end.
        beta: (>= m,) written.
        room: work.
    """
    g, y, w, _ = fit
    residual, pull, key, amount, edge, order, matrix, inverse, balance = room
    n = y.shape[0]
    if not inverted(g, m, basis, matrix, inverse):
        return np.inf
    for k in range(m):
        beta[k] = 0.0
        for b in range(m):
            beta[k] += y[basis[b]] * inverse[b, k]
    for i in range(n):
        residual[i] = y[i]
    for k in range(m):
        factor = beta[k]
        for i in range(n):
            residual[i] -= factor * g[k, i]
    for i in range(n):
        pull[i] = w[i] if residual[i] > 0.0 else -w[i]
    for b in range(m):
        residual[basis[b]] = 0.0
        pull[basis[b]] = 0.0
    for k in range(m):
        balance[k] = 0.0
        for i in range(n):
            balance[k] += pull[i] * g[k, i]
    for _ in range(EDGES):
        # The dual variables of the readings that are met; one beyond its weight is given up.
        leave = -1
        need = 0.0
        towards = 0.0
        for b in range(m):
            dual = 0.0
            for k in range(m):
                dual += inverse[b, k] * balance[k]
            excess = abs(dual) - w[basis[b]]
            if excess > DUAL * w[basis[b]] and excess > need:
                leave = b
                need = excess
                towards = 1.0 if dual > 0.0 else -1.0
        if leave < 0:
            value = 0.0
            for i in range(n):
                value += w[i] * abs(residual[i])
            return value
        for i in range(n):
            edge[i] = 0.0
        for k in range(m):
            factor = towards * inverse[leave, k]
            for i in range(n):
                edge[i] += factor * g[k, i]
        for i in range(n):
            amount[i] = 2.0 * pull[i] * edge[i]
            key[i] = residual[i] / edge[i]
        count = plain(0)
        for i in range(n):
            order[count] = i
            count += amount[i] > 0.0
        place = crossing(key, amount, order, count, need)
        if place == count:
            return np.inf
        for p in range(place):
            i = order[p]
            for k in range(m):
                balance[k] -= 2.0 * pull[i] * g[k, i]
            pull[i] = -pull[i]
        enter = order[place]
        step = key[enter]
        for i in range(n):
            residual[i] -= step * edge[i]
        for k in range(m):
            beta[k] += step * towards * inverse[leave, k]
        i = basis[leave]
        pull[i] = -towards * w[i]
        for k in range(m):
            balance[k] += pull[i] * g[k, i] - pull[enter] * g[k, enter]
        pull[enter] = 0.0
        for b in range(m):
            residual[basis[b]] = 0.0 if b != leave else residual[i]
        residual[enter] = 0.0
        basis[leave] = enter
        scale = towards / edge[enter]
        for k in range(m):
            inverse[leave, k] *= scale
        for b in range(m):
            if b != leave:
                factor = 0.0
                for k in range(m):
                    factor += inverse[b, k] * g[k, enter]
                for k in range(m):
                    inverse[b, k] -= factor * inverse[leave, k]
    return np.inf
