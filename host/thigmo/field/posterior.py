"""The posterior of what stands there: modes, then importance samples around them.

A contact slides as the body bends on, so a peg's radius and place trade off along a narrow ridge,
jagged where an end slips off. Starts lie under a large error of the mechanics, under which it is
smooth; then it is followed from radius to radius. Each everted length by itself says where the pegs
of a pair may be, and a second one is tried on a grid beside the likeliest single one; walls are
tried on a grid as well. Samples also carry what has no table of its own: how far gains and maps
have drifted, and the mechanics' relative error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln, logsumexp, softmax

from thigmo.field.atlas import Atlas
from thigmo.field.fit import MOST_EVIDENCE_PASSES, SPREAD_STD, FieldFit, Mode
from thigmo.field.hypotheses import (
    AHEAD,
    AHEAD_MEAN,
    ARC,
    BASE,
    FOLD,
    PEG,
    PEG_UNKNOWNS,
    PEGS,
    RADIUS,
    RADIUS_MEAN,
    RADIUS_STD,
    SHARED_UNKNOWNS,
    UNSIGNED,
    WALL,
    YIELD,
    Hypothesis,
)
from thigmo.field.readings import Errors, Floats, Readings

# Friction, yield and base from which a fit starts: at none they have no derivative.
_LEAST = 0.05, 0.05, 0.01
# Logarithms of radii over the tube's at which the ridge has nodes.
RADII = RADIUS_MEAN + RADIUS_STD * np.linspace(-2.0, 2.0, 8)
_STARTS = RADIUS_MEAN + RADIUS_STD * np.array([-0.7, 0.6])
# Levels of the mechanics' relative error, and their prior odds: a body of fabric is no ideal rod.
MODELS, MODEL_ODDS = (0.0, 0.05, 0.2), (0.6, 0.3, 0.1)
ROUGH = 0.15  # under which starts are sought
_CHAINS = 2  # of the likeliest; the likeliest between any two ends is followed as well
_ARC_NEAR = 1 / 53  # of the longest body: two starts so near lead to one mode
_FAR = 60.0  # cost beyond which a mode is dropped, and
_FALLEN = 25.0  # one beyond which the ridge is not followed
_PROPOSED = 14.0  # and beyond which a node proposes no samples
_DOF, _WIDER = 6, 1.3  # of the proposals
_WIDEST = 6.0  # standard deviations over which an unknown direction is proposed
_DRAWS, _LEAST_DRAWS = 8000, 60  # of a bell, for its part where nothing unsigned is negative
_TEMPER = 0.35  # exponent of the modes' weights among the proposals
_TEMPERED = 25.0  # effective samples from which later rounds learn
_LEAST_TEMPER = 1e-3  # power of the weights: some samples are impossible, whatever the power
_SPREAD = 1.15  # of their covariance
_LEARNT = 0.75  # share of a later round that lies as earlier samples are spread
_LEAST_SHARE = 0.02  # of a chain's weight, with less of which nothing is learnt of it
_NEGLIGIBLE = 1e-3  # share of a level of the mechanics' error that later rounds omit
ROUND, ROUNDS, _FEW_ROUNDS = 60, 16, 3
ENOUGH = 50.0  # effective samples
_KEPT = np.array([0, 1, 3, 4, 5, 6])  # unknowns other than the radius
_UNFOLDED = 0.25  # of the proposals, against those that hold to a mode's fold
_SIGNS = np.array(list(product((1.0, -1.0), repeat=len(UNSIGNED))))
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


@dataclass(frozen=True)
class Samples:
    """Weighted samples of what stands there."""

    hypothesis: Hypothesis
    q: Floats  # (n, unknowns)
    model: Floats  # (n, levels) posterior of the level of the mechanics' error
    # (n, stages, obstacles, 5) arc, x, y, force, normal at each stage's last peak; NaN: none
    touch: Floats
    weight: Floats  # (n,) of sum one
    compliance: Floats  # (n,) of the obstacles, cm^3
    misfit: float  # of the likeliest, over the number of readings
    log_evidence: float  # with the prior odds of the obstacles
    gave_way_at: float | None = None  # bend of the free body, 1/cm, from which on it was gone

    @property
    def effective(self) -> float:
        """Effective number of samples (Kish)."""
        return float(1 / np.sum(self.weight**2))

    @property
    def likeliest(self) -> Floats:
        """(unknowns,) of the sample with the greatest weight."""
        likeliest: Floats = self.q[int(np.argmax(self.weight))]
        return likeliest


class Search:
    """Fits to a side's readings, at each level of the mechanics' error."""

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
        self._levels = [self._fit_with(readings, model=model) for model in MODELS]
        self.fit = self._levels[0]
        self._rough = self._fit_with(readings, model=ROUGH, row=2.0)
        self.nothing = self.fit.nothing()
        self.pegs = atlas.pegs(self.fit, self.nothing)
        self.places = atlas.likeliest(self.pegs, readings)
        # The bin of each stage at whose end the answer is told; -1: what stood there was gone.
        self._peaks = [self._peak(s) for s in range(len(readings.stages))]

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

    def _gave_way_at(self) -> float | None:
        standing = self.readings.standing
        if standing is None:
            return None
        whole = np.flatnonzero(standing == standing.max())
        return float(self.readings.bend[self._peaks[self.readings.stage[whole[-1]]]])

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

    def pairs(self, peg: Floats | None = None) -> list[list[Mode]]:
        """Modes of two pegs, in one chain: the likeliest one with free radii, and some beside it.

        `peg`: (7,) likeliest unknowns of a single one, beside which a second one is sought all over
        the plane.
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
        solved = [mode for starts in groups for mode in self._likeliest(PEGS, starts, radii)]
        shown = [mode for mode in solved if self._shows(mode)]
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
        solved = self._likeliest(WALL, starts, ())
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

    def _likeliest(
        self, hypothesis: Hypothesis, starts: Sequence[Floats], held: tuple[int, ...]
    ) -> list[Mode]:
        """Modes near the likeliest starts; under the rough error q[held] are as these have it.

        No fit crosses an end, so the best start between any two ends is followed first. A start of
        which an obstacle is never touched is one of fewer.
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
        shared = tuple(range(hypothesis.unknowns - SHARED_UNKNOWNS, hypothesis.unknowns))
        followed = [
            rough.solve(hypothesis, q, xi, passes=6, held=held + shared)
            for _, q, xi in (tried[n] for n in [*best.values(), *others][:_ROUGHLY])
        ]
        followed.sort(key=lambda mode: mode.cost)
        distinct: list[Mode] = []
        for mode in followed:
            if not any(self._touch_alike(mode, kept) for kept in distinct):
                distinct.append(mode)
        return [self.fit.solve(hypothesis, mode.q) for mode in distinct[:_FINELY]]

    def _touch_alike(self, first: Mode, second: Mode) -> bool:
        """Whether the pegs of two modes are touched near the same arcs."""
        pegs = first.hypothesis.pegs
        arcs, others = (
            np.sort([row[ARC] for row in mode.hypothesis.rows(mode.q)[:pegs]])
            for mode in (first, second)
        )
        return pegs > 0 and bool(np.abs(arcs - others).max() < _APART * self.fit.longest)

    def laplace(self, mode: Mode) -> float:
        """Log evidence of a mode's hypothesis, were its posterior a bell."""
        log = self.fit.evidence(mode.tables, mode.xi)[0]
        prior = mode.hypothesis.log_prior(mode.q, self.fit.body)
        volume = float(np.linalg.slogdet(mode.precision / (2 * np.pi))[1])
        return log + prior - 0.5 * volume + float(np.log(_bounded(mode.q, mode.precision)[2]))

    def sample(
        self,
        chains: Sequence[Sequence[Mode]],
        *,
        seed: int = 0,
        expected: Callable[[Floats], Floats] | None = None,
        most_misfit: float = np.inf,
        least_log_evidence: float = -np.inf,
    ) -> Samples | None:
        """Importance samples, in rounds until enough of them count; None if no place is possible.

        The first round is drawn around the ridges, later ones mostly as the samples so far are
        spread; all are weighed by the mixture of all rounds. `expected`: density of a given map at
        points (n, 2) of the touched skin, over that of a new obstacle. Where the weightiest sample
        leaves more than `most_misfit`, or the evidence stays below `least_log_evidence`, a few
        rounds are drawn, for their evidence alone: samples that agree are hard to get there, and
        place nothing.
        """
        rng, fit, hypothesis = np.random.default_rng(seed), self.fit, chains[0][0].hypothesis
        ridges, modes, chain_of = _ridges(chains) if hypothesis == PEG else _around(chains)
        likeliest = min(modes, key=lambda mode: mode.cost)
        drifts, levels = self._drifts(likeliest), self._likely_levels(likeliest)
        proposals: list[_Proposal] = [ridges]
        counts = np.zeros(ROUNDS * len(chains) + 1)
        drawn: list[_Draw] = []
        weight, round_shares = np.zeros(0), [1.0]
        readings = float(np.sum(~fit.missing))
        for done in range(1, ROUNDS + 1):
            for n in rng.choice(len(round_shares), ROUND, p=round_shares):
                at = len(proposals) - len(round_shares) + n if n else 0
                counts[at] += 1
                q, drift = proposals[at].draw(rng), drifts.draw(rng)
                if hypothesis.possible(q, fit.body):
                    drawn.append(self._drawn(q, modes[ridges.nearest(q[None])[0]], levels, drift))
            if not drawn:
                continue
            q = np.array([d.q for d in drawn])
            density = np.logaddexp.reduce(
                [
                    np.log(count / counts.sum()) + proposal.log_density(q)
                    for count, proposal in zip(counts, proposals, strict=False)
                    if count
                ]
            )
            logs = np.array([d.log - drifts.log_ratio(d.drift) for d in drawn]) - density
            if expected is not None:
                skin = np.array([d.skin for d in drawn])
                density_given = expected(skin.reshape(-1, 2)).reshape(len(drawn), -1)
                logs += np.log(density_given).sum(axis=1)
            weight = softmax(logs)
            total = float(logsumexp(logs) - np.log(counts.sum()))
            best = drawn[int(np.argmax(weight))]
            hopeless = best.misfit > most_misfit * readings or total < least_log_evidence
            if ENOUGH * np.sum(weight**2) < 1 or (hopeless and done >= _FEW_ROUNDS):
                break
            shares = weight @ np.array([d.levels for d in drawn])
            levels = [n for n in levels if shares[n] > _NEGLIGIBLE]
            bells, bell_shares = _bells(q, logs, chain_of[ridges.nearest(q)])
            proposals += bells
            learnt = _LEARNT if bells else 0.0
            round_shares = [1 - learnt, *(learnt * bell_shares)]
        if not drawn:
            return None
        return Samples(
            hypothesis, q, np.array([d.levels for d in drawn]),
            np.array([d.touch for d in drawn]), weight,
            np.abs(q[:, YIELD]) * fit.body.yield_unit,
            best.misfit / readings, total, self._gave_way_at(),
        )  # fmt: skip

    def _likely_levels(self, mode: Mode) -> list[int]:
        """Levels of the mechanics' error that a mode leaves likely."""
        logs = np.log(MODEL_ODDS)
        for n, level in enumerate(self._levels):
            xi = level.free()
            xi[: mode.xi.size] = mode.xi
            logs[n] += level.evidence(mode.tables, xi)[0]
        likely: list[int] = np.flatnonzero(logs > logs.max() + np.log(_NEGLIGIBLE)).tolist()
        return likely

    def _drifts(self, mode: Mode) -> _Drifts:
        """How far gains and maps have drifted, as a mode has it."""
        z = np.linspace(-2.0, 2.0, 9)
        logs = np.array(
            [
                self.fit.evidence(mode.tables, mode.xi, spread=float(np.exp(SPREAD_STD * size)))[0]
                for size in z
            ]
        )
        logs -= 0.5 * z**2
        weight = softmax(logs)
        mean = float(weight @ z)
        std = float(np.sqrt(weight @ (z - mean) ** 2))
        return _Drifts(mean, _WIDER * max(std, 0.2))

    def _drawn(self, q: Floats, mode: Mode, levels: Sequence[int], drift: float) -> _Draw:
        fit, spread = self.fit, float(np.exp(SPREAD_STD * drift))
        hypothesis = mode.hypothesis
        tables = fit.tables(hypothesis, q)
        logs = np.full(len(MODELS), -np.inf)
        for n in levels:
            level = self._levels[n]
            xi = level.free()
            xi[: mode.xi.size] = mode.xi + mode.follow @ (q - mode.q)
            xi[level.drifting] /= spread  # what they add stays
            log, fitted, misfit = level.evidence(
                tables, xi, spread=spread, passes=MOST_EVIDENCE_PASSES
            )
            logs[n] = log + np.log(MODEL_ODDS[n])
            if logs[n] == logs.max():
                best, least = fitted, misfit
        touch = np.full((len(self.readings.stages), hypothesis.obstacles, 5), np.nan)
        k, u = np.divmod(fit.bend(best, spread)[self._peaks] / fit.step, 1)
        for s, peak in enumerate(self._peaks):
            if peak >= 0:
                touch[s] = tables.touch(s, int(k[s]), u[s])
        total = float(np.logaddexp.reduce(logs))
        prior = hypothesis.log_prior(q, fit.body)
        skin = hypothesis.skin(q, fit.body)
        return _Draw(q, drift, total + prior, np.exp(logs - total), touch, skin, least)


