"""One side's readings as a function of what stands in the plane, with calibration's errors.

  a frame's readings = mechanics(what stands in the plane, bend of the free body) + errors

Obstacles stand still, so the same few numbers explain all sweeps at all everted lengths, those that
felt nothing included. Calibration's errors are Gaussian and small: they are integrated out around
their best fit (Laplace). An unknown relative error of the mechanics has a few levels, which the
posterior weighs: where a body is not the model's, answers widen. docs/methods.md derives it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve

from thigmo.field.hypotheses import (
    BASE,
    FOLD,
    FRICTION,
    NOTHING,
    OBSTACLE_UNKNOWNS,
    UNSIGNED,
    YIELD,
    Body,
    Hypothesis,
    nearest_on,
    untouched,
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
_LEVER = 0.7  # of the longest body, where the force acts for which a yield is stated
_LARGEST_TURN = 0.13  # rad at the end of the body, of one step of the touch's bend


class Touch(NamedTuple):
    """Contacts by bend (k) and obstacle (p) at one stage; NaN where there is none."""

    arc: Floats  # (k, p) cm
    x: Floats  # (k, p) of the touched skin, cm
    y: Floats
    normal: Floats  # (k, p) direction from the contact into the obstacle, rad
    force: Floats  # (k, p) over EI, 1/cm^2


class Tables(NamedTuple):
    """The mechanics of what stands there, by stage (s), bend (k) and sensor (m)."""

    mean: Floats  # (s, k, m) what sensors read, 1/cm
    shift: Floats  # (s, k, m) by how much that grows for each cm farther out
    by_q: Floats  # (s, k, m, unknowns) by how much for each unknown
    touch: tuple[Touch | None, ...]  # of each stage; None: it reaches nothing


class Prediction(NamedTuple):
    """Readings of n bins by m sensors, 1/cm."""

    value: Floats  # (n, m)
    slope: Floats  # (n, m) over the bend
    effect: Floats  # (n, m, count) derivatives by the errors
    bend: Floats  # (n,) of the free body, 1/cm
    answer: Floats  # (n, m) derivatives over the true curvature
    row: npt.NDArray[np.intp]  # (n,) of the tables below the bend, and
    part: Floats  # (n,) its share of the way to the next


class Departures(NamedTuple):
    """Whitened departures of the readings from a prediction."""

    z: Floats  # (n m,)
    effect: Floats  # (n m, count) derivatives of the prediction by the errors, whitened
    weight: Floats  # (n, m) of the whitening, for `whitened`
    along: Floats  # (n, m) bin's error of the bend, whitened
    volume: float  # logarithm of the noise's volume
    prediction: Prediction


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


class FieldFit:
    """One side's readings with the errors of calibration; `model` is the mechanics' error."""

    def __init__(
        self, readings: Readings, errors: Errors, *, model: float = 0.0, row: float = 1.0
    ) -> None:
        """`model`: relative error of what a contact adds to a reading; `row`: coarser tables."""
        self.readings, self.errors, self.model, self.row = readings, errors, model, row
        self.longest = max(stage.length for stage in readings.stages)
        self.step = row * ROW_TURN / self.longest
        top = BEYOND * float(readings.bend.max()) + 2 * self.step
        self.bends = np.arange(0.0, top + self.step, self.step)
        force = float(readings.fold_moment.min()) / (_LEVER * self.longest)
        self.body = Body(
            readings.radius, self.longest, float(self.bends[-1]), errors.fold,
            readings.radius / force, errors.base / self.longest, errors.base_error / self.longest,
        )  # fmt: skip
        self.missing = ~np.isfinite(readings.curvature)
        self._sd = np.where(self.missing, np.inf, readings.noise * np.sqrt(ALIKE))
        highest = [readings.bend[readings.stage == s].max() for s in range(len(readings.stages))]
        self._rows = [
            min(int(BEYOND * g / self.step) + 4, self.bends.size) for g in np.maximum(highest, 0.0)
        ]
        self._lay_out()

    def _lay_out(self) -> None:
        """What each error of one sigma adds to the bend (n, .) and to a reading (n, m, .)."""
        r, e = self.readings, self.errors
        g, (n, m) = r.bend[:, None], r.curvature.shape
        used, zone = np.unique([r.stages[s].zone for s in r.stage], return_inverse=True)
        zones = np.eye(used.size)[zone]
        sweeps = np.eye(r.sweep.max() + 1)[r.sweep]
        on_bend = [e.map * g, e.map_zone[used] * g * zones, e.map_offset * zones]
        on_bend += [e.sweep * g * sweeps, e.sweep_offset * sweeps, e.lag_s * r.rate[:, None]]
        self.on_bend = np.hstack(on_bend)
        zeros = [(np.ones((n, 1)), e.zero)]
        if r.zeroing.max() == r.sweep.max():  # one sweep a zeroing: the two are one error
            zeros += [(sweeps, np.hypot(e.zero_zeroing, e.zero_sweep))]
        else:
            zeros += [(np.eye(r.zeroing.max() + 1)[r.zeroing], e.zero_zeroing)]
            zeros += [(sweeps, e.zero_sweep)]
        parts = [
            np.einsum("nc,m,mj->nmcj", times, sd, np.eye(m)).reshape(n, m, -1)
            for times, sd in zeros
        ]
        if e.shared.size:
            parts.append(np.einsum("nc,mj->nmcj", sweeps, e.shared).reshape(n, m, -1))
        self.on_zero = np.concatenate(parts, axis=2)
        self._drifts = np.zeros(self.on_bend.shape[1], dtype=bool)
        self._drifts[: 1 + zones.shape[1]] = True  # the map's scales
        self._gain = self.on_bend.shape[1]
        self._place, self._against = self._gain + m, self._gain + 2 * m
        self._zero = self._against + 1
        self._modelled = self._zero + self.on_zero.shape[2]
        self.count = self._modelled + (m if self.model else 0)
        # Errors that each sweep has by itself: of the bend, and beyond a sensor's constant zero.
        self.of_sweeps = np.zeros(self.count, dtype=bool)
        first = 1 + 2 * zones.shape[1]
        self.of_sweeps[first : first + 2 * sweeps.shape[1]] = True
        self.of_sweeps[self._zero + m : self._modelled] = True
        self._unit = np.eye(self.count)

    def free(self) -> Floats:
        """(count,) errors that are all nil."""
        return np.zeros(self.count)

    def tables(self, hypothesis: Hypothesis, q: Floats) -> Tables:
        """The mechanics of q; most of the time goes here."""
        r, m = self.readings, self.readings.centers.size
        obstacles = hypothesis.place(q, self.body)
        mean = np.tile(self.bends[:, None], (len(r.stages), 1, m))
        shift = np.zeros(mean.shape)
        by_q = np.zeros((*mean.shape, hypothesis.unknowns))
        chain = hypothesis.moves(q, self.body)
        touches: list[Touch | None] = []
        for s, (length, zone) in enumerate(r.stages):
            rows, touch = self._rows[s], None
            bends = self.bends[:rows]
            first = min((untouched(p, length, r.radius, bends) for p in obstacles), default=rows)
            if first < rows:
                critical = float(r.fold_moment[zone] * np.exp(q[FOLD]))
                base = abs(float(q[BASE])) * self.longest
                cell_cm = min(CELL * self.longest, MOST_CELL_CM)
                rod = Rod(
                    Tube(2 * r.radius, critical, base), obstacles, cell_cm=cell_cm,
                    friction=abs(float(q[FRICTION])),
                )  # fmt: skip
                sweep = rod.sweep(bends[first:], length, r.centers, r.spans)
                on = slice(first, rows)
                mean[s, on], shift[s, on] = sweep.readings, sweep.by_place
                for p, moves in enumerate(chain):
                    own = slice(OBSTACLE_UNKNOWNS * p, OBSTACLE_UNKNOWNS * (p + 1))
                    by_q[s, on, :, own] = sweep.by_obstacle[:, :, p, :5] @ moves
                yields = sweep.by_obstacle[..., 5].sum(axis=2) * self.body.yield_unit
                by_q[s, on, :, YIELD] = yields * np.sign(q[YIELD])
                if np.isfinite(critical):  # else the base does not fold
                    by_q[s, on, :, FOLD] = sweep.by_body[..., 0] * critical
                by_q[s, on, :, BASE] = sweep.by_body[..., 1] * self.longest * np.sign(q[BASE])
                by_q[s, on, :, FRICTION] = sweep.by_body[..., 2] * np.sign(q[FRICTION])
                for part in (mean, shift, by_q):
                    part[s, rows:] = part[s, rows - 1]
                touch = self._touch(obstacles, sweep.contacts, first, rows)
            touches.append(touch)
        return Tables(mean, shift, by_q, tuple(touches))

    @staticmethod
    def _touch(obstacles: list[Obstacle], contacts: Floats, first: int, rows: int) -> Touch:
        where = np.full((5, rows, len(obstacles)), np.nan)
        arc, x, y, force = np.moveaxis(contacts, 2, 0)
        for p, obstacle in enumerate(obstacles):
            near_x, near_y = nearest_on(obstacle, x[:, p], y[:, p])
            where[3, first:, p] = np.arctan2(near_y - y[:, p], near_x - x[:, p])
        where[:3, first:], where[4, first:] = (arc, x, y), force
        return Touch(*where)

    def bend(self, xi: Floats, spread: float = 1.0) -> Floats:
        """(n,) bends of the free body as the errors have it; `spread` scales drifts."""
        along = xi[: self._gain] * np.where(self._drifts, spread, 1.0)
        bend: Floats = np.clip(self.readings.bend + self.on_bend @ along, 0.0, self.bends[-2])
        return bend

    def predict(self, tables: Tables, xi: Floats, spread: float = 1.0) -> Prediction:
        """What the sensors read, and its derivatives.

        `xi` are the errors in their standard deviations: each is N(0, 1) beforehand.
        """
        e, r, m = self.errors, self.readings, self.readings.centers.size
        j, p, b, o = self._gain, self._place, self._against, self._zero
        gain, place = 1 + spread * e.gain * xi[j:p], e.place * xi[p:b]
        bend = self.bend(xi, spread)
        whole, part = np.divmod(bend / self.step, 1)
        k, u = np.minimum(whole.astype(np.intp), self.bends.size - 2), part[:, None]
        low, high = tables.mean[r.stage, k], tables.mean[r.stage, k + 1]
        shift = tables.shift[r.stage, k] * (1 - u) + tables.shift[r.stage, k + 1] * u
        true = low * (1 - u) + high * u + shift * place
        back = true < 0  # a flex sensor answers less to a bend against its valid direction
        against = np.ones(m) if e.against is None else e.against
        unsure = np.zeros(m) if e.against_error is None else e.against_error
        answer = np.where(back, against + unsure * xi[b], 1.0)
        slope = gain * answer * (high - low) / self.step
        effect = np.zeros((*true.shape, self.count))
        along = self.on_bend * np.where(self._drifts, spread, 1.0)
        effect[..., :j] = slope[..., None] * along[:, None]
        sensors = np.arange(m)
        effect[:, sensors, j + sensors] = spread * e.gain * answer * true
        effect[:, sensors, p + sensors] = e.place * gain * answer * shift
        effect[..., b] = unsure * gain * true * back
        effect[..., o : self._modelled] = self.on_zero
        value = gain * answer * true + self.on_zero @ xi[o : self._modelled]
        if self.model:
            added = self.model * (true - bend[:, None])
            effect[:, sensors, self._modelled + sensors] = added
            value = value + added * xi[self._modelled :]
        return Prediction(value, slope, effect, bend, gain * answer, k, part)

    def by_q(self, tables: Tables, at: Prediction) -> Floats:
        """(n, m, unknowns) derivatives of a prediction by what stands there."""
        stage, part = self.readings.stage, at.part[:, None, None]
        below, above = tables.by_q[stage, at.row], tables.by_q[stage, at.row + 1]
        slopes: Floats = at.answer[..., None] * (below * (1 - part) + above * part)
        return slopes

    def departures(self, tables: Tables, xi: Floats, spread: float = 1.0) -> Departures:
        """Departures from a prediction.

        The noise is white, plus the mechanics' error, plus each bin's error of the bend, which all
        of its sensors share (a rank-one update).
        """
        there = self.predict(tables, xi, spread)
        added = self.model * (there.value - there.bend[:, None]) / self._sd
        weight = 1 / (self._sd * np.sqrt(1 + added**2))
        along = weight * there.slope * self.errors.bend_bin
        volume = float(np.log1p((along**2).sum(axis=1)).sum() + np.log1p(added**2).sum())
        left = np.where(self.missing, 0.0, self.readings.curvature - there.value)
        z, effect = whitened(left, weight, along), whitened(there.effect, weight, along)
        return Departures(z, effect, weight, along, volume, there)

    def evidence(
        self, tables: Tables, xi: Floats, *, spread: float = 1.0, passes: int = 2
    ) -> tuple[float, Floats, float]:
        """log p(readings | q) with errors integrated out, their best fit, and the misfit.

        The evidence lacks what all q share. The misfit is the sum of squares that the best errors
        leave: the mean is about the number of readings if the model holds.
        """
        for left in range(passes, -1, -1):
            d = self.departures(tables, xi, spread)
            z, effect = d.z, d.effect
            factor = cho_factor(effect.T @ effect + self._unit, check_finite=False)
            slope = effect.T @ z - xi
            step = cho_solve(factor, slope, check_finite=False)
            gain = 0.5 * float(slope @ step)  # of a further pass, were the readings linear
            if not left or gain < _MET:
                break
            xi = xi + step
        inside = 2 * float(np.log(np.diag(factor[0])).sum())
        misfit = float(z @ z + xi @ xi) - 2 * gain
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
        """The most probable q and errors near a start: Gauss-Newton, damped. q[held] stay."""
        q = np.array(q, dtype=float)
        xi = self.free() if xi is None or xi.size != self.count else xi
        unit = self.longest
        turn = _LARGEST_TURN / unit
        most = hypothesis.columns((0.06 * unit, turn, 0.6), 0.15, 0.3, 0.5, 0.05, (turn, 0.2, 0.6))
        mean, spread = hypothesis.bells(self.body)
        precision = np.concatenate([1 / spread**2, np.ones(self.count)])

        def cost_at(q: Floats, xi: Floats) -> tuple[float, Tables, Departures]:
            tables = self.tables(hypothesis, q)
            d = self.departures(tables, xi)
            prior = -2 * hypothesis.log_prior(q, self.body)
            return float(d.z @ d.z + xi @ xi + d.volume + prior), tables, d

        cost, tables, d = cost_at(q, xi)
        damping, hessian = _DAMPING, np.eye(q.size + self.count)
        for _ in range(passes):
            by_q = whitened(self.by_q(tables, d.prediction), d.weight, d.along)
            by_q[:, list(held)] = 0.0
            jacobian = np.hstack([by_q, d.effect])
            hessian = jacobian.T @ jacobian + np.diag(precision)
            slope = jacobian.T @ d.z - np.concatenate([(q - mean) / spread**2, xi])
            slope[list(held)] = 0.0
            ahead = None
            for _ in range(_TRIES):
                damped = hessian + damping * np.diag(np.diag(hessian) + 1e-9)
                by = np.linalg.solve(damped, slope)
                by[: q.size] /= max(1.0, float(np.max(np.abs(by[: q.size]) / most)))
                by[list(held)] = 0.0
                trial = q + by[: q.size]
                if hypothesis.possible(trial, self.body):
                    better = cost_at(trial, xi + by[q.size :])
                    if better[0] < cost:
                        ahead = trial, xi + by[q.size :]
                        break
                damping *= _RAISED
            if ahead is None:
                break
            gained, damping = cost - better[0], max(damping / _RAISED, _LEAST_DAMPING)
            (q, xi), (cost, tables, d) = ahead, better
            if gained < _GAIN:
                break
        k = q.size
        follow = -np.linalg.solve(hessian[k:, k:], hessian[k:, :k])
        inner = hessian[:k, :k] + hessian[:k, k:] @ follow
        sign = np.ones(k)
        sign[list(UNSIGNED)] = np.where(q[list(UNSIGNED)] < 0.0, -1.0, 1.0)
        return Mode(
            hypothesis, sign * q, xi, tables, cost, inner * np.outer(sign, sign), precision[:k],
            follow * sign,
        )  # fmt: skip


def whitened(x: npt.NDArray[np.float64], weight: Floats, along: Floats) -> Floats:
    """Whiten x (n, m, ...) by weights (n, m) and a rank-one part of each bin; (n m, ...)."""
    squared = np.sum(along**2, axis=1)
    share = (1 - 1 / np.sqrt(1 + squared)) / np.maximum(squared, 1e-30)
    z = x * weight.reshape(*weight.shape, *[1] * (x.ndim - 2))
    common = np.einsum("n,nm,nm...->n...", share, along, z)
    z = z - np.einsum("nm,n...->nm...", along, common)
    white: Floats = z.reshape(x.shape[0] * x.shape[1], *x.shape[2:])
    return white
