"""`localize`: one frame of readings in, contacts with intervals out.

Called by the exploration, by the command line and by users. The posterior decides: number of
contacts by evidence, place by its median, interval by its mass. Richer mechanics are tried only
where a misfit or the bend calls for them. The exact 1-norm optimum and its set are computed when
asked for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError
from thigmo.localization import prior
from thigmo.localization.models import (
    GRID,
    Fit,
    MomentLimit,
    Setting,
    bent_shape,
    contact_curvature,
    fit_one,
    fit_several,
    fold_column,
    mix,
    not_beyond,
    precision,
    restrict,
    same_side,
    solve_columns,
    start,
)
from thigmo.localization.readings import Readings, normalise
from thigmo.localization.result import Contact, LocalizeResult, Range, Status
from thigmo.localization.several import LOOK, place_bound
from thigmo.localization.tip import tip_contact

Array = npt.NDArray[np.float64]

MOST_CONTACTS = 3


@dataclass(frozen=True, slots=True)
class Options:
    """What the caller knows of the body, normalised by the length."""

    offset: float
    critical: float | None
    critical_of: str
    mechanics: str
    radius: float
    width: float
    within: Range | None


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
        return _point_estimate(method, readings, contacts)
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
    solve = partial(_exact, curvature, position, length, span, free_curvature)
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
    plain = start(readings, options.offset)
    fit = fit_one(readings, plain)
    null = fit.null
    odds = fit.score - null
    threshold = prior.contact_threshold(len(readings.y), readings.known)
    found = odds > threshold
    if contacts == 0 or (contacts == "auto" and not found):
        status: Status = "below detection" if odds > prior.HINT else "no contact"
        return _answer(readings, fit, (), status, "free body", _SENTENCE[status], odds, solve)
    fit, second_likely = _best_model(readings, fit, contacts, options)
    if not found and len(fit.arcs) == 1:
        weak: Status = "below detection"
        listed = _contacts(readings, fit, options, weak)
        return _answer(readings, fit, listed, weak, fit.setting.name, _SENTENCE[weak], odds, solve)
    listed = _contacts(readings, fit, options, "ambiguous" if second_likely else None)
    statuses = [contact.status for contact in listed]
    status = "ambiguous" if "ambiguous" in statuses else "localized"
    message = _SENTENCE[status]
    if second_likely:
        message = "a second contact is likely, but not certain; average more readings"
    return _answer(
        readings, fit, listed, status, fit.setting.name, message, fit.score - null, solve
    )


def _best_model(
    readings: Readings, plain: Fit, contacts: int | str, options: Options
) -> tuple[Fit, bool]:
    """The model that the evidence prefers, and whether it leaves a further contact likely."""
    rich = options.mechanics == "auto"
    if contacts not in ("auto", 1):
        fold = _fold_setting(readings, plain, options, called=True) if rich else None
        return _given_number(readings, plain.setting, fold, int(contacts), rich), False
    # What the plain beam leaves unexplained: a second contact stands for any misfit here.
    one = _lever_arms(readings, plain) if rich else plain
    misfit = not readings.known or one.misfit > prior.MISFIT
    look = None
    if misfit and len(readings.y) >= LEAST_FOR_TWO:
        look = fit_several(readings, one.setting, 2, passes=LOOK)
    called = look is not None and look.score > one.score + prior.HINT_OF_MORE
    ones = [one]
    if rich:
        called = called or one.misfit > prior.misfit_limit(len(readings.y))
        fold = _fold_setting(readings, one, options, called)
        if called:
            ones += _tip_moment(readings, one)
            ones += _on_the_end(readings, one, options, attached=True)
        if called and len(readings.y) >= LEAST_FOR_SPREAD:
            ones += _spread_models(readings, one)
        if fold is not None:
            ones = _with_fold(readings, ones, fold, options)
        else:
            ones += _on_the_end(readings, one, options)
    else:
        fold = None
    winner = max(ones, key=_score)
    likely = False
    if contacts == "auto" and look is not None:
        step = prior.second_threshold(len(readings.y), readings.known)
        if look.score - step > winner.score - _margin(winner) - 0.5 or (called and fold):
            winner, likely = _more_contacts(readings, one.setting, winner, fold, rich)
    if len(winner.arcs) > 1:
        return winner, likely
    return mix(ones if options.within is None else restrict(ones, *options.within)), likely


# Readings from which two contacts can differ from one and noise.
LEAST_FOR_TWO = 4
# Readings from which a spread load can differ from a point load and noise.
LEAST_FOR_SPREAD = 5


def _score(fit: Fit) -> float:
    return fit.score


def _given_number(
    readings: Readings, plain: Setting, fold: Setting | None, count: int, rich: bool
) -> Fit:
    """As many contacts as the caller asks for."""
    fits = [fit_several(readings, plain, count)]
    if fold is not None:
        fits.append(fit_several(readings, fold, count, prior.FOLD_PENALTY))
    best = max(fits, key=_score)
    return _refit_bent(readings, best) if rich else best


def _margin(winner: Fit) -> float:
    """Nats by which one contact must lead two, for a second one not to count as likely.

    A rare load at the tip or a spread one can stand for two contacts that the sensors do not
    part: such a model must lead clearly.
    """
    rare = winner.stretch > 0.0 or "tip_moment" in winner.setting.labels
    return 4.0 if rare or winner.end is not None else 1.0


def _more_contacts(
    readings: Readings, plain: Setting, winner: Fit, fold: Setting | None, rich: bool
) -> tuple[Fit, bool]:
    """Two and three contacts, as long as each adds enough evidence."""
    step = prior.second_threshold(len(readings.y), readings.known)
    for count in range(2, MOST_CONTACTS + 1):
        # Each contact takes two numbers.
        if len(readings.y) < 2 * count:
            break
        penalty = (count - 1) * step + (prior.THIRD_PENALTY if count > 2 else 0.0)
        rivals = [fit_several(readings, plain, count, penalty)]
        if fold is not None:
            rivals.append(fit_several(readings, fold, count, penalty + prior.FOLD_PENALTY))
        rival = max(rivals, key=_score)
        if rich:
            rival = _refit_bent(readings, rival)
        if rival.score <= winner.score:
            return winner, count == 2 and rival.score > winner.score - _margin(winner)
        winner = rival
        if readings.known and winner.misfit < prior.MISFIT:
            break
    return winner, False


def _turning(fit: Fit, readings: Readings) -> float:
    """Largest turning (rad) between a contact and the base under a fit, roughly."""
    total, far = 0.0, 0.0
    for arc, force in zip(fit.arcs.tolist(), fit.forces.tolist(), strict=True):
        total += abs(force) * arc * arc / 2
        far = max(far, arc)
    return total + abs(readings.bend) * far


def _lever_arms(readings: Readings, fit: Fit) -> Fit:
    """One contact with levers from the bent shape, iterated until the place stands."""
    if _turning(fit, readings) < prior.BEND:
        return fit
    for _ in range(4):
        before = float(fit.arcs[0])
        setting = fit.setting.bent(bent_shape(fit, readings), readings)
        fit = fit_one(readings, setting, fit.penalty)
        if abs(float(fit.arcs[0]) - before) < 5e-4:
            break
    return fit


def _refit_bent(readings: Readings, fit: Fit) -> Fit:
    """Several contacts with levers from the bent shape."""
    if _turning(fit, readings) < prior.BEND:
        return fit
    setting = fit.setting.bent(bent_shape(fit, readings), readings)
    return fit_several(readings, setting, len(fit.arcs), fit.penalty)


def _fold_setting(readings: Readings, fit: Fit, options: Options, called: bool) -> Setting | None:
    """The same body with a fold at its base, where base sensors or the moment suggest one."""
    arc, force = float(fit.arcs[0]), float(fit.forces[0])
    limit = prior.SUSPECT_MOMENT if options.critical is None else 0.7 * options.critical
    near = (abs(force) + 2.0 * fit.deviation) * arc > limit
    odd = bool((fit.flagged & (readings.low < 2.0 * options.radius)).any())
    if not (near or called or odd):
        return None
    column = fold_column(readings, options.radius)
    # A fold needs base sensors to show it, and others to be told from a contact.
    base = np.count_nonzero(column > 0.0)
    if base == 0 or len(column) - base < 2:
        return None
    return fit.setting.with_column(column, prior.FOLD_ANGLE, "fold_angle", "base fold")


def _with_fold(readings: Readings, ones: list[Fit], fold: Setting, options: Options) -> list[Fit]:
    """One contact with a free and with a folded base; a known critical moment is enforced."""
    if options.critical is None:
        limit = None
        buckled, penalty = fold, prior.FOLD_PENALTY
    else:
        counted = readings.bend if options.critical_of == "total" else 0.0
        limit = MomentLimit(options.critical, counted)
        ones = [not_beyond(fit, limit) for fit in ones]
        penalty = 0.0
        buckled = replace(
            fold,
            name=fold.name.replace("base fold", "base fold at the critical moment"),
            moment=np.array([options.critical - counted, -options.critical - counted]),
            spread=np.full(2, prior.CRITICAL_SPREAD * options.critical),
            log_weight=np.log(np.full(2, 0.5)),
        )
    ones = [*ones, *_on_the_end(readings, ones[0], options, limit)]
    first = _lever_arms(readings, fit_one(readings, buckled, penalty))
    # The fold opens the way the contact bends the body.
    for folded in [first, *_on_the_end(readings, first, options)]:
        folded.score += same_side(folded, readings)
        ones.append(folded)
    return ones


def _on_the_end(
    readings: Readings,
    side: Fit,
    options: Options,
    limit: MomentLimit | None = None,
    *,
    attached: bool = False,
) -> list[Fit]:
    """A contact on the end of the body instead of its side, where a bend gives it a lever."""
    if _turning(side, readings) < prior.CORNER_BEND:
        return []
    found = tip_contact(
        readings, side.setting, side, options.radius, side.penalty, limit, attached=attached
    )
    return [] if found is None else [found]


def _tip_moment(readings: Readings, fit: Fit) -> list[Fit]:
    """A moment at the tip beside the contact."""
    if len(readings.y) < LEAST_FOR_TIP_MOMENT:
        return []
    setting = fit.setting.with_column(
        np.ones(len(readings.y)), prior.TIP_MOMENT, "tip_moment", "tip moment"
    )
    return [_lever_arms(readings, fit_one(readings, setting, prior.TIP_MOMENT_PENALTY))]


# A place, a force and a tip moment take three readings; one more to test them.
LEAST_FOR_TIP_MOMENT = 4


def _spread_models(readings: Readings, fit: Fit) -> list[Fit]:
    """A uniform load over a stretch of a few widths."""
    penalty = prior.DISTRIBUTED_PENALTY + math.log(len(prior.HALF_WIDTHS))
    setting = replace(fit.setting, name=f"{fit.setting.name} + distributed contact")
    return [fit_several(readings, setting, 1, penalty, half) for half in prior.HALF_WIDTHS]


def _contacts(
    readings: Readings, fit: Fit, options: Options, status: Status | None
) -> tuple[Contact, ...]:
    """Contacts in the caller's units; `status` overrides what the posterior says."""
    scale = readings.length
    out = []
    for j, (arc, force) in enumerate(zip(fit.arcs, fit.forces, strict=True)):
        low, high = fit.intervals[j]
        pieces = fit.pieces[j]
        own: Status = "localized"
        modes = len(pieces)
        if len(fit.arcs) == 1:
            # The end is a place of its own: no second mode, if the interval reaches it.
            modes = sum(near < 1.0 - 1.01 * prior.CORNER_WIDTH for near in pieces[:, 0].tolist())
        if modes > 1 or high - low > options.width or _open(readings, fit, options):
            own = "ambiguous"
        out.append(
            Contact(
                float(arc) * scale,
                float(force) / scale**2,
                (float(low) * scale, float(high) * scale),
                status or own,
                tuple((near * scale, far * scale) for near, far, _ in pieces.tolist()),
                fit.deviation / scale**2,
                None if fit.end is None else fit.end.offset * scale,
            )
        )
    return tuple(out)