class _Drifts(NamedTuple):
    """Proposal of the logarithm of how far gains and maps have drifted, over its prior sigma."""

    mean: float
    std: float

    def draw(self, rng: np.random.Generator) -> float:
        """One logarithm."""
        return self.mean + self.std * float(rng.standard_normal())

    def log_ratio(self, drift: float) -> float:
        """Logarithm of the proposal's density over the prior's."""
        z = (drift - self.mean) / self.std
        return 0.5 * (drift**2 - z**2) - float(np.log(self.std))


class _Draw(NamedTuple):
    q: Floats
    drift: float  # logarithm of the factor by which gains and maps drifted, over its prior sigma
    log: float  # posterior density
    levels: Floats  # (levels,) posterior of the mechanics' error
    touch: Floats
    skin: Floats  # (obstacles, 2) first touched points
    misfit: float


class _Mixture:
    """t-distributions around points, each lying along a ridge: unknowns move with the radius."""

    def __init__(
        self, centers: Floats, slopes: Floats, factors: Floats, share: Floats, step: float
    ) -> None:
        """Of n points: `slopes` (n, 6) of the other unknowns over the radius's logarithm, of which
        one sigma is `step`; `factors` (n, 6, 6) of their covariance; `share` (n,) of sum one.
        """
        self._centers, self._slopes, self._factors = centers, slopes, factors
        self._share, self._step = share, step
        self._inverses = np.linalg.inv(factors)
        self._volumes = np.linalg.slogdet(factors)[1]
        d = _KEPT.size
        self._norm = float(
            gammaln((_DOF + d) / 2) - gammaln(_DOF / 2) - 0.5 * d * np.log(_DOF * np.pi)
            - np.log(step * np.sqrt(2 * np.pi))
        )  # fmt: skip

    def draw(self, rng: np.random.Generator) -> Floats:
        """Unknowns."""
        n = int(rng.choice(self._share.size, p=self._share))
        off = self._step * rng.standard_normal()
        wide = np.sqrt(_DOF / rng.chisquare(_DOF))
        q = self._centers[n].copy()
        q[RADIUS] += off
        q[_KEPT] += self._slopes[n] * off
        q[_KEPT] += wide * self._factors[n] @ rng.standard_normal(_KEPT.size)
        q[list(UNSIGNED)] = np.abs(q[list(UNSIGNED)])
        drawn: Floats = q
        return drawn

    def nearest(self, q: Floats) -> npt.NDArray[np.intp]:
        """(k,) the points around which unknowns (k, 7) most probably lie."""
        nearest: npt.NDArray[np.intp] = np.argmax(self._logs(q), axis=1)
        return nearest

    def log_density(self, q: Floats) -> Floats:
        """(k,) logarithm of the density at unknowns (k, 7), mirrored ones included."""
        mirrored = [self._logs(q * sign) for sign in _mirrors(q.shape[1])]
        density: Floats = np.logaddexp.reduce(np.concatenate(mirrored, axis=1), axis=1)
        return density + self._norm

    def _logs(self, q: Floats) -> Floats:
        off = q[:, None, RADIUS] - self._centers[:, RADIUS]
        away = q[:, None, _KEPT] - self._centers[:, _KEPT] - self._slopes * off[..., None]
        z = np.einsum("nij,qnj->qni", self._inverses, away)
        bells = -0.5 * (_DOF + _KEPT.size) * np.log1p(np.sum(z**2, axis=-1) / _DOF)
        share = np.log(np.maximum(self._share, 1e-300))
        logs: Floats = share + bells - self._volumes - 0.5 * (off / self._step) ** 2
        return logs


