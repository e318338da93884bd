"""One side's readings as a function of what stands in the plane, with calibration's errors.

  a frame's readings = mechanics(what stands in the plane, bend of the free body) + errors

Obstacles stand still, so the same few numbers explain all sweeps at all everted lengths, those that
felt nothing included. Calibration's errors are Gaussian and small: they are integrated out around
their best fit (Laplace). An unknown relative error of the mechanics has a few levels, which the
posterior weighs: where a body is not the model's, answers widen. docs/methods.md derives it.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dposv
from threadpoolctl import ThreadpoolController

from thigmo.field._departures import Bins, normal_equations
from thigmo.field.hypotheses import (
    BASE,
    FOLD,
    FRICTION,
    NOTHING,
    UNSIGNED,
    YIELD,
    Body,
    Hypothesis,
    way_into,
)
from thigmo.field.readings import Errors, Floats, Readings
from thigmo.mechanics import Obstacle, Rod, Tube

# Rows of a table of the mechanics: turns (rad) of the whole body between them, and the share of a
# sweep's highest bend up to which errors of the map may take it.
ROW_TURN, BEYOND = 0.037, 1.15
MOST_CELL_CM = 10.0  # that the mechanics allow
CELL = 3.0 / 53  # of the length, of the elastica's mesh: an error below 1e-4 1/cm
# Bins that count as one reading: swings and loops of hysteresis outlast a bin.
ALIKE = 2.0
# Standard deviation of the logarithm by which gains and maps have drifted more than stated.
SPREAD_STD = 0.4
MOST_PASSES, MOST_EVIDENCE_PASSES = 12, 6
_MET = 0.3  # log likelihood that the last pass for the errors may gain
_DAMPING, _LEAST_DAMPING, _RAISED = 1e-2, 1e-4, 6.0
_TRIES = 5  # of a step, each with more damping
_GAIN = 0.02  # log likelihood below which a pass ends the fit
_LARGEST_TURN = 0.13  # rad at the end of the body, of one step of the touch's bend
# From pressure to bend, a muscle and a body that swings respond as something between a first-order
# lag and a pure delay of the same time: evenly anywhere between. What chains of 2 to 8 lags, or a
# lag and a swing, leave of a ramp's start after the best mixture is a tenth of their difference.
_RESPONSE_STD, _RESPONSE_LEFT = 3**-0.5, 0.2  # of half that difference
# Bends, over half of a bin's range, at which its reading is predicted: middles of four equal parts.
_IN_BIN = np.array([-0.75, -0.25, 0.25, 0.75])


class Tables(NamedTuple):
    """The mechanics of what stands there, by stage (s), bend (k) and sensor (m)."""

    obstacles: list[Obstacle]
    mean: Floats  # (s, k, m) what sensors read, 1/cm
    shift: Floats  # (s, k, m) by how much that grows for each cm farther out
    by_q: Floats  # (s, k, m, unknowns) by how much for each unknown
    # (s, k, obstacles, 4) arc, x, y of the touched skin, cm, and force over EI; NaN: no contact
    contacts: Floats

    def touch(self, stage: int, row: int, part: float) -> Floats:
        """(obstacles, 5) contacts at a bend between two rows, and the way into the obstacle (rad).

        Arc, x, y, force, and the direction from the skin to what it touches; NaN: none.
        """
        low, high = self.contacts[stage, row : row + 2]
        contact = np.where(np.isfinite(low), low + part * (high - low), high)
        normal = np.full((len(self.obstacles), 1), np.nan)
        for p, obstacle in enumerate(self.obstacles):
            _, x, y, _ = contact[p]
            normal[p] = way_into(obstacle, x, y)
        return np.hstack([contact, normal])


class Effect(NamedTuple):
    """Derivatives of n bins of m sensors: by c unknowns of all sensors, then by k of each sensor.

    Unknowns are numbered so: c, then the first of each sensor, the second of each, and so on.
    """

    common: Floats  # (n, m, c)
    separate: Floats  # (n, m, k)

    def dense(self) -> Floats:
        """(n, m, c + k m)"""
        n, m, k = self.separate.shape
        whole = np.zeros((n, m, k, m))
        sensors = np.arange(m)
        whole[:, sensors, :, sensors] = np.moveaxis(self.separate, 1, 0)
        dense: Floats = np.concatenate([self.common, whole.reshape(n, m, k * m)], axis=2)
        return dense


class Noise(NamedTuple):
    """White noise of each reading, and the error of a bin's bend, which its sensors share."""

    weight: Floats  # (n, m) one over the white noise, 1/cm; 0 where there is no reading
    along: Floats  # (n, m) bin's error of the bend over the white noise

    def whitened(self, x: Floats) -> Floats:
        """x (n, m, ...) made white; (n m, ...)."""
        squared = np.sum(self.along**2, axis=1)
        share = (1 - 1 / np.sqrt(1 + squared)) / np.maximum(squared, 1e-30)
        z = x * self.weight.reshape(*self.weight.shape, *[1] * (x.ndim - 2))
        common = np.einsum("n,nm,nm...->n...", share, self.along, z)
        z = z - np.einsum("nm,n...->nm...", self.along, common)
        white: Floats = z.reshape(x.shape[0] * x.shape[1], *x.shape[2:])
        return white


