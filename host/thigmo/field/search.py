"""The search for what stands there: the most probable places of one peg, of two, and of a wall.

A contact slides as the body bends on, so a peg's radius and place trade off along a narrow ridge,
jagged where an end slips off. Starts lie under a large error of the mechanics, under which it is
smooth; then it is followed from radius to radius. Each everted length by itself says where the pegs
of a pair may be, and a second one is tried on a grid beside the likeliest single one; walls are
tried on a grid as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, product

import numpy as np

from thigmo.field.atlas import Atlas
from thigmo.field.fit import FieldFit, Mode
from thigmo.field.hypotheses import (
    AHEAD,
    AHEAD_MEAN,
    ARC,
    PEG,
    PEG_UNKNOWNS,
    PEGS,
    RADIUS,
    RADIUS_MEAN,
    RADIUS_STD,
    SHARED_UNKNOWNS,
    WALL,
    Hypothesis,
)
from thigmo.field.readings import Errors, Floats, Readings

# Friction, yield and base from which a fit starts: at none they have no derivative.
_LEAST = 0.05, 0.05, 0.01
# Logarithms of radii over the tube's at which the ridge has nodes.
RADII = RADIUS_MEAN + RADIUS_STD * np.linspace(-2.0, 2.0, 8)
_STARTS = RADIUS_MEAN + RADIUS_STD * np.array([-0.7, 0.6])
# Levels of the mechanics' relative error: a body of fabric is no ideal rod.
MODELS = 0.0, 0.05, 0.2
_ROUGH = 0.15  # under which starts are sought
_CHAINS = 2  # of the likeliest; the likeliest between any two ends is followed as well
_ARC_NEAR = 1 / 53  # of the longest body: two starts so near lead to one mode
_FAR = 60.0  # cost beyond which a mode is dropped, and
_FALLEN = 25.0  # one beyond which the ridge is not followed
_ROUGHLY_FAR = 300.0  # under the rough error: where no place explains the readings without it
# Of the search for pairs and walls: starts that are followed under the rough error, and then
# without it, if their touches lie so far apart (over the longest body): which of them is likeliest
# a rough error does not say.
_ROUGHLY, _FINELY, _APART = 5, 2, 0.06
# Of pairs: places of the plane taken from each length; radii beside the likeliest at which samples
# are proposed, as logarithms.
_PLACES, _ASIDE = 2, 0.6
_LEAST_PLACE = 3.0  # log likelihood that a length by itself gains by a place
# Touches of a second peg beside the likeliest one: arcs over the longest body, bends over the
# highest. Between two ends there may be none of them, so the middle is tried as well.
_SECOND_ARCS, _SECOND_BENDS = np.linspace(0.12, 1.05, 8), np.linspace(0.15, 0.95, 6)
# Of the search for a wall: bends over the highest, tilts (rad) and reaches; and ways over the
# longest body by which the likeliest one is tried to end short of the touch.
_WALLS = np.linspace(0.1, 0.9, 6), (0.25, 0.6, 0.95, 1.3), (np.log(0.4),)
_SHORT = -0.01, -0.04, -0.1


class Search:
    """Fits to a side's readings, and the modes of what they may have touched.

    Attributes:
        levels: the fit at each level of the mechanics' error.
        fit: that without one.
        places: the likeliest places of one peg.
        peaks: the bin of each stage at whose end the answer is told; -1: what stood there was gone.
    """

    def __init__(
        self,
        readings: Readings,
        errors: Errors,
        atlas: Atlas,
        meanwhile: Callable[[], None] | None = None,
    ) -> None:
        self.readings, self.errors, self._atlas = readings, errors, atlas
        self._meanwhile = meanwhile
        self._fit_with = partial(FieldFit, errors=errors, meanwhile=meanwhile)
        self.levels = [self._fit_with(readings, model=model) for model in MODELS]
        self.fit = self.levels[0]
        self._rough = self._fit_with(readings, model=_ROUGH, row=2.0)
        self.nothing = self.fit.nothing()
        self.pegs = atlas.pegs(self.fit, self.nothing)
        self.places = atlas.likeliest(self.pegs, readings)
        self.peaks = [self._peak(s) for s in range(len(readings.stages))]

    def with_standing(self, standing: Floats) -> Search:
        """The same for an obstacle that stood in a share (n,) of each bin."""
        readings = replace(self.readings, standing=standing)
        return Search(readings, self.errors, self._atlas, self._meanwhile)

    def _peak(self, stage: int) -> int:
        """The last bin of a stage; of what gave way, that of the highest bend while it stood."""
        bins = np.flatnonzero((self.fit.standing > 0.0) & (self.readings.stage == stage))
        if self.readings.standing is not None and bins.size:
            return int(bins[np.argmax(self.readings.bend[bins])])
        return int(bins.max(initial=-1))

    @property
    def gave_way_at(self) -> float | None:
        """Bend of the free body, 1/cm, from which on what stood there was gone; None: it stays."""
        standing = self.readings.standing
        if standing is None:
            return None
        whole = np.flatnonzero(standing == standing.max())
        return float(self.readings.bend[self.peaks[self.readings.stage[whole[-1]]]])

    def ridges(self) -> list[list[Mode]]:
        """Chains of modes along the ridges of the likeliest places."""
        fit, rough = self.fit, self._rough
        first = []
        for place in self.places:
            for log_radius in _STARTS:
                q = PEG.columns((place.arc, place.bend, log_radius), 0.0, *_LEAST)
                if PEG.possible(q, rough.body):
                    first.append(rough.solve(PEG, q, passes=6, held=(RADIUS, 3, 4, 5, 6)))
        first.sort(key=lambda mode: mode.cost)
        begins: list[Mode] = []
        for mode in first:
            if mode.cost > first[0].cost + _ROUGHLY_FAR:
                break
            if not any(self._near(mode, begin) for begin in begins):
                begins.append(mode)
        modes = [fit.solve(PEG, mode.q, passes=6, held=(RADIUS,)) for mode in begins]
        modes.sort(key=lambda mode: mode.cost)
        chains: list[list[Mode]] = []
        between = set()
        for mode in modes:
            if mode.cost > modes[0].cost + _FAR:
                break
            ends = self.readings.ends_before(mode.q[ARC])
            if any(self._on(chain, mode) for chain in chains):
                continue
            if len(chains) < _CHAINS or ends not in between:
                chains.append(self._followed(mode))
                between.add(ends)
        return chains

    def _near(self, first: Mode, second: Mode) -> bool:
        """Whether two modes lead to one."""
        arcs, radii = (abs(first.q[n] - second.q[n]) for n in (ARC, RADIUS))
        ends = {self.readings.ends_before(mode.q[ARC]) for mode in (first, second)}
        return arcs < _ARC_NEAR * self.fit.longest and radii < 1.0 and len(ends) == 1

    def _on(self, chain: Sequence[Mode], mode: Mode) -> bool:
        """Whether a mode lies on a ridge."""
        radii = [node.q[RADIUS] for node in chain]
        arc = np.interp(mode.q[RADIUS], radii, [node.q[ARC] for node in chain])
        return bool(abs(arc - mode.q[ARC]) < 0.5 * _ARC_NEAR * self.fit.longest)

    def _followed(self, begin: Mode) -> list[Mode]:
        """The ridge from a mode to both sides, node by node."""
        at = int(np.argmin(abs(RADII - begin.q[RADIUS])))
        q = begin.q.copy()
        q[RADIUS] = RADII[at]
        start = self.fit.solve(PEG, q, begin.xi, passes=2, held=(RADIUS,))
        nodes = {at: start}
        for way in (1, -1):
            n, slope = at, np.zeros(begin.q.size)
            while 0 <= n + way < RADII.size:
                if nodes[n].cost > min(m.cost for m in nodes.values()) + _FALLEN:
                    break
                ahead = nodes[n].q + slope
                ahead[RADIUS] = RADII[n + way]
                if not PEG.possible(ahead, self.fit.body):
                    ahead = nodes[n].q.copy()
                    ahead[RADIUS] = RADII[n + way]
                if not PEG.possible(ahead, self.fit.body):
                    break
                nodes[n + way] = self.fit.solve(PEG, ahead, nodes[n].xi, passes=3, held=(RADIUS,))
                slope = 0.7 * (nodes[n + way].q - nodes[n].q)
                n += way
        return [nodes[n] for n in sorted(nodes)]

    def pairs(self, peg: Floats | None = None, *, holds: bool = False) -> list[list[Mode]]:
        """Modes of two pegs, in one chain: the likeliest one with free radii, and some beside it.

        `peg`: (7,) likeliest unknowns of a single one, beside which a second one is sought all over
        the plane. Where that one `holds`, two are followed only if they are likelier than it under
        the rough error.
        """
        places = list(self.places)
        for length in sorted({stage.length for stage in self.readings.stages}):
            alone = self._fit_with(self.readings.at_length(length))
            nearest = self._atlas.likeliest(
                self._atlas.pegs(alone, alone.nothing()), alone.readings
            )[:_PLACES]
            places += [place for place in nearest if place.gain > _LEAST_PLACE]
        touches = sorted({(place.arc, place.bend) for place in places})
        groups = [
            [
                np.array([*first, RADIUS_MEAN, *second, RADIUS_MEAN, 0.0, *_LEAST])
                for first, second in combinations(touches, 2)
            ]
        ]
        if peg is not None:
            lengths = np.unique([stage.length for stage in self.readings.stages])
            between_ends = (lengths[1:] + lengths[:-1]) / 2
            arcs = [*(self.fit.longest * _SECOND_ARCS), *between_ends]
            known = peg[:PEG_UNKNOWNS]
            groups.append(
                [
                    np.array([*known, *second, RADIUS_MEAN, 0.0, *_LEAST])
                    for second in product(arcs, self.readings.bend.max() * _SECOND_BENDS)
                ]
            )
        radii = RADIUS, RADIUS + PEG_UNKNOWNS
        rough = [self._rough_modes(PEGS, starts, radii) for starts in groups]
        if peg is not None and holds:
            single = np.array([*peg[:PEG_UNKNOWNS], 0.0, *_LEAST])
            cost = self._rough.solve(PEG, single, passes=6, held=(RADIUS, *_shared(PEG))).cost
            if all(mode.cost > cost for modes in rough for mode in modes):
                return []
        fine = [mode for modes in rough for mode in self._fine_modes(modes)]
        shown = [mode for mode in fine if self._shows(mode)]
        if not shown:
            return []
        free = min(shown, key=lambda mode: mode.cost)
        modes = [free]
        for aside in product((-_ASIDE, _ASIDE), repeat=2):
            q = free.q.copy()
            q[list(radii)] += aside
            if PEGS.possible(q, self.fit.body):
                modes.append(self.fit.solve(PEGS, q, free.xi, passes=3, held=radii))
        shown = [mode for mode in modes if self._shows(mode)]
        return [shown] if shown else []

    def walls(self) -> list[list[Mode]]:
        """Modes of a wall: the likeliest that goes on ahead, and one that ends short of the touch.

        How far ahead it goes shows only once a body has slipped past its end, so nothing leads from
        a wall that goes on to one that ends.
        """
        bends, tilts, reaches = _WALLS
        highest = float(self.readings.bend.max())
        starts = [
            np.array([highest * bend, tilt, reach, AHEAD_MEAN, 0.0, *_LEAST])
            for bend, tilt, reach in product(bends, tilts, reaches)
        ]
        solved = self._fine_modes(self._rough_modes(WALL, starts, ()))
        if not solved:
            return []
        whole = min(solved, key=lambda mode: mode.cost)
        modes, short = [whole], []
        for ahead in _SHORT:
            q = whole.q.copy()
            q[AHEAD] = ahead
            if WALL.possible(q, self.fit.body):
                short.append(self.fit.solve(WALL, q, whole.xi))
        if short:
            modes.append(min(short, key=lambda mode: mode.cost))
        return [[mode] for mode in modes if self._shows(mode)]

    def _shows(self, mode: Mode) -> bool:
        """Whether the readings say of each obstacle where it is: more than that it is in reach."""
        unit, most = self.fit.longest, np.inf
        wide = mode.hypothesis.columns(
            (unit, 1 / unit, most), most, most, most, most, (1 / unit, 1.0, most, most)
        )
        known = np.isfinite(wide)
        scaled = mode.precision[np.ix_(known, known)] * np.outer(wide[known], wide[known])
        return bool(np.linalg.eigvalsh(scaled).min() > 1.0)

    def _rough_modes(
        self, hypothesis: Hypothesis, starts: Sequence[Floats], held: tuple[int, ...]
    ) -> list[Mode]:
        """Modes under the rough error near the likeliest starts, likeliest first, that lie apart.

        q[held] are as the starts have it. No fit crosses an end, so the best start between any two
        ends is followed first. A start of which an obstacle is never touched is one of fewer.
        """
        rough = self._rough
        tried = []
        for q in starts:
            if not hypothesis.possible(q, rough.body):
                continue
            tables = rough.tables(hypothesis, q)
            is_touched = np.isfinite(tables.contacts[..., 0]).any(axis=(0, 1))
            if is_touched.all():
                log, xi, _ = rough.evidence(tables, rough.free(), passes=1)
                tried.append((log + hypothesis.log_prior(q, rough.body), q, xi))
        tried.sort(key=lambda trial: -trial[0])
        best: dict[tuple[int, ...], int] = {}
        for n, (_, q, _) in enumerate(tried):
            arcs = [row[ARC] for row in hypothesis.rows(q)[: hypothesis.pegs]]
            best.setdefault(tuple(self.readings.ends_before(arc) for arc in arcs), n)
        others = [n for n in range(len(tried)) if n not in best.values()]
        followed = [
            rough.solve(hypothesis, q, xi, passes=6, held=held + _shared(hypothesis))
            for _, q, xi in (tried[n] for n in [*best.values(), *others][:_ROUGHLY])
        ]
        followed.sort(key=lambda mode: mode.cost)
        distinct: list[Mode] = []
        for mode in followed:
            if not any(self._touch_alike(mode, earlier) for earlier in distinct):
                distinct.append(mode)
        return distinct

    def _fine_modes(self, rough: Sequence[Mode]) -> list[Mode]:
        """Modes without the rough error near the likeliest of those under it."""
        return [self.fit.solve(mode.hypothesis, mode.q) for mode in rough[:_FINELY]]

    def _touch_alike(self, first: Mode, second: Mode) -> bool:
        """Whether the pegs of two modes are touched near the same arcs."""
        pegs = first.hypothesis.pegs
        arcs, others = (
            np.sort([row[ARC] for row in mode.hypothesis.rows(mode.q)[:pegs]])
            for mode in (first, second)
        )
        return pegs > 0 and bool(np.abs(arcs - others).max() < _APART * self.fit.longest)


def _shared(hypothesis: Hypothesis) -> tuple[int, ...]:
    """Where the unknowns stand that all obstacles of a side share."""
    return tuple(range(hypothesis.unknowns - SHARED_UNKNOWNS, hypothesis.unknowns))