class _Bell:
    """A t-distribution of unknowns."""

    def __init__(self, center: Floats, covariance: Floats) -> None:
        self._center = center
        self._factor = np.linalg.cholesky(covariance)
        d = center.size
        self._norm = float(
            gammaln((_DOF + d) / 2) - gammaln(_DOF / 2) - 0.5 * d * np.log(_DOF * np.pi)
            - np.log(np.diag(self._factor)).sum()
        )  # fmt: skip

    def draw(self, rng: np.random.Generator) -> Floats:
        """Unknowns."""
        wide = np.sqrt(_DOF / rng.chisquare(_DOF))
        q: Floats = self._center + wide * self._factor @ rng.standard_normal(self._center.size)
        q[list(UNSIGNED)] = np.abs(q[list(UNSIGNED)])
        return q

    def log_density(self, q: Floats) -> Floats:
        """(k,) logarithm of the density at unknowns (k, d), mirrored ones included."""
        logs = []
        for sign in _mirrors(q.shape[1]):
            z = np.linalg.solve(self._factor, (q * sign - self._center).T)
            logs.append(-0.5 * (_DOF + len(z)) * np.log1p(np.sum(z**2, axis=0) / _DOF))
        density: Floats = np.logaddexp.reduce(logs, axis=0) + self._norm
        return density


