"""What one unit contact force does to each sensor: the influence phi(a; x, l).

A flex sensor reads the average curvature over its span, so a unit force at arc `a` (EI = 1, EI is
not known) moves it by the average over the span of the lever from the point of the body to `a`.
Straight beam: lever = a - s (Euler-Bernoulli, small deflection). Bent beam: the normal force at `a`
turns with the body, and the lever is the integral from s to a of cos(theta(u) - theta(a)). Both are
compiled here for every estimator of this package; lengths are fractions of the everted length.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled, compiled_inner

Array = npt.NDArray[np.float64]

# A shape is a table over uniform arcs 0..1: heading, x, y and the integrals of x and y.
STRAIGHT: Array = np.zeros((0, 5))


class Sensors(NamedTuple):
    """Sensors on a body.

    Attributes:
        low: (N,) near end of each, fraction of the length.
        high: (N,) far end; equal to `low` for a point sensor.
        table: (G, 5) shape of the body, or no rows for a straight one.
        edges: (N, 4) from `sensor_edges`, ignored for a straight body.
    """

    low: Array
    high: Array
    table: Array
    edges: Array


@compiled_inner
def influence(arc: float, sensors: Sensors, out: Array) -> float:
    """Fill `out` (N,) with each sensor's reading for a unit normal force at `arc`.

    Args:
        arc: place of the force, fraction of the length.
        sensors: N of them.
        out: (N,) written.

    Returns:
        The lever at the base, the contact's base moment for a unit force.
    """
    low, high, table, edges = sensors
    n = low.shape[0]
    if table.shape[0] == 0:
        for i in range(n):
            reach = arc - low[i]
            if reach <= 0.0:
                out[i] = 0.0
            elif arc >= high[i]:
                out[i] = arc - 0.5 * (low[i] + high[i])
            else:
                out[i] = 0.5 * reach * reach / (high[i] - low[i])
        return arc
    last = table.shape[0] - 1
    place = arc * last
    j = min(int(place), last - 1)
    t = place - j
    heading = table[j, 0] * (1.0 - t) + table[j + 1, 0] * t
    x = table[j, 1] * (1.0 - t) + table[j + 1, 1] * t
    y = table[j, 2] * (1.0 - t) + table[j + 1, 2] * t
    sum_x = table[j, 3] * (1.0 - t) + table[j + 1, 3] * t
    sum_y = table[j, 4] * (1.0 - t) + table[j + 1, 4] * t
    c = np.cos(heading)
    s = np.sin(heading)
    for i in range(n):
        reach = arc - low[i]
        if reach <= 0.0:
            out[i] = 0.0
        elif arc >= high[i]:
            out[i] = c * (x - edges[i, 0]) + s * (y - edges[i, 1])
        else:
            moment = c * (x * reach - (sum_x - edges[i, 2]))
            moment += s * (y * reach - (sum_y - edges[i, 3]))
            out[i] = moment / (high[i] - low[i])
    base: float = c * x + s * y
    return base


@compiled_inner
def influences(
    count: int, arcs: Array, sensors: Sensors, levers: Array, out: Array, room: Array
) -> None:
    """`influence` at `count` arcs at once, in loops over the arcs, which vectorise.

    Args:
        count: M or fewer.
        arcs: (M,) places of the force.
        sensors: N of them.
        levers: (M,) written: the levers at the base.
        out: (N, M) written.
        room: (3 or more, M).
    """
    low, high, table, edges = sensors
    n = low.shape[0]
    if table.shape[0] == 0:
        for j in range(count):
            levers[j] = arcs[j]
        for i in range(n):
            near = low[i]
            span = high[i] - near
            half = 0.5 / span if span > 0.0 else 0.0
            for j in range(count):
                inside = min(max(arcs[j] - near, 0.0), span)
                beyond = max(arcs[j] - near, span) - span
                out[i, j] = half * inside * inside + beyond
        return
    cosine, sine, turned = room[0], room[1], room[2]
    last = table.shape[0] - 1
    for j in range(count):
        place = arcs[j] * last
        k = min(int(place), last - 1)
        t = place - k
        heading = table[k, 0] * (1.0 - t) + table[k + 1, 0] * t
        c = np.cos(heading)
        s = np.sin(heading)
        cosine[j] = c
        sine[j] = s
        levers[j] = c * (table[k, 1] * (1.0 - t) + table[k + 1, 1] * t)
        levers[j] += s * (table[k, 2] * (1.0 - t) + table[k + 1, 2] * t)
        turned[j] = c * (table[k, 3] * (1.0 - t) + table[k + 1, 3] * t)
        turned[j] += s * (table[k, 4] * (1.0 - t) + table[k + 1, 4] * t)
    for i in range(n):
        near = low[i]
        far = high[i]
        share = 1.0 / (far - near) if far > near else 0.0
        for j in range(count):
            beyond = levers[j] - cosine[j] * edges[i, 0] - sine[j] * edges[i, 1]
            inside = levers[j] * (arcs[j] - near) - turned[j]
            inside += cosine[j] * edges[i, 2] + sine[j] * edges[i, 3]
            felt = beyond if arcs[j] >= far else share * inside
            out[i, j] = felt if arcs[j] > near else 0.0


def shape_table(curvature: Array) -> Array:
    """Shape of a body of unit length from its curvature on uniform arcs.

    Args:
        curvature: (G,) curvature times length at G uniform arcs 0..1, G >= 2.

    Returns:
        (G, 5) heading (rad), x, y, integral of x, integral of y.
    """
    step = 1.0 / (len(curvature) - 1)

    def integral(values: Array) -> Array:
        out = np.zeros_like(values)
        np.cumsum(0.5 * step * (values[1:] + values[:-1]), out=out[1:])
        return out

    heading = integral(curvature)
    x, y = integral(np.cos(heading)), integral(np.sin(heading))
    return np.column_stack([heading, x, y, integral(x), integral(y)])


@compiled
def _at(table: Array, arc: float, out: Array) -> None:
    """A row of a shape table at any arc; beyond the tip the tip's."""
    if arc < 0.0:
        out[:] = 0.0
        out[1] = arc
        out[3] = 0.5 * arc * arc
        return
    last = table.shape[0] - 1
    place = min(arc, 1.0) * last
    j = min(int(place), last - 1)
    t = place - j
    for c in range(5):
        out[c] = table[j, c] * (1.0 - t) + table[j + 1, c] * t