class Departures(NamedTuple):
    """A prediction of n bins by m sensors, and the departures of the readings from it."""

    value: Floats  # (n, m) predicted, 1/cm
    left: Floats  # (n, m) of the readings, 1/cm; 0 where there is none
    noise: Noise
    effect: Effect  # derivatives of the prediction by the errors
    answer: Floats  # (n, m) its derivatives by the true curvature
    bend: Floats  # (n,) of the free body as the errors have it, 1/cm
    row: npt.NDArray[np.int32]  # (n, b) of the tables below each of b bends in the bin, and
    part: Floats  # (n, b) its share of the way to the next
    volume: float  # logarithm of the noise's volume
    squares: float  # of the departures, whitened

    def normal(self, by_q: Floats | None = None) -> tuple[Floats, Floats]:
        """Normal equations of the departures: the matrix and the right-hand side.

        Of the errors; or, with derivatives (n, m, unknowns) of what stands there, of both.
        """
        common, separate = self.effect
        if by_q is not None:
            common = np.concatenate([by_q, common], axis=2)
        return normal_equations(common, separate, *self.noise, self.left)


@dataclass(frozen=True)
class Mode:
    """A most probable explanation."""

    hypothesis: Hypothesis
    q: Floats  # (unknowns,)
    xi: Floats  # (count,) errors in standard deviations
    tables: Tables
    cost: float  # -2 log posterior, less what all share
    precision: Floats  # (unknowns, unknowns) with the errors integrated out
    prior_precision: Floats  # (unknowns,) what of its diagonal was known before
    follow: Floats  # (count, unknowns) derivatives of the best errors by the unknowns


def on_one_thread() -> AbstractContextManager[object]:
    """Keep linear algebra on one thread.

    Between threads, products of this size take up to 200 times as long on a busy computer.
    """
    limited: AbstractContextManager[object] = _thread_pools().limit(limits=1, user_api="blas")
    return limited


@cache
def _thread_pools() -> ThreadpoolController:
    return ThreadpoolController()


