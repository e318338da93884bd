"""What a sensor sees: the mean curvature over its span.

For small deflections a unit force at arc a adds phi(a; x, l) to a sensor centred at x with span l
(METHODS section 1). For any shape the mean is the turn of the tangent over the span divided by it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def phi(arc: npt.ArrayLike, center: npt.ArrayLike, span: npt.ArrayLike) -> Floats:
    """Mean over the span of the lever (a - s)+ of a unit force at arc a; arguments broadcast.

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


def mean_curvature(
    s: npt.ArrayLike, heading: npt.ArrayLike, centers: npt.ArrayLike, spans: npt.ArrayLike
) -> Floats:
    """Mean curvature over each span from headings (rad) at arcs s, linear in between; shape (N,).

    Exact when the span's ends are among s. A span of 0 is widened to 0.001 of the length.
    """
    arcs = np.asarray(s, dtype=np.float64)
    theta = np.asarray(heading, dtype=np.float64)
    x = np.asarray(centers, dtype=np.float64)
    width = np.broadcast_to(np.asarray(spans, dtype=np.float64), x.shape)
    width = np.where(width > 0, width, 1e-3 * arcs[-1])
    low = np.clip(x - width / 2, arcs[0], arcs[-1])
    high = np.clip(x + width / 2, arcs[0], arcs[-1])
    turn = np.interp(high, arcs, theta) - np.interp(low, arcs, theta)
    wide = high > low
    return np.asarray(np.where(wide, turn / np.where(wide, high - low, 1.0), 0.0))
