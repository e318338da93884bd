"""The fold at the base: when it opens, and where its angle goes.

Past a critical contact moment the inflated tube wrinkles through and folds at its base; the moment
then stays and the fold's angle takes up the rest (thesis, sections 2.3.3 and 3.2). An inflated
tube's critical moment is proportional to its pressure (Comer and Levy 1963), so the value measured
at one body pressure scales to others.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def critical_moment(critical_curvature: float, measured_psi: float, pressure_psi: float) -> float:
    """Contact moment over EI (1/cm) at which the base folds, at another body pressure."""
    return critical_curvature * pressure_psi / measured_psi


def fold_share(
    centers: npt.ArrayLike, spans: npt.ArrayLike, diameter: float
) -> npt.NDArray[np.float64]:
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
