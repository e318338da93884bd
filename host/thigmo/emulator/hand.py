"""Hands that hold the robot aside, as the operator does in a calibration and in the experiments.

A finger or a dowel is held at a lateral place beside a point of the body; its force stays normal to
the body there (it slides along the wall), and the base folds when the contact moment there passes
the critical one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from thigmo.errors import DataError
from thigmo.mechanics import Solution, Tube, push

Floats = NDArray[np.float64]

_FOLD_MOST = 1.2  # rad
_MISS_CM = 1e-4


def hold(
    pushes: Sequence[tuple[float, float]], free_curvature: float, length_cm: float, tube: Tube
) -> Solution:
    """Shape of the body with points (arc, y) of its centreline held, cm, base first.

    Raises DataError for a place that the body cannot reach.
    """
    from scipy.optimize import root  # a quarter of a second that most emulations need not wait

    arcs = np.array([arc for arc, _ in pushes])
    target_y = np.array([y for _, y in pushes])
    unit = 3 / length_cm**3  # force that moves a straight tip by about 1 cm

    def bent(forces: Floats, fold: float) -> Solution:
        return push(forces * unit, arcs, free_curvature=free_curvature, length=length_cm,
                    tube=tube, fold_angle=fold)  # fmt: skip

    def miss(body: Solution) -> Floats:
        offset: Floats = np.array([body.pose(float(arc))[1] for arc in arcs]) - target_y
        return offset

    # A straight cantilever's flexibility gives the start.
    near, far = np.minimum.outer(arcs, arcs), np.maximum.outer(arcs, arcs)
    flexibility = near**2 * (3 * far - near) / 6 * unit
    start = np.linalg.solve(flexibility, -miss(bent(np.zeros(len(arcs)), 0.0)))

    def unfolded(forces: Floats) -> Floats:
        return miss(bent(forces, 0.0))

    solution = root(unfolded, start, tol=1e-10)
    body = bent(solution.x, 0.0)
    critical = tube.critical_moment
    if critical is not None and abs(body.base_moment) > critical:
        limit = float(np.copysign(critical, body.base_moment))

        def folded(unknown: Floats) -> Floats:
            body = bent(unknown[:-1], float(unknown[-1]))
            return np.append(miss(body), (body.base_moment - limit) / critical)

        start_folded = np.append(solution.x * limit / body.base_moment, 0.0)
        solution = root(folded, start_folded, tol=1e-10)
        body = bent(solution.x[:-1], float(solution.x[-1]))
    if not np.abs(miss(body)).max() < _MISS_CM or abs(body.fold_angle) > _FOLD_MOST:
        places = ", ".join(f"y = {y:.1f} cm at {arc:.1f} cm" for arc, y in pushes)
        raise DataError(
            f"the body cannot be held at {places}", "choose places nearer to the free body"
        )
    return body
