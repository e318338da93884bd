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
from thigmo.localization.answer import SENTENCE, answer, contacts_of
from thigmo.localization.model_choice import MOST_CONTACTS, Options, best_model
from thigmo.localization.models import Setting, fit_one, start
from thigmo.localization.point_estimates import least_absolute, point_estimate
from thigmo.localization.readings import Readings, normalise
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
        method: "exact"; or "l2" and the names of `thigmo.localization.baselines`, which give
            point estimates without intervals.
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
    readings = normalise(curvature, position, length, span, free_curvature, noise)
    scale = readings.length
    if method != "exact":
        return point_estimate(method, readings, contacts)
    if mechanics not in ("auto", "plain"):
        raise DataError(f"unknown mechanics {mechanics!r}", 'use "auto" or "plain"')
    if critical_of not in ("contact", "total"):
        raise DataError(f"unknown critical_of {critical_of!r}", 'use "contact" or "total"')
    options = Options(
        _positive("offset_sigma", offset_sigma) * scale,
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
    return _decide(readings, contacts, options, solve)


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
    readings: Readings,
    contacts: int | str,
    options: Options,
    solve: partial[tuple[float, tuple[tuple[Range, ...], ...]]],
) -> LocalizeResult:
    plain = start(readings, options.offset, options.mechanics == "auto")
    fit = fit_one(readings, plain)
    null = fit.null
    odds = fit.score - null
    threshold = prior.contact_threshold(len(readings.y), readings.known)
    found = odds > threshold
    # Contacts of opposed forces, or one on the end, can explain what one on the side does not.
    odd = contacts == "auto" and not found and _not_free(readings, plain)
    if not odd and (contacts == 0 or (contacts == "auto" and not found)):
        status: Status = "below detection" if odds > prior.HINT else "no contact"
        return answer(readings, fit, (), status, "free body", SENTENCE[status], odds, solve)
    fit, second_likely = best_model(readings, fit, contacts, options)
    if odd:
        odds = fit.score - null
        found = odds > threshold
    if not found and (odd or len(fit.arcs) == 1):
        weak: Status = "below detection"
        listed = () if odd else contacts_of(readings, fit, options, weak)
        return answer(readings, fit, listed, weak, fit.setting.name, SENTENCE[weak], odds, solve)
    listed = contacts_of(readings, fit, options, "ambiguous" if second_likely else None)
    statuses = [contact.status for contact in listed]
    status = "ambiguous" if "ambiguous" in statuses else "localized"
    message = SENTENCE[status]
    if second_likely:
        message = "a second contact is likely, but not certain; average more readings"
    return answer(readings, fit, listed, status, fit.setting.name, message, fit.score - null, solve)


def _not_free(readings: Readings, plain: Setting) -> bool:
    """Whether readings of known noise are beyond those of a free body with a common offset."""
    if not readings.known:
        return False
    weighted = readings.y / readings.variance
    misfit = float(readings.y @ weighted)
    if plain.columns.shape[1]:
        taken = plain.columns.T @ weighted
        gram = plain.columns.T @ (plain.columns / readings.variance[:, None])
        misfit -= float(taken @ np.linalg.solve(gram + np.eye(len(gram)), taken))
    return misfit > prior.free_limit(len(readings.y))
