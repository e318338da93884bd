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
ROOM = 8192  # boxes kept at a time; a search that needs more is cut short
RANGES = 4  # of one contact's optimum set; the last takes what is too many
SHARP = 1e-6  # an optimum that does not reach this far is a point
SET_WIDTH = 1e-7  # the ends of two contacts' ranges are found to this


@dataclass(frozen=True, slots=True)
class PointFit:
    """The global fit of one frame.

    `objective` is the least sum of |residual| or of residual^2; `gap` is how far its proven lower
    bound lies below: at most 1e-9 of the objective without contact, unless the search was cut
    short. `arcs` (k,) are ascending, over the length; where the optimum of one contact is a range,
    the middle of its widest. `forces` (k,) are over EI, times the square of the length.
    `optimum_set` holds, by contact, the disjoint ranges ((near, far), ...) of its arc on which the
    minimum is attained, the other parameters free; near == far for a point, and for "l2".
    """

    objective: float
    arcs: Floats
    forces: Floats
    optimum_set: tuple[tuple[Range, ...], ...]
    gap: float


def fit(
    y: npt.ArrayLike, low: npt.ArrayLike, high: npt.ArrayLike, contacts: int, norm: Norm
) -> PointFit:
    """The global fit of one frame `y` (N,); arguments and errors are those of `fit_rows`."""
    return fit_rows(np.asarray(y, dtype=np.float64)[None], low, high, contacts, norm)[0]


def fit_rows(
    readings: npt.ArrayLike, low: npt.ArrayLike, high: npt.ArrayLike, contacts: int, norm: Norm
) -> list[PointFit]:
    """Global fits of M frames; that of one contact does without Python between rows.

    Args:
        readings: (M, N) above the free curvature, times the length; finite.
        low: (N,) near ends of the sensors' spans over the length.
        high: (N,) far ends; equal to `low` for a point sensor.
        contacts: 1 or 2.
        norm: "l1" or "l2".

    Raises:
        DataError: another number of contacts, arrays that do not match or are not finite.
    """
    if contacts not in (1, 2):
        raise DataError(f"cannot fit {contacts} contacts exactly", "ask for 1 or 2")
    rows = np.array(readings, dtype=np.float64)
    sensors = np.array((low, high), dtype=np.float64)
    if rows.ndim != 2 or sensors.shape != (2, rows.shape[1]):
        found = f"readings {rows.shape} and spans {sensors.shape[1:]} do not match"
        raise DataError(found, "pass one reading and one span for each sensor")
    if not np.isfinite(rows).all():
        raise DataError("a reading is not finite", "leave out what is missing")
    if contacts == 2:
        return [_two_contacts(y, sensors, norm) for y in rows]
    table = np.full((len(rows), 3 + 2 * RANGES), np.nan)
    table[:, :5] = (0.0, 0.5, 0.0, 0.0, 1.0)
    if norm == "l1" and rows.size:
        fit_one_l1(rows, sensors[0], sensors[1], _edges(sensors), TOLERANCE, table)
    elif rows.size:
        fit_one_l2(rows, sensors[0], sensors[1], _edges(sensors), table)
    fits = []
    for least, arc, force, *ends in table.tolist():
        ranges = zip(ends[::2], ends[1::2], strict=True)
        there = tuple((near, far) for near, far in ranges if near == near)
        fits.append(PointFit(least, np.array([arc]), np.array([force]), (there,), 0.0))
    return fits


def _edges(sensors: Floats) -> Floats:
    """Ends of spans within the body, and its own ends."""
    return np.unique(np.clip(np.concatenate((*sensors, (0.0, 1.0))), 0.0, 1.0))


def _two_contacts(y: Floats, sensors: Floats, norm: Norm) -> PointFit:
    """The fit of two contacts to one frame."""
    size = float(np.abs(y).max(initial=0.0))
    if size == 0.0:
        return PointFit(0.0, np.ones(2), np.zeros(2), (((0.0, 1.0),), ((0.0, 1.0),)), 0.0)
    # In units of the largest reading: bounds stay well scaled.
    frame = (y / size, sensors, 1 if norm == "l1" else 2)
    arcs, forces, (least, bound) = _search(frame, (0.0, 1.0, 0.0, 1.0), -1.0).reshape(3, 2)
    sets = tuple(((float(arc), float(arc)),) for arc in arcs)
    if norm == "l1":
        level = float(least + TOLERANCE * np.abs(frame[0]).sum())
        sets = tuple((_range_around(frame, c, float(arcs[c]), level),) for c in range(2))
    back = size if norm == "l1" else size * size
    return PointFit(float(least) * back, arcs, forces * size, sets, float(least - bound) * back)


def _search(frame: _Frame, places: tuple[float, float, float, float], wanted: float) -> Floats:
    """What `search_boxes` answers for contacts within places, with forces of any signs."""
    y, sensors, norm = frame
    rest = float((np.abs(y) if norm == 1 else y * y).sum())
    boxes = np.zeros((ROOM, BOX))
    boxes[:4, :SIGNS] = places
    boxes[:4, SIGNS:BOUND] = ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0))
    answer = np.empty(6)
    search_boxes(y, sensors, norm, (LARGEST, TOLERANCE * rest, wanted), boxes, answer)
    return answer


def _range_around(frame: _Frame, contact: int, place: float, level: float) -> Range:
    """The connected range of a contact's arc around a place where `level` is reached."""
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
