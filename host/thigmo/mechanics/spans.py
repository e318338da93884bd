"""What a sensor sees: the mean curvature over its span.

For small deflections a unit force at arc a adds phi(a; x, l) to a sensor centred at x with span l
(docs/methods.md). The bent body's own mean is the extension's (`Solution.averages`).
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
