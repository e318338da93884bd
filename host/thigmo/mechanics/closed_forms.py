"""Closed forms: the moment at which the base folds, the shape of a body that nothing bends, and
sensor readings of force and fold.

At a critical contact moment the inflated tube wrinkles all round and folds at its base. The moment
then stays constant while the angle of the fold grows (thesis, sections 2.3.3 and 3.2). An inflated
tube's critical moment is proportional to its pressure (Comer and Levy 1963), so the value measured
at one body pressure scales to others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_POINT_CM = 1e-3  # width of a sensor that reads at a point


def critical_moment(critical_curvature: float, measured_psi: float, pressure_psi: float) -> float:
    """Contact moment over EI (1/cm) at which the base folds at `pressure_psi`.

    `critical_curvature` (1/cm) is the moment over EI measured at `measured_psi`.
    """
    if np.isinf(critical_curvature):
        return critical_curvature
    return critical_curvature * pressure_psi / measured_psi


def fold_share(centers: npt.ArrayLike, spans: npt.ArrayLike, diameter: float) -> Floats:
    """Average curvature that one radian of fold adds to each sensor, in 1/cm, shape (N,).

    The fold is spread evenly over one body diameter from the base.
    """
    x = np.asarray(centers, dtype=np.float64)
    span = np.broadcast_to(np.asarray(spans, dtype=np.float64), x.shape)
    low, high = np.maximum(x - span / 2, 0.0), x + span / 2
    inside = np.clip(np.minimum(high, diameter) - low, 0.0, None)
    wide = high - low > 0
    share = np.where(wide, inside / np.where(wide, high - low, 1.0), x < diameter)
    return np.asarray(share / diameter, dtype=np.float64)


def rest_turn(pieces: Sequence[tuple[float, float]], arc: npt.ArrayLike) -> Floats:
    """Angle (rad) between a body that nothing bends and its base, at arcs (cm) of any shape.

    Args:
        pieces: where each piece of the rest shape ends (cm), and its curvature (1/cm), base first.
            Beyond the last the body is straight.
    """
    ends, curvature = np.reshape(np.asarray(pieces, dtype=np.float64), (-1, 2)).T
    knots = np.concatenate([[0.0], ends])
    turns = np.concatenate([[0.0], np.cumsum(curvature * np.diff(knots))])
    return np.asarray(np.interp(np.asarray(arc, dtype=np.float64), knots, turns))


def rest_mean(
    pieces: Sequence[tuple[float, float]], center: npt.ArrayLike, span: npt.ArrayLike
) -> Floats:
    """Mean curvature (1/cm) of the rest shape over spans (cm) around arcs, (N,).

    `pieces` are those of `rest_turn`. A span of 0 gives the value at the centre.
    """
    x = np.asarray(center, dtype=np.float64)
    half = np.maximum(np.asarray(span, dtype=np.float64), _POINT_CM) / 2
    turn = rest_turn(pieces, x + half) - rest_turn(pieces, x - half)
    return np.asarray(turn / (2 * half))


def phi(arc: npt.ArrayLike, center: npt.ArrayLike, span: npt.ArrayLike) -> Floats:
    """Mean over the span of the lever (a - s)+ of a unit force over EI at arc a.

    This is the mean curvature that the force adds for small deflections (docs/methods.md). With a
    span of 0 it is the thesis's (2.9), max(a - x, 0). Arguments broadcast. Lengths are in any one
    unit, and so is the result.
    """
    a, x, width = np.broadcast_arrays(
        np.asarray(arc, dtype=np.float64),
        np.asarray(center, dtype=np.float64),
        np.asarray(span, dtype=np.float64),
    )
    overlap = a - x + width / 2
    safe = np.where(width > 0, width, 1.0)
    inside = np.where(width > 0, overlap**2 / (2 * safe), 0.0)
    return np.where(overlap <= 0, 0.0, np.where(a >= x + width / 2, a - x, inside))


def heading_along(curvature: Floats, step: Floats | float) -> Floats:
    """Headings (..., n), rad, along a line that starts along x, by its curvature (..., n), 1/cm.

    `step` is the distance between points, cm. The curvature is linear between them.
    """
    heading = np.zeros_like(curvature)
    turns = step * (curvature[..., 1:] + curvature[..., :-1]) / 2
    heading[..., 1:] = np.cumsum(turns, axis=-1)
    return heading


def traced(heading: Floats, step: Floats | float) -> tuple[Floats, Floats]:
    """Points x and y (..., n) of a line from the origin with headings (..., n), rad.

    `step` is the distance between points. The midpoint headings make this second order.
    """
    middle = (heading[..., 1:] + heading[..., :-1]) / 2
    x, y = np.zeros_like(heading), np.zeros_like(heading)
    x[..., 1:] = np.cumsum(step * np.cos(middle), axis=-1)
    y[..., 1:] = np.cumsum(step * np.sin(middle), axis=-1)
    return x, y
