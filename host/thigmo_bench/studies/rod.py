"""Independent truth for studies and tests: bodies under known loads, by the equations of the rod.

A planar inextensible rod (Kirchhoff), clamped at the base, EI = 1 (times `stiffness`), free
curvature g. Integration starts at the most distal load, in the frame of the section there, where
heading and place are zero. Each further load on the way to the base is given in the frame of its
own section, and the heading of that section is known by then. So this is an initial value problem,
solved without iteration. Between loads the moment m obeys m' = -(t x F), and the curvature is g + m
/ EI. It shares no code with the localizer (levers of a fitted shape) nor with the emulator's plant
(an energy minimum), so each can check the others. Many bodies are integrated side by side. Source:
Antman, Nonlinear Problems of Elasticity, chapter 4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Profile = Callable[[Floats], Floats]

STEPS = 24  # Runge-Kutta steps between loads: errors below 1e-8 at a vine robot's bends


@dataclass(frozen=True)
class Bodies:
    """S bodies in equilibrium under E loads each."""

    breaks: Floats  # (S, E + 2) base, loads, tip
    # (S, E + 1, STEPS + 1) of the pieces between them, in the last load's frame without the kinks
    heading: Floats
    curvature: Floats
    kink: Floats  # (S, E) rad
    base_moment: Floats  # (S,) moment of the loads at the base, over EI
    base: Floats  # (3, S) heading, x and y of the base in the last load's frame
    at_loads: Floats  # (3, S, E) the same of the loaded sections, on their far sides

    def turn(self, arcs: Floats) -> Floats:
        """(S, Q) heading at arcs (S, Q), without the kinks: cubic between the nodes."""
        piece = (arcs[:, :, None] >= self.breaks[:, None, 1:-1]).sum(axis=2)
        low = np.take_along_axis(self.breaks, piece, 1)
        step = (np.take_along_axis(self.breaks, piece + 1, 1) - low) / STEPS
        node_position = (arcs - low) / np.maximum(step, 1e-12)
        node = np.clip(node_position.astype(int), 0, STEPS - 1)
        t = node_position - node
        body = np.arange(len(arcs))[:, None]
        first, second = (body, piece, node), (body, piece, node + 1)
        near = self.heading[first] * (1.0 + 2.0 * t) + self.curvature[first] * step * t
        far = self.heading[second] * (3.0 - 2.0 * t) + self.curvature[second] * step * (t - 1.0)
        heading: Floats = near * (1.0 - t) ** 2 + far * t**2
        return heading

    def readings(self, position: Floats, span: float | Floats = 0.0) -> Floats:
        """(S, N) average curvature over sensors at `position` (N,), or the curvature at points.

        Not a number for a sensor that lies beyond the body.
        """
        bodies, length = len(self.breaks), self.breaks[:, -1:]
        # A point's curvature is the mean over a hundred-thousandth of the body.
        half = np.maximum(0.5 * np.asarray(span), 5e-6 * length)
        low = np.clip(np.broadcast_to(position, (bodies, len(position))) - half, 0.0, length)
        high = np.clip(position + half, 0.0, length)
        kinks = self.breaks[:, None, 1:-1]
        covered = (kinks > low[:, :, None]) & (kinks < high[:, :, None])
        kinked = (covered * self.kink[:, None, :]).sum(axis=2)
        turn = self.turn(high) - self.turn(low) + kinked
        mean: Floats = turn / np.where(high > low, high - low, np.nan)
        return mean


def solve(
    arcs: Floats,
    normal: Floats,
    *,
    length: float,
    free_curvature: float | Floats = 0.0,
    tangential: float | Floats = 0.0,
    couple: float | Floats = 0.0,
    kink: float | Floats = 0.0,
    stiffness: Profile | None = None,
    evenness: Profile | None = None,
    added: float | Floats = 0.0,
) -> Bodies:
    """Bodies in equilibrium under loads at `arcs` (S, E), rising, of everted length `length`.

    Loads are over EI: forces `normal` (S, E) to the body where they act, positive towards +y,
    `tangential` along it, towards its tip, and moments `couple` beside theirs. `kink` is a turn
    (rad) of the body there, whatever the load. The free curvature is one, (S, 1), or (S, E + 1) for
    each piece between loads; `stiffness` turns arcs (S,) into stiffness over EI, 1 if not given.
    `evenness` turns arcs into factors of the free curvature; `added` is curvature besides, as a
    fold's, (S, E + 1).
    """
    bodies, loads = arcs.shape
    normal, tangential, couple, kink = (
        np.broadcast_to(np.asarray(load, dtype=float), (bodies, loads))
        for load in (normal, tangential, couple, kink)
    )
    free, extra = (
        np.broadcast_to(np.asarray(value, dtype=float), (bodies, loads + 1))
        for value in (free_curvature, added)
    )

    def unloaded(arc: Floats, piece: int) -> Floats:
        factor = 1.0 if evenness is None else evenness(arc)
        curvature: Floats = free[:, piece] * factor + extra[:, piece]
        return curvature

    breaks = np.concatenate([np.zeros((bodies, 1)), arcs, np.full((bodies, 1), length)], axis=1)
    heading = np.empty((bodies, loads + 1, STEPS + 1))
    curvature = np.empty_like(heading)
    # Beyond the last load the body turns by itself: Simpson's rule.
    h = (breaks[:, -1] - breaks[:, -2]) / STEPS
    curvature[:, -1, 0], heading[:, -1, 0] = unloaded(breaks[:, -2], loads), 0.0
    for node in range(1, STEPS + 1):
        arc = breaks[:, -2] + node * h
        curvature[:, -1, node] = unloaded(arc, loads)
        middle = 4.0 * unloaded(arc - 0.5 * h, loads)
        mean = (curvature[:, -1, node - 1] + middle + curvature[:, -1, node]) / 6.0
        heading[:, -1, node] = heading[:, -1, node - 1] + h * mean
    state = np.zeros((4, bodies))  # heading, x, y, moment
    force_x, force_y, kinked = np.zeros((3, bodies))
    at_loads = np.empty((3, bodies, loads))

    def slope(arc: Floats, state: Floats, piece: int) -> Floats:
        cosine, sine = np.cos(state[0]), np.sin(state[0])
        soft = state[3] if stiffness is None else state[3] / stiffness(arc)
        turns = unloaded(arc, piece) + soft
        return np.array([turns, cosine, sine, sine * force_x - cosine * force_y])

    for e in reversed(range(loads)):
        at_loads[:, :, e] = state[:3]
        cosine, sine = np.cos(state[0]), np.sin(state[0])
        force_x = force_x + tangential[:, e] * cosine - normal[:, e] * sine
        force_y = force_y + tangential[:, e] * sine + normal[:, e] * cosine
        state[3] += couple[:, e]
        state[0] -= kink[:, e]
        kinked = kinked + kink[:, e]
        arc = breaks[:, e + 1]
        h = (breaks[:, e] - arc) / STEPS
        for node in reversed(range(STEPS + 1)):
            a = slope(arc, state, e)
            heading[:, e, node] = state[0] + kinked
            curvature[:, e, node] = a[0]
            if node > 0:
                b = slope(arc + 0.5 * h, state + 0.5 * h * a, e)
                c = slope(arc + 0.5 * h, state + 0.5 * h * b, e)
                d = slope(arc + h, state + h * c, e)
                state = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
                arc = arc + h
    return Bodies(breaks, heading, curvature, kink, state[3], state[:3], at_loads)


def readings(
    arcs: Floats, normal: Floats, position: Floats, span: float | Floats = 0.0, **options: Any
) -> Floats:
    """(N,) readings of one body under loads (C,) in any order; options are those of `solve`."""
    order = np.argsort(arcs)
    bodies = solve(arcs[None, order], normal[None, order], **options)
    only: Floats = bodies.readings(position, span)[0]
    return only
