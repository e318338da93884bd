"""Which model explains a frame: how many contacts, and which mechanics, by evidence.

One contact on the side of a plain beam first; levers of the bent shape where it bends; a base fold,
a load at the tip or over a stretch, a second and a third contact only where misfit, moment or bend
call for them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from thigmo.localization import prior
from thigmo.localization.first_look import Look
from thigmo.localization.mixing import mix, not_beyond, restrict
from thigmo.localization.models import (
    Fit,
    MomentLimit,
    Setting,
    bent_shape,
    evidence_of,
    fit_one,
    fit_several,
    fold_column,
    same_side,
    two_at_most,
)
from thigmo.localization.readings import Readings
from thigmo.localization.result import Range
from thigmo.localization.tip import tip_contact

MOST_CONTACTS = 3


@dataclass(frozen=True, slots=True)
class Options:
    """What the caller knows of the body, normalised by the length."""

    critical: float | None
    critical_of: str
    mechanics: str
    radius: float
    width: float
    within: Range | None


def stands(look: Look, contacts: int | str, options: Options) -> bool:
    """Whether the first look is all that a frame calls for: one contact on the straight side.

    As `best_model` would find at length: no bend, no moment and no misfit that another model could
    explain.
    """
    if contacts not in ("auto", 1) or options.within is not None:
        return False
    if look.flagged.any() or look.two > look.evidence + _least_of_two(look.finite):
        return False
    if options.mechanics != "auto":
        return True
    arc, force = look.arc, abs(look.force)
    turning = force * arc * arc / 2
    if turning + abs(look.bend) * arc >= prior.BEND:
        return False
    if turning + abs(look.bend) >= prior.CORNER_BEND:
        return False
    if (force + 2.0 * look.deviation) * arc > _suspect(options):
        return False
    return look.misfit <= prior.misfit_limit(look.finite)


# Nats by which one contact must lead two, for a second one not to count as likely; and by which a
# rare one must.
MARGIN = 1.0
RARE_MARGIN = 4.0
# By so much less than its threshold does a second contact call for a fit.
NEARLY = 0.5


# Outliers beside one contact from which three are tried even if two explain no more.
MANY_OUTLIERS = 3


def _least_of_two(readings: int, margin: float = MARGIN) -> float:
    """What two contacts must add to the evidence of one, of known noise, to count at all."""
    return prior.second_threshold(readings, True) - margin - NEARLY


def best_model(
    readings: Readings, plain: Fit, contacts: int | str, options: Options
) -> tuple[Fit, bool]:
    """The model that the evidence prefers, and whether it leaves a further contact likely."""
    rich = options.mechanics == "auto"
    if contacts not in ("auto", 1):
        fold = _fold_setting(readings, plain, options, called=True) if rich else None
        return _given_number(readings, plain.setting, fold, int(contacts), rich), False
    # What the plain beam leaves unexplained: a second contact stands for any misfit here.
    one = _lever_arms(readings, plain) if rich else plain
    odd = one.misfit > prior.misfit_limit(len(readings.y))
    two = -math.inf
    rare = odd or _turning(one, readings, whole=True) >= prior.CORNER_BEND
    least = one.score + _least_of_two(len(readings.y), RARE_MARGIN if rare else MARGIN)
    if two_at_most(readings, one) > least:
        two = evidence_of(2, readings, one.setting)
    called = two > one.score + prior.HINT_OF_MORE
    ones = [one]
    if rich:
        called = called or odd
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
    if contacts == "auto" and math.isfinite(two):
        step = prior.second_threshold(len(readings.y), readings.known)
        if two - step > winner.score - _margin(winner) - NEARLY or (called and fold):
            winner, likely = _more_contacts(readings, one.setting, winner, fold, rich)
    if len(winner.arcs) > 1:
        return winner, likely
    return mix(ones if options.within is None else restrict(ones, *options.within)), likely


# Readings from which a spread load can differ from a point load and noise.
LEAST_FOR_SPREAD = 5


def _score(fit: Fit) -> float:
    return fit.score


def _unexplained(readings: Readings, fit: Fit) -> bool:
    """Whether a fit leaves enough for a further contact to explain."""
    if not readings.known or fit.misfit > prior.least_misfit(len(readings.y)):
        return True
    return bool(fit.flagged.any())


def _given_number(
    readings: Readings, plain: Setting, fold: Setting | None, count: int, rich: bool
) -> Fit:
    """As many contacts as the caller asks for."""
    fits = [fit_several(readings, plain, count)]
    if fold is not None:
        fits.append(fit_several(readings, fold, count, prior.FOLD_PENALTY))
    return _best_bent(readings, fits) if rich else max(fits, key=_score)


def _best_bent(readings: Readings, fits: list[Fit]) -> Fit:
    """The best of fits of several contacts, the first of them without a fold, on its bent shape.

    Levers of the wrong shape leave what a fold can stand for.
    """
    best = max(fits, key=_score)
    bent = _refit_bent(readings, best)
    return bent if best is fits[0] else max(bent, _refit_bent(readings, fits[0]), key=_score)


def _margin(winner: Fit) -> float:
    """Nats by which one contact must lead two, for a second one not to count as likely.

    A rare load at the tip or a spread one can stand for two contacts that the sensors do not
    part: such a model must lead clearly.
    """
    rare = winner.stretch > 0.0 or "tip_moment" in winner.setting.labels
    return RARE_MARGIN if rare or winner.end is not None else MARGIN


def _more_contacts(
    readings: Readings, plain: Setting, winner: Fit, fold: Setting | None, rich: bool
) -> tuple[Fit, bool]:
    """Two and three contacts, as long as each adds enough evidence."""
    step = prior.second_threshold(len(readings.y), readings.known)
    second = False
    for count in range(2, MOST_CONTACTS + 1):
        # Each contact takes two numbers.
        if len(readings.y) < 2 * count:
            break
        penalty = (count - 1) * step + (prior.THIRD_PENALTY if count > 2 else 0.0)
        likely = [(plain, penalty)]
        if fold is not None:
            likely.append((fold, penalty + prior.FOLD_PENALTY))
        if count > 2:
            # On the shape that two give the body a look is enough, where three are far from them.
            shape = winner.setting.sensors.table
            if len(shape):
                likely = [(setting.bent(shape, readings), cost) for setting, cost in likely]
            likely = [
                (setting, cost)
                for setting, cost in likely
                if evidence_of(count, readings, setting) - cost > winner.score - NEARLY
            ]
            if not likely:
                break
        rivals = [fit_several(readings, setting, count, cost) for setting, cost in likely]
        rival = _best_bent(readings, rivals) if rich else max(rivals, key=_score)
        if rival.score <= winner.score:
            second = second or (count == 2 and rival.score > winner.score - _margin(winner))
            # Where much is thrown out, three can explain what two do not.
            if np.count_nonzero(winner.flagged) < MANY_OUTLIERS:
                break
            continue
        winner, second = rival, False
        if not _unexplained(readings, winner):
            break
    return winner, second


def _turning(fit: Fit, readings: Readings, *, whole: bool = False) -> float:
    """Turning (rad) up to the last contact under a fit, or of the whole body, roughly."""
    total, far = 0.0, 1.0 if whole else 0.0
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
    """Several contacts with levers from the bent shape, iterated as far as their intervals ask."""
    if _turning(fit, readings) < prior.BEND:
        return fit
    for _ in range(4):
        before, width = fit.arcs, np.ptp(fit.intervals, axis=1)
        setting = fit.setting.bent(bent_shape(fit, readings), readings)
        fit = fit_several(readings, setting, len(fit.arcs), fit.penalty)
        if (np.abs(fit.arcs - before) <= 0.1 * width).all():
            break
    return fit


def _suspect(options: Options) -> float:
    """Moment at the base from which a fold is suspected."""
    return prior.SUSPECT_MOMENT if options.critical is None else 0.7 * options.critical


def _fold_setting(readings: Readings, fit: Fit, options: Options, called: bool) -> Setting | None:
    """The same body with a fold at its base, where base sensors or the moment suggest one."""
    arc, force = float(fit.arcs[0]), float(fit.forces[0])
    near = (abs(force) + 2.0 * fit.deviation) * arc > _suspect(options)
    odd = fit.flagged.any() and bool(fit.flagged[readings.low < 2.0 * options.radius].any())
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
            moment=prior.BaseMoment(
                np.array([options.critical - counted, -options.critical - counted]),
                np.full(2, prior.CRITICAL_SPREAD * options.critical),
                np.full(2, 0.5),
            ),
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
    if _turning(side, readings, whole=True) < prior.CORNER_BEND:
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
