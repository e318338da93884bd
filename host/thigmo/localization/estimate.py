"""`localize`: one frame of readings in, contacts with intervals out.

Called by the exploration, by the command line and by users. The posterior decides: number of
contacts by evidence, place by its mean, interval by its mass. The exact 1-norm optimum and its set
are computed when asked for.
"""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError
from thigmo.localization import prior
from thigmo.localization.influence import STRAIGHT
from thigmo.localization.posterior import one_contact
from thigmo.localization.readings import Readings, normalise
from thigmo.localization.result import Contact, LocalizeResult, Range, Status

Array = npt.NDArray[np.float64]


def localize(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    *,
    length: float,
    span: npt.ArrayLike = 0.0,
    free_curvature: npt.ArrayLike = 0.0,
    noise: npt.ArrayLike | None = None,
    contacts: int | Literal["auto"] = "auto",
    method: str = "exact",
) -> LocalizeResult:
    """Find the contacts that a body of known length feels.

    Lengths in any one unit (cm, mm, m), curvature in its inverse: the result scales with it.

    Args:
        curvature: (N,) readings, average curvature over each sensor; NaN marks a missing one.
        position: (N,) sensor centres along the body, 0 at the base.
        length: everted length.
        span: scalar or (N,) sensor lengths; 0 for point sensors.
        free_curvature: scalar or (N,) curvature that actuation alone would cause.
        noise: standard deviation of a reading, scalar or (N,); None if it is not known.
        contacts: how many, or "auto" to let the evidence decide.
        method: "exact".

    Returns:
        Contacts with 95 % intervals, status, model.

    Raises:
        DataError: readings that cannot be used as given.
    """
    if contacts != "auto" and (
        isinstance(contacts, bool)
        or not isinstance(contacts, (int, np.integer))
        or not 0 <= contacts <= 1
    ):
        raise DataError(f"contacts={contacts!r} is not possible", 'give "auto" or 0 to 3')
    if method != "exact":
        raise DataError(f"unknown method {method!r}", 'use method="exact"')
    readings = normalise(curvature, position, length, span, free_curvature, noise)
    solve = partial(_exact, curvature, position, length, span, free_curvature)
    return _one(readings, contacts, solve)


_NO_COLUMNS: Array = np.zeros((0, 0))


def _one(readings: Readings, contacts: int | str, solve: partial[object]) -> LocalizeResult:
    n = len(readings.y)
    scale = readings.length
    (
        null,
        evidence,
        arc,
        force,
        deviation,
        low,
        high,
        noise,
        pieces,
        arcs,
        logp,
        _,
        flagged,
    ) = one_contact(
        readings.y,
        readings.low,
        readings.high,
        readings.variance,
        readings.known,
        np.zeros((n, 0)),
        STRAIGHT,
        np.zeros((n, 4)),
        prior.MOMENT,
        prior.SPREAD,
        prior.LOG_WEIGHT,
        prior.OUTLIER_ODDS,
        prior.OUTLIER_VARIANCE,
        prior.LEVEL,
    )
    odds = evidence - null
    found = odds > prior.contact_threshold(n, readings.known)
    outliers = tuple(int(i) for i in readings.index[flagged]) if flagged.any() else ()
    arcs = arcs * scale
    density = np.exp(logp) / scale
    if contacts == 0 or (contacts == "auto" and not found):
        status: Status = "below detection" if odds > prior.HINT else "no contact"
        return LocalizeResult(
            status,
            (),
            "free body",
            _SENTENCE[status],
            noise / scale,
            odds,
            arcs,
            density,
            outliers,
            {},
            partial(solve, count=0),
        )
    if not found:
        status = "below detection"
    elif len(pieces) == 1 and high - low <= prior.WIDTH_SHARE:
        status = "localized"
    else:
        status = "ambiguous"
    contact = Contact(
        arc * scale,
        force / scale**2,
        (low * scale, high * scale),
        status,
        tuple((float(a) * scale, float(b) * scale) for a, b, _ in pieces),
        deviation / scale**2,
    )
    return LocalizeResult(
        status,
        (contact,),
        "plain beam",
        _SENTENCE[status],
        noise / scale,
        odds,
        arcs,
        density,
        outliers,
        {},
        partial(solve, count=1),
    )


_SENTENCE: dict[Status, str] = {
    "no contact": "the readings are those of the free body",
    "below detection": "a contact is not certain; average more readings or bend further",
    "localized": "one place explains the readings",
    "ambiguous": "several places explain the readings; see `intervals`",
}


def _exact(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    length: float,
    span: npt.ArrayLike,
    free_curvature: npt.ArrayLike,
    *,
    count: int,
) -> tuple[float, tuple[tuple[Range, ...], ...]]:
    """Global 1-norm optimum for `count` contacts: objective and sets."""
    from thigmo.localization.exact import one_contact as exact_one
    from thigmo.localization.exact import several_contacts

    y = np.asarray(curvature, dtype=np.float64) - np.asarray(free_curvature, dtype=np.float64)
    if count == 0:
        return float(np.nansum(np.abs(y))), ()
    if count == 1:
        solution = exact_one(y, position, length, span=span)
    else:
        solution = several_contacts(
            y, position, length, contacts=count, span=span, optimum_set=True
        )
    return solution.objective, solution.ranges
