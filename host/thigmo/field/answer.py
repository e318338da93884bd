"""What stands beside the body, by all sweeps of one side: the fit's answer for people and maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import nan

import numpy as np
from scipy.special import chdtri, softmax

from thigmo.field.atlas import Atlas
from thigmo.field.fit import ALIKE, Mode, on_one_thread
from thigmo.field.hypotheses import (
    ARC,
    BEND,
    FRICTION,
    PEG,
    PEGS,
    RADIUS,
    TILT,
    WALL,
    WALL_BEND,
    Body,
    way_into,
)
from thigmo.field.posterior import ENOUGH, Samples, laplace, sample
from thigmo.field.readings import Errors, Flags, Floats, Indices, Readings
from thigmo.field.search import Search

# Log likelihood that a place must gain for a fit: with less, the prior odds of a place refuse it.
LEAST_GAIN = 3.0
# Share of sweeps that their own model explains, and that are taken for unexplained.
FALSE_ALARMS = 0.05
# Log evidence by which an explanation must be likelier than the next for its place to count; and
# by which it must be likelier than the next by that one's first samples, or by its mode alone, for
# no more to be asked. Both fall short of the evidence where a posterior is no bell.
_SURELY, _BY_FIRST_SAMPLES, _BY_MODE = 3.0, 5.0, 7.0
# Everted length by the spool's encoder, and the side against the corner of the end, cm.
_LENGTH_CM = 0.1
# By how much wider a place is than its samples: the mechanics lack more than any hypothesis has.
# Fabric is uneven, its end is neither flat nor round, and friction depends on what went before. Of
# an independent rod's sides with one such error each, 9 % of the 95 % sets would else lack the
# truth (`thigmo bench field`).
UNMODELLED = 1.4
# Tube radii over which the end's shape decides where it touches, and one sigma of that: fabric that
# everts is anything between a flat end and a half sphere.
_END, _END_STD = 1.0, 0.5
# Sum of squares over the number of independent readings that a model which holds leaves on average.
# Where one peg leaves more, though possible, it is weighed against two and a wall.
_USUAL = 1.0
_TRACK = 25  # points
_REFUSED = 1e-3  # smaller odds are not worth a fit's contact

# Probability of a touch before the first readings that show when it came, beyond which a contact
# that one length alone has felt is not placed. They do where the bend is known to this share: at
# the start of a half sweep, before that, how the body follows the pressure is not.
_EARLY, _KNOWN = 0.5, 0.1

# Share of obstacles that give way for good under a body's force: doors, loose pegs.
_GIVES_WAY = 0.1

_NAMES = {PEG: "peg", PEGS: "two pegs", WALL: "wall"}
UNEXPLAINED_WORDS = "the model does not explain these sweeps"
SCARCE_WORDS = "too few samples of the fit agree"
RIVAL_WORDS = "another explanation is nearly as likely"
EARLY_WORDS = "one length alone touched it, before the first readings that count"
GAVE_WAY_WORDS = "one length alone touched it, until it gave way"


@dataclass(frozen=True, slots=True)
class FieldContact:
    """An obstacle where the last sweep that reached it touched it, in the side's own plane.

    x runs along the straight body, y towards the inflated side; lengths in cm.
    """

    length_cm: float  # everted, of that sweep
    arc_cm: float  # along the body
    interval_cm: tuple[float, float]  # 95 % of the arc
    x_cm: float  # of the touched skin
    y_cm: float
    covariance_cm2: Floats  # (2, 2) of x, y
    normal_rad: float  # direction from the centreline to the contact
    force_per_cm2: float  # across the body over EI, without sign
    force_interval_per_cm2: tuple[float, float]  # 95 %
    track: Floats  # (25, 2) the interval drawn along the skin
    arcs: Floats  # (n,) samples of the arc, cm, widened as the interval is
    weights: Floats  # (n,) of the samples, of sum one
    probability: float  # that something stands there
    places: bool  # whether its place is an answer: the model holds, and enough samples agree
    doubt: str  # why not, in words
    felt_at_cm: tuple[float, ...]  # everted lengths whose sweeps touched it, ascending
    log_odds: float  # log Bayes factor times prior odds, against nothing
    log_evidence: float  # of the readings, with the prior odds, less what all hypotheses share
    misfit: float  # sum of squares over the number of independent readings: 1 if the model holds
    effective: float  # samples
    kind: str  # "peg" or "wall"
    face: Floats  # (2, 2) ends of the part of a wall's face that was touched; (0, 2) for a peg
    # "peg", "two pegs" or "wall", with probabilities of sum one, likeliest first
    explanations: dict[str, float]
    peg_radius_cm: float  # posterior median; NaN for a wall
    friction: float  # posterior mean
    yield_cm: float  # posterior mean, of the obstacle under its force
    gave_way_at: float | None  # bend of the free body, 1/cm, from which on it was gone


def contacts(
    readings: Readings,
    errors: Errors,
    atlas: Atlas,
    *,
    expected: Callable[[Floats], Floats] | None = None,
    meanwhile: Callable[[], None] | None = None,
) -> list[FieldContact]:
    """What one side's sweeps touched; empty if the readings need no obstacle.

    `expected`: density of a given map at points (n, 2) of the skin, over that of a new obstacle.
    `meanwhile`: called often, since a fit takes seconds; an exception in it ends the fit.
    """
    with on_one_thread():
        return _contacts(Search(readings, errors, atlas, meanwhile), expected)


def _contacts(search: Search, expected: Callable[[Floats], Floats] | None) -> list[FieldContact]:
    readings = search.readings
    peg = _one_peg(search, expected)
    holds = peg is not None and _explains(peg, readings) and peg.misfit * ALIKE <= _USUAL
    gone = None if holds else _gave_way(search, expected)
    if peg is not None and gone is not None and not _explains(gone, readings):
        gone = None  # a peg that stands is the safer of two that explain nothing
    explanations = [samples for samples in (peg, gone) if samples is not None]
    if not explanations:
        return []
    explanations.sort(key=lambda samples: -samples.log_evidence)
    if explanations[0] is gone and not _doubt(explanations, readings):
        return _answer(search, explanations, "")
    # One peg may leave no more than is usual where two are touched at different lengths, or where a
    # second one is touched beyond it. So two are tried in any case; a wall as well, unless one peg
    # holds and is surely likelier.
    pairs = partial(search.pairs, None if peg is None else peg.likeliest, holds=holds)
    for modes_of_rival in (pairs, search.walls):
        chains, best = modes_of_rival(), explanations[0]
        if _laplace(search, chains) > best.log_evidence - _BY_MODE:
            least = best.log_evidence - _BY_FIRST_SAMPLES
            samples = _sampled(search, chains, expected, least)
            explanations += [] if samples is None else [samples]
            explanations.sort(key=lambda samples: -samples.log_evidence)
        if holds and explanations[0] is peg and not _doubt(explanations, readings):
            break
    return _answer(search, explanations, _doubt(explanations, readings))


def _doubt(explanations: list[Samples], readings: Readings) -> str:
    """Why the likeliest explanation, the first, is no answer; empty if it is."""
    best, *rivals = explanations
    if not _leaves_little(best, readings):
        return UNEXPLAINED_WORDS
    if best.effective < ENOUGH:
        return SCARCE_WORDS
    rivalled = any(rival.log_evidence > best.log_evidence - _SURELY for rival in rivals)
    return RIVAL_WORDS if rivalled else ""


def _one_peg(search: Search, expected: Callable[[Floats], Floats] | None) -> Samples | None:
    """Samples of one peg; None where nothing is likelier."""
    if not search.places or search.places[0].gain < LEAST_GAIN:
        return None
    chains = search.ridges()
    samples = _sampled(search, chains, expected) if chains else None
    if samples is None or _log_odds(search, samples) < np.log(_REFUSED):
        return None
    return samples


def _gave_way(search: Search, expected: Callable[[Floats], Floats] | None) -> Samples | None:
    """Samples of one peg that gave way in some bin; None where one that stays is likelier."""
    prior = float(np.log(_GIVES_WAY / len(search.readings.bend)))
    release = search.pegs.release()
    if release is None or release.gain + prior < max(release.stays, LEAST_GAIN):
        return None
    samples = _one_peg(search.with_standing(release.standing), expected)
    if samples is None:
        return None
    samples = replace(samples, log_evidence=samples.log_evidence + prior)
    return samples if _log_odds(search, samples) > np.log(_REFUSED) else None


def _sampled(
    search: Search,
    chains: list[list[Mode]],
    expected: Callable[[Floats], Floats] | None,
    least_log_evidence: float = -np.inf,
) -> Samples | None:
    """Samples around modes; few, for their evidence alone, if the likeliest leaves too much."""
    most = _most_misfit(search.readings) / ALIKE
    return sample(
        search, chains, expected=expected, most_misfit=most, least_log_evidence=least_log_evidence
    )


def _laplace(search: Search, chains: list[list[Mode]]) -> float:
    """Log evidence of the likeliest of modes, were its posterior a bell."""
    return max((laplace(search, mode) for chain in chains for mode in chain), default=-np.inf)


def _log_odds(search: Search, samples: Samples) -> float:
    return samples.log_evidence + 0.5 * search.nothing.cost


def _explains(samples: Samples, readings: Readings) -> bool:
    """Whether samples leave no more than a model that holds, and enough of them agree."""
    return _leaves_little(samples, readings) and samples.effective >= ENOUGH


def _leaves_little(samples: Samples, readings: Readings) -> bool:
    """Whether the likeliest sample leaves no more than a model that holds.

    Where one peg does not explain the readings, much may stand there that is no hypothesis: a row
    of dowels, a corner, a third peg. So other explanations must leave no more than is usual.
    """
    most = _most_misfit(readings) if samples.hypothesis == PEG else _USUAL
    return samples.misfit * ALIKE <= most


def _most_misfit(readings: Readings) -> float:
    """The sum of squares over the number of independent readings that a model which holds leaves.

    With the noise as these sweeps show it, the sum is distributed as chi-squared.
    """
    independent = float(np.isfinite(readings.curvature).sum()) / ALIKE
    return float(chdtri(independent, FALSE_ALARMS)) / independent


def _answer(search: Search, explanations: list[Samples], doubt: str) -> list[FieldContact]:
    """The contacts of the likeliest explanation, the first."""
    likeliest, *rivals = explanations
    best = _touched_in_passing(likeliest, search.readings, search.fit.body)
    return [
        _placed(
            search.readings, [best, *rivals], n, _log_odds(search, best), doubt,
            face=_face(best, n, search.fit.body),
        )
        for n in range(best.hypothesis.obstacles)
    ]  # fmt: skip


def _touched_in_passing(samples: Samples, readings: Readings, body: Body) -> Samples:
    """Samples with the longest body's first touch, without force, of what no peak of a sweep shows.

    A body may slip past an obstacle before each peak.
    """
    touch = samples.touch.copy()
    longest = int(np.argmax([stage.length for stage in readings.stages]))
    for n in range(samples.hypothesis.obstacles):
        if (samples.weight @ np.isfinite(touch[:, :, n, 0])).max() > 0.5:
            continue
        at = samples.hypothesis.unknowns_of(n).start + ARC
        for i, q in enumerate(samples.q):
            reached, arc = q.copy(), body.longest
            if n < samples.hypothesis.pegs:  # of what lies ahead of the end, the end
                arc = reached[at] = min(q[at], body.longest)
            x, y = samples.hypothesis.skin(reached, body)[n]
            normal = way_into(samples.hypothesis.place(q, body)[n], x, y)
            touch[i, longest, n] = arc, x, y, 0.0, normal
    return replace(samples, touch=touch)


def _face(samples: Samples, obstacle: int, body: Body) -> Floats:
    """Ends (2, 2) of the part of a wall's face that was touched; (0, 2) for a peg.

    It reaches from the first touch of the longest body to the last touches at each length.
    """
    if obstacle < samples.hypothesis.pegs:
        return np.zeros((0, 2))
    wall = samples.q[:, samples.hypothesis.unknowns_of(obstacle)]
    turn = body.longest * wall[:, WALL_BEND] - wall[:, TILT]
    heading = np.angle(samples.weight @ np.exp(1j * turn))
    first = samples.weight @ [samples.hypothesis.skin(q, body)[obstacle] for q in samples.q]
    points = [first]
    for touch in np.moveaxis(samples.touch[:, :, obstacle, 1:3], 1, 0):
        touches = np.isfinite(touch).all(axis=1)
        if samples.weight @ touches > 0.5:
            points.append(np.average(touch[touches], axis=0, weights=samples.weight[touches]))
    middle = np.mean(points, axis=0)
    way = np.array([np.cos(heading), np.sin(heading)])
    along = (np.array(points) - middle) @ way
    ends: Floats = middle + np.outer([along.min(), along.max()], way)
    return ends


def _placed(
    readings: Readings,
    explanations: Sequence[Samples],
    obstacle: int,
    log_odds: float,
    doubt: str,
    *,
    face: Floats,
) -> FieldContact:
    """One of the likeliest explanation's obstacles where the last sweep that reached it touched it.

    The errors of its place include what the other explanations have there, by their probabilities.
    """
    samples, *rivals = explanations
    touch = samples.touch[:, :, obstacle]
    touches = np.isfinite(touch[:, :, 0])  # (n, stages)
    shares = samples.weight @ touches
    reached = np.flatnonzero(shares > 0.5)
    last_sweep = [readings.sweep[readings.stage == s].max() for s in range(len(readings.stages))]
    stage = int(max(reached, key=lambda s: last_sweep[s]))
    weight = _widened(np.where(touches[:, stage], samples.weight, 0.0))
    weighed = weight > 0.0
    weight = weight[weighed] / weight[weighed].sum()
    force, normal = touch[weighed, stage, 3:].T
    length = readings.stages[stage].length
    mean = weight @ touch[weighed, stage, :3]
    probabilities = softmax([explanation.log_evidence for explanation in explanations])
    places, masses = [touch[weighed, stage, :3]], [probabilities[0] * weight]
    for rival, probability in zip(rivals, probabilities[1:], strict=True):
        touched, weights = _nearest(rival, stage, mean)
        places.append(touched)
        masses.append(probability * weights)
    place, mass = np.concatenate(places), np.concatenate(masses)
    mass /= mass.sum()
    scarce = 0.5 * ENOUGH * np.sum(weight**2) > 1.0
    if scarce:  # too few agree to say how far they spread: all along the body
        place = np.linspace(0.0, length / mean[0], _TRACK)[:, None] * mean
        mass = np.full(_TRACK, 1 / _TRACK)
    low, high = _quantiles(place[:, 0], mass, (0.025, 0.975))
    leaves = samples.misfit * ALIKE
    # What the model leaves beyond that is taken for more noise; and few samples that agree are as
    # much too narrow as they are too few.
    wider = max(UNMODELLED, leaves) * max(1.0, ENOUGH / samples.effective) ** 0.5
    # What the end touched, or just missed, at any stop: its shape adds to the errors, since a round
    # one touches farther back.
    end = float(mass @ _at_an_end(place[:, 0], readings))
    by_shape = _END * readings.radius * end
    interval = (
        max(float(mean[0] - wider * max(mean[0] - low, 0.0)) - _LENGTH_CM - by_shape, 0.0),
        min(float(mean[0] + wider * max(high - mean[0], 0.0)) + _LENGTH_CM, length),
    )
    off = wider * (place - mean)
    shape = _LENGTH_CM**2 + end * (_END_STD * readings.radius) ** 2 + scarce * length**2
    covariance = (mass[:, None] * off).T @ off + shape * np.eye(3)
    arc_std = float(np.sqrt(mass @ off[:, 0] ** 2))
    arc_off = off[:, 0] * min(1.0, 0.5 * length / max(arc_std, _LENGTH_CM))
    along = np.linspace(*interval, _TRACK)[:, None] - mean[0]
    turn = np.angle(weight @ np.exp(1j * normal))
    lengths_cm = sorted({round(readings.stages[s].length, 2) for s in reached})
    q = samples.q[weighed]
    is_peg = obstacle < samples.hypothesis.pegs
    unknowns = q[:, samples.hypothesis.unknowns_of(obstacle)]
    bends = unknowns[:, BEND if is_peg else WALL_BEND]
    if not doubt and len(lengths_cm) == 1:
        if weight @ (bends < _first_bend(readings, reached)) > _EARLY:
            doubt = EARLY_WORDS
        elif samples.gave_way_at is not None:
            doubt = GAVE_WAY_WORDS
    radii = readings.radius * np.exp(unknowns[:, RADIUS])
    return FieldContact(
        length_cm=length,
        arc_cm=float(mean[0]),
        interval_cm=interval,
        x_cm=float(mean[1]),
        y_cm=float(mean[2]),
        covariance_cm2=_on_the_body(covariance[1:, 1:], length),
        normal_rad=float(turn),
        force_per_cm2=float(weight @ np.abs(force)),
        force_interval_per_cm2=_quantiles(np.abs(force), weight, (0.025, 0.975)),
        arcs=mean[0] + arc_off,
        weights=mass,
        track=mean[1:] + along * covariance[0, 1:] / covariance[0, 0],
        probability=float(1 / (1 + np.exp(-log_odds))) * float(shares[stage]),
        places=not doubt,
        doubt=doubt,
        felt_at_cm=tuple(lengths_cm),
        log_odds=log_odds,
        log_evidence=samples.log_evidence,
        misfit=leaves,
        effective=samples.effective,
        kind="peg" if is_peg else "wall",
        face=face,
        explanations={
            _name(explanation): float(probability)
            for explanation, probability in zip(explanations, probabilities, strict=True)
        },
        peg_radius_cm=_quantiles(radii, weight, (0.5, 0.5))[0] if is_peg else nan,
        friction=float(weight @ np.abs(q[:, FRICTION])),
        yield_cm=float(weight @ (samples.compliance[weighed, obstacle] * np.abs(force))),
        gave_way_at=samples.gave_way_at,
    )


def _on_the_body(covariance: Floats, length_cm: float) -> Floats:
    """A covariance (n, n), narrowed where it says less than that a contact lies on the body.

    No distribution of places along it has a standard deviation above half of its length.
    """
    w, v = np.linalg.eigh(covariance)
    narrowed: Floats = (v * np.minimum(w, (0.5 * length_cm) ** 2)) @ v.T
    return narrowed


def _at_an_end(arcs: Floats, readings: Readings) -> Flags:
    """Whether touches at arcs (n,) are where a stop's end is, round or flat, or just beyond it.

    Beyond, a peg of the tube's radius at most reaches back to the corner of a flat end.
    """
    ends = np.array([stage.length for stage in readings.stages])
    beyond = (arcs[:, None] - ends) / (_END * readings.radius)
    at_an_end: Flags = ((beyond > -1.0) & (beyond < 2.0)).any(axis=1)
    return at_an_end


def _first_bend(readings: Readings, stages: Indices) -> float:
    """The bend from which on readings at these stages show when a touch came, 1/cm."""
    at_stages = np.isin(readings.stage, stages)
    if readings.response is not None:
        at_stages &= np.abs(readings.response) <= _KNOWN * readings.bend
    return float(np.min(readings.bend[at_stages], initial=np.inf))


def _name(samples: Samples) -> str:
    name = _NAMES[samples.hypothesis]
    return name if samples.gave_way_at is None else f"{name} that gave way"


def _nearest(samples: Samples, stage: int, mean: Floats) -> tuple[Floats, Floats]:
    """Arcs and places (n, 3) at which an explanation's samples touch at a stage, and weights (n,).

    Of the obstacle that is nearest to `mean` (3,); empty if none is touched.
    """
    nearest = np.zeros((0, 3)), np.zeros(0)
    least = np.inf
    for touch in np.moveaxis(samples.touch[:, stage, :, :3], 1, 0):
        touching = np.isfinite(touch[:, 0])
        weight = samples.weight[touching]
        if weight.sum() < 0.5:
            continue
        away = float(np.hypot(*(np.average(touch[touching], axis=0, weights=weight) - mean)[1:]))
        if away < least:
            least, nearest = away, (touch[touching], weight)
    return nearest


def _widened(weight: Floats) -> Floats:
    """Weights tempered until enough samples count."""
    exponent = 1.0
    tempered: Floats = weight / weight.sum()
    while exponent > 0.05 and ENOUGH * np.sum(tempered**2) > 1:
        exponent *= 0.85
        tempered = np.where(weight > 0.0, (weight / weight.max()) ** exponent, 0.0)
        tempered = tempered / tempered.sum()
    return tempered


def _quantiles(value: Floats, weight: Floats, at: tuple[float, float]) -> tuple[float, float]:
    along = np.argsort(value)
    below = np.cumsum(weight[along]) - 0.5 * weight[along]
    low, high = np.interp(at, below / weight.sum(), value[along])
    return float(low), float(high)
