"""What the compiled solvers share: readings with their sensors, objectives, ends of spans.

A sensor is given by its near end `low`, span `span` and `inverse` = 1 / (2 span), 0 for a point
sensor, so that its response needs no branch. Everything is homogeneous in the units.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled_sums

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Readings(NamedTuple):
    """N readings and the sensors that they are from.

    Attributes:
        y: (N,) readings above free curvature.
        low: (N,) near ends of the spans.
        span: (N,).
        inverse: (N,) 1 / (2 span), or 0.
        w: (N,) weights.
    """

    y: Floats
    low: Floats
    span: Floats
    inverse: Floats
    w: Floats


class ForceRange(NamedTuple):
    """Least and largest force over EI that a fit may take; infinite for no bound."""

    low: float
    high: float


# Kernels over rows write one row for each: objective, arc, force, number of ranges, then both ends
# of up to PIECES ranges.
PIECES = 4
RANGES = 4  # where they start
WRITTEN = RANGES + 2 * PIECES

INNER_END = 1e-9  # where in the first cell its open end is looked at, as a share of the cell


@compiled_sums
def plain(value: int) -> int:
    """The same integer, but no literal: callees are not compiled once more for its value."""
    return value + 0


@compiled_sums
def usable(y: Floats, sensors: Floats, length: Floats) -> bool:
    """Whether a fit can be made of these rows.

    Args:
        y: (B, N), NaN for a missing sensor; none may be infinite.
        sensors: (1 or B, 3, N) centres, spans and weights: finite, the last two >= 0.
        length: (1 or B,) everted lengths, finite and > 0.
    """
    fine = True
    for b in range(y.shape[0]):
        for j in range(y.shape[1]):
            fine = fine and abs(y[b, j]) != np.inf
    for b in range(sensors.shape[0]):
        for j in range(sensors.shape[2]):
            fine = fine and abs(sensors[b, 0, j]) < np.inf
            fine = fine and 0.0 <= sensors[b, 1, j] < np.inf
            fine = fine and 0.0 <= sensors[b, 2, j] < np.inf
    for b in range(length.shape[0]):
        fine = fine and 0.0 < length[b] < np.inf
    return fine


@compiled_sums
def inverse_spans(span: Floats) -> Floats:
    """`Readings.inverse` of the spans."""
    out = np.zeros(span.shape[0])
    for j in range(span.shape[0]):
        if span[j] > 0.0:
            out[j] = 0.5 / span[j]
    return out


@compiled_sums
def objective_l1(
    arc: float, force: float, y: Floats, low: Floats, span: Floats, inverse: Floats, w: Floats
) -> float:
    """Sum of w |y - f phi|."""
    total = 0.0
    for j in range(y.shape[0]):
        inside = min(max(arc - low[j], 0.0), span[j])
        phi = inside * inside * inverse[j] + (max(arc - low[j], span[j]) - span[j])
        total += w[j] * abs(y[j] - force * phi)
    return total


@compiled_sums
def objective_l2(
    arc: float, force: float, y: Floats, low: Floats, span: Floats, inverse: Floats, w: Floats
) -> float:
    """Sum of (w (y - f phi))^2."""
    total = 0.0
    for j in range(y.shape[0]):
        inside = min(max(arc - low[j], 0.0), span[j])
        phi = inside * inside * inverse[j] + (max(arc - low[j], span[j]) - span[j])
        r = w[j] * (y[j] - force * phi)
        total += r * r
    return total


@compiled_sums
def find_edges(low: Floats, span: Floats, length: float, edges: Floats) -> int:
    """Sorted distinct ends of spans within [0, length], 0 and length included; returns how many.

    Args:
        low: (N,).
        span: (N,).
        length: everted length.
        edges: (2 N + 2,), written.
    """
    n = low.shape[0]
    count = 2
    edges[0] = 0.0
    edges[1] = length
    for j in range(n):
        for side in range(2):
            e = low[j] + side * span[j]
            if e <= 0.0 or e >= length or (side == 1 and span[j] == 0.0):
                continue
            k = count - 1
            while edges[k] > e:
                k -= 1
            if edges[k] == e:
                continue
            for m in range(count, k + 1, -1):
                edges[m] = edges[m - 1]
            edges[k + 1] = e
            count += 1
    return count


@compiled_sums
def first_influence(low: Floats, edges: Floats) -> int:
    """Index of the last edge at which no sensor answers yet (0 if one answers at the base)."""
    least = np.inf
    for j in range(low.shape[0]):
        least = min(least, low[j])
    k = 0
    while k + 2 < edges.shape[0] and edges[k + 1] <= least:
        k += 1
    return k