@compiled
def sensor_edges(table: Array, low: Array, high: Array) -> Array:
    """What `influence` needs of each sensor on a bent body; behind the base it is straight.

    Returns:
        (N, 4) mean x and mean y over the span; integrals of x and y up to the near end.
    """
    n = low.shape[0]
    edges = np.zeros((n, 4))
    if table.shape[0] == 0:
        return edges
    near = np.empty(5)
    far = np.empty(5)
    for i in range(n):
        _at(table, low[i], near)
        span = high[i] - low[i]
        if span > 0.0:
            _at(table, high[i], far)
            edges[i, 0] = (far[3] - near[3]) / span
            edges[i, 1] = (far[4] - near[4]) / span
        else:
            edges[i, 0] = near[1]
            edges[i, 1] = near[2]
        edges[i, 2] = near[3]
        edges[i, 3] = near[4]
    return edges


def sensors_on(table: Array, low: Array, high: Array) -> Sensors:
    """Sensors from `low` to `high` (N,) on a body of the shape `table`."""
    return Sensors(low, high, table, sensor_edges(table, low, high))


@compiled
def end_influence(sensors: Sensors, radius: float) -> tuple[Array, Array]:
    """Readings for unit loads at the tip of a bent body (see `tip.py`).

    Args:
        sensors: N of them on a shape with rows; beyond the tip they read nothing.
        radius: of the tube.

    Returns:
        (3, N) readings for a unit normal force, a unit tangential force, and the couple of a unit
        tangential force that bears one radius to the left; (3,) their moments at the base.
    """
    low, high, table, edges = sensors
    n = low.shape[0]
    out = np.empty((3, n))
    at_base = np.empty(3)
    at_base[0] = influence(1.0, sensors, out[0])
    last = table.shape[0] - 1
    x = table[last, 1]
    y = table[last, 2]
    sine = np.sin(table[last, 0])
    cosine = np.cos(table[last, 0])
    for i in range(n):
        part = 1.0
        mean_x = edges[i, 0]
        mean_y = edges[i, 1]
        if high[i] > 1.0 and low[i] < 1.0:
            part = (1.0 - low[i]) / (high[i] - low[i])
            mean_x = (table[last, 3] - edges[i, 2]) / (1.0 - low[i])
            mean_y = (table[last, 4] - edges[i, 3]) / (1.0 - low[i])
        out[1, i] = part * ((x - mean_x) * sine - (y - mean_y) * cosine)
        out[2, i] = -radius * part
    at_base[1] = x * sine - y * cosine
    at_base[2] = -radius
    return out, at_base
