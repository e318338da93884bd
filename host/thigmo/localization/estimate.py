"""`localize`: one frame of readings in, contacts with intervals out.

Readings are checked and normalised (`readings`), explanations weighed (`hypotheses.h`), and mixed
into an answer (`answer.h`): one posterior over everything that may have bent the body, every error
told, nothing thrown out silently. `localize_batch` runs the same compiled code over rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from thigmo.display import POINT_ESTIMATE
from thigmo.errors import DataError
from thigmo.localization import _posterior, priors
from thigmo.localization.readings import (
    Range,
    check_layout,
    columns,
    everted_length,
    grip,
    positive,
    refusal,
    share,
    share_of_length,
    vector,
)
from thigmo.localization.result import (
    Contact,
    LocalizeResult,
    OfBody,
    Status,
)

MOST_CONTACTS = 3
COMPILED = ("posterior", "l1", "l2")  # the norm of a point fit is its place here
METHODS = (*COMPILED, "thesis")
_BEND_POINTS = 107  # along a body bent by a point fit; every 0.5 cm of 53
STATUSES: tuple[Status, ...] = ("no contact", "below detection", "ambiguous", "localized")


def localize(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    *,
    length: float,
    span: npt.ArrayLike = 0.0,
    free_curvature: npt.ArrayLike = 0.0,
    body_curvature: npt.ArrayLike | None = None,
    noise: npt.ArrayLike | None = None,
    gain_error: npt.ArrayLike = 0.0,
    offset_error: float = 0.0,
    map_error: float = 0.0,
    shared_errors: npt.ArrayLike | None = None,
    bad_reading_odds: npt.ArrayLike = priors.BAD_READING,
    contacts: int | Literal["auto"] = "auto",
    method: str = "posterior",
    critical_curvature: float | None = None,
    critical_curvature_error: float = priors.CRITICAL_ERROR,
    tube_radius: float | None = None,
    held_end: bool | float | None = None,
    end_face_odds: float | None = None,
    width_limit: float | None = None,
    number_level: float = 0.0,
    within: Range | None = None,
) -> LocalizeResult:
    """Find the contacts that a body of known length feels.

    Lengths in any one unit (cm, mm, m), curvature in its inverse: the result scales with it. Every
    error that is told widens the answer by what it is worth; one that is not told makes it wrong.

    Args:
        curvature: (N,) readings, average curvature over each sensor; NaN marks a missing one.
        position: (N,) sensor centres along the body, 0 at the base.
        length: everted length.
        span: scalar or (N,) sensor lengths; 0 for point sensors.
        free_curvature: scalar or (N,) what each sensor would read if nothing touched.
        body_curvature: scalar or (N,) curvature of the free body at the sensors, where it differs
            from what they would read; the same if not given.
        noise: standard deviation of a reading, scalar or (N,), 1/length; None if it is not known.
        gain_error: relative standard error of each sensor's gain, scalar or (N,).
        offset_error: standard deviation of an offset that all readings share, 1/length.
        map_error: relative standard error of the free curvature, shared by all readings.
        shared_errors: (N, K) further errors that readings share: what each adds at one standard
            deviation, 1/length.
        bad_reading_odds: prior odds that a given reading is bad, scalar or (N,).
        contacts: how many (0 to 3), or "auto" to let the evidence decide.
        method: "posterior"; or a method without intervals, whose answers say so by their status
            `point estimate`: "l1", "l2" (exact point fits of one or two contacts), "thesis" (the
            alternating fit of `thigmo.localization.thesis`, for the number of contacts given, one
            for "auto"; with `critical_curvature`, also its remedies for a folded base). "thesis"
            takes no error, and lengths in cm only.
        critical_curvature: contact moment over EI at which the base folds, at this body pressure
            (it is proportional to it: `thigmo.mechanics.critical_moment`); infinity for a base
            that does not fold. If not given, a fold at any moment is weighed.
        critical_curvature_error: its relative standard error.
        tube_radius: radius of the body; 1.75/53 of the length if not given.
        held_end: whether something holds the end, so that it may bear any couple and be pulled; or
            the prior odds of that against a contact on the side. If not given, it is weighed.
        end_face_odds: prior odds of a contact on the face of the end, against one on the side: 0 if
            it cannot be touched there, the usual ones if not given.
        width_limit: widest 95 % interval that counts as localized; 10/53 of the length (10 cm of
            the 53 cm body) if not given.
        number_level: probability that the number of contacts must have before any of them counts
            as localized. 0 leaves the number open: each contact is a claim by itself.
        within: arcs between which a single contact is known to lie, by whatever else is known
            (a sweep that felt nothing, say). It does not decide how many contacts there are.

    Returns:
        Contacts with 95 % intervals, probabilities, status, and the likeliest explanation.

    Raises:
        DataError: readings that cannot be used as given, or that look like another unit.
    """
    k = vector(curvature, "curvature")
    localizer = localizer_of(
        position, k.size, length,
        span, noise, gain_error, offset_error, map_error, shared_errors, bad_reading_odds,
        contacts, critical_curvature, critical_curvature_error, tube_radius, held_end,
        end_face_odds, width_limit, number_level, within,
        "posterior" if method == "thesis" else method,
    )  # fmt: skip
    free = vector(free_curvature, "free_curvature", k.size)
    body = free if body_curvature is None else vector(body_curvature, "body_curvature", k.size)
    found = localizer.localize(k, free, body)
    if found.problem:
        raise refusal(found.problem, found.shows, localizer.length)
    if method == "thesis":
        count = 1 if contacts == "auto" else int(contacts)
        return _thesis_fit(
            k - free, position, span, localizer.length, count, critical_curvature or math.inf
        )
    if method != "posterior":
        return _point_fit(found, localizer.length, method)
    return _result(found, localizer.length)


def localizer_of(
    position: npt.ArrayLike, count: int, length: float, *options: Any, **named: Any
) -> _posterior.Localizer:
    """The compiled localizer of `count` readings, by checked options and the priors of now."""
    given = vector(position, "position").tobytes(), priors.compiled(), count, length, *options
    try:
        # Most callers give the same options again and again.
        return _checked(*given, **named)
    except TypeError:  # one is an array, which has no hash
        return _checked.__wrapped__(*given, **named)


@lru_cache(maxsize=64, typed=True)
def _checked(
    position: bytes,
    rules: _posterior.Priors,
    count: int,
    length: float,
    span: npt.ArrayLike = 0.0,
    noise: npt.ArrayLike | None = None,
    gain_error: npt.ArrayLike = 0.0,
    offset_error: float = 0.0,
    map_error: float = 0.0,
    shared_errors: npt.ArrayLike | None = None,
    bad_reading_odds: npt.ArrayLike = priors.BAD_READING,
    contacts: int | str = "auto",
    critical_curvature: float | None = None,
    critical_curvature_error: float = priors.CRITICAL_ERROR,
    tube_radius: float | None = None,
    held_end: bool | float | None = None,
    end_face_odds: float | None = None,
    width_limit: float | None = None,
    number_level: float = 0.0,
    within: Range | None = None,
    method: str = "posterior",
) -> _posterior.Localizer:
    x, total = np.frombuffer(position), everted_length(length)
    if x.size != count:
        raise DataError(
            "position and curvature differ in length", "give one position for each reading"
        )
    white = np.zeros(0) if noise is None else vector(noise, "noise", count)
    if noise is not None and not white.size:
        raise DataError("noise is empty", "give one standard deviation, or None if it is unknown")
    if (white == 0.0).any():
        raise DataError(
            "noise is 0", "give the standard deviation of a reading, or None if it is unknown"
        )
    widths, gains = vector(span, "span", count), vector(gain_error, "gain_error", count)
    odds = vector(bad_reading_odds, "bad_reading_odds", count)
    if count:
        check_layout(x, widths, total, noise=white, gain_error=gains, bad_reading_odds=odds)
    if contacts != "auto" and (
        isinstance(contacts, bool)
        or not isinstance(contacts, (int, np.integer))
        or not 0 <= contacts <= MOST_CONTACTS
    ):
        raise DataError(f"contacts={contacts!r} is not possible", 'give "auto" or 0 to 3')
    if method not in COMPILED:
        raise DataError(f"unknown method {method!r}", f"use one of {', '.join(COMPILED)}")
    if method != "posterior" and contacts not in ("auto", 1, 2):
        raise DataError(f"{method} fits no {contacts} contacts", "give 1 or 2, or no method")
    radius, limit = priors.TUBE_RADIUS * total, priors.WIDTH_SHARE
    if tube_radius is not None:
        radius = max(positive(tube_radius, "tube_radius"), 1e-6 * total)
    moment = math.inf
    if critical_curvature is not None and critical_curvature != math.inf:
        moment = max(positive(critical_curvature, "critical_curvature") * total, 1e-6)
    if width_limit is not None:
        limit = positive(width_limit, "width_limit") / total
    held, held_odds = grip(held_end)
    return _posterior.Localizer(
        x,
        widths,
        white,
        gains,
        odds,
        columns(shared_errors, count),
        positive(offset_error, "offset_error"),
        positive(map_error, "map_error"),
        total,
        radius,
        moment,
        max(positive(critical_curvature_error, "critical_curvature_error"), 1e-3),
        critical_curvature is None,
        held,
        math.nan if end_face_odds is None else positive(end_face_odds, "end_face_odds"),
        held_odds,
        -1 if contacts == "auto" else int(contacts),
        share_of_length(within, total),
        limit,
        share(number_level, "number_level"),
        COMPILED.index(method),
        rules,
    )


def _point_fit(found: _posterior.Answer, total: float, method: str) -> LocalizeResult:
    """The global minimum of a norm of the residual, and where it is attained."""
    fitted = [(arc, force, pieces) for arc, force, _, _, pieces, *_ in found.contacts(total)]
    return _point_result(fitted, total, method, found.objective)


def _thesis_fit(
    excess: npt.NDArray[np.float64],
    position: npt.ArrayLike,
    span: npt.ArrayLike,
    total: float,
    count: int,
    critical: float,
) -> LocalizeResult:
    """The thesis's fit to checked readings above the free curvature."""
    from thigmo.localization import thesis  # its optimiser takes a tenth of a second to import

    if count == 0:
        raise DataError("thesis fits no 0 contacts", "give 1 to 3, or no method")
    read = np.isfinite(excess)
    spans = np.broadcast_to(vector(span, "span", excess.size), excess.size)[read]
    problem = thesis.Problem(
        excess[read], vector(position, "position")[read], spans, total, count, critical
    )
    arcs, forces = thesis.coupled(problem)
    fitted = [(arc, force, ()) for arc, force in zip(arcs.tolist(), forces.tolist(), strict=True)]
    left = thesis.objective(thesis.at_centres(problem), arcs, forces)
    return _point_result(fitted, total, "thesis", left)


