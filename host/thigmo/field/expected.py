"""How well planned sweeps would feel and place a peg: for plans of where to sweep.

At each place of a grid over what a side reaches, the mechanics give the readings beside a peg of
average size, and their derivatives by the peg and by calibration's errors. Sweeps add up their
Fisher information; its inverse is the covariance of the peg's place (Cramer-Rao bound), and
Laplace's evidence says whether the peg would be felt at all. Lengths in cm, bends in 1/cm.
"""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from thigmo.config import Side
from thigmo.field.fit import FieldFit
from thigmo.field.hypotheses import ARC, BEND, PEG, RADIUS_MEAN
from thigmo.field.readings import Errors, Floats, Readings, Stage
from thigmo.field.sweeps import fold_moments, stated
from thigmo.robot import FRAME_SPACING_S, SensorTable, rising_period_s
from thigmo.wiring import Wiring

_ARCS, _TURNS = 9, 6  # places along the body, and bends of each
_LEAST_ARC = 0.1  # lengths
_LEAST_TURN, _MOST_TURN = 0.1, 1.9  # rad at the touch: as the search of the plane
_BINS = 10  # of a sweep
# Friction and yield (in its unit) beside which derivatives are taken: by their signs they are none.
_FAINT = 0.1, 0.1
_FELT = float(np.log(19.0))  # log odds of 95 %
_WIDTH = 2 * 1.96  # standard deviations in a 95 % interval


class ExpectedSweeps:
    """Information of one sweep at each of several everted lengths, at places of one side."""

    def __init__(
        self, share: Floats, precision: Floats, log_prior: Floats, before: Floats, length_cm: float
    ) -> None:
        """Of n places:

        share: (n,) of the area that each stands for.
        precision: (n, lengths, k + 1, k + 1) of a peg's unknowns, of the errors that sweeps share,
            and of the departure from nothing.
        log_prior: (n,) density of a peg's unknowns.
        before: (k,) precision before the first sweep.
        """
        self._share, self._precision, self._log_prior = share, precision, log_prior
        self._before, self._length_cm = before, length_cm

    def felt_and_placed(self, sweeps: Sequence[int], narrow: float) -> tuple[float, float]:
        """Shares of pegs within the side's reach that are felt, and that are placed as well.

        `sweeps`: their number at each of the lengths. Placed is a peg whose 95 % interval along the
        body is at most `narrow` of the body's length.
        """
        q = PEG.unknowns
        total = np.einsum("s,nsij->nij", np.asarray(sweeps, dtype=np.float64), self._precision)
        known, departure = total[:, :-1, :-1], total[:, :-1, -1]
        errors = known[:, q:, q:] + np.diag(self._before[q:])
        absorbed = np.linalg.solve(errors, departure[:, q:, None])[..., 0]
        left = total[:, -1, -1] - np.einsum("ni,ni->n", departure[:, q:], absorbed)
        covariance = np.linalg.inv(known + np.diag(self._before))[:, :q, :q]
        volume = 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
        is_felt = 0.5 * left + self._log_prior + volume > _FELT
        width = _WIDTH * np.sqrt(covariance[:, ARC, ARC])
        placed = is_felt & (width <= narrow * self._length_cm)
        return float(self._share[is_felt].sum()), float(self._share[placed].sum())