def _open(readings: Readings, fit: Fit, options: Options) -> bool:
    """Whether only the ends of the body, not the readings, bound the place."""
    if len(fit.arcs) > 1:
        return fit.loose
    if fit.end is not None or options.within is not None:
        return False
    setting = fit.setting
    bound = place_bound(
        fit.arcs,
        fit.forces,
        readings.low,
        readings.high,
        setting.table,
        setting.edges,
        precision(fit, readings),
        setting.columns,
    )
    return not bound < options.width


_SENTENCE: dict[Status, str] = {
    "no contact": "the readings are those of the free body",
    "below detection": "a contact is not certain; average more readings or bend further",
    "localized": "one place explains the readings",
    "ambiguous": "the readings do not fix the place; see `intervals`",
}


def _answer(
    readings: Readings,
    fit: Fit,
    contacts: tuple[Contact, ...],
    status: Status,
    model: str,
    message: str,
    odds: float,
    solve: partial[tuple[float, tuple[tuple[Range, ...], ...]]],
) -> LocalizeResult:
    scale = readings.length
    return LocalizeResult(
        status,
        contacts,
        model,
        message,
        fit.noise / scale,
        odds,
        fit.nodes * scale,
        np.exp(fit.logp) / scale,
        tuple(int(i) for i in readings.index[fit.flagged]) if fit.flagged.any() else (),
        _parameters(readings, fit) if contacts else {},
        partial(_bend, readings, fit) if contacts else None,
        None,
        partial(solve, count=len(contacts)),
    )


