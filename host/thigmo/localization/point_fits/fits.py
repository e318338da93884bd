"""Entrances: readings in, the global fit of one or two contacts and its optimum set out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError
from thigmo.localization.point_fits.one_contact_l1 import fit_one_l1
from thigmo.localization.point_fits.one_contact_l2 import fit_one_l2
from thigmo.localization.point_fits.response import Floats
from thigmo.localization.point_fits.two_contacts import BOUND, BOX, SIGNS, search_boxes

Norm = Literal["l1", "l2"]
Range = tuple[float, float]
_Frame = tuple[Floats, Floats, int]  # readings, both ends of the spans, 1 or 2

TOLERANCE = 1e-9  # of the objective without contact
LARGEST = 20.0  # |force| of two contacts over the largest reading
MOST_BOXES = 200_000.0
ROOM = 256  # boxes that there is room for at first
RANGES = 4  # disjoint ranges of one contact's optimum set; the last takes what is too many
SHARP = 1e-6  # an optimum that does not reach this far is a point
SET_WIDTH = 1e-7  # the ends of two contacts' ranges are found to this


@dataclass(frozen=True, slots=True)
class PointFit:
    """The global fit of one frame.

    Attributes:
        objective: the least sum of |residual| or of residual^2.
        arcs: (k,) ascending, over the length; where the optimum of one contact is a range, the
            middle of its widest.
        forces: (k,) over EI, times the square of the length.
        optimum_set: by contact, the disjoint ranges ((near, far), ...) of its arc on which the
            minimum is attained, the other parameters free; near == far for a point, and for "l2".
        gap: objective minus its proven lower bound: at most 1e-9 of the objective without contact
            unless the search was cut short.
    """

    objective: float
    arcs: Floats
    forces: Floats
    optimum_set: tuple[tuple[Range, ...], ...]
    gap: float


@dataclass(frozen=True, slots=True)
class PointFits:
    """Global fits of M frames; each is that of `fit`.

    Attributes:
        objective: (M,).
        arcs: (M, k).
        forces: (M, k).
        ranges: (M, k, 4, 2) optimum sets, NaN where there are fewer ranges.
        gap: (M,).
    """

    objective: Floats
    arcs: Floats
    forces: Floats
    ranges: Floats
    gap: Floats


def fit(
    y: npt.ArrayLike, low: npt.ArrayLike, high: npt.ArrayLike, contacts: int, norm: Norm
) -> PointFit:
    """The global fit of one frame: `fit_rows` of one row.

    Args:
        y: (N,) readings above the free curvature, times the length; NaN for a missing one.
        low: (N,) near ends of the sensors' spans over the length.
        high: (N,) far ends; equal to `low` for a point sensor.
        contacts: 1 or 2.
        norm: "l1" or "l2".

    Raises:
        DataError: as `fit_rows`.
    """
    rows = fit_rows(np.asarray(y, dtype=np.float64)[None], low, high, contacts, norm)
    return PointFit(
        float(rows.objective[0]),
        rows.arcs[0],
        rows.forces[0],
        tuple(
            tuple((near, far) for near, far in ranges if near == near)
            for ranges in rows.ranges[0].tolist()
        ),
        float(rows.gap[0]),
    )


def fit_rows(
    readings: npt.ArrayLike, low: npt.ArrayLike, high: npt.ArrayLike, contacts: int, norm: Norm
) -> PointFits:
    """Global fits of (M, N) readings.

    Args:
        readings: (M, N) above the free curvature, times the length; NaN for a missing one.
        low: (N,) near ends of the sensors' spans over the length.
        high: (N,) far ends; equal to `low` for a point sensor.
        contacts: 1 or 2.
        norm: "l1" or "l2".

    Raises:
        DataError: another number of contacts, or arrays that do not match.
    """
    if contacts not in (1, 2):
        raise DataError(f"cannot fit {contacts} contacts exactly", "ask for 1 or 2")
    rows = np.array(readings, dtype=np.float64)
    sensors = np.array((low, high), dtype=np.float64)
    if rows.ndim != 2 or sensors.shape != (2, rows.shape[1]):
        raise DataError(
            f"readings {rows.shape} and spans {sensors.shape[1:]} do not match",
            "pass one reading and one span for each sensor",
        )
    used = ~np.isnan(rows)
    if contacts == 2:
        return _two_contacts(rows, used, sensors, norm)
    found = np.full((len(rows), 3 + 2 * RANGES), np.nan)
    if used.all():
        _one_contact(rows, sensors, norm, found)
    else:
        for row, there, own in zip(rows, used, found, strict=True):
            _one_contact(row[there][None], sensors[:, there], norm, own[None])
    ranges = found[:, 3:].reshape(-1, 1, RANGES, 2)
    return PointFits(found[:, 0], found[:, 1:2], found[:, 2:3], ranges, np.zeros(len(rows)))


def _edges(sensors: Floats) -> Floats:
    """Ends of spans within the body, and its own ends."""
    return np.unique(np.clip(np.concatenate((*sensors, (0.0, 1.0))), 0.0, 1.0))


def _one_contact(rows: Floats, sensors: Floats, norm: Norm, found: Floats) -> None:
    """Rows without a missing reading; what is found is written."""
    low, high = np.ascontiguousarray(sensors)
    if low.size == 0:
        found[:, :5] = (0.0, 0.5, 0.0, 0.0, 1.0)
    elif norm == "l1":
        fit_one_l1(rows, low, high, _edges(sensors), TOLERANCE, found)
    else:
        fit_one_l2(rows, low, high, _edges(sensors), found)


def _two_contacts(
    rows: Floats, used: npt.NDArray[np.bool_], sensors: Floats, norm: Norm
) -> PointFits:
    """`fit_rows` for two contacts: a fit takes many times what Python takes between rows."""
    m = len(rows)
    fits = PointFits(
        np.zeros(m),
        np.ones((m, 2)),
        np.zeros((m, 2)),
        np.full((m, 2, RANGES, 2), np.nan),
        np.zeros(m),
    )
    fits.ranges[:, :, 0] = (0.0, 1.0)
    for k in range(m):
        y = rows[k, used[k]]
        size = float(np.abs(y).max(initial=0.0))
        if size == 0.0:
            continue
        # In units of the largest reading: bounds stay well scaled.
        frame = (y / size, np.ascontiguousarray(sensors[:, used[k]]), 1 if norm == "l1" else 2)
        arcs, forces, (least, bound) = _search(frame, (0.0, 1.0, 0.0, 1.0), -1.0).reshape(3, 2)
        back = size if norm == "l1" else size * size
        fits.objective[k] = least * back
        fits.gap[k] = (least - bound) * back
        fits.arcs[k] = arcs
        fits.forces[k] = forces * size
        fits.ranges[k, :, 0] = arcs[:, None]
        if norm == "l1":
            level = float(least + TOLERANCE * np.abs(frame[0]).sum())
            for c in range(2):
                fits.ranges[k, c, 0] = _range_around(frame, c, float(arcs[c]), level)
    return fits


def _search(frame: _Frame, places: tuple[float, float, float, float], wanted: float) -> Floats:
    """What `search_boxes` answers for contacts within places, with forces of any signs."""
    y, sensors, norm = frame
    rest = float((np.abs(y) if norm == 1 else y * y).sum())
    boxes = np.zeros((ROOM, BOX))
    boxes[:4, :SIGNS] = places
    boxes[:4, SIGNS:BOUND] = ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0))
    answer = np.empty(6)
    limits = (LARGEST, TOLERANCE * rest, wanted, MOST_BOXES)
    search_boxes(y, sensors, norm, limits, boxes, answer)
    return answer


def _range_around(frame: _Frame, contact: int, place: float, level: float) -> Range:
    """The connected range of one contact's arc around a place where `level` is reached.

    Ends of spans first, then by halving.
    """
    edges = _edges(frame[1])

    def reached(arc: float) -> bool:
        places = (0.0, arc, arc, arc) if contact else (arc, arc, arc, 1.0)
        return bool(_search(frame, places, level)[4] <= level)

    ends = []
    for way in (-1, 1):
        good = bad = place
        for arc in (place + way * SHARP, *edges[edges * way > place * way][::way].tolist()):
            if 0.0 <= arc <= 1.0 and (arc - good) * way > 0.0:
                bad = arc
                if not reached(arc):
                    break
                good = arc
        while abs(bad - good) > SET_WIDTH:
            middle = 0.5 * (good + bad)
            if reached(middle):
                good = middle
            else:
                bad = middle
        ends.append(good)
    return ends[0], ends[1]
