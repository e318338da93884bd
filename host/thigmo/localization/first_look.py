"""The first look at a frame: from the caller's arrays to one contact on the straight body.

One compiled pass, because most frames need no more (`model_choice.stands`), and crossings between
Python and compiled code cost more than the fit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization import prior
from thigmo.localization.frame import Frame
from thigmo.localization.influence import STRAIGHT, Sensors
from thigmo.localization.models import Fit, start
from thigmo.localization.pair_grid import limit_of_two
from thigmo.localization.posterior import one_contact
from thigmo.localization.prior import BaseMoment
from thigmo.localization.readings import Readings, fault, normalise_into, vectors

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]


@compiled
def _look(
    curvature: Array,
    position: Array,
    span: Array,
    free: Array,
    noise: Array,
    length: float,
    offset: float,
    straight: Array,
    mean: Array,
    spread: Array,
    weight: Array,
) -> tuple[Array, Array, Indices, Array, Array, Flags]:
    """As few arrays as will do, because each costs on its way to Python.

    Returns:
        (14,) problem or 0, and the scalars of `Look` in their order; (4, N) normalised readings;
        (N,) their places in the caller's arrays; (P, 3) modes; (5, M) nodes; (N,) outliers.
    """
    n = curvature.shape[0]
    block = np.empty((4, n))
    index = np.empty(n, dtype=np.int64)
    numbers = np.zeros(14)
    problem, count, bend = normalise_into(
        curvature, position, span, free, noise, length, block, index
    )
    numbers[0] = problem
    if problem:
        return (
            numbers, block, index, np.empty((0, 3)), np.empty((5, 0)), np.zeros(0, dtype=np.bool_)
        )  # fmt: skip
    y, low, high, variance = (
        block[0][:count], block[1][:count], block[2][:count], block[3][:count]
    )  # fmt: skip
    columns = np.full((count, 1 if offset > 0.0 else 0), offset)
    known = noise.shape[0] > 0
    frame = Frame(y, variance, known, columns, Sensors(low, high, straight, np.empty((count, 4))))
    moment = BaseMoment(mean, spread, weight)
    found = one_contact(frame, moment)
    numbers[1] = count
    numbers[2] = bend
    numbers[3] = found.null
    numbers[4] = found.evidence
    numbers[5] = found.arc
    numbers[6] = found.force
    numbers[7] = found.deviation
    numbers[8] = found.low
    numbers[9] = found.high
    numbers[10] = found.noise
    numbers[11] = found.misfit
    numbers[12] = found.bound
    numbers[13] = limit_of_two(frame, moment, found.misfit, found.flagged)
    m = found.nodes.arcs.shape[0]
    nodes = np.empty((5, m))
    for j in range(m):
        nodes[0, j] = found.nodes.arcs[j]
        nodes[1, j] = found.nodes.logp[j]
        nodes[2, j] = found.nodes.force[j]
        nodes[3, j] = found.nodes.arcs[j] * length
        nodes[4, j] = math.exp(found.nodes.logp[j]) / length
    return numbers, block, index, found.pieces, nodes, found.flagged


class Look(NamedTuple):
    """What the first look finds, in units of the length.

    Attributes:
        finite: N, how many readings are.
        bend: mean free curvature, times length.
        null, evidence: log evidence without and with the contact.
        arc, force, deviation: place, force there, and the force's deviation.
        low, high: interval of the arc.
        noise: of one reading.
        misfit: sum of squared residuals over variance.
        bound: Cramer-Rao bound of the arc, from the readings alone.
        two: what the log evidence of two contacts cannot pass (`limit_of_two`).
        block: (4, n) y, low, high and variance of the n readings given, the first N filled.
        chosen: (n,) places of those in the caller's arrays.
        pieces: (P, 3) modes.
        nodes: (5, M) places, log density, force; then place and density in the caller's units.
        flagged: (N,) outliers.
        known: whether the noise is known.
        offset: deviation of an error that all readings share, times length.
        length: the everted length, caller's unit.
    """

    finite: int
    bend: float
    null: float
    evidence: float
    arc: float
    force: float
    deviation: float
    low: float
    high: float
    noise: float
    misfit: float
    bound: float
    two: float
    block: Array
    chosen: Indices
    pieces: Array
    nodes: Array
    flagged: Flags
    known: bool
    offset: float
    length: float

    def readings(self) -> Readings:
        """The normalised readings."""
        n = self.finite
        y, low, high, variance = self.block[:, :n]
        return Readings(y, low, high, variance, self.known, self.bend, self.chosen[:n], self.length)

    def fit(self, readings: Readings) -> Fit:
        """The posterior, as that of any other model."""
        return Fit(
            start(readings, self.offset, False),
            self.evidence,
            self.null,
            np.array([self.arc]),
            np.array([self.force]),
            np.array([[self.low, self.high]]),
            [self.pieces],
            self.nodes[0],
            self.nodes[1],
            self.flagged,
            self.noise,
            self.misfit,
            self.deviation,
            self.bound,
            node_forces=self.nodes[2],
        )


def first_look(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    length: float,
    span: npt.ArrayLike,
    free_curvature: npt.ArrayLike,
    noise: npt.ArrayLike | None,
    offset: float,
) -> Look:
    """Check a frame, normalise it and fit one contact on the straight body.

    Raises:
        DataError: as `readings.normalise`.
    """
    k, x, width, g, s, total = vectors(curvature, position, length, span, free_curvature, noise)
    moment = prior.BASE_MOMENT
    numbers, block, index, pieces, nodes, flagged = _look(
        k, x, width, g, s, total, offset * total, STRAIGHT, *moment
    )
    problem, finite, *scalars = numbers.tolist()
    if problem:
        raise fault(int(problem))
    known = noise is not None
    rest = (block, index, pieces, nodes, flagged, known, offset * total, total)
    return Look._make((int(finite), *scalars, *rest))
