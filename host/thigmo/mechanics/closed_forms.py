"""What needs no step-by-step solving: the base's fold, and what a sensor sees of force and fold.

Past a critical contact moment the inflated tube wrinkles through and folds at its base; the moment
then stays and the fold's angle takes up the rest (thesis, sections 2.3.3 and 3.2). An inflated
tube's critical moment is proportional to its pressure (Comer and Levy 1963), so the value measured
at one body pressure scales to others.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def critical_moment(critical_curvature: float, measured_psi: float, pressure_psi: float) -> float:
    """Contact moment over EI (1/cm) at which the base folds, at another body pressure."""
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


def phi(arc: npt.ArrayLike, center: npt.ArrayLike, span: npt.ArrayLike) -> Floats:
    """Mean over the span of the lever (a - s)+ of a unit force at arc a; arguments broadcast.

    That is the mean curvature that the force adds where deflections are small (docs/methods.md).
    With span 0 this is the thesis's (2.9), max(a - x, 0). Lengths in any one unit; the result is in
    that unit.
    """
    a, x, width = np.broadcast_arrays(
        np.asarray(arc, dtype=np.float64),
        np.asarray(center, dtype=np.float64),
        np.asarray(span, dtype=np.float64),
    )
    into = a - x + width / 2
    safe = np.where(width > 0, width, 1.0)
    inside = np.where(width > 0, into**2 / (2 * safe), 0.0)
    return np.where(into <= 0, 0.0, np.where(a >= x + width / 2, a - x, inside))


def traced(heading: Floats, step: Floats | float) -> tuple[Floats, Floats]:
    """Points x and y (..., n) of a line from the origin, from its headings (..., n), step by step.

    The headings halfway make it of second order.
    """
    middle = (heading[..., 1:] + heading[..., :-1]) / 2
    x, y = np.zeros_like(heading), np.zeros_like(heading)
    x[..., 1:] = np.cumsum(step * np.cos(middle), axis=-1)
    y[..., 1:] = np.cumsum(step * np.sin(middle), axis=-1)
    return x, y
