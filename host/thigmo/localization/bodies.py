"""Bodies bent into a peg, for every place of the room that the body reaches in an inflation.

A peg's place is told by where on the outline of the body it is first touched (along the side, round
the corner, across the face of the end) and at which free curvature. From that touch the
large-deflection rod is followed through the frames. `obstacle` compares the tables with readings;
they depend on the body and on the inflation only, so they are kept for the next trial. Peg on the
left, lengths those of a body of 53 cm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from thigmo.mechanics import Peg, Rod, Solution, Tube

Array = npt.NDArray[np.float64]

LENGTH = 53.0
_CELL = 0.25  # of the tables of heading
_SIDE = np.linspace(8.0, LENGTH, 37)
_CORNER = 5  # places round the corner of the end, and across half of its face
_TOUCHES = 28  # least number of free curvatures of touch
# Nodes of a sensor's place, in deviations.
SHIFTS = np.linspace(-3.0, 3.0, 13)


@dataclass(frozen=True, slots=True)
class Inflation:
    """A body and the free curvatures (T,) that an inflation takes it through, all positive."""

    free: tuple[float, ...]
    radius: float
    peg: float
    critical: float | None

    def bend(self, centre: Array, touch: float) -> Rod:
        """The body where a peg at `centre` is about to touch it, at the free curvature `touch`."""
        peg = Peg(float(centre[0]), float(centre[1]), self.peg)
        rod = Rod(Tube(2.0 * self.radius, self.critical), [peg])
        rod.assume_free(touch * (1.0 - 1e-6), LENGTH)
        return rod

    def last(self, centre: Array, touch: float) -> Solution:
        """The body in the last frame, bent into a peg at `centre`."""
        rod = self.bend(centre, touch)
        for free in self.free:
            if free > touch:
                rod.step(free, LENGTH)
        return rod.solution()


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """A places along the outline, G free curvatures of touch.

    Attributes:
        touch: (G,).
        peg: (A, G, 2) centres.
        weight: (A, G) area of the room over a step of both.
        heading: (A, G, T, M) in each frame, over arcs a cell apart.
        arc: (A, G) of the contact in the last frame; NaN where there is none.
    """

    touch: Array
    peg: Array
    weight: Array
    heading: Array
    arc: Array


def _outline(radius: float, peg: float) -> Array:
    """(A, 3) arc, and the centre of a touching peg from there: along the tangent, the normal.

    From near the base along the left side, round the left corner, across the face.
    """
    side = np.column_stack([_SIDE, np.zeros(len(_SIDE)), np.full(len(_SIDE), radius + peg)])
    angle = np.linspace(0.0, math.pi / 2, _CORNER + 1)[1:]
    corner = np.column_stack(
        [np.full(_CORNER, LENGTH), peg * np.sin(angle), radius + peg * np.cos(angle)]
    )
    across = np.linspace(radius, -radius, 2 * _CORNER + 1)[1:]
    face = np.column_stack([np.full(len(across), LENGTH), np.full(len(across), peg), across])
    return np.concatenate([side, corner, face])


def _touches(free: Array) -> Array:
    """(G,) ascending; the frames' own curvatures are among them, for readings have a kink there."""
    ends = np.unique(np.concatenate([[1e-3 * free.max()], free[free > 2e-3 * free.max()]]))
    step = free.max() / _TOUCHES
    parts = [
        np.linspace(low, high, 1 + max(1, round((high - low) / step)))[:-1]
        for low, high in pairwise(ends)
    ]
    return np.concatenate([*parts, ends[-1:]])


@lru_cache(maxsize=8)
def bodies(inflation: Inflation) -> Bodies:
    """The table of an inflation (seconds, then kept)."""
    free = np.array(inflation.free)
    outline = _outline(inflation.radius, inflation.peg)
    touch = _touches(free)
    heading = touch * outline[:, :1]
    x = np.sin(heading) / touch
    x += outline[:, 1:2] * np.cos(heading) - outline[:, 2:] * np.sin(heading)
    y = (1.0 - np.cos(heading)) / touch
    y += outline[:, 1:2] * np.sin(heading) + outline[:, 2:] * np.cos(heading)
    along = np.gradient(x, axis=0), np.gradient(y, axis=0)
    onward = np.gradient(x, axis=1), np.gradient(y, axis=1)
    # Where the skin recedes as the body bends, it meets nothing.
    weight = np.maximum(along[0] * onward[1] - along[1] * onward[0], 0.0)
    cells = round(LENGTH / _CELL)
    centres: Array = np.linspace(0.5 * _CELL, LENGTH - 0.5 * _CELL, cells)
    spans = np.full(cells, _CELL)
    table = np.zeros((*x.shape, len(free), cells + 1))
    arc = np.full(x.shape, np.nan)
    mean = np.empty(cells)
    peg = np.stack([x, y], axis=-1)
    for a, g in np.ndindex(x.shape):
        rod = inflation.bend(peg[a, g], float(touch[g]))
        for frame, curvature in enumerate(inflation.free):
            if curvature <= touch[g]:
                mean[:] = curvature
            else:
                rod.step(curvature, LENGTH)
                rod.averages_into(centres, spans, mean)
            np.cumsum(mean * _CELL, out=table[a, g, frame, 1:])
        if inflation.free[-1] <= touch[g]:
            arc[a, g] = outline[a, 0]
        elif rod.touching and not rod.approximate:
            arc[a, g] = rod.contacts()[-1].arc
    return Bodies(touch, peg, weight, table, arc)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What N sensors would read of the bodies, each displaced by each of D shifts.

    Attributes:
        mean: (A, G, T, N, D) average curvature.
        blur: (A, G, N, D) its variance between a shift and the next.
    """

    mean: Array
    blur: Array


@lru_cache(maxsize=8)
def seen(
    inflation: Inflation, low: tuple[float, ...], high: tuple[float, ...], place: float
) -> Seen:
    """The readings of sensors from `low` to `high` whose places are known to `place`."""
    shifts = SHIFTS * place if place > 0.0 else np.zeros(1)
    heading = bodies(inflation).heading
    mean = np.stack(
        [_means(heading, a, b, shifts) for a, b in zip(low, high, strict=True)], axis=-2
    )
    step = np.gradient(mean, axis=-1) if len(shifts) > 1 else np.zeros_like(mean)
    return Seen(mean, (step**2).mean(axis=2) / 12.0)


def _means(heading: Array, low: float, high: float, shifts: Array) -> Array:
    span = max(high - low, 2.0 * _CELL)
    middle = 0.5 * (high + low)
    # A sensor stays on the body.
    at = np.clip(middle + shifts, min(span / 2, middle), LENGTH - min(span / 2, LENGTH - middle))
    near, far = np.maximum(at - span / 2, 0.0), np.minimum(at + span / 2, LENGTH)
    ends = []
    for end in (near, far):
        cell = np.minimum((end / _CELL).astype(np.int64), heading.shape[-1] - 2)
        share = end / _CELL - cell
        ends.append((1.0 - share) * heading[..., cell] + share * heading[..., cell + 1])
    return np.asarray((ends[1] - ends[0]) / (far - near))
