"""A body bent into a peg, solved from the equations of the rod alone: truth from neither thigmo's
plant nor its studies' rod.

Planar inextensible rod (Kirchhoff), EI = 1, free curvature g, clamped at the origin along x, and a
round frictionless peg anywhere on its outline. Shooting starts at the contact, in the frame of the
section there: with heading and place zero and the force known, curvature obeys k' = -(t x F) back
to the base, so nothing but the place u on the outline and the size of the force is unknown. They
follow from where the peg stands in the room.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import root

TUBE, PEG = 1.75, 1.05
CRITICAL = 0.01108
STEP = 1.0 / 32.0  # of the arc: error below 1e-8


class SlippedError(Exception):
    """The body passes the peg."""


def outline(u: float, length: float) -> tuple[float, np.ndarray, np.ndarray, float]:
    """Arc, peg's centre in the section's frame, direction of its push, and the push's couple.

    `u` runs along the left side (as arc), round the left corner, across the face and round the
    right corner, as the peg's centre does.
    """
    if u <= length:
        return u, np.array([0.0, TUBE + PEG]), np.array([0.0, -1.0]), 0.0
    along = u - length
    quarter = 0.5 * math.pi * PEG
    if along <= quarter:
        angle, offset = along / PEG, TUBE
    elif along <= quarter + 2.0 * TUBE:
        angle, offset = 0.5 * math.pi, TUBE - (along - quarter)
    else:
        angle, offset = (along - 2.0 * TUBE) / PEG, -TUBE
    if angle > math.pi:
        raise SlippedError
    away = np.array([math.sin(angle), math.cos(angle)])
    return length, np.array([0.0, offset]) + PEG * away, -away, offset * away[0]


@dataclass(frozen=True)
class Pressed:
    """One equilibrium: place on the outline, size of the force, free curvature, length."""

    u: float
    force: float
    free: float
    length: float

    @property
    def arc(self) -> float:
        return min(self.u, self.length)

    def heading(self, arcs: np.ndarray) -> np.ndarray:
        """(K,) heading at arcs, relative to the section of the contact."""
        bent = self._shot(np.minimum(arcs, self.arc))[0]
        return bent + self.free * np.maximum(arcs - self.arc, 0.0)

    def readings(self, position: np.ndarray, span: float) -> np.ndarray:
        """(N,) average curvature over the sensors, or that at points."""
        half = max(0.5 * span, 1e-4)
        low = np.maximum(position - half, 0.0)
        high = np.minimum(position + half, self.length)
        return (self.heading(high) - self.heading(low)) / (high - low)

    @property
    def moment(self) -> float:
        """Of the contact at the base."""
        return abs(float(self._shot(np.zeros(1))[3, 0]) - self.free)

    def _shot(self, arcs: np.ndarray) -> np.ndarray:
        """(4, K) heading, x, y, curvature at arcs, in the frame of the contact's section."""
        arc, _, push, couple = outline(self.u, self.length)
        along, across = (self.force * push).tolist()

        def slope(heading: float, k: float) -> tuple[float, float, float, float]:
            cosine, sine = math.cos(heading), math.sin(heading)
            return k, cosine, sine, sine * along - cosine * across

        stops = np.unique(np.append(arcs, 0.0))[::-1]
        s, state = arc, [0.0, 0.0, 0.0, self.free + self.force * couple]
        out = np.empty((4, len(stops)))
        for column, stop in enumerate(stops.tolist()):
            # Classical Runge and Kutta; plain floats are faster here than arrays of four.
            steps = math.ceil((s - stop) / (STEP * arc)) or 1
            h = (stop - s) / steps
            for _ in range(steps):
                t, _, _, k = state
                a = slope(t, k)
                b = slope(t + 0.5 * h * a[0], k + 0.5 * h * a[3])
                c = slope(t + 0.5 * h * b[0], k + 0.5 * h * b[3])
                d = slope(t + h * c[0], k + h * c[3])
                state = [
                    old + h / 6.0 * (p + 2.0 * q + 2.0 * r + w)
                    for old, p, q, r, w in zip(state, a, b, c, d, strict=True)
                ]
            s = stop
            out[:, column] = state
        return out[:, np.searchsorted(-stops, -arcs)]

    def missed(self, peg: np.ndarray) -> np.ndarray:
        """(2,) from where the outline has the peg to where it stands in the room."""
        heading, x, y, _ = self._shot(np.zeros(1))[:, 0]
        cosine, sine = math.cos(heading), math.sin(heading)
        seen = [x + cosine * peg[0] - sine * peg[1], y + sine * peg[0] + cosine * peg[1]]
        return np.array(seen) - outline(self.u, self.length)[1]


def touched(u: float, free: float, length: float) -> np.ndarray:
    """(2,) centre of a peg that the body just touches."""
    arc, centre, _, _ = outline(u, length)
    heading = free * arc
    cosine, sine = math.cos(heading), math.sin(heading)
    place = np.array([sine, 1.0 - cosine]) / free
    return place + np.array([[cosine, -sine], [sine, cosine]]) @ centre


def inflated(u: float, touch: float, frees: np.ndarray, length: float) -> list[Pressed | None]:
    """Equilibria at rising free curvatures, None before the touch.

    Raises:
        SlippedError: the body passes the peg.
    """
    peg = touched(u, touch, length)
    place, before = np.array([u, 0.0]), touch
    out: list[Pressed | None] = []
    for goal in frees:
        if goal <= touch:
            out.append(None)
            continue
        steps = math.ceil((goal - before) / 0.004)
        for free in np.linspace(before, goal, steps + 1)[1:]:
            # Forces are of the order of 1e-3.
            found = root(
                lambda z, g=free: Pressed(z[0], 1e-3 * z[1], g, length).missed(peg),
                place * [1.0, 1e3],
                tol=1e-7,
            )
            if not found.success or found.x[1] < 0.0:
                raise SlippedError
            place = found.x * [1.0, 1e-3]
        before = goal
        out.append(Pressed(float(place[0]), float(place[1]), float(goal), length))
    return out


def room(rng: np.random.Generator, frees: np.ndarray, length: float) -> list[Pressed | None]:
    """A peg anywhere in the room, through an inflation that ends with it felt, below the fold."""
    while True:
        u = rng.uniform(8.0, length + math.pi * PEG + 2.0 * TUBE)
        touch = rng.uniform(1e-3, frees[-1])
        step = 1e-5
        along = (touched(u + step, touch, length) - touched(u, touch, length)) / step
        onward = (touched(u, touch + step, length) - touched(u, touch, length)) / step
        # Even over the room: as likely as the area that a step of both sweeps.
        area = along[0] * onward[1] - along[1] * onward[0]
        if rng.uniform(0.0, 0.95 * length**2) > area:
            continue
        try:
            frames = inflated(u, touch, frees, length)
        except SlippedError:
            continue
        last = frames[-1]
        if last is not None and 0.3 * CRITICAL < last.moment < 1.2 * CRITICAL:
            return frames
