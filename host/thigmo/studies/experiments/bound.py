"""Cramer-Rao bound of a dowel that stands still while the robot bends into it, from all frames.

Unknown are the two coordinates of the dowel; every reading has its noise, and every sensor an error
of its gain and of its place, the same in all frames. What is bounded is the x of the contact in the
last frame. Derivatives are those of the large-deflection rod.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from thigmo.mechanics import Peg, Tube, solve
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.specimen import Constants

_STEP_CM = 0.02


@cache
def obstacle_bound(
    peg: Peg,
    free: tuple[float, ...],
    centers_cm: tuple[float, ...],
    constants: Constants,
    gain_sigma: float,
) -> float:
    """Mean absolute error (cm) of a Gaussian estimator at the bound; infinite if singular.

    Args:
        peg: the dowel.
        free: (T,) free curvature in each frame, 1/cm; the dowel is touched in the last.
        centers_cm: (N,) of the sensors.
        constants: noise and places.
        gain_sigma: relative standard deviation of the gains.
    """
    tube = Tube(thesis.DIAMETER_CM, thesis.CRITICAL)
    at = np.array(centers_cm)

    def bent(dx: float, dy: float) -> tuple[np.ndarray, np.ndarray, float]:
        moved = Peg(peg.x + dx, peg.y + dy, peg.radius)
        found = [solve(g, thesis.LENGTH_CM, tube=tube, pegs=[moved]) for g in free]
        seen = np.array([body.averages(at, thesis.SPAN_CM) for body in found])
        onward = np.array([body.averages(at + _STEP_CM, thesis.SPAN_CM) for body in found])
        x = found[-1].contacts[-1].x if found[-1].contacts else float("nan")
        return seen, (onward - seen) / _STEP_CM, x

    here, slope, _ = bent(0.0, 0.0)
    jacobian, gradient = [], []
    for dx, dy in ((_STEP_CM, 0.0), (0.0, _STEP_CM)):
        (far, _, far_x), (near, _, near_x) = bent(dx, dy), bent(-dx, -dy)
        jacobian.append((far - near) / (2 * _STEP_CM))
        gradient.append((far_x - near_x) / (2 * _STEP_CM))
    information = np.zeros((2, 2))
    for sensor in range(len(at)):
        covariance = max(constants.noise, 1e-9) ** 2 * np.eye(len(free))
        covariance += np.outer(here[:, sensor], here[:, sensor]) * gain_sigma**2
        covariance += np.outer(slope[:, sensor], slope[:, sensor]) * constants.position_cm**2
        sensed = np.array([part[:, sensor] for part in jacobian])
        information += sensed @ np.linalg.solve(covariance, sensed.T)
    if np.linalg.cond(information) > 1e12:
        return float("inf")
    variance = np.array(gradient) @ np.linalg.solve(information, np.array(gradient))
    return float(np.sqrt(2 / np.pi * variance))
