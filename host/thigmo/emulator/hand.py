"""A hand that holds the robot's tip aside, as the operator does in a calibration.

The force stays normal to the body at its tip (a finger or a dowel that slides along the wall), and
the base folds when the contact moment there passes the critical one.
"""

from __future__ import annotations

from scipy.optimize import brentq

from thigmo.errors import DataError
from thigmo.mechanics import Solution, Tube, push

_FOLD_MOST = 1.2  # rad


def hold_tip(y_cm: float, free_curvature: float, length_cm: float, tube: Tube) -> Solution:
    """Shape of the body with its tip held at a lateral place.

    Args:
        y_cm: where the tip is.
        free_curvature: 1/cm.
        length_cm: everted length.
        tube: with its critical moment.

    Raises:
        DataError: a place that the tip cannot reach.
    """

    def bent(force: float, fold: float = 0.0) -> Solution:
        return push(force, length_cm, free_curvature=free_curvature, length=length_cm, tube=tube,
                    fold_angle=fold)  # fmt: skip

    def miss(force: float) -> float:
        return bent(force).pose(length_cm)[1] - y_cm

    scale = 3 * length_cm**-2
    try:
        force = float(brentq(miss, -scale, scale, xtol=1e-12))
    except ValueError as error:
        raise DataError(
            f"the tip cannot be held at y = {y_cm:.1f} cm", "choose a place nearer the axis"
        ) from error
    free = bent(force)
    critical = tube.critical_moment
    if critical is None or abs(free.base_moment) <= critical:
        return free
    sign = 1.0 if force > 0 else -1.0

    def at_limit(fold: float) -> Solution:
        def over(size: float) -> float:
            return abs(bent(sign * size, fold).base_moment) - critical

        return bent(sign * float(brentq(over, 0.0, 4 * scale, xtol=1e-13)), fold)

    def still(fold: float) -> float:
        return at_limit(sign * fold).pose(length_cm)[1] * sign - y_cm * sign

    try:
        return at_limit(sign * float(brentq(still, 0.0, _FOLD_MOST, xtol=1e-9)))
    except ValueError as error:
        raise DataError(
            f"the tip cannot be held at y = {y_cm:.1f} cm", "choose a place nearer the axis"
        ) from error