class _Bells:
    """Bells around modes."""

    def __init__(self, bells: list[_Bell], share: Floats) -> None:
        self._bells, self._share = bells, share

    def draw(self, rng: np.random.Generator) -> Floats:
        """Unknowns."""
        return self._bells[int(rng.choice(self._share.size, p=self._share))].draw(rng)

    def nearest(self, q: Floats) -> npt.NDArray[np.intp]:
        """(k,) the bells in which unknowns (k, d) most probably lie."""
        nearest: npt.NDArray[np.intp] = np.argmax(self._logs(q), axis=0)
        return nearest

    def log_density(self, q: Floats) -> Floats:
        """(k,) logarithm of the density at unknowns (k, d), mirrored ones included."""
        density: Floats = np.logaddexp.reduce(self._logs(q), axis=0)
        return density

    def _logs(self, q: Floats) -> Floats:
        logs = [bell.log_density(q) for bell in self._bells]
        return np.array(logs) + np.log(self._share)[:, None]


_Proposal = _Mixture | _Bells | _Bell


def _mirrors(unknowns: int) -> Floats:
    """(8, unknowns) signs under which samples mean the same."""
    mirrors = np.ones((len(_SIGNS), unknowns))
    mirrors[:, list(UNSIGNED)] = _SIGNS
    return mirrors


