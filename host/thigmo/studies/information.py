"""Cramer-Rao bounds of arcs in the beam model, for the studies that hold methods against them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thigmo.studies.baselines.problem import Problem, influence

Floats = NDArray[np.float64]

_STEP_CM = 1e-3


def arc_deviations(
    arcs: Floats, forces: Floats, position: Floats, span: ArrayLike, noise: ArrayLike, length: float
) -> Floats:
    """Standard deviations of an efficient estimator's arcs, forces unknown too (cm).

    Args:
        arcs, forces: (C,) contacts, cm and 1/cm^2.
        position, span: (N,) sensors, cm.
        noise: standard deviation of a reading, scalar or (N,), 1/cm.
        length: everted length, cm.

    Returns:
        (C,); infinite where the information matrix is singular.
    """
    spans = np.broadcast_to(np.asarray(span, dtype=np.float64), position.shape)
    sensors = Problem(np.zeros(position.shape), position, spans, length, len(arcs))
    ahead, behind = (influence(sensors, arcs + step) for step in (_STEP_CM, -_STEP_CM))
    slopes = forces * (ahead - behind) / (2 * _STEP_CM)
    columns = np.hstack([influence(sensors, arcs), slopes])
    columns /= np.broadcast_to(noise, position.shape)[:, None]
    # Scaled to a unit diagonal, so that singular means singular in any unit.
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    information = (columns / scale).T @ (columns / scale)
    if np.linalg.cond(information) > 1e12:
        return np.full(len(arcs), np.inf)
    variance = np.diag(np.linalg.inv(information))[len(arcs) :]
    return np.asarray(np.sqrt(variance) / scale[len(arcs) :])
