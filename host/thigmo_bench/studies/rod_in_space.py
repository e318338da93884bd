"""Independent truth in space: rods under known loads, by the equations of the rod.

An inextensible rod (Kirchhoff), clamped at the base, EI = 1, torsional stiffness 1 / `twist`, or
none if that is 0. Integration starts at the tip and in its frame, because nothing acts beyond
it. Each load on the way to the base is given in the frame of its own section, and the
weight in the tip's, so this is an initial value problem, solved without iteration. Force and moment
of the part beyond a section obey n' = -w and m' = n x t; the curvature is free + K R' m. Frames are
integrated as matrices by Runge and Kutta, on nodes between the loads: nothing is shared with the
localizer (cells of constant curvature, running sums). Source: Antman, Nonlinear Problems of
Elasticity, chapter 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thigmo_bench.studies.rod import Floats

STEPS = 60  # Runge-Kutta steps between loads: errors of turns below 1e-7


@dataclass(frozen=True)
class RodsInSpace:
    """S rods in equilibrium under E loads each, of length one, in the base's frame."""

    breaks: Floats  # (S, E + 2) base, loads, tip
    turned: Floats  # (S, E + 1, STEPS + 1, 3) integral of the curvature from the tip
    curvature: Floats  # (S, E + 1, STEPS + 1, 3) along the body, about the normal and the binormal
    forces: Floats  # (S, E, 3)
    weight: Floats  # (S, 3) per length
    tip: Floats  # (S, 3) direction of the tip

    def _integral(self, arcs: Floats) -> Floats:
        """(S, Q, 3) of the curvature up to arcs (Q,): cubic between the nodes."""
        rods = np.arange(len(self.breaks))[:, None]
        piece = (arcs[None, :, None] >= self.breaks[:, None, 1:-1]).sum(axis=2)
        low = np.take_along_axis(self.breaks, piece, 1)
        step = (np.take_along_axis(self.breaks, piece + 1, 1) - low) / STEPS
        node_position = (arcs - low) / np.maximum(step, 1e-12)
        node = np.clip(node_position.astype(int), 0, STEPS - 1)
        t, h = (node_position - node)[..., None], step[..., None]
        first, second = (rods, piece, node), (rods, piece, node + 1)
        near = self.turned[first] * (1.0 + 2.0 * t) + self.curvature[first] * h * t
        far = self.turned[second] * (3.0 - 2.0 * t) + self.curvature[second] * h * (t - 1.0)
        out: Floats = near * (1.0 - t) ** 2 + far * t**2
        return out

    def readings(self, position: Floats, axis: Floats, span: float) -> Floats:
        """(S, N) mean curvature about axes (N, 3) over sensors at `position` (N,)."""
        low, high = (np.clip(position + side * span / 2.0, 0.0, 1.0) for side in (-1.0, 1.0))
        mean = (self._integral(high) - self._integral(low)) / (high - low)[:, None]
        out: Floats = np.einsum("snj,nj->sn", mean, axis)
        return out


def solve(
    arcs: Floats,
    force: Floats,
    *,
    couple: Floats | None = None,
    free: Floats | None = None,
    weight: Floats | None = None,
    twist: float = 0.0,
) -> RodsInSpace:
    """Rods in equilibrium.

    Args:
        arcs: (S, E) ascending arcs of the loads.
        force: (S, E, 3) forces over EI in the frame of the section: along, normal, binormal.
        couple: (S, E, 3) couples over EI in the same frame; none if not given.
        free: (S, 3) curvature of the free body in its own frame.
        weight: (S, 3) weight per length over EI, in the frame of the tip.
        twist: EI over the torsional stiffness.
    """
    rods, loads = arcs.shape
    couple = np.zeros_like(force) if couple is None else couple
    free_curvature, heavy = (np.zeros((rods, 3)) if v is None else v for v in (free, weight))
    compliance = np.array([twist, 1.0, 1.0])
    breaks = np.concatenate([np.zeros((rods, 1)), arcs, np.ones((rods, 1))], axis=1)
    turned = np.zeros((rods, loads + 1, STEPS + 1, 3))
    curvature = np.zeros_like(turned)
    # columns: frame, force, moment, integral of the curvature
    state = np.concatenate([np.tile(np.eye(3), (rods, 1, 1)), np.zeros((rods, 3, 3))], axis=2)
    world = np.zeros((rods, loads, 3))

    def curvature_of(state: Floats) -> Floats:
        u: Floats = free_curvature + compliance * np.einsum(
            "sij,si->sj", state[:, :, :3], state[:, :, 4]
        )
        return u

    def slope(state: Floats) -> Floats:
        u = curvature_of(state)
        t, n, b = np.moveaxis(state[:, :, :3], 2, 0)
        u1, u2, u3 = (u[:, j : j + 1] for j in range(3))
        columns = [
            u3 * n - u2 * b, u1 * b - u3 * t, u2 * t - u1 * n,
            -heavy, np.cross(state[:, :, 3], t), u,
        ]  # fmt: skip
        out: Floats = np.stack(columns, axis=2)
        return out

    for piece in reversed(range(loads + 1)):
        h = (breaks[:, piece] - breaks[:, piece + 1])[:, None, None] / STEPS
        for node in reversed(range(STEPS + 1)):
            turned[:, piece, node], curvature[:, piece, node] = state[:, :, 5], curvature_of(state)
            if node == 0:
                break
            a = slope(state)
            b = slope(state + 0.5 * h * a)
            c = slope(state + 0.5 * h * b)
            d = slope(state + h * c)
            state = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        if piece > 0:
            frame = state[:, :, :3]
            world[:, piece - 1] = np.einsum("sij,sj->si", frame, force[:, piece - 1])
            state[:, :, 3] += world[:, piece - 1]
            state[:, :, 4] += np.einsum("sij,sj->si", frame, couple[:, piece - 1])
    base = state[:, :, :3]
    forces, down = np.einsum("sij,sei->sej", base, world), np.einsum("sij,si->sj", base, heavy)
    return RodsInSpace(breaks, turned, curvature, forces, down, base[:, 0])
