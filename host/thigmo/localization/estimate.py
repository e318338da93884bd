"""`localize`: one frame of readings in, contacts with intervals out.

Called by the exploration, by the command line and by users. The posterior decides: number of
contacts by evidence, place by its median, interval by its mass. Richer mechanics are tried only
where a misfit or the bend calls for them (`model_choice`). The exact 1-norm optimum and its set are
computed when asked for.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Literal

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError
from thigmo.localization import prior
from thigmo.localization.answer import (
    SENTENCE,
    answer,
    contact_of,
    contacts_of,
    plain_answer,
)
from thigmo.localization.first_look import Look, first_look
from thigmo.localization.model_choice import MOST_CONTACTS, Options, best_model, stands
from thigmo.localization.models import fit_one, start
from thigmo.localization.point_estimates import least_absolute, point_estimate
from thigmo.localization.readings import normalise
from thigmo.localization.result import LocalizeResult, Range, Status


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
    offset_sigma: float = 0.0,
    critical_curvature: float | None = None,
    critical_of: Literal["contact", "total"] = "contact",
    mechanics: Literal["auto", "plain"] = "auto",
    tube_radius: float | None = None,
    width_limit: float | None = None,
    within: Range | None = None,
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
        contacts: how many (0 to 3), or "auto" to let the evidence decide.
        method: "exact"; or "l1" and "l2", which give point estimates without intervals.
        offset_sigma: standard deviation of an error that all readings share (of the free
            curvature or the zero); it is marginalised.
        critical_curvature: contact moment over EI at which the base folds, at this body pressure
            (it is proportional to it: `thigmo.mechanics.buckling.critical_moment`).
        critical_of: whether the contact's moment or the total curvature is critical.
        mechanics: "auto" takes what the scene needs; "plain" keeps to the straight beam.
        tube_radius: radius of the body; 1.75/53 of the length if not given.
        width_limit: widest 95 % interval that counts as localized; 10/53 of the length (10 cm of
            the 53 cm body) if not given.
        within: arcs between which a single contact is known to lie, by whatever else is known
            (a sweep that felt nothing, say). It does not decide how many contacts there are.

    Returns:
        Contacts with 95 % intervals, status, model.

    Raises:
        DataError: readings that cannot be used as given.
    """
    if contacts != "auto" and (
        isinstance(contacts, bool)
        or not isinstance(contacts, (int, np.integer))
        or not 0 <= contacts <= MOST_CONTACTS
    ):
        raise DataError(f"contacts={contacts!r} is not possible", 'give "auto" or 0 to 3')
    if method != "exact":
        readings = normalise(curvature, position, length, span, free_curvature, noise)
        return point_estimate(method, readings, contacts)
    if mechanics not in ("auto", "plain"):
        raise DataError(f"unknown mechanics {mechanics!r}", 'use "auto" or "plain"')
    if critical_of not in ("contact", "total"):
        raise DataError(f"unknown critical_of {critical_of!r}", 'use "contact" or "total"')
    offset = _positive("offset_sigma", offset_sigma)
    look = first_look(curvature, position, length, span, free_curvature, noise, offset)
    scale = look.length
    options = Options(
        None
        if critical_curvature is None
        else max(_positive("critical_curvature", critical_curvature) * scale, 1e-6),
        critical_of,
        mechanics,
        prior.TUBE_RADIUS
        if tube_radius is None
        else max(_positive("tube_radius", tube_radius) / scale, 1e-6),
        prior.WIDTH_SHARE if width_limit is None else _positive("width_limit", width_limit) / scale,
        None if within is None else _range(within, scale),
    )
    solve = partial(least_absolute, curvature, position, length, span, free_curvature)
    return _decide(look, contacts, options, solve)


def _positive(name: str, value: float) -> float:
    number = float(value)
    if not (math.isfinite(number) and number >= 0.0):
        raise DataError(f"{name} is {value!r}", f"give a finite {name} of zero or more")
    return number


def _range(within: Range, scale: float) -> Range:
    low, high = (_positive("within", end) / scale for end in within)
    high = min(high, 1.0)
    if not low < high:
        raise DataError(f"within={within!r} holds no place", "give two arcs, base first")
    return low, high


def _decide(
    look: Look,
    contacts: int | str,
    options: Options,
    solve: partial[tuple[float, tuple[tuple[Range, ...], ...]]],
) -> LocalizeResult:
    fit = None
    odds, null = look.evidence - look.null, look.null
    if options.mechanics == "auto" and abs(look.bend) >= prior.BEND:
        # The levers of the bend from the start.
        readings = look.readings()
        fit = fit_one(readings, start(readings, look.offset, True))
        odds, null = fit.score - fit.null, fit.null
    threshold = prior.contact_threshold(look.finite, look.known)
    found = odds > threshold
    # Contacts of opposed forces, or one on the end, can explain what one on the side does not.
    odd = contacts == "auto" and not found and _not_free(look)
    if not odd and (contacts == 0 or (contacts == "auto" and not found)):
        status: Status = "below detection" if odds > prior.HINT else "no contact"
        if fit is None:
            return plain_answer(look, (), status, SENTENCE[status], solve)
        return answer(readings, fit, (), status, "free body", SENTENCE[status], odds, solve)
    weak: Status = "below detection"
    if not odd and stands(look, contacts, options):
        contact = contact_of(look, options, None if found else weak)
        return plain_answer(look, (contact,), contact.status, SENTENCE[contact.status], solve)
    if fit is None:
        readings = look.readings()
        fit = look.fit(readings)
    fit, second_likely = best_model(readings, fit, contacts, options)
    model = fit.setting.name
    if odd:
        odds = fit.score - null
        found = odds > threshold
    if not found and (odd or len(fit.arcs) == 1):
        listed = () if odd else contacts_of(readings, fit, options, weak)
        return answer(readings, fit, listed, weak, model, SENTENCE[weak], odds, solve)
    listed = contacts_of(readings, fit, options, "ambiguous" if second_likely else None)
    statuses = [contact.status for contact in listed]
    status = "ambiguous" if "ambiguous" in statuses else "localized"
    message = SENTENCE[status]
    if second_likely:
        message = "a second contact is likely, but not certain; average more readings"
    return answer(readings, fit, listed, status, model, message, fit.score - null, solve)


def _not_free(look: Look) -> bool:
    """Whether readings of known noise are beyond those of a free body with a common offset."""
    if not look.known:
        return False
    y, _, _, variance = look.block[:, : look.finite]
    misfit = float(y @ (y / variance))
    if look.offset > 0.0:
        taken = look.offset * float((y / variance).sum())
        misfit -= taken**2 / (1.0 + look.offset**2 * float((1.0 / variance).sum()))
    return misfit > prior.free_limit(look.finite)