def _point_result(
    fitted: Sequence[tuple[float, float, tuple[Range, ...]]],
    total: float,
    method: str,
    objective: float,
) -> LocalizeResult:
    """Places and forces without errors, as a result that nobody takes for one with errors.

    The interval of such a contact is the whole body: nothing narrower would hold.
    """
    contacts = tuple(
        Contact(arc, force, (0.0, total), POINT_ESTIMATE, pieces, math.nan, math.nan)
        for arc, force, pieces in fitted
    )
    arcs = np.linspace(0.0, total, _BEND_POINTS)
    bend = sum((force * np.maximum(arc - arcs, 0.0) for arc, force, _ in fitted), np.zeros(1))
    return LocalizeResult(
        POINT_ESTIMATE,
        contacts,
        f"{len(contacts)} contact{'s' * (len(contacts) > 1)}, {method}",
        f"{method} gives a place without an interval: how far off it is, and whether there is a "
        "contact at all, it does not say",
        math.nan,
        math.nan,
        {},
        objective=objective,
        length=total,
        _body=OfBody(bend=bend * total),
    )


def _result(found: _posterior.Answer, total: float) -> LocalizeResult:
    """The answer in the caller's units."""
    status = STATUSES[found.status]
    contacts = tuple(Contact(*fields) for fields in found.contacts(total))
    return LocalizeResult(
        status,
        contacts,
        found.hypothesis,
        _message(status, found, len(contacts)),
        found.noise,
        found.log_odds,
        found.hypotheses,
        () if found.discarded < 0 else (found.discarded,),
        found.parameters(total),
        number=tuple(found.number),
        length=total,
        _body=found,
    )


def _message(status: Status, found: _posterior.Answer, count: int) -> str:
    bad = ""
    if found.discarded >= 0:  # a kink under a sensor looks much the same
        bad = "; one reading looks bad (see `discarded`)"
        kink = sum(p for name, p in found.hypotheses.items() if "hinge" in name or "folded" in name)
        if kink > priors.EXCLUDED:
            bad += f", or the body is kinked there (probability {kink:.2f})"
    if status == "no contact":
        return "the readings are those of the free body" + bad
    if status == "below detection":
        return "a contact is not certain; average more readings, bend further or give `noise`" + bad
    felt = f"{count} felt with probability {found.number[count]:.2f}"
    if count < MOST_CONTACTS:
        felt += f", more are not excluded ({sum(found.number[count + 1 :]):.2f})"
    if status == "localized":
        places = "a contact lies" if count == 1 else "contacts lie"
        return f"{places} where `intervals` say, whatever their number; {felt}{bad}"
    if found.touched < 1.0 - priors.EXCLUDED:
        return f"a contact has probability {found.touched:.2f}; {felt}{bad}"
    if found.end_open:
        return f"something may hold the end: give held_end; {felt}{bad}"
    return f"the readings do not fix the place, see `intervals`; {felt}{bad}"