def expected_sweeps(wiring: Wiring, side: Side, lengths: Sequence[float]) -> ExpectedSweeps:
    """Expected information of sweeps of one side at everted lengths (cm)."""
    config, table = wiring.config, SensorTable.laid_out(wiring)
    muscle = config.muscle(side)
    use = table.usable(side, ~0)
    stages, bends, rates, frames = [], [], [], []
    for length in lengths:
        body_pressure = config.body.pressure_number(length)
        rise_s = rising_period_s(config, body_pressure) / 4
        top = muscle.maps[body_pressure].inflate.curvature(muscle.max_pressure_psi)
        stages.append(Stage(length, body_pressure))
        bends.append(abs(top) * np.arange(1, _BINS + 1) / _BINS)
        rates.append(abs(top) / rise_s)
        frames.append(rise_s / FRAME_SPACING_S / _BINS)
    stage = np.repeat(np.arange(len(stages)), _BINS)
    centers, spans = table.center_cm[use], table.span_cm[use]
    beyond = (centers + spans / 2)[None] > np.asarray(lengths)[stage, None]
    white = table.white[use] / np.sqrt(np.asarray(frames))[stage, None]
    readings = Readings(
        curvature=np.where(beyond, np.nan, 0.0),
        noise=white,
        bend=np.concatenate(bends),
        rate=np.asarray(rates)[stage],
        stage=stage,
        sweep=stage,
        zeroing=stage,
        stages=tuple(stages),
        centers=centers,
        spans=spans,
        fold_moment=fold_moments(config),
        radius=config.body.radius_cm,
    )
    errors = stated(wiring, side, use)
    return _expected(_Question(pickle.dumps((readings, errors)), readings, errors))


@dataclass(frozen=True)
class _Question:
    """Readings and errors, compared by their bytes."""

    key: bytes
    readings: Readings = field(compare=False)
    errors: Errors = field(compare=False)


@lru_cache(maxsize=8)  # sides are often alike, and runs have the robot of the run before
def _expected(question: _Question) -> ExpectedSweeps:
    """The information of each stage's sweep at places that the area weighs."""
    fit = FieldFit(question.readings, question.errors)
    arcs = np.linspace(_LEAST_ARC, 1.0, _ARCS) * fit.longest
    most = min(float(fit.readings.bend.max()) * fit.longest, _MOST_TURN)
    turns = np.linspace(_LEAST_TURN, most, _TURNS)
    touches = [(arc, turn / fit.longest) for arc in arcs for turn in turns]
    unknowns = [PEG.columns((arc, bend, RADIUS_MEAN), 0.0, *_FAINT, 0.0) for arc, bend in touches]
    unknowns = [q for q in unknowns if PEG.possible(q, fit.body)]
    log_prior = np.array([PEG.log_prior(q, fit.body) for q in unknowns])
    nothing = fit.departures(fit.nothing().tables, fit.free())
    without = nothing.noise.whitened(nothing.left)
    precision = np.array([_information(fit, q, without) for q in unknowns])
    share = np.exp(log_prior - log_prior.max())
    _, spread = PEG.bells(fit.body)
    spread[ARC], spread[BEND] = fit.longest, fit.body.most_bend  # somewhere within reach
    before = np.concatenate([1 / spread**2, np.ones(precision.shape[-1] - 1 - spread.size)])
    return ExpectedSweeps(share / share.sum(), precision, log_prior, before, fit.longest)


def _information(fit: FieldFit, q: Floats, without: Floats) -> Floats:
    """(stages, k + 1, k + 1) of one peg: see `ExpectedSweeps`; a sweep's own errors integrated out.

    `without`: departures from the readings beside nothing.
    """
    tables = fit.tables(PEG, q)
    departures = fit.departures(tables, fit.free())
    noise = departures.noise
    by_q = noise.whitened(fit.by_q(tables, departures))
    effect = noise.whitened(departures.effect.dense())
    moved = noise.whitened(departures.left) - without
    shared = np.column_stack([by_q, effect[:, ~fit.of_sweeps], moved])
    sweeps = effect[:, fit.of_sweeps]
    stage = np.repeat(fit.readings.stage, fit.readings.centers.size)
    parts = []
    for s in range(len(fit.readings.stages)):
        rows = stage == s
        of_sweep = sweeps[rows][:, np.any(sweeps[rows], axis=0)]
        cross = of_sweep.T @ shared[rows]
        taken = np.linalg.solve(of_sweep.T @ of_sweep + np.eye(of_sweep.shape[1]), cross)
        parts.append(shared[rows].T @ shared[rows] - cross.T @ taken)
    return np.array(parts)
