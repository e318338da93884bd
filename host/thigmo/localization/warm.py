"""Compiles the localizer before a robot is armed, so that no first answer takes seconds."""

from __future__ import annotations

import numpy as np

from thigmo.localization.estimate import localize


def warm_up() -> None:
    """Run every compiled path of `localize` once (seconds at first, then cached on disk)."""
    position = np.array([5.0, 15.0, 25.0, 35.0, 45.0, 5.0, 15.0, 25.0, 35.0, 45.0])
    lever = np.maximum(40.0 - position, 0.0)
    one = 2e-4 * lever
    two = one - 8e-4 * np.maximum(20.0 - position, 0.0)
    for curvature in (np.zeros(10), one, two):
        for noise in (6e-4, None):
            result = localize(
                curvature, position, length=53.0, span=5.5, free_curvature=0.02, noise=noise
            )
            _ = result.objective
