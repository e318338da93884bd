"""The search of the whole plane for a peg: readings of every place, made once a robot.

What the sensors of a body read beside a peg depends on the robot alone. So the tables of a grid of
touches serve every side, stage and run of one robot, and a search costs one product a place.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.field.fit import MOST_CELL_CM, FieldFit, Mode
from thigmo.field.hypotheses import RADIUS_MEAN, touched, untouched
from thigmo.field.readings import Floats, Readings
from thigmo.mechanics import Rod, Tube

# Grid of the touches: steps of the arc over the body's length, and of the bend (turns of the whole
# body, rad). The linearised fit of a place reaches as far.
_ARC_STEP, _TURN_STEP = 2.5 / 53, 0.085
_FIRST_ARC, _BEYOND = 0.1, 0.1  # lengths
_MOST_TURN = 1.9
_ROW_TURN = 0.084  # rad of the whole body between rows of a table
_KEPT = 3
_CELLS, _MESH = 53, 5.0 / 53  # at whose ends headings are kept; of the elastica, a length
_SHOWS = 1e-4  # 1/cm: a place that changes no reading by more explains nothing
_PARTS = 0.25, 0.5, 0.75, 1.0  # of the bin in which a peg gives way
_APART = 1.6, 2.6  # steps of arc and bend within which two places lead to one fit


class Place(NamedTuple):
    """A place that explains readings."""

    gain: float  # log likelihood beyond that of nothing, errors linearised
    arc: float
    bend: float


class Release(NamedTuple):
    """A peg that gave way."""

    standing: Floats  # (n,) share of each bin in which it stood
    gain: float  # log likelihood beyond that of nothing, errors linearised, and
    stays: float  # that of a peg that stays


class Pegs(NamedTuple):
    """What p pegs would change in n bins of m sensors, whitened."""

    touches: list[tuple[float, float]]  # (p,) arc and bend
    z: Floats  # (n, m) departures from nothing
    white: Floats  # (n, m, p)
    shared: Floats  # (errors, n, m): of departures d the errors' best fit takes |shared d|^2 off

    def gains(self) -> Floats:
        """(p,) log likelihood of each peg, beyond that of nothing."""
        *_, (_, _, gains) = self.gains_so_far()
        return gains

    def gains_so_far(self) -> Iterator[tuple[int, float, Floats]]:
        """Of pegs that give way in a bin, after a part of it: (p,) gains, and bin and part."""
        explained = np.einsum("enm,nm->e", self.shared, self.z)
        left, squares = explained[:, None], np.zeros(len(self.touches))
        bins = zip(self.z, self.white, np.moveaxis(self.shared, 1, 0), strict=True)
        for n, (z, white, shared) in enumerate(bins):
            moved, product, size = shared @ white, z @ white, np.sum(white**2, axis=0)
            for part in _PARTS:
                rest, more = left - part * moved, part**2 * size - 2 * part * product
                after = squares + more - np.sum(rest**2, axis=0)
                yield n, part, -0.5 * (after + explained @ explained)
            left, squares = left - moved, squares + size - 2 * product

    def release(self) -> Release | None:
        """From which bin on a peg was gone, if one stood there and gave way: the likeliest."""
        if not self.touches or len(self.z) < 2:
            return None
        gains = np.array([gains.max() for _, _, gains in self.gains_so_far()])
        last, part = divmod(int(np.argmax(gains[:-1])), len(_PARTS))
        standing = np.zeros(len(self.z))
        standing[:last], standing[last] = 1.0, _PARTS[part]
        return Release(standing, float(gains[:-1].max()), float(gains[-1]))


class _Table(NamedTuple):
    first: int  # the first row that departs from a free body
    heading: npt.NDArray[np.float32]  # (k, cells + 1) beyond the free body's, rad


class Atlas:
    """Headings beside a peg of average size at each touch of a grid, for bodies of one length.

    Grown as stages come: a table for each everted length and body pressure, for both sides and for
    what a sensor reads is the difference of two headings.
    """

    def __init__(self, length_cm: float, most_bend: float) -> None:
        """`length_cm`: of the whole body; `most_bend`: 1/cm, the highest of its maps."""
        self.step = _ROW_TURN / length_cm
        self.bends = np.arange(0.0, most_bend + 2 * self.step, self.step)
        self._cell = length_cm / _CELLS
        self.arc_step, self.bend_step = _ARC_STEP * length_cm, _TURN_STEP / length_cm
        arcs = np.arange(_FIRST_ARC, 1 + _BEYOND, _ARC_STEP) * length_cm
        bends = np.arange(_TURN_STEP, most_bend * length_cm, _TURN_STEP) / length_cm
        self.touches = [(a, b) for a in arcs for b in bends if b < _MOST_TURN / a]
        # By radius, everted length and moment that folds the base.
        self._tables: dict[tuple[float, float, float], list[_Table | None]] = {}

    def _stage(self, readings: Readings, s: int) -> list[_Table | None]:
        length, body_pressure = readings.stages[s]
        moment = float(readings.fold_moment[body_pressure])
        body = readings.radius, length, moment
        if body not in self._tables:
            self._tables[body] = [self._table(*body, a, b) for a, b in self.touches]
        return self._tables[body]

    def _table(
        self, radius: float, length: float, moment: float, arc: float, bend: float
    ) -> _Table | None:
        peg = touched(arc, bend, float(np.exp(RADIUS_MEAN)) * radius, radius)
        first = untouched(peg, length, radius, self.bends)
        straight = np.hypot(peg.x - np.clip(peg.x, 0.0, length), peg.y)
        if first == self.bends.size or straight < peg.radius + radius:
            return None
        count = int(np.ceil(length / self._cell))
        cell = length / count
        middles: Floats = cell * (np.arange(count, dtype=np.float64) + 0.5)
        widths: Floats = np.full(count, cell)
        bends = self.bends[first:]
        rod = Rod(Tube(2 * radius, moment), [peg], cell_cm=min(_MESH * length, MOST_CELL_CM))
        mean = rod.sweep(bends, length, middles, widths).readings
        heading: npt.NDArray[np.float32] = np.zeros((bends.size, count + 1), dtype=np.float32)
        heading[:, 1:] = np.cumsum((mean - bends[:, None]) * cell, axis=1)
        return _Table(first, heading)

    def likeliest(self, pegs: Pegs, readings: Readings) -> list[Place]:
        """The best places for one peg, likeliest first; the best between any two ends among them.

        A body whose end passes a peg reads as if nothing stood there, so no fit crosses an end.
        """
        if not pegs.touches:
            return []
        gains = pegs.gains()
        best: list[Place] = []
        between = set()
        for n in np.argsort(-gains):
            place = Place(float(gains[n]), *pegs.touches[n])
            ends = readings.ends_before(place.arc)
            is_apart = all(self._apart(place, kept) for kept in best)
            if ends not in between or (is_apart and len(best) < _KEPT):
                best.append(place)
                between.add(ends)
        return best

    def pegs(self, fit: FieldFit, nothing: Mode) -> Pegs:
        """What a peg at each touch of the grid would change in a fit's readings.

        Errors are linearised where calibration is right: those that explain a touch by no obstacle
        are far from it.
        """
        right = fit.free()
        d = fit.departures(nothing.tables, right)
        z, effect = d.noise.whitened(d.left), d.noise.whitened(d.effect.dense())
        factor = np.linalg.cholesky(effect.T @ effect + np.eye(fit.count))
        shared = np.linalg.solve(factor, effect.T)
        whole, part = np.divmod(d.bend / self.step, 1)
        rows, u = np.minimum(whole.astype(np.intp), self.bends.size - 2), part[:, None]
        r = fit.readings
        changes = np.zeros((len(self.touches), *r.curvature.shape))
        for s, (length, _) in enumerate(r.stages):
            inside = np.flatnonzero(r.stage == s)
            mean = _averages(length, self._cell, r.centers, r.spans)
            for change, table in zip(changes, self._stage(r, s), strict=True):
                if table is not None:
                    k = rows[inside] - table.first
                    on, k = inside[k >= 0], k[k >= 0]
                    heading = table.heading[k] * (1 - u[on]) + table.heading[k + 1] * u[on]
                    change[on] = heading @ mean
        changes[:, fit.missing] = 0.0
        changes *= fit.standing[:, None]
        shows = np.flatnonzero(np.abs(changes).max(axis=(1, 2)) > _SHOWS)
        white = d.noise.whitened(np.moveaxis(changes[shows], 0, -1))
        n, m = r.curvature.shape
        return Pegs(
            [self.touches[k] for k in shows],
            z.reshape(n, m), white.reshape(n, m, -1), shared.reshape(-1, n, m),
        )  # fmt: skip

    def _apart(self, first: Place, second: Place) -> bool:
        arcs = abs(first.arc - second.arc) / (_APART[0] * self.arc_step)
        return max(arcs, abs(first.bend - second.bend) / (_APART[1] * self.bend_step)) > 1


def _averages(length: float, cell: float, centers: Floats, spans: Floats) -> Floats:
    """(cells + 1, m) matrix from headings at the ends of cells to mean curvatures of sensors."""
    count = int(np.ceil(length / cell))
    ends = np.linspace(0.0, length, count + 1)
    width = np.maximum(spans, length / count)
    low, high = np.maximum(centers - width / 2, 0.0), np.minimum(centers + width / 2, length)
    units = np.eye(count + 1)
    weight = [np.interp(high, ends, unit) - np.interp(low, ends, unit) for unit in units]
    matrix: Floats = np.asarray(weight) / np.maximum(high - low, 1e-9)
    return matrix
