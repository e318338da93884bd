"""The exact minimum of the thesis's objective (`l1`), and of its 2-norm (`l2`), on a grid.

The model is that of the thesis's solver, averaged over the sensors' spans. One or two contacts.
"""

from __future__ import annotations

from itertools import product
from typing import Literal

import numpy as np

from thigmo.errors import DataError
from thigmo.localization.thesis import Array, ThesisProblem, influence, weighted_median

_ARCS, _PAIR_ARCS = 5300, 106  # grid intervals: 0.01 cm of 53 for one contact, 0.5 cm for two
_MOST_LINES = 30  # line searches for the best two forces
_KEPT = 12  # best pairs around which the grid of pairs is refined


def _least_1(y: Array, levers: Array) -> Array:
    """(C, K) forces that minimise the 1-norm of y (N,) less levers (N, C, K) times forces.

    C is 1 or 2. One force is a weighted median. The best two forces fit two readings exactly. Along
    the line of forces that fit one reading, the best is again a weighted median, which fits the
    next reading (Karst, J. Am. Stat. Assoc. 53, 1958).
    """
    first, second, columns = levers[:, 0], levers[:, -1], np.arange(levers.shape[2])
    if levers.shape[1] == 1:
        ratio = np.divide(y[:, None], first, out=np.zeros_like(first), where=first > 0.0)
        return np.asarray(ratio[weighted_median(ratio, first), columns][None])
    active = (np.abs(y)[:, None] * (second > 0.0)).argmax(axis=0)
    previous, forces = np.full(columns.size, -1), np.zeros((2, columns.size))
    for _ in range(_MOST_LINES):
        row = np.stack([first[active, columns], second[active, columns]])
        through = row * y[active] / np.maximum((row**2).sum(axis=0), 1e-300)
        slope = first * -row[1] + second * row[0]
        slope[active, columns] = 0.0
        weight = np.where(np.abs(slope) > 1e-12 * np.abs(slope).max(axis=0), np.abs(slope), 0.0)
        residual = y[:, None] - first * through[0] - second * through[1]
        ratio = np.divide(residual, slope, out=np.zeros_like(residual), where=weight > 0.0)
        best = weighted_median(ratio, weight)
        forces = through + ratio[best, columns] * np.stack([-row[1], row[0]])
        best = np.where(weight[best, columns] > 0.0, best, previous)
        if (best == previous).all():
            break
        previous, active = active, np.where(best < 0, active, best)
    return forces


def _least_2(y: Array, levers: Array) -> Array:
    """As `_least_1`, for the 2-norm."""
    design = levers.transpose(2, 0, 1)
    return np.asarray((np.linalg.pinv(design) @ y).T)


def exact(problem: ThesisProblem, norm: Literal[1, 2] = 1) -> tuple[Array, Array]:
    """Arcs and forces (contacts,) of least residual norm for one or two contacts.

    The model is averaged over the sensors' spans. One contact is tried at every place of a grid,
    two at every pair of a coarser grid, which is refined around the best pairs. Forces are exact.
    If places tie, the middle one is returned. The forces of two contacts are limited to 20 times
    the force that bends the base by the largest reading: without a limit, opposed contacts that
    merge would fit better than any true pair.

    Raises:
        DataError: the number of contacts is not 1 or 2.
    """
    y, count, length = problem.curvature, problem.contacts, problem.length
    if count not in (1, 2):
        raise DataError(f"no exact fit of {count} contacts", "give 1 or 2")
    fit, step = (_least_1, _least_2)[norm - 1], length / (_ARCS if count == 1 else _PAIR_ARCS)
    nodes: Array = step * np.arange(1.0, round(length / step) + 1.0)
    arcs = nodes[None] if count == 1 else nodes[np.array(np.triu_indices(nodes.size, 1))]
    offsets = np.array(list(product(np.linspace(-1.0, 1.0, 7), repeat=count))).T
    while True:
        levers = influence(problem, arcs.ravel()).reshape(y.size, count, -1)
        forces = fit(y, levers)
        misfit = (np.abs(y[:, None] - (levers * forces).sum(axis=1)) ** norm).sum(axis=0)
        if count == 2:
            misfit[np.abs(forces).max(axis=0) > 20.0 * np.abs(y).max() / length] = np.inf
        if step <= length / _ARCS:
            break
        best = arcs[:, np.argsort(misfit)[:_KEPT]]
        arcs = np.sort((best[:, :, None] + step * offsets[:, None, :]).reshape(count, -1), axis=0)
        step /= 3.0
        arcs = np.clip(arcs, step, length)
    tied = np.flatnonzero(misfit <= misfit.min() + 1e-9 * (np.abs(y) ** norm).sum())
    middle = tied[np.argsort(arcs[-1, tied])][tied.size // 2]
    return arcs[:, middle], forces[:, middle]
