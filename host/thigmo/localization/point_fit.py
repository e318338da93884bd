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
    listed = tuple(
        Contact(arc, force, interval, "ambiguous", pieces)
        for arc, force, interval, _, pieces, *_ in found.contacts(total)
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
        optimum_set=tuple(contact.intervals for contact in listed),
        length=total,
    )
