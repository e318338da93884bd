"""What the methods "l1" and "l2" of `localize` answer, from `point_fits/point_fit.h`."""

from __future__ import annotations

import math

from thigmo.localization import _posterior
from thigmo.localization.result import Contact, LocalizeResult


def point_fit_result(found: _posterior.Answer, total: float, method: str) -> LocalizeResult:
    """The global minimum of a norm of the residual, and where it is attained.

    Args:
        found: by the compiled code, over the length.
        total: that length, in the caller's unit.
        method: "l1" (thesis, equation 2.10) or "l2".
    """
    sets = tuple(
        tuple((near * total, far * total) for near, far in pieces) for *_, pieces in found.contacts
    )
    listed = tuple(
        Contact(arc * total, force / total**2, (low * total, high * total), "ambiguous", pieces)
        for (arc, force, low, high, *_), pieces in zip(found.contacts, sets, strict=True)
    )
    return LocalizeResult(
        "ambiguous",
        listed,
        f"{len(listed)} contact{'s' * (len(listed) > 1)}, {method}",
        "a point fit: its interval is where the minimum is attained, and no measure of error",
        math.nan,
        math.nan,
        {},
        objective=found.objective,
        optimum_set=sets,
        length=total,
    )
