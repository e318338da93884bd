"""From curvature along the body to its place in the workspace.

x runs along the straight robot from its base, y to its left; positive curvature bends left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Shape:
    """A centreline: arcs s (cm), x, y (cm) and heading (rad), each of shape (n,)."""

    s: Floats
    x: Floats
    y: Floats
    heading: Floats

    def at(self, arc: float) -> tuple[float, float, float]:
        """(x, y, heading) at an arc length, linear between the points."""
        return (
            float(np.interp(arc, self.s, self.x)),
            float(np.interp(arc, self.s, self.y)),
            float(np.interp(arc, self.s, self.heading)),
        )


def from_curvature(s: npt.ArrayLike, curvature: npt.ArrayLike, heading: float = 0.0) -> Shape:
    """Integrate curvature samples (1/cm, linear in between) at arcs s (cm, ascending) from (0, 0).

    Heading is exact for that curvature; positions use Simpson's rule in each interval.
    """
    arcs = np.asarray(s, dtype=np.float64)
    kappa = np.asarray(curvature, dtype=np.float64)
    step = np.diff(arcs)
    theta = heading + np.concatenate(([0.0], np.cumsum(step * (kappa[1:] + kappa[:-1]) / 2)))
    middle = theta[:-1] + step * (3 * kappa[:-1] + kappa[1:]) / 8
    x = np.concatenate(
        ([0.0], np.cumsum(step / 6 * (np.cos(theta[:-1]) + 4 * np.cos(middle) + np.cos(theta[1:]))))
    )
    y = np.concatenate(
        ([0.0], np.cumsum(step / 6 * (np.sin(theta[:-1]) + 4 * np.sin(middle) + np.sin(theta[1:]))))
    )
    return Shape(s=arcs, x=x, y=y, heading=theta)


def skin_point(
    x: float, y: float, heading: float, radius: float, side: float
) -> tuple[float, float]:
    """Point on the skin beside a centreline point; side +1 = left, -1 = right."""
    return x - side * radius * float(np.sin(heading)), y + side * radius * float(np.cos(heading))
