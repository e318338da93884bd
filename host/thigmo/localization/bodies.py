"""Bodies bent into a peg, for every place of the room that a body reaches as it bends.

A peg's place is told by where on the outline of the body it is first touched (along the side, round
the corner, across the face of the end) and at which free curvature. From that touch the
large-deflection rod is followed to the most that the body bends. `frames` compares the tables
with readings; they depend on the body and its sensors only, so they are kept for the next sweep.
Peg at +y, lengths those of a body of 53 cm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from thigmo.mechanics import Peg, Rod, Solution, Tube

Array = npt.NDArray[np.float64]

LENGTH = 53.0
_SIDE = np.linspace(8.0, LENGTH, 37)
_CORNER = 5  # places round the corner of the end, and across half of its face
_TOUCHES = 28  # free curvatures of touch
_BENDS = 9  # from the touch to the most bend
_LEAST_BEND = 1e-3  # first of the touches, over the most bend
_MESH = 2.0  # of the rod: 1e-8 1/cm on its curvature


@dataclass(frozen=True, slots=True)
class BentBody:
    """A body that bends towards +y, and the peg's size."""

    most: float  # free curvature that it reaches
    # radius, peg: of the tube and the peg
    radius: float
    peg: float
    critical: float | None  # moment at which the base folds, or None
    # low, high: (N,) ends of the sensors
    low: tuple[float, ...]
    high: tuple[float, ...]
    shift: float  # by which the sensors are displaced to learn what an error of their places does

    def at_touch(self, centre: Array, touch: float) -> Rod:
        """The body where a peg at `centre` is about to touch it, at the free curvature `touch`."""
        peg = Peg(float(centre[0]), float(centre[1]), self.peg)
        rod = Rod(Tube(2.0 * self.radius, self.critical), [peg], cell_cm=_MESH)
        rod.assume_free(touch * (1.0 - 1e-6), LENGTH)
        return rod

    def against(self, centre: Array, touch: float, free: float) -> Solution:
        """The body bent into a peg at `centre`, up to a free curvature beyond the touch."""
        rod = self.at_touch(centre, touch)
        for bend in np.linspace(touch, free, _BENDS)[1:]:
            rod.step(float(bend), LENGTH)
        return rod.solution()


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """A places along the outline, G free curvatures of touch, U bends from there to the most."""

    touch: Array  # (G,)
    peg: Array  # (A, G, 2) centres
    weight: Array  # (A, G) area of the room over a step of both
    # (A, G, U, 3, N) what the sensors read above the free body, where they are and displaced back
    # and forth
    held: Array
    arc: Array  # (A, G, U) of the contact; NaN where there is none


def _outline(radius: float, peg: float) -> Array:
    """(A, 3) arc, and the centre of a touching peg from there: along the tangent, the normal.

    From near the base along the side at +y, round its corner, across the face.
    """
    side = np.column_stack([_SIDE, np.zeros(len(_SIDE)), np.full(len(_SIDE), radius + peg)])
    angle = np.linspace(0.0, math.pi / 2, _CORNER + 1)[1:]
    corner = np.column_stack(
        [np.full(_CORNER, LENGTH), peg * np.sin(angle), radius + peg * np.cos(angle)]
    )
    across = np.linspace(radius, -radius, 2 * _CORNER + 1)[1:]
    face = np.column_stack([np.full(len(across), LENGTH), np.full(len(across), peg), across])
    return np.concatenate([side, corner, face])


@lru_cache(maxsize=8)
def bodies(body: BentBody) -> Bodies:
    """The table of a body (seconds, then kept)."""
    outline = _outline(body.radius, body.peg)
    touch = body.most * np.linspace(_LEAST_BEND, 1.0 - 0.5 / _TOUCHES, _TOUCHES)
    heading = touch * outline[:, :1]
    x = np.sin(heading) / touch
    x += outline[:, 1:2] * np.cos(heading) - outline[:, 2:] * np.sin(heading)
    y = (1.0 - np.cos(heading)) / touch
    y += outline[:, 1:2] * np.sin(heading) + outline[:, 2:] * np.cos(heading)
    along = np.gradient(x, axis=0), np.gradient(y, axis=0)
    onward = np.gradient(x, axis=1), np.gradient(y, axis=1)
    # Where the skin recedes as the body bends, it meets nothing.
    weight = np.maximum(along[0] * onward[1] - along[1] * onward[0], 0.0)
    low, high = np.array(body.low), np.array(body.high)
    shift = body.shift * np.array([0.0, -1.0, 1.0])[:, None]
    span = high - low
    centre = np.clip(0.5 * (low + high) + shift, 0.5 * span, LENGTH - 0.5 * span).ravel()
    spans = np.broadcast_to(span, (3, span.size)).ravel().copy()
    held = np.zeros((*x.shape, _BENDS, centre.size))
    arc = np.full((*x.shape, _BENDS), np.nan)
    arc[..., 0] = outline[:, :1]
    peg = np.stack([x, y], axis=-1)
    for a, g in np.argwhere(weight > 0.0):
        rod = body.at_touch(peg[a, g], float(touch[g]))
        for u, bend in enumerate(np.linspace(touch[g], body.most, _BENDS)[1:], start=1):
            rod.step(float(bend), LENGTH)
            rod.averages_into(centre, spans, held[a, g, u])
            held[a, g, u] -= bend
            if rod.touching and rod.status != "approximate":
                arc[a, g, u] = rod.contacts()[-1].arc
    return Bodies(touch, peg, weight, held.reshape(*x.shape, _BENDS, 3, -1), arc)
