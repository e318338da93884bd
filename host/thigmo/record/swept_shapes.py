"""Where the tube has been: its outline around a centreline, and the positions passed in a sweep.

Shared by the picture of the map and by the obstacle map, so that both show the same swept space.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thigmo.record.document import Shape

Floats = NDArray[np.float64]
_BETWEEN = 9  # positions from one recorded shape to the next


def outline(poses: ArrayLike, radius_cm: float) -> Floats:
    """The tube around centrelines (..., n, 3) of x, y, heading: left side out, right back.

    Returns:
        (..., 2n, 2) corners.
    """
    line = np.asarray(poses, dtype=np.float64)
    heading = line[..., 2:]
    across = radius_cm * np.concatenate((-np.sin(heading), np.cos(heading)), axis=-1)
    left, right = line[..., :2] + across, line[..., :2] - across
    around: Floats = np.concatenate((left, right[..., ::-1, :]), axis=-2)
    return around


def passed(shapes: Iterable[Shape]) -> Floats:
    """Centrelines (k, n, 3) of a half sweep's recorded shapes and those passed on the way between.

    The sweep starts with the straight robot, and goes up in pressure.
    """
    ordered = sorted(shapes, key=lambda shape: shape.pressure_psi)
    if not ordered:
        return np.zeros((0, 0, 3))
    bent = np.array([shape.poses for shape in ordered])
    straight = np.zeros_like(bent[0])
    along = np.hypot(*np.diff(bent[0, :, :2], axis=0).T).sum()
    straight[:, 0] = np.linspace(0.0, along, len(straight))
    start = np.concatenate((straight[None], bent[:-1]))
    share = np.linspace(0, 1, _BETWEEN)[None, :, None, None]
    between: Floats = start[:, None] + (bent - start)[:, None] * share
    return between.reshape(-1, *straight.shape)
