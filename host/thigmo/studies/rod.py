"""Independent truth for the studies: what sensors read on a large-deflection rod under known loads.

The rod under contact forces that stay normal to it is an initial value problem from the tip to the
base: k' = -sum_j f_j cos(theta - theta_j), theta' = k, with k(L) = g. It shares no code with the
localizer (a linear beam) nor with the emulator's plant (an energy minimum), so all three can be
held against each other. Integrated with classical Runge-Kutta between breakpoints, EI = 1.
Source: Antman, Nonlinear Problems of Elasticity, chapter 4.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled

Floats = NDArray[np.float64]

_MAX_STEP = 1.0 / 24.0  # of the length: error below 1e-9 at the bends of a vine robot


@compiled
def _readings(
    arcs: Floats,
    normal: Floats,
    tangential: Floats,
    arm: float,
    free: float,
    length: float,
    position: Floats,
    span: Floats,
    out: Floats,
) -> float:
    """Fill `out` with the sensors' average curvature; returns the heading of the tip."""
    sensors = position.size
    contacts = arcs.size
    points = np.empty(2 * sensors + contacts + 2)
    points[0] = 0.0
    points[1] = length
    for i in range(sensors):
        points[2 + 2 * i] = max(position[i] - span[i] / 2, 0.0)
        points[3 + 2 * i] = min(position[i] + span[i] / 2, length)
    for j in range(contacts):
        points[2 + 2 * sensors + j] = arcs[j]
    points = np.sort(points)[::-1]
    theta_at = np.zeros(points.size)
    k_at = np.zeros(points.size)
    theta_contact = np.zeros(contacts)
    acting = np.zeros(contacts)
    theta = 0.0
    k = free
    for p in range(points.size):
        if p > 0:
            gap = points[p - 1] - points[p]
            if gap > 0.0:
                steps = math.ceil(gap / (length * _MAX_STEP))
                h = -gap / steps
                for _ in range(steps):
                    k1, t1 = 0.0, k
                    k2, k3, k4 = 0.0, 0.0, 0.0
                    for j in range(contacts):
                        if acting[j] > 0.0:
                            d = theta - theta_contact[j]
                            k1 -= normal[j] * math.cos(d) - tangential[j] * math.sin(d)
                    t2 = k + 0.5 * h * k1
                    for j in range(contacts):
                        if acting[j] > 0.0:
                            d = theta + 0.5 * h * t1 - theta_contact[j]
                            k2 -= normal[j] * math.cos(d) - tangential[j] * math.sin(d)
                    t3 = k + 0.5 * h * k2
                    for j in range(contacts):
                        if acting[j] > 0.0:
                            d = theta + 0.5 * h * t2 - theta_contact[j]
                            k3 -= normal[j] * math.cos(d) - tangential[j] * math.sin(d)
                    t4 = k + h * k3
                    for j in range(contacts):
                        if acting[j] > 0.0:
                            d = theta + h * t3 - theta_contact[j]
                            k4 -= normal[j] * math.cos(d) - tangential[j] * math.sin(d)
                    theta += h / 6.0 * (t1 + 2.0 * t2 + 2.0 * t3 + t4)
                    k += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        for j in range(contacts):
            if acting[j] == 0.0 and points[p] == arcs[j]:
                acting[j] = 1.0
                theta_contact[j] = theta
                k += tangential[j] * arm
        theta_at[p] = theta
        k_at[p] = k
    for i in range(sensors):
        low = max(position[i] - span[i] / 2, 0.0)
        high = min(position[i] + span[i] / 2, length)
        theta_low, theta_high, k_mid = 0.0, 0.0, 0.0
        for p in range(points.size):
            if points[p] == high:
                theta_high = theta_at[p]
                k_mid = k_at[p]
            if points[p] == low:
                theta_low = theta_at[p]
        out[i] = (theta_high - theta_low) / (high - low) if high > low else k_mid
    return -theta


def readings(
    arcs: Floats,
    normal: Floats,
    position: Floats,
    *,
    length: float,
    span: Floats | float = 0.0,
    free_curvature: float = 0.0,
    tangential: Floats | None = None,
    arm: float = 0.0,
    fold_angle: float = 0.0,
    fold_length: float = 0.0,
) -> Floats:
    """Average curvature over each sensor's span, without noise.

    Args:
        arcs: (C,) arc lengths of the contacts.
        normal: (C,) forces over EI normal to the rod, positive to its left.
        position, span: (N,) sensor centres and active lengths.
        length: everted length.
        free_curvature: curvature without contact.
        tangential: (C,) force components over EI along the rod's tangent, towards the tip
            (a peg bearing on the tip's corner).
        arm: signed distance of the tangential forces' line from the centreline, left positive;
            they add the moment -arm * tangential ahead of their arc.
        fold_angle, fold_length: a base fold of so many radians spread evenly over so much arc.

    Returns:
        (N,) readings.
    """
    position = np.ascontiguousarray(position, dtype=np.float64)
    spans = np.broadcast_to(np.asarray(span, dtype=np.float64), position.shape).copy()
    arcs = np.atleast_1d(np.asarray(arcs, dtype=np.float64))
    normal = np.atleast_1d(np.asarray(normal, dtype=np.float64))
    along = np.zeros_like(normal) if tangential is None else np.asarray(tangential, dtype=float)
    out = np.empty_like(position)
    _readings(arcs, normal, along, -arm, free_curvature, length, position, spans, out)
    if fold_angle and fold_length:
        low = np.clip(position - spans / 2, 0.0, fold_length)
        high = np.clip(position + spans / 2, 0.0, fold_length)
        share = np.where(spans > 0, (high - low) / np.maximum(spans, 1e-12), 0.0)
        out += fold_angle / fold_length * share
    return out