class FieldFit:
    """One side's readings with the errors of calibration; `model` is the mechanics' error."""

    def __init__(
        self,
        readings: Readings,
        errors: Errors,
        *,
        model: float = 0.0,
        row: float = 1.0,
        meanwhile: Callable[[], None] | None = None,
    ) -> None:
        """`model`: relative error of what a contact adds to a reading; `row`: coarser tables;
        `meanwhile`: called before each of the long computations.
        """
        self.readings, self.errors, self.model, self.row = readings, errors, model, row
        self._meanwhile = meanwhile
        self.longest = max(stage.length for stage in readings.stages)
        self.step = row * ROW_TURN / self.longest
        top = BEYOND * float(readings.bend.max()) + 2 * self.step
        self.bends = np.arange(0.0, top + self.step, self.step)
        self.body = Body(
            readings.radius, self.longest, float(self.bends[-1]), errors.fold,
            readings.radius / float(readings.fold_moment.min()),
            errors.base / self.longest, errors.base_error / self.longest,
        )  # fmt: skip
        self.missing = ~np.isfinite(readings.curvature)
        self._deviation = np.where(self.missing, np.inf, readings.noise * np.sqrt(ALIKE))
        highest = [readings.bend[readings.stage == s].max() for s in range(len(readings.stages))]
        self._rows = [
            min(int(BEYOND * g / self.step) + 4, self.bends.size) for g in np.maximum(highest, 0.0)
        ]
        self.standing = np.ones(readings.bend.size)
        if readings.standing is not None:
            self.standing = readings.standing
        self._lay_out()

    def _lay_out(self) -> None:
        """What each error of one sigma adds to the bend (n, .) and to a reading (n, m, .)."""
        r, e = self.readings, self.errors
        g, (n, m) = r.bend[:, None], r.curvature.shape
        stage_pressures = [r.stages[s].body_pressure for s in r.stage]
        used, number = np.unique(stage_pressures, return_inverse=True)
        pressures = np.eye(used.size)[number]
        sweeps = np.eye(r.sweep.max() + 1)[r.sweep]
        on_bend = [e.map * g, e.map_by_pressure[used] * g * pressures, e.map_offset * pressures]
        on_bend += [e.sweep * g * sweeps, e.sweep_offset * sweeps, e.lag_s * r.rate[:, None]]
        bend_bin = np.full((n, 1), e.bend_bin)
        if r.response is not None:
            on_bend += [_RESPONSE_STD * r.response[:, None]]
            bend_bin = np.hypot(e.bend_bin, _RESPONSE_LEFT * r.response[:, None])
        on_bend_columns = np.hstack(on_bend)
        parts = [np.ones((n, 1, 1)) * e.zero[:, None]]
        if r.zeroing.max() == r.sweep.max():  # one sweep a zeroing: the two are one error
            parts += [sweeps[:, None] * np.hypot(e.zero_zeroing, e.zero_sweep)[:, None]]
        else:
            parts += [np.eye(r.zeroing.max() + 1)[r.zeroing][:, None] * e.zero_zeroing[:, None]]
            parts += [sweeps[:, None] * e.zero_sweep[:, None]]
        zeros = np.concatenate(parts, axis=2)
        shared = np.zeros((n, m, 0))
        if e.shared.size:
            shared = np.einsum("nc,mj->nmcj", sweeps, e.shared).reshape(n, m, -1)
        drifts = np.zeros(on_bend_columns.shape[1], dtype=bool)
        drifts[: 1 + pressures.shape[1]] = True  # the map's scales
        half_range = np.zeros(n) if r.half_range is None else r.half_range
        against = np.ones(m) if e.against is None else e.against
        against_error = np.zeros(m) if e.against_error is None else e.against_error
        self._bins = Bins(
            curvature=r.curvature, deviation=self._deviation, bend=r.bend,
            bend_bin=np.ravel(bend_bin), standing=self.standing,
            in_bin=half_range[:, None] * _IN_BIN, stage=r.stage, on_bend=on_bend_columns,
            drifts=drifts, shared=shared, zeros=zeros, gain=e.gain, place=e.place,
            against=against, against_error=against_error, model=self.model, step=self.step,
            rows=self.bends.size,
        )  # fmt: skip
        # Numbers of the errors, first those of all sensors: of the bend, of the gain against a
        # bend sign, and shared ones; then each sensor's gain, place, zeros and mechanics.
        self.count, by_sensor = self._bins.count, self._bins.common
        zero_at, model_at = by_sensor + 2 * m, by_sensor + (2 + zeros.shape[2]) * m
        # Errors that each sweep has by itself: of the bend, and beyond a sensor's constant zero.
        self.of_sweeps = np.zeros(self.count, dtype=bool)
        first = 1 + 2 * pressures.shape[1]
        self.of_sweeps[first : first + 2 * sweeps.shape[1]] = True
        self.of_sweeps[drifts.size + 1 : by_sensor] = True
        self.of_sweeps[zero_at + m : model_at] = True
        # Errors that drift: of maps and gains.
        self.drifting = np.zeros(self.count, dtype=bool)
        self.drifting[: drifts.size] = drifts
        self.drifting[by_sensor : by_sensor + m] = True
        self._unit = np.eye(self.count)

    def free(self) -> Floats:
        """(count,) errors that are all nil."""
        return np.zeros(self.count)

    def tables(self, hypothesis: Hypothesis, q: Floats) -> Tables:
        """The mechanics of q; most of the time goes here."""
        r, m = self.readings, self.readings.centers.size
        obstacles = hypothesis.place(q, self.body)
        shape = len(r.stages), self.bends.size
        mean = np.empty((*shape, m))
        mean[:] = self.bends[:, None]
        shift = np.zeros((*shape, m))
        by_q = np.zeros((*shape, m, hypothesis.unknowns))
        contacts = np.full((*shape, len(obstacles), 4), np.nan)
        if not obstacles:
            return Tables(obstacles, mean, shift, by_q, contacts)
        chain, yield_units = hypothesis.moves(q, self.body), hypothesis.yield_units(q, self.body)
        for s, (length, body_pressure) in enumerate(r.stages):
            if self._meanwhile is not None:
                self._meanwhile()
            rows = self._rows[s]
            critical = float(r.fold_moment[body_pressure] * np.exp(q[FOLD]))
            base = abs(float(q[BASE])) * self.longest
            cell_cm = min(CELL * self.longest, MOST_CELL_CM)
            rod = Rod(
                Tube(2 * r.radius, critical, base), obstacles, cell_cm=cell_cm,
                friction=abs(float(q[FRICTION])),
            )  # fmt: skip
            sweep = rod.sweep(self.bends[:rows], length, r.centers, r.spans)
            mean[s, :rows], shift[s, :rows] = sweep.readings, sweep.by_place
            contacts[s, :rows] = sweep.contacts
            for p, moves in enumerate(chain):
                by_q[s, :rows, :, hypothesis.unknowns_of(p)] = sweep.by_obstacle[:, :, p] @ moves
            by_q[s, :rows, :, YIELD] = sweep.by_obstacle[..., 5] @ yield_units
            if np.isfinite(critical):  # else the base does not fold
                by_q[s, :rows, :, FOLD] = sweep.by_body[..., 0] * critical
            by_q[s, :rows, :, BASE] = sweep.by_body[..., 1] * self.longest
            by_q[s, :rows, :, FRICTION] = sweep.by_body[..., 2]
            for part in (mean, shift, by_q, contacts):
                part[s, rows:] = part[s, rows - 1]
        return Tables(obstacles, mean, shift, by_q, contacts)

    def bend(self, xi: Floats, spread: float = 1.0) -> Floats:
        """(n,) bends of the free body as the errors have it; `spread` scales drifts."""
        return self._bins.bends(xi, spread)

    def departures(self, tables: Tables, xi: Floats, spread: float = 1.0) -> Departures:
        """What the sensors read, and the readings' departures from it.

        `xi` are the errors in their standard deviations: each is N(0, 1) beforehand. The noise is
        white, plus the mechanics' error, plus each bin's error of the bend, which all of its
        sensors share (a rank-one update).
        """
        value, left, weight, along, common, separate, answer, bend, row, part, volume, squares = (
            self._bins.departures(tables.mean, tables.shift, xi, spread)
        )
        noise, effect = Noise(weight, along), Effect(common, separate)
        return Departures(
            value, left, noise, effect, answer, bend, row, part, volume, squares
        )  # fmt: skip

    def by_q(self, tables: Tables, at: Departures) -> Floats:
        """(n, m, unknowns) derivatives of a prediction by what stands there."""
        stage, part = self.readings.stage[:, None], at.part[..., None, None]
        below, above = tables.by_q[stage, at.row], tables.by_q[stage, at.row + 1]
        stood = (self.standing[:, None] * at.answer)[..., None]
        slopes: Floats = stood * (below * (1 - part) + above * part).mean(axis=1)
        return slopes

    def evidence(
        self, tables: Tables, xi: Floats, *, spread: float = 1.0, passes: int = 2
    ) -> tuple[float, Floats, float]:
        """log p(readings | q) with errors integrated out, their best fit, and the misfit.

        The evidence lacks what all q share. The misfit is the sum of squares that the best errors
        leave: the mean is about the number of readings if the model holds.
        """
        for left in range(passes, -1, -1):
            d = self.departures(tables, xi, spread)
            matrix, slope = d.normal()
            slope = slope - xi
            factor, step, problem = dposv(matrix + self._unit, slope)
            if problem:
                raise np.linalg.LinAlgError("the normal equations of the errors are not positive")
            gain = 0.5 * float(slope @ step)  # of a further pass, were the readings linear
            if not left or gain < _MET:
                break
            xi = xi + step
        inside = 2 * float(np.log(np.diag(factor)).sum())
        misfit = d.squares + float(xi @ xi) - 2 * gain
        return -0.5 * (misfit + inside + d.volume), xi + step, misfit

    def nothing(self) -> Mode:
        """The readings' explanation by errors alone."""
        tables = self.tables(NOTHING, np.zeros(0))
        log, xi, _ = self.evidence(tables, self.free())
        return Mode(
            NOTHING,
            np.zeros(0),
            xi,
            tables,
            -2 * log,
            np.zeros((0, 0)),
            np.zeros(0),
            np.zeros((xi.size, 0)),
        )

    def solve(
        self,
        hypothesis: Hypothesis,
        q: Floats,
        xi: Floats | None = None,
        *,
        passes: int = MOST_PASSES,
        held: tuple[int, ...] = (),
    ) -> Mode:
        """The most probable q and errors near a start: Gauss-Newton, damped. q[held] stay.

        What cannot be negative stays at 0 while a lower value would be likelier (active set).
        """
        q = np.array(q, dtype=float)
        xi = self.free() if xi is None or xi.size != self.count else xi
        k, bounded = q.size, np.array(UNSIGNED) % q.size
        unit = self.longest
        turn = _LARGEST_TURN / unit
        most = hypothesis.columns(
            (0.06 * unit, turn, 0.6), 0.15, 0.3, 0.5, 0.05, (turn, 0.2, 0.6, 0.06)
        )
        mean, spread = hypothesis.bells(self.body)
        precision = np.concatenate([1 / spread**2, np.ones(self.count)])

        def cost_at(q: Floats, xi: Floats) -> tuple[float, Tables, Departures]:
            tables = self.tables(hypothesis, q)
            d = self.departures(tables, xi)
            prior = -2 * hypothesis.log_prior(q, self.body)
            return d.squares + float(xi @ xi) + d.volume + prior, tables, d

        def linearised(tables: Tables, d: Departures) -> tuple[Floats, Floats]:
            """Precision of q and errors, and the slope of the log posterior."""
            matrix, right = d.normal(self.by_q(tables, d))
            slope = right - np.concatenate([(q - mean) / spread**2, xi])
            return matrix + np.diag(precision), slope

        cost, tables, d = cost_at(q, xi)
        hessian, slope = linearised(tables, d)
        damping = _DAMPING
        for _ in range(passes):
            free = np.ones(slope.size, dtype=bool)
            free[list(held)] = False
            free[bounded[(q[bounded] <= 0.0) & (slope[bounded] <= 0.0)]] = False
            inner = hessian[np.ix_(free, free)]
            ahead = None
            for _ in range(_TRIES):
                change = np.zeros(slope.size)
                damped = inner + damping * np.diag(np.diag(inner) + 1e-9)
                change[free] = np.linalg.solve(damped, slope[free])
                change[:k] /= max(1.0, float(np.max(np.abs(change[:k]) / most)))
                trial = q + change[:k]
                trial[bounded] = np.maximum(trial[bounded], 0.0)
                if hypothesis.possible(trial, self.body):
                    better = cost_at(trial, xi + change[k:])
                    if better[0] < cost:
                        ahead = trial, xi + change[k:]
                        break
                damping *= _RAISED
            if ahead is None:
                break
            gained, damping = cost - better[0], max(damping / _RAISED, _LEAST_DAMPING)
            (q, xi), (cost, tables, d) = ahead, better
            hessian, slope = linearised(tables, d)
            if gained < _GAIN:
                break
        # Where the posterior falls from a bound on, a bell of this precision is about as wide.
        fall = np.minimum(slope[bounded], 0.0)
        hessian[bounded, bounded] += np.where(q[bounded] <= 0.0, 0.5 * fall**2, 0.0)
        follow = -np.asarray(np.linalg.solve(hessian[k:, k:], hessian[k:, :k]))
        inside = hessian[:k, :k] + hessian[:k, k:] @ follow
        return Mode(hypothesis, q, xi, tables, cost, inside, precision[:k], follow)
