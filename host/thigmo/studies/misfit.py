"""Whether one contact explains readings, by the rod itself: studies sort their frames by that."""

from __future__ import annotations

import numpy as np

from thigmo.studies.rod import Floats, solve
from thigmo.studies.scenes import LENGTH, SIGMA, SPAN

_PLACES = np.linspace(1.0, LENGTH, 53)
_STEP = 1e-6  # of the force, 1/cm^2


def of_one_contact(curvature: Floats, position: Floats, free: Floats) -> Floats:
    """Least misfit that a contact on the side leaves of each frame's readings.

    Args:
        curvature: (F, N) readings of the same sensors, 1/cm.
        position: (N,) their centres, cm.
        free: (F,) free curvature of each body.

    Returns:
        (F,) sums of squares over the noise's variance.
    """
    arcs = np.tile(_PLACES, len(curvature))[:, None]
    bend = np.repeat(free, len(_PLACES))[:, None]
    read = np.repeat(curvature, len(_PLACES), axis=0)

    def left(force: Floats) -> Floats:
        bodies = solve(arcs, force, length=LENGTH, free_curvature=bend)
        return read - bodies.readings(position, SPAN)

    force = np.zeros_like(arcs)
    for _ in range(2):  # Gauss and Newton: the body is all but linear in the force
        rest = left(force)
        slope = (rest - left(force + _STEP)) / _STEP
        power = np.maximum((slope**2).sum(axis=1), 1e-12)
        force = force + ((slope * rest).sum(axis=1) / power)[:, None]
    each = np.square(left(force) / SIGMA).sum(axis=1).reshape(len(curvature), -1)
    least: Floats = each.min(axis=1)
    return least