def _bells(q: Floats, logs: Floats, chain: npt.NDArray[np.intp]) -> tuple[list[_Bell], Floats]:
    """What samples of each chain are spread as, and the chains' shares of the weight.

    `logs`: (k,) logarithms of the samples' weights.
    """
    # Tempered until enough samples share the weight to give a covariance. A weight may be below
    # what a number can hold, so its logarithm is tempered.
    temper, weight = 1.0, softmax(logs)
    while temper > _LEAST_TEMPER and _TEMPERED * np.sum(weight**2) > 1:
        temper *= 0.8
        weight = softmax(temper * logs)
    bells, shares = [], []
    for number in np.unique(chain):
        on = (chain == number) & (weight > 0.0)
        share = weight[on].sum()
        part = weight[on] / share if share else weight[on]
        if share < _LEAST_SHARE or np.sum(part**2) > 1 / q.shape[1]:
            continue
        center = part @ q[on]
        off = q[on] - center
        covariance = _SPREAD * (part[:, None] * off).T @ off
        bells.append(_Bell(center, covariance + 1e-9 * np.diag(np.diag(covariance))))
        shares.append(share)
    return bells, np.array(shares) / max(sum(shares), 1e-300)


def _bounded(center: Floats, precision: Floats) -> tuple[Floats, Floats, float]:
    """Mean, covariance and share of that part of a bell where nothing unsigned is negative.

    Along an even direction the bell is `_WIDEST` wide. Base, yield and friction explain much the
    same, so a bell that reaches far below 0 in one and above in another has a small such part.
    """
    d = center.size
    w, v = np.linalg.eigh(precision)
    wide = v * np.minimum(1 / np.sqrt(np.maximum(w, 1e-9)), _WIDEST)
    draws = center + np.random.default_rng(d).standard_normal((_DRAWS, d)) @ wide.T
    inside = draws[(draws[:, list(UNSIGNED)] >= 0.0).all(axis=1)]
    share = len(inside) / _DRAWS
    if len(inside) < _LEAST_DRAWS:
        inside = draws
        inside[:, list(UNSIGNED)] = np.abs(inside[:, list(UNSIGNED)])
    covariance: Floats = np.cov(inside, rowvar=False)
    return inside.mean(axis=0), covariance, max(share, 1 / _DRAWS)


