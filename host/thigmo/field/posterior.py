"""The posterior of what stands there: importance samples around the modes of a search.

Samples also carry what has no table of its own: how far gains and maps have drifted, and the
mechanics' relative error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp, softmax

from thigmo.field.fit import MOST_EVIDENCE_PASSES, SPREAD_STD, Mode
from thigmo.field.hypotheses import PEG, Hypothesis
from thigmo.field.proposals import (
    SETTLED_SPREAD,
    SPREAD,
    WIDER,
    Proposal,
    along_ridges,
    around,
    bounded,
    learnt_bells,
)
from thigmo.field.readings import Floats
from thigmo.field.search import MODELS, Search

_MODEL_ODDS = 0.6, 0.3, 0.1  # prior ones of each level of the mechanics' error
_LEARNT = 0.75  # share of a later round that lies as earlier samples are spread
_NEGLIGIBLE = 1e-3  # share of a level of the mechanics' error that later rounds omit
ROUND, _FEW_ROUNDS = 60, 3
ENOUGH = 50.0  # effective samples


class _Rounds(NamedTuple):
    wide: int  # that draw wider than the samples so far, to find what these lack
    most: int


# Where samples of two pegs or a wall do not agree, the search may have missed a place: to draw on
# until they do would localize another.
_ROUNDS_OF_A_PEG, _ROUNDS_OF_OTHERS = _Rounds(wide=8, most=24), _Rounds(wide=16, most=16)


@dataclass(frozen=True)
class Samples:
    """Weighted samples of what stands there."""

    hypothesis: Hypothesis
    q: Floats  # (n, unknowns)
    model: Floats  # (n, levels) posterior of the level of the mechanics' error
    # (n, stages, obstacles, 5) arc, x, y, force, normal at each stage's last peak; NaN: none
    touch: Floats
    weight: Floats  # (n,) of sum one
    compliance: Floats  # (n, obstacles) cm^3
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


def laplace(search: Search, mode: Mode) -> float:
    """Log evidence of a mode's hypothesis, were its posterior a bell."""
    log = search.fit.evidence(mode.tables, mode.xi)[0]
    prior = mode.hypothesis.log_prior(mode.q, search.fit.body)
    volume = float(np.linalg.slogdet(mode.precision / (2 * np.pi))[1])
    return log + prior - 0.5 * volume + float(np.log(bounded(mode.q, mode.precision)[2]))


def sample(
    search: Search,
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
    rng, fit, hypothesis = np.random.default_rng(seed), search.fit, chains[0][0].hypothesis
    ridges, modes, chain_of = along_ridges(chains) if hypothesis == PEG else around(chains)
    likeliest = min(modes, key=lambda mode: mode.cost)
    drifts, levels = _drifts(search, likeliest), _likely_levels(search, likeliest)
    proposals: list[Proposal] = [ridges]
    rounds = _ROUNDS_OF_A_PEG if hypothesis == PEG else _ROUNDS_OF_OTHERS
    counts = np.zeros(rounds.most * len(chains) + 1)
    drawn: list[_Draw] = []
    weight, round_shares = np.zeros(0), [1.0]
    readings = float(np.sum(~fit.missing))
    for done in range(1, rounds.most + 1):
        possible: list[tuple[Floats, float]] = []
        for n in rng.choice(len(round_shares), ROUND, p=round_shares):
            at = len(proposals) - len(round_shares) + n if n else 0
            counts[at] += 1
            q, drift = proposals[at].draw(rng), drifts.draw(rng)
            if hypothesis.possible(q, fit.body):
                possible.append((q, drift))
        if possible:
            nearest = ridges.nearest(np.array([q for q, _ in possible]))
            drawn += [
                _drawn(search, q, modes[near], levels, drift)
                for (q, drift), near in zip(possible, nearest, strict=True)
            ]
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
        spread = SPREAD if done <= rounds.wide else SETTLED_SPREAD
        bells, bell_shares = learnt_bells(q, logs, chain_of[ridges.nearest(q)], spread)
        proposals += bells
        learnt = _LEARNT if bells else 0.0
        round_shares = [1 - learnt, *(learnt * bell_shares)]
    if not drawn:
        return None
    return Samples(
        hypothesis, q, np.array([d.levels for d in drawn]),
        np.array([d.touch for d in drawn]), weight,
        np.array([hypothesis.compliances(d.q, fit.body) for d in drawn]),
        best.misfit / readings, total, search.gave_way_at,
    )  # fmt: skip


def _likely_levels(search: Search, mode: Mode) -> list[int]:
    """Levels of the mechanics' error that a mode leaves likely."""
    logs = np.log(_MODEL_ODDS)
    for n, level in enumerate(search.levels):
        xi = level.free()
        xi[: mode.xi.size] = mode.xi
        logs[n] += level.evidence(mode.tables, xi)[0]
    likely: list[int] = np.flatnonzero(logs > logs.max() + np.log(_NEGLIGIBLE)).tolist()
    return likely


def _drifts(search: Search, mode: Mode) -> _Drifts:
    """How far gains and maps have drifted, as a mode has it."""
    z = np.linspace(-2.0, 2.0, 9)
    logs = np.array(
        [
            search.fit.evidence(mode.tables, mode.xi, spread=float(np.exp(SPREAD_STD * size)))[0]
            for size in z
        ]
    )
    logs -= 0.5 * z**2
    weight = softmax(logs)
    mean = float(weight @ z)
    std = float(np.sqrt(weight @ (z - mean) ** 2))
    return _Drifts(mean, WIDER * max(std, 0.2))


def _drawn(search: Search, q: Floats, mode: Mode, levels: Sequence[int], drift: float) -> _Draw:
    fit, spread = search.fit, float(np.exp(SPREAD_STD * drift))
    hypothesis = mode.hypothesis
    tables = fit.tables(hypothesis, q)
    logs = np.full(len(MODELS), -np.inf)
    for n in levels:
        level = search.levels[n]
        xi = level.free()
        xi[: mode.xi.size] = mode.xi + mode.follow @ (q - mode.q)
        xi[level.drifting] /= spread  # what they add stays
        log, fitted, misfit = level.evidence(tables, xi, spread=spread, passes=MOST_EVIDENCE_PASSES)
        logs[n] = log + np.log(_MODEL_ODDS[n])
        if logs[n] == logs.max():
            bend, least = level.bend(fitted, spread), misfit
    touch = np.full((len(search.readings.stages), hypothesis.obstacles, 5), np.nan)
    k, u = np.divmod(bend[search.peaks] / fit.step, 1)
    for s, peak in enumerate(search.peaks):
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
