"""The posterior of what stands in the room, from what all sweeps of one side felt and passed.

Until its first touch a body is free, and a free body bends alike at every length. So an obstacle at
arc s that is touched at bend k touches every longer body at s and k as well, and where a body
passed k untouched, none stands nearer than its tip. Every way to share the sightings out has an
evidence: those of one peg lie at one arc and one bend; those of a wall lie at the tips, which slide
along it, and on a line in the room, and beyond its far end bodies lean on that end as on a peg; a
sighting may be another obstacle's, or nothing. Places are mixed over all ways, so only what is the
same obstacle is multiplied.

Lengths in cm, bends (free curvatures without sign) in 1/cm. `docs/methods.md` derives it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from thigmo.config import SIGN, Side
from thigmo.exploration.sighting import (
    BEND_LEAST,
    BEND_SHARE,
    LEVEL,
    Passed,
    Sighting,
    bend_grid,
    median,
    shortest,
)
from thigmo.localization.priors import narrow
from thigmo.robot.curvature import Floats

Group = tuple[int, ...]  # sightings of one obstacle
Masses = dict[int, Floats]  # posterior over the arcs of each of a group's sightings

# Lengths are shares of the body's, measured on one of 53 cm; where a peg rolls on the skin they are
# tube radii. At the rim of an earlier tip, one radius, a peg may have slid off unfelt.
# A wall is felt by the last tube radius of the body, or by this mean distance farther from the tip:
# of 163 emulated touches of walls 75 % lie within it, and 91 % within 5 cm of the tip.
_AT_TIP, _BEHIND = 0.75, 4.0 / 53
_SLIDE = 0.7 / 1.75  # one sigma by which a contact moves along the body while a peg stands still
# What the end felt, a longer body's side feels by less than the peg's radius beyond it; pegs have
# any of these.
_RADII_CM = (0.25, 0.5, 1.0, 2.0, 4.0)
# Of 838 things that emulated sweeps touched first, 33 touched the straight body, as whatever stands
# beside its path does; the others are spread over all bends.
_TOUCH_STRAIGHT = 0.04
_OTHERS_TOUCH = 0.05  # probability that the touch was not this contact's: a bad zero, noise
# Of 2007 emulated pairs of sweeps, 7 passed a place at which the other touched something.
_PASSED_UNFELT = 0.01
_OTHERS_OF_SEVERAL = 0.5  # the same where the sweep felt several contacts
_WRONG_FRAME = 0.03  # probability that the readings were explained wrongly altogether
# The same where only a wrench on the end explains them, at every length: friction and a body
# squeezed from both sides look like that. Of 18 such contacts at emulated walls 4 were elsewhere.
_WRONG_END = 0.2
# One sigma of the distance of touched points from a line: of one wall's, of several things'.
_STRAIGHT, _OFF = 1.2 / 53, 15.0 / 53
# Prior odds of one more obstacle, and of a wall against a peg. With 0.1 and 0.05, 287 pairs of
# touches in 200 emulated rooms of walls were one peg with over 90 %, of which 46 were of different
# places; now 192 and 8.
_LOG_ANOTHER, _LOG_WALL = np.log(0.3), np.log(0.2)
_MOST_WAYS = 400  # kept after each sighting; up to six sightings have no more


@dataclass(frozen=True, slots=True)
class Found:
    """An obstacle of the likeliest way; its places are mixed over all ways."""

    kind: str  # "peg" or "wall"
    members: Group  # indices of its sightings, the longest body's last
    kinds: dict[str, float]  # probability that just these sightings are one peg, or one wall
    probability: float  # that it is real
    mass: Floats  # of the arc on the longest member's body, of sum one
    arc_cm: float
    interval_cm: tuple[float, float]
    status: str  # "localized" or "ambiguous"
    surface: list[tuple[float, float]]  # a point of each member's touch; a wall's line along them


@dataclass(frozen=True, slots=True)
class _Way:
    """One way to share out the first sightings."""

    log: float
    groups: tuple[Group, ...]
    nothing: Group  # sightings behind which there is no obstacle


def touch_point(
    arc_cm: float, bend: float, side: Side, radius_cm: float = 0.0
) -> tuple[float, float]:
    """Point of the skin on the inner side of a free body: what its first touch touches.

    Without a radius it is that of the centreline.
    """
    turn = arc_cm * bend
    x = np.sin(turn) / bend - radius_cm * np.sin(turn)
    y = (1 - np.cos(turn)) / bend + radius_cm * np.cos(turn)
    return float(x), float(SIGN[side] * y)


class Room:
    """What stands in the room, by all that the sweeps of one muscle felt and passed.

    `arcs` (n,) is the grid of the sightings' masses.
    """

    def __init__(
        self, arcs: Floats, seen: Sequence[Sighting], passed: Sequence[Passed], radius_cm: float
    ) -> None:
        self._arcs, self._radius_cm = arcs, radius_cm
        self._full_cm = float(arcs[-1])
        self._bends = bend_grid(self._full_cm)
        straight = np.exp(-0.5 * ((self._bends - self._bends[0]) / BEND_LEAST) ** 2)
        spread = (1 - _TOUCH_STRAIGHT) / len(self._bends)
        self._bend_prior = spread + _TOUCH_STRAIGHT * straight / straight.sum()
        self._seen = sorted(seen, key=lambda each: each.length_cm)
        self._passed = passed
        slide_cm = _SLIDE * radius_cm
        reach = np.arange(-3 * slide_cm, 3 * slide_cm + 1e-9, arcs[1] - arcs[0])
        self._slide = np.exp(-0.5 * (reach / slide_cm) ** 2)
        self._alone = [self._arc_likelihood(each, slides=False) for each in self._seen]
        self._shared = [self._arc_likelihood(each, slides=True) for each in self._seen]
        self._tip = [self._near_tip(each.length_cm) for each in self._seen]
        self._touch = [_or_another(each, self._same_bend(each)) for each in self._seen]
        self._at_end = [self._end_likelihood(each) for each in self._seen]
        self._weighed_groups: dict[tuple[Group, str], tuple[float, Masses]] = {}

    def place(self, index: int) -> Floats:
        """Posterior of one sighting's arc, (n,), by what it felt and what other sweeps passed."""
        mass = self._alone[index] * self._expected((index,))
        mass = mass * self._arcs * (self._arcs <= self._seen[index].length_cm + 1e-9)
        normalised: Floats = mass / mass.sum()
        return normalised

    def obstacles(self) -> list[Found]:
        """The obstacles of the likeliest way, in the order of the lengths that felt them first."""
        if not self._seen:
            return []
        ways, lost = self._ways()
        kinds: list[tuple[float, list[tuple[Group, str]], Group]] = []
        for way in ways:
            for choice in product(*[("peg", "wall")[: 1 + (len(g) > 1)] for g in way.groups]):
                each = list(zip(way.groups, choice, strict=True))
                log = sum(_LOG_ANOTHER + self._evidence(*one)[0] for one in each)
                kinds.append((log + self._log_nothing(way.nothing), each, way.nothing))
        weight = np.exp(np.array([log for log, *_ in kinds]) - max(log for log, *_ in kinds))
        weight /= weight.sum()
        mixed = [np.zeros(len(self._arcs)) for _ in self._seen]
        share: dict[tuple[Group, str], float] = {}
        for w, (_, each, nothing) in zip(weight.tolist(), kinds, strict=True):
            for one in each:
                share[one] = share.get(one, 0.0) + w
                for i, mass in self._evidence(*one)[1].items():
                    mixed[i] += w * mass
            for i in nothing:
                share[(i,), "nothing"] = share.get(((i,), "nothing"), 0.0) + w
        best = kinds[int(weight.argmax())][1]
        return [self._found(group, kind, share, mixed, lost) for group, kind in best]

    def _found(
        self,
        group: Group,
        kind: str,
        share: dict[tuple[Group, str], float],
        mixed: list[Floats],
        lost: float,
    ) -> Found:
        mass = mixed[group[-1]] / mixed[group[-1]].sum()
        newest = self._seen[group[-1]]
        length_cm = newest.length_cm
        on_end = [self._seen[i].hypothesis.startswith("end wrench") for i in group]
        # A peg's place is shared by its sightings; along a wall each has its own.
        if all(on_end) or (kind == "wall" and any(on_end)):
            body = self._arcs <= length_cm + 1e-9
            mass = (1 - _WRONG_END) * mass + _WRONG_END * body / body.sum()
        low, high = shortest(self._arcs, mass)
        if high > length_cm - (self._arcs[1] - self._arcs[0]):
            high = length_cm  # the last node on the body stands for all up to its end
        real = 1.0 - min(share.get(((i,), "nothing"), 0.0) for i in group)
        # Of several contacts in one frame the localizer may know that its numbers are too many.
        vouched = len(group) > 1 or newest.alone or newest.contact.status == "localized"
        sure = vouched and narrow((low, high), self._full_cm) and real - lost >= LEVEL
        kinds = {each: share.get((group, each), 0.0) for each in ("peg", "wall")}
        touch = np.prod([self._touch[i] for i in group], axis=0) * self._bend_prior
        same = median(self._bends, touch) if kind == "peg" else None
        points = [self._point(i, median(self._arcs, mixed[i]), same) for i in group]
        return Found(
            kind, group, kinds, real, mass, median(self._arcs, mass), (low, high),
            "localized" if sure else "ambiguous", points,
        )  # fmt: skip

    @property
    def seen(self) -> list[Sighting]:
        """The sightings that groups index, by their bodies' lengths."""
        return self._seen

    def _arc_likelihood(self, s: Sighting, *, slides: bool) -> Floats:
        """Likelihood of its arc, (n,), which other sightings may share; one if it tells nothing."""
        arcs = self._arcs
        body = arcs <= s.length_cm + 1e-9
        mass = s.mass * body
        if slides:
            # What a contact near the end is off by, it is off by towards the base.
            inside = np.convolve(body.astype(float), self._slide, mode="same")
            mass = np.convolve(mass, self._slide, mode="same") / np.maximum(inside, 1e-9) * body
        mass = ((1 - _WRONG_FRAME) * mass / mass.sum()) * body.sum() + _WRONG_FRAME * body
        other = _PASSED_UNFELT if s.alone else _OTHERS_OF_SEVERAL
        touched = self._same_bend(s) * self._bend_prior
        for each in self._passed:
            if each.side == s.side and abs(each.length_cm - s.length_cm) > 0.5:
                clear = (1 - other) * float(each.free @ touched)
                mass = mass * np.where(arcs < each.length_cm - self._radius_cm, 1 - clear, 1.0)
        end = body & (arcs > s.length_cm - self._radius_cm)
        mass[~body & (arcs <= s.length_cm + _RADII_CM[-1])] = mass[end].mean()
        return np.asarray(mass)

    def _end_likelihood(self, s: Sighting) -> dict[int, Floats]:
        """The touch's likelihood (145,) at each node of the grid just beyond the body's end.

        There the end's corner touches a peg that stands beside a longer body: it bends farther, by
        what the peg's round leaves between the corner and the side.
        """
        same, likelihood = self._same_bend(s), {}
        over = self._arcs - s.length_cm
        for n in np.flatnonzero((over > 1e-9) & (over <= _RADII_CM[-1])).tolist():
            late = [r - np.sqrt(r**2 - over[n] ** 2) for r in _RADII_CM if r >= over[n]]
            bends = [self._bends + 2 * cm / s.length_cm**2 for cm in late]
            density = np.sum(
                [np.interp(each, self._bends, same, right=0.0) for each in bends], axis=0
            )
            likelihood[n] = _or_another(s, density / len(_RADII_CM))
        return likelihood

    def _expected(self, group: Group) -> Floats:
        """Prior density over the arc that a given map adds, as the longest body sees it."""
        known = self._seen[group[-1]].expected
        return np.ones(len(self._arcs)) if known is None else known / known.mean()

    def _log_nothing(self, sightings: Group) -> float:
        """Log weight of no obstacle behind sightings, against another behind each."""
        odds = [(1 - p) / p for p in (self._seen[i].probability for i in sightings)]
        return float(np.sum(np.log(np.array(odds) + 1e-9) + _LOG_ANOTHER))

    def _ways(self) -> tuple[list[_Way], float]:
        """The ways to share the sightings out, and a bound on the share of those omitted."""
        ways, lost = [_Way(0.0, (), ())], 0.0
        for i, sighting in enumerate(self._seen):
            more: list[_Way] = []
            for way in ways:
                for g, group in enumerate(way.groups):
                    # No obstacle has two sightings of one sweep.
                    if all(abs(self._seen[j].length_cm - sighting.length_cm) > 1 for j in group):
                        more.append(
                            self._weighed((*way.groups[:g], (*group, i), *way.groups[g + 1 :]),
                                          way.nothing)
                        )  # fmt: skip
                more.append(self._weighed((*way.groups, (i,)), way.nothing))
                more.append(self._weighed(way.groups, (*way.nothing, i)))
            more.sort(key=lambda way: -way.log)
            ways = more[:_MOST_WAYS]
            if dropped := more[_MOST_WAYS:]:
                top = ways[0].log
                lesser, kept = (sum(np.exp(w.log - top) for w in some) for some in (dropped, ways))
                # Each later sighting may bear out a dropped way by its largest likelihood at most,
                # and bears out a kept one as another obstacle at least.
                gain = sum(
                    np.log(self._shared[j].max() * self._touch[j].max())
                    - max(_LOG_ANOTHER + self._evidence((j,), "peg")[0], -50.0)
                    for j in range(i + 1, len(self._seen))
                )
                lost += float(lesser / kept * np.exp(min(gain, 50.0)))
        return ways, min(lost, 1.0)

    def _weighed(self, groups: tuple[Group, ...], nothing: Group) -> _Way:
        log = self._log_nothing(nothing)
        for group in groups:
            peg = self._evidence(group, "peg")[0]
            wall = self._evidence(group, "wall")[0] if len(group) > 1 else -np.inf
            log += float(_LOG_ANOTHER + np.logaddexp(peg, wall))
        return _Way(log, groups, nothing)

    def _evidence(self, group: Group, kind: str) -> tuple[float, Masses]:
        """Log evidence that these felt one obstacle of a kind, and the posteriors of the arcs."""
        if (group, kind) not in self._weighed_groups:
            if kind == "peg":
                log, mass = self._peg(group)
                self._weighed_groups[group, kind] = log, dict.fromkeys(group, mass)
            else:
                self._weighed_groups[group, kind] = self._wall(group)
        return self._weighed_groups[group, kind]

    def _peg(self, group: Group, within: NDArray[np.bool_] | None = None) -> tuple[float, Floats]:
        """Log evidence that these felt one peg, and the posterior of its arc."""
        lengths = np.array([self._seen[i].length_cm for i in group])
        there = self._arcs <= min(lengths.min() + _RADII_CM[-1], lengths.max())
        if within is not None:
            there &= within
        arc = self._alone if len(group) == 1 else self._shared
        log = np.sum([np.log(arc[i] + 1e-12) for i in group], axis=0)
        prior = there * self._expected(group)
        same = np.prod([self._touch[i] for i in group], axis=0)
        bends = np.full(len(self._arcs), same @ self._bend_prior)
        for n in np.flatnonzero(there & (self._arcs > lengths.min() + 1e-9)).tolist():
            each = [self._at_end[i].get(n, self._touch[i]) for i in group]
            bends[n] = np.prod(each, axis=0) @ self._bend_prior
        total = float((np.exp(log) * prior * bends).sum() / max(there.sum(), 1))
        # Sightings share errors of map and gains: on the place n of them count as the root of n.
        place = np.exp((log - log.max()) / np.sqrt(len(group)))
        # It stands anywhere in the plane, where the area at a distance grows with that.
        mass = place * prior * bends * self._arcs
        return float(np.log(total + 1e-300)), mass / max(float(mass.sum()), 1e-300)

    def _wall(self, group: Group) -> tuple[float, Masses]:
        """Log evidence that these felt one wall, and the posterior of each arc."""
        ways: list[tuple[float, Masses]] = []
        for slid in range(1, len(group) + 1):
            log, points = _LOG_WALL - np.log(len(group)), []
            masses: Masses = {}
            for i in group[:slid]:
                mass = self._alone[i] * self._tip[i]
                # Their errors are shared: so many sightings say as much as their root's number.
                log += np.log(mass.sum() + 1e-300) / np.sqrt(slid)
                masses[i] = mass / max(float(mass.sum()), 1e-300)
                points.append(self._point(i, self._seen[i].length_cm - self._radius_cm / 2))
            if rest := group[slid:]:
                beyond = self._arcs >= self._seen[group[slid - 1]].length_cm - self._radius_cm
                more, mass = self._peg(rest, beyond)
                log += more
                masses |= dict.fromkeys(rest, mass)
                points.append(self._point(rest[0], float(mass @ self._arcs)))
            if len(points) > 2:  # two points always lie on a line
                off = np.linalg.svd(points - np.mean(points, axis=0), compute_uv=False)[1]
                log -= 0.5 * (off / (_STRAIGHT * self._full_cm)) ** 2
                log += (len(points) - 2) * np.log(_OFF / (_STRAIGHT * np.sqrt(2 * np.pi)))
            ways.append((float(log), masses))
        top = max(log for log, _ in ways)
        weight = np.exp([log - top for log, _ in ways])
        mixed = {
            i: np.sum([w * m[i] for w, (_, m) in zip(weight, ways, strict=True)], axis=0)
            / weight.sum()
            for i in group
        }
        return top + float(np.log(weight.sum())), mixed

    def _near_tip(self, length_cm: float) -> Floats:
        """Prior of the arc at which a body feels a wall, (n,), of sum one."""
        behind = length_cm - self._arcs
        body = behind >= -1e-9
        at_tip = body & (behind <= self._radius_cm + 1e-9)
        farther = body * np.exp(-behind / (_BEHIND * self._full_cm))
        share = _AT_TIP * at_tip / at_tip.sum() + (1 - _AT_TIP) * farther / farther.sum()
        return np.asarray(share)

    def _point(self, i: int, arc_cm: float, bend: float | None = None) -> tuple[float, float]:
        sighting = self._seen[i]
        began = float(sighting.touch @ self._bends) if bend is None else bend
        return touch_point(arc_cm, began, sighting.side, self._radius_cm)

    def _same_bend(self, s: Sighting) -> Floats:
        """Likelihood of the bend at which another body touches the same place, (145,).

        Over that of any bend that a touch may begin at.
        """
        bends = self._bends
        sigma = np.hypot(BEND_SHARE * bends, BEND_LEAST)
        kernel = np.exp(-0.5 * ((bends[:, None] - bends) / sigma) ** 2)
        same = (kernel / kernel.sum(0)) @ s.touch
        return np.asarray(same / (same @ self._bend_prior))


def _or_another(s: Sighting, bend: Floats) -> Floats:
    """Likelihood of a bend, (145,), from that of a touch that was surely this contact's."""
    other = _OTHERS_TOUCH if s.alone else _OTHERS_OF_SEVERAL
    return np.asarray((1 - other) * bend + other)
