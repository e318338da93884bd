"""Contacts on the end of the body: a round peg that bears on a corner or on the flat face.

A peg at the end pushes along the normal of the end's outline: on a corner obliquely, between the
side's normal and the face's; on the face straight back, anywhere across the diameter. Seen from the
peg's centre the end is one path (right corner, face, left corner), and the place on this path is
the one unknown beside the size of the force. At the place u of it a unit force has the components
n(u), t(u) along the body's normal and tangent at the tip and bears at the offset o(u), so it bends
the body at s by

    n * integral cos(theta(L) - theta(v)) dv + t * integral sin(theta(L) - theta(v)) dv - o * t

(integrals from s to the tip, theta the heading): for a given shape linear in the force. `estimate`
weighs this family against contacts on the side wherever the body is bent; on a straight body the
face has no lever.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization import prior
from thigmo.localization.frame import TOGETHER, Frame, empty_levels, empty_tried, one_level
from thigmo.localization.influence import end_influence
from thigmo.localization.marginal import prepare_levels, weigh
from thigmo.localization.models import (
    End,
    Fit,
    MomentLimit,
    Setting,
    bent_shape,
    contact_readings,
    precision,
    solve_columns,
)
from thigmo.localization.noise_levels import all_levels
from thigmo.localization.prior import BaseMoment
from thigmo.localization.readings import Readings

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]
Path = Callable[[Array], tuple[Array, Array]]

# Passes over the shape: the levers of a contact at the tip depend on all of it.
MOST_PASSES = 6
# A contact on the end that is this much less likely than one on the side is not looked at further.
HOPELESS = 8.0
# Pieces of the outline at first; one that holds more than this share is cut in three, so often.
PIECES = 14
MOST_SHARE = 0.25
MOST_CUTS = 10


def outline(place: Array) -> tuple[Array, Array]:
    """What a unit force does at places along the end's outline.

    Args:
        place: (K,) 0..1 along the path of the centre of a peg of `prior.PEG_RADIUS` tube radii
            round the right corner, across the face and round the left corner.

    Returns:
        (K, 3) its normal part, its tangential part, and the latter times the offset over the tube
        radius; (K,) that offset, left of the centreline.
    """
    quarter = 0.5 * math.pi * prior.PEG_RADIUS
    along = place * (2.0 * quarter + 2.0) - quarter - 1.0
    offset = np.clip(along, -1.0, 1.0)
    angle = (along - offset) / prior.PEG_RADIUS
    tangential = -np.cos(angle)
    return np.column_stack([-np.sin(angle), tangential, offset * tangential]), offset


def pulled(place: Array) -> tuple[Array, Array]:
    """As `outline`, of a load that is attached to a corner and pulls the end outwards as well."""
    angle = np.pi * (place - 0.5)
    offset = np.where(angle < 0.0, -1.0, 1.0)
    tangential = np.abs(np.sin(angle))
    return np.column_stack([-offset * np.cos(angle), tangential, offset * tangential]), offset


@compiled
def _weigh_places(
    phis: Array,
    levers: Array,
    flagged: Flags,
    frame: Frame,
    moment: BaseMoment,
    logp: Array,
    force: Array,
    flips: Array,
) -> float:
    """Weigh a force at each of K given places; a force that pulls has no weight.

    Args:
        phis: (K, N) readings for a unit force.
        levers: (K,) its moment at the base.
        flagged: (N,) readings taken for outliers.
        frame: what was read.
        moment: prior of the moment at the base.
        logp, force: (K,) written: log likelihood, and posterior mean.
        flips: (N + 1,) written: of the best place, as in `weigh`.

    Returns:
        Noise level with the most weight at the best place.
    """
    sigma, log_prior = all_levels(frame)
    levels = empty_levels(frame, sigma, log_prior)
    levels.flagged[:] = flagged
    prepare_levels(frame, 0.0, levels)
    tried = empty_tried(frame, TOGETHER)
    y = frame.y
    at = 0
    first = 0
    while first < phis.shape[0]:
        count = min(phis.shape[0] - first, TOGETHER)
        for j in range(count):
            tried.lever[j] = levers[first + j]
            tried.phi[:, j] = phis[first + j]
        weigh(count, y, levels, moment, tried, False)
        for j in range(count):
            k = first + j
            force[k] = tried.force[j]
            # The place says which way the force pushes: all of its prior is on that side.
            z = -force[k] / np.sqrt(2.0 * max(tried.variance[j], 1e-300))
            logp[k] = tried.logp[j] + np.log(max(math.erfc(z), 1e-300))
            if logp[k] > logp[at]:
                at = k
        first += count
    tried.lever[0] = levers[at]
    tried.phi[:, 0] = phis[at]
    level = 0
    top = -1e300
    for s in range(sigma.shape[0]):
        weigh(1, y, one_level(levels, s), moment, tried, False)
        if tried.logp[0] > top:
            top = tried.logp[0]
            level = s
    weigh(1, y, levels, moment, tried, True)
    flips[:] = tried.flips
    return float(sigma[level])


@dataclass(slots=True)
class _Weighed:
    """Pieces of the outline: middle, width, log posterior (not normalised), mean force, (K,)."""

    place: Array
    width: Array
    logp: Array
    force: Array
    level: float
    flips: Array


def _weigh(
    place: Array,
    width: Array,
    readings: Readings,
    setting: Setting,
    radius: float,
    limit: MomentLimit | None,
    flagged: Flags,
    path: Path,
) -> _Weighed:
    parts, bases = end_influence(setting.sensors, radius)
    weights, _ = path(place)
    levers = weights @ bases
    logp, force = np.empty(len(place)), np.empty(len(place))
    flips = np.empty(len(flagged) + 1)
    frame = setting.frame(readings)
    level = _weigh_places(
        weights @ parts, levers, flagged, frame, setting.moment, logp, force, flips
    )
    logp += np.log(width)
    if limit is not None:
        logp += limit.log_weight(force * levers)
    return _Weighed(place, width, logp, force, level, flips)


def _resolved(weigh_at: Callable[[Array, Array], _Weighed]) -> _Weighed:
    """Cut the outline until no piece holds most of the posterior."""
    place = (np.arange(PIECES) + 0.5) / PIECES
    found = weigh_at(place, np.full(PIECES, 1.0 / PIECES))
    for _ in range(MOST_CUTS):
        share = np.exp(found.logp - found.logp.max())
        if share.max() <= MOST_SHARE * share.sum():
            break
        # The top may lie just across the border of the best piece.
        at = int(share.argmax())
        cut = np.zeros(len(share), dtype=np.bool_)
        cut[max(at - 1, 0) : at + 2] = True
        third = found.width[cut] / 3.0
        place = np.concatenate([found.place[cut] + k * third for k in (-1, 0, 1)])
        new = weigh_at(place, np.tile(third, 3))
        keep = found if new.logp.max() < found.logp.max() - math.log(3.0) else new
        order = np.argsort(np.concatenate([found.place[~cut], new.place]))

        def joined(old: Array, added: Array, left: Flags = ~cut, by: Indices = order) -> Array:
            return np.concatenate([old[left], added])[by]

        found = _Weighed(
            joined(found.place, new.place),
            joined(found.width, new.width),
            joined(found.logp, new.logp),
            joined(found.force, new.force),
            keep.level,
            keep.flips,
        )
    return found


def tip_contact(
    readings: Readings,
    setting: Setting,
    fit: Fit,
    radius: float,
    penalty: float = 0.0,
    limit: MomentLimit | None = None,
    attached: bool = False,
) -> Fit | None:
    """Posterior of a contact on the end of the body; None where no push on it bends the body so.

    Args:
        readings: one frame.
        setting: columns and prior of the base moment.
        fit: of a contact on the side, whose shape the first pass takes.
        radius: of the tube.
        penalty: of the setting.
        limit: base moment beyond which the body would fold.
        attached: of a load that pulls the end outwards instead.
    """
    path = pulled if attached else outline
    what = "load attached to the tip" if attached else "contact on the tip"
    # A peg on the end opposes the bend, as one on the side does that a bending body meets; there
    # the other sign, which the readings exclude, has half of the prior.
    share_of_it = prior.PULL_SHARE if attached else 0.5 * prior.TIP_SHARE
    flagged = np.zeros(len(readings.y), dtype=np.bool_)
    out: Fit | None = None
    for _ in range(MOST_PASSES):
        setting = setting.bent(bent_shape(out or fit, readings), readings)

        def weigh_at(place: Array, width: Array, on: Setting = setting) -> _Weighed:
            return _weigh(place, width, readings, on, radius, limit, flagged, path)

        found = _resolved(weigh_at)
        pushes = found.force > 0.0
        if not pushes.any():
            return None
        top = float(found.logp[pushes].max())
        share = np.where(pushes, np.exp(np.minimum(found.logp - top, 0.0)), 0.0)
        score = top + math.log(share.sum() * share_of_it) - penalty
        share /= share.sum()
        weights, offset = path(found.place)
        # All that the force does is linear in these three, so their means will do.
        normal, tangential, couple = (share * found.force) @ weights
        before = out
        end = End(float(tangential), float(couple), float(share @ offset) * radius, radius)
        named = replace(setting, name=f"{setting.name} + {what}")
        out = _at_the_tip(readings, named, score, float(normal), end)
        out.penalty = penalty
        out.flagged = flagged.copy()
        out.noise = found.level * float(np.sqrt(readings.variance.mean()))
        out.deviation = float(np.sqrt(share @ (found.force * weights[:, 0] - normal) ** 2))
        out.misfit = _misfit(out, readings)
        if before is not None and score < fit.score - HOPELESS:
            break
        if before is not None and abs(score - before.score) < 0.05:
            odd = int(found.flips.argmax())
            if found.flips[odd] <= found.flips[-1] * (1.0 + 1e-9) or (
                not flagged[odd] and 2 * (flagged.sum() + 1) > len(flagged)
            ):
                break
            flagged[odd] = not flagged[odd]
    return out


def _at_the_tip(readings: Readings, setting: Setting, score: float, normal: float, end: End) -> Fit:
    """A fit whose place is known: the last hundredth of the body."""
    near = 1.0 - prior.CORNER_WIDTH
    # All but flat: denser at the tip itself, so that intervals close there. Nothing before it.
    nodes = np.array([near - 1e-6, near, 1.0])
    logp = np.array([-700.0, -0.05, 0.05]) - np.log([1.0, prior.CORNER_WIDTH, prior.CORNER_WIDTH])
    return Fit(
        setting,
        score,
        np.nan,
        np.array([1.0]),
        np.array([normal]),
        np.array([[near, 1.0]]),
        [np.array([[near, 1.0, 1.0]])],
        nodes,
        logp,
        np.zeros(len(readings.y), dtype=np.bool_),
        0.0,
        0.0,
        end=end,
    )


def _misfit(fit: Fit, readings: Readings) -> float:
    """Squared residuals over variance, with what the columns take at the cost of their priors."""
    columns = fit.setting.columns
    weight = precision(fit, readings)
    residual = readings.y - contact_readings(fit, readings.low, readings.high)
    total = float(weight @ residual**2)
    return total - float((columns.T @ (weight * residual)) @ solve_columns(fit, readings))