def _unfolded(mode: Mode) -> Floats:
    """A mode's precision as if readings said nothing of the fold's moment and the base.

    A base that folds under a moment as stated may also turn before it folds under a higher one,
    where the readings have no such curvature as at the mode.
    """
    precision = mode.precision.copy()
    for n in (mode.q.size + FOLD, mode.q.size + BASE):
        precision[n] = precision[:, n] = 0.0
        precision[n, n] = mode.prior_precision[n]
    return precision


def _around(
    chains: Sequence[Sequence[Mode]],
) -> tuple[_Bells, list[Mode], npt.NDArray[np.intp]]:
    """Proposals around modes, the modes, and the numbers of their chains."""
    numbered = [(n, mode) for n, chain in enumerate(chains) for mode in chain]
    best = min(mode.cost for _, mode in numbered)
    numbered = [(n, mode) for n, mode in numbered if mode.cost < best + _PROPOSED]
    near = [mode for _, mode in numbered]
    share = np.exp([-_TEMPER * (mode.cost - best) for mode in near])
    bells = []
    for mode in near:
        center, covariance, _ = _bounded(mode.q, mode.precision)
        bells.append(_Bell(center, _WIDER**2 * covariance))
    numbers = np.array([n for n, _ in numbered], dtype=np.intp)
    return _Bells(bells, share / share.sum()), near, numbers


def _ridges(
    chains: Sequence[Sequence[Mode]],
) -> tuple[_Mixture, list[Mode], npt.NDArray[np.intp]]:
    """Proposals around the nodes of ridges, the nodes, and the numbers of their chains."""
    best = min(mode.cost for chain in chains for mode in chain)
    modes: list[Mode] = []
    centers, slopes, factors = [], [], []
    numbers = []
    for number, chain in enumerate(chains):
        q = np.array([mode.q for mode in chain])
        many = len(chain) > 1
        slope = np.gradient(q[:, _KEPT], q[:, RADIUS], axis=0) if many else [np.zeros(_KEPT.size)]
        for mode, along in zip(chain, slope, strict=True):
            if mode.cost < best + _PROPOSED:
                for precision in (mode.precision, _unfolded(mode)):
                    kept = precision[np.ix_(_KEPT, _KEPT)]
                    center = mode.q.copy()
                    center[_KEPT], covariance, _ = _bounded(mode.q[_KEPT], kept)
                    modes.append(mode)
                    numbers.append(number)
                    centers.append(center)
                    slopes.append(along)
                    factors.append(_WIDER * np.linalg.cholesky(covariance))
    share = np.exp([-_TEMPER * (mode.cost - best) for mode in modes])
    share[1::2] *= _UNFOLDED
    step = 0.75 * (RADII[1] - RADII[0])
    mixture = _Mixture(
        np.array(centers), np.array(slopes), np.array(factors), share / share.sum(), step
    )
    return mixture, modes, np.array(numbers, dtype=np.intp)
