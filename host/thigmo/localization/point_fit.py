"""The methods "l1" and "l2" of `localize`: exact point fits of one or two contacts."""

from __future__ import annotations

import numpy as np

from thigmo.errors import DataError
from thigmo.localization.result import Array, Contact, LocalizeResult


def point_fit(
    curvature: Array, position: Array, length: float, span: Array, free: Array, method: str,
    contacts: int | str,
) -> LocalizeResult:  # fmt: skip
    """The global minimum of a norm of the residual, and where it is attained.

    Args:
        curvature, position, length, span, free: as `localize`, checked.
        method: "l1" (thesis, equation 2.10) or "l2".
        contacts: 1 or 2; "auto" is 1.

    Raises:
        DataError: another number of contacts; no finite reading.
    """
    count = 1 if contacts == "auto" else int(contacts)
    if count not in (1, 2):
        raise DataError(f"{method} fits no {count} contacts", "give 1 or 2, or use the posterior")
    good = np.isfinite(curvature)
    if not good.any():
        raise DataError("no reading is finite", "give at least one reading")
    from thigmo.localization.point_fits import fit  # its compiler takes seconds to import

    excess = ((curvature - free) * length)[good]
    half = 0.5 * np.broadcast_to(span, curvature.shape)[good]
    low = np.maximum(position[good] - half, 0.0) / length
    high = np.minimum(position[good] + half, length) / length
    found = fit(excess, low, high, count, "l1" if method == "l1" else "l2")
    sets = tuple(
        tuple((near * length, far * length) for near, far in pieces) for pieces in found.optimum_set
    )
    listed = tuple(
        Contact(arc * length, force / length**2, (pieces[0][0], pieces[-1][1]), "ambiguous", pieces)
        for arc, force, pieces in zip(found.arcs.tolist(), found.forces.tolist(), sets, strict=True)
    )
    return LocalizeResult(
        "ambiguous",
        listed,
        f"{count} contact{'s' * (count > 1)}, {method}",
        "a point fit: its interval is where the minimum is attained, and no measure of error",
        float("nan"),
        float("nan"),
        {},
        objective=found.objective / length ** (1 if method == "l1" else 2),
        optimum_set=sets,
        length=length,
    )
