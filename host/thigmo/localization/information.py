"""Cramer-Rao bounds of contacts: how well the readings alone can fix their places, compiled.

From the Fisher information of places, forces and nuisance columns. `estimate` calls a place open
where they leave it so; `bounds` draws them for a proposed layout.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization.influence import Sensors, influence

Array = npt.NDArray[np.float64]


@compiled
def arc_bounds(arcs: Array, force: Array, sensors: Sensors, W: Array, columns: Array) -> Array:
    """Cramer-Rao bounds of the arcs: how well the readings alone can fix the places.

    Args:
        arcs, force: (C,) contacts.
        sensors: N of them.
        W: (N,) precision of the readings.
        columns: (N, Q) nuisance columns times their prior deviations.

    Returns:
        (C,) standard deviations; infinite where the information matrix is singular.
    """
    c = arcs.shape[0]
    n = sensors.low.shape[0]
    q = columns.shape[1]
    size = 2 * c + q
    J = np.empty((n, size))
    ahead = np.empty(n)
    behind = np.empty(n)
    step = 1e-4
    for j in range(c):
        influence(arcs[j], sensors, ahead)
        J[:, j] = ahead
        up = min(arcs[j] + step, 1.0)
        down = max(arcs[j] - step, 0.0)
        influence(up, sensors, ahead)
        influence(down, sensors, behind)
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
def place_bound(arcs: Array, force: Array, sensors: Sensors, W: Array, columns: Array) -> float:
    """The largest of `arc_bounds`."""
    worst: float = arc_bounds(arcs, force, sensors, W, columns).max()
    return worst