def _bend(readings: Readings, fit: Fit) -> Array:
    """(K, 2) arc and contact curvature in the caller's units."""
    scale = readings.length
    return np.column_stack([GRID * scale, contact_curvature(fit, readings) / scale])


def _parameters(readings: Readings, fit: Fit) -> dict[str, float]:
    """Reported parameters of the model in the caller's units."""
    scale = readings.length
    power = {"tip_moment": 1, "fold_angle": 0}
    out = {}
    if fit.setting.labels:
        for label, unit, value in zip(
            fit.setting.labels, fit.setting.scales, solve_columns(fit, readings), strict=True
        ):
            if label:
                out[label] = float(value) * unit / scale ** power[label]
    if fit.end is not None:
        out["tangential_force"] = fit.end.tangential / scale**2
        # Its line passes beside the centreline.
        out["tip_moment"] = -fit.end.couple * fit.end.radius / scale
    if fit.stretch > 0.0:
        out["half_width"] = fit.stretch * scale
    return out


# Baselines work in cm with tolerances in cm: any body is handed to them as one of this length.
_BASELINE_LENGTH = 53.0


def _point_estimate(
    method: str, readings: Readings, contacts: int | Literal["auto"]
) -> LocalizeResult:
    """A method without a posterior: one point for each contact, no interval to speak of.

    "auto" is one contact: these methods cannot decide.
    """
    count = 1 if contacts == "auto" else int(contacts)
    scale = readings.length
    position = 0.5 * (readings.low + readings.high)
    span = readings.high - readings.low
    deviation = np.sqrt(readings.variance)
    if method in ("l1", "l2"):
        from thigmo.localization.exact import one_contact, several_contacts

        norm: Literal[1, 2] = 1 if method == "l1" else 2
        weight = deviation.min() / deviation
        if count == 1:
            solved = one_contact(readings.y, position, 1.0, span=span, weight=weight, norm=norm)
        elif count > 1:
            solved = several_contacts(
                readings.y, position, 1.0, contacts=count, span=span, weight=weight, norm=norm
            )
        arcs, forces = (solved.arc, solved.force) if count else (np.zeros(0), np.zeros(0))
    else:
        from thigmo.localization.baselines import BASELINES, Problem

        if method not in BASELINES:
            known = ", ".join(("exact", "l1", "l2", *BASELINES))
            raise DataError(f"unknown method {method!r}", f"use one of {known}")
        unit = _BASELINE_LENGTH
        arcs, forces = np.zeros(0), np.zeros(0)
        if count:
            noise = float(deviation.mean()) / unit if readings.known else 6e-4
            arcs, forces = BASELINES[method](
                Problem(
                    readings.y / unit,
                    position * unit,
                    span * unit,
                    unit,
                    contacts=count,
                    noise=noise,
                )
            )
            arcs, forces = np.asarray(arcs) / unit, np.asarray(forces) * unit**2
    order = np.argsort(arcs)
    listed = tuple(
        Contact(
            float(arcs[j]) * scale,
            float(forces[j]) / scale**2,
            (0.0, scale),
            "ambiguous",
            ((0.0, scale),),
        )
        for j in order
    )
    return LocalizeResult(
        "ambiguous" if listed else "no contact",
        listed,
        method,
        f"{method} gives a point and no interval",
        float(deviation.mean()) / scale if readings.known else 0.0,
        0.0,
        np.zeros(0),
        np.zeros(0),
    )


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
    from thigmo.localization.exact import one_contact, several_contacts

    y = np.asarray(curvature, dtype=np.float64) - np.asarray(free_curvature, dtype=np.float64)
    if count == 0:
        return float(np.nansum(np.abs(y))), ()
    if count == 1:
        solution = one_contact(y, position, length, span=span)
    else:
        solution = several_contacts(
            y, position, length, contacts=count, span=span, optimum_set=True
        )
    return solution.objective, solution.ranges
