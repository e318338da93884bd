"""Where the tube has been: its outline around a centreline, and the positions passed in a sweep.

Shared by the picture of the map and by the obstacle map, so that both show the same swept space.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import ceil

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thigmo.config import SIDES
from thigmo.mechanics import traced
from thigmo.record.document import Shape

Floats = NDArray[np.float64]
# Positions from one recorded shape to the next, at least, and the most between two tips.
_BETWEEN, _APART_CM = 9, 2.0


def outline(poses: ArrayLike, radius_cm: float) -> Floats:
    """The tube's (..., 2n, 2) corners around centrelines (..., n, 3): out and back."""
    line = np.asarray(poses, dtype=np.float64)
    heading = line[..., 2:]
    offset = radius_cm * np.concatenate((-np.sin(heading), np.cos(heading)), axis=-1)
    left, right = line[..., :2] + offset, line[..., :2] - offset
    corners: Floats = np.concatenate((left, right[..., ::-1, :]), axis=-2)
    return corners


def passed(shapes: Iterable[Shape], shrink_sigmas: float = 0.0) -> Floats:
    """Centrelines (k, n, 3) of a half sweep's recorded shapes and those passed on the way between.

    The shapes are of one stage and side. Its sweep starts with the straight robot and goes up in
    pressure. `shrink_sigmas` shortens the sweep at both ends by that many standard errors of the
    curvature, which each shape must then state.
    """
    ordered = sorted(shapes, key=lambda shape: shape.pressure_psi)
    if not ordered:
        return np.zeros((0, 0, 3))
    bent = np.array([shape.poses for shape in ordered])
    steps = np.hypot(*np.moveaxis(np.diff(bent[..., :2], axis=1), -1, 0))
    straight = np.zeros_like(bent[0])
    straight[1:, 0] = np.cumsum(steps[0])
    if shrink_sigmas:
        sign = -1.0 if ordered[0].side == SIDES[1] else 1.0
        correction = (
            sign * shrink_sigmas * np.array([shape.curvature_se or 0.0 for shape in ordered])
        )
        straight = _turned(straight[None], steps[:1], correction[:1])[0]
        bent = _turned(bent, steps, -correction)
        # What bends no further than the late start, by its error, was perhaps never passed.
        bent = bent[sign * (bent[:, -1, 2] - straight[-1, 2]) > 0]
    start = np.concatenate((straight[None], bent[:-1]))
    moved = float(np.hypot(*(bent - start)[:, -1, :2].T).max(initial=0.0))
    count = max(_BETWEEN, ceil(moved / _APART_CM) + 1)
    share = np.linspace(0, 1, count)[None, :, None, None]
    centrelines: Floats = start[:, None] + (bent - start)[:, None] * share
    return centrelines.reshape(-1, *straight.shape)


def _turned(poses: Floats, steps: Floats, curvature: Floats) -> Floats:
    """Centrelines (k, n, 3) of (k, n - 1) steps after adding a curvature (k,) to each, 1/cm."""
    arc = np.concatenate((np.zeros((len(steps), 1)), np.cumsum(steps, axis=1)), axis=1)
    heading = poses[..., 2] + curvature[:, None] * arc
    return np.stack((*traced(heading, steps), heading), axis=-1)
