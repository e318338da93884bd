"""Where the tube has been: its outline around a centreline, and the positions passed in a sweep.

Shared by the picture of the map and by the obstacle map, so that both show the same swept space.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thigmo.record.document import Shape

Floats = NDArray[np.float64]
_BETWEEN = 9  # positions from one recorded shape to the next


def outline(poses: ArrayLike, radius_cm: float) -> Floats:
    """The tube around a centreline (n, 3) of x, y, heading: (2n, 2), left side out, right back."""
    line = np.asarray(poses, dtype=np.float64)
    normal = np.column_stack((-np.sin(line[:, 2]), np.cos(line[:, 2])))
    left, right = line[:, :2] + radius_cm * normal, line[:, :2] - radius_cm * normal
    around: Floats = np.vstack((left, right[::-1]))
    return around


def passed(shapes: Iterable[Shape]) -> list[Floats]:
    """Centrelines (n, 3) of a half sweep's recorded shapes and those passed on the way between.

    The sweep starts with the straight robot, and goes up in pressure.
    """
    ordered = [
        np.asarray(shape.poses) for shape in sorted(shapes, key=lambda shape: shape.pressure_psi)
    ]
    if not ordered:
        return []
    straight = np.zeros_like(ordered[0])
    along = np.hypot(*np.diff(ordered[0][:, :2], axis=0).T).sum()
    straight[:, 0] = np.linspace(0.0, along, len(straight))
    return [
        start + (end - start) * share
        for start, end in pairwise([straight, *ordered])
        for share in np.linspace(0, 1, _BETWEEN)
    ]
