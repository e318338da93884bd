"""Answers without a posterior: the exact norms."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError
from thigmo.localization.readings import Readings
from thigmo.localization.result import Contact, LocalizeResult, Range

METHODS = ("exact", "l1", "l2")


def point_estimate(
    method: str, readings: Readings, contacts: int | Literal["auto"]
) -> LocalizeResult:
    """A method without a posterior: one point for each contact, no interval to speak of.

    "auto" is one contact: these methods cannot decide.
    """
    count = 1 if contacts == "auto" else int(contacts)
    scale = readings.length
    position = 0.5 * (readings.low + readings.high)
    span = readings.high - readings.low
    deviation = np.sqrt(readings.variance)
    if method not in METHODS:
        raise DataError(f"unknown method {method!r}", f"use one of {', '.join(METHODS)}")
    from thigmo.localization.exact import one_contact, several_contacts

    norm: Literal[1, 2] = 1 if method == "l1" else 2
    weight = deviation.min() / deviation
    if count == 1:
        solved = one_contact(readings.y, position, 1.0, span=span, weight=weight, norm=norm)
    elif count > 1:
        solved = several_contacts(
            readings.y, position, 1.0, contacts=count, span=span, weight=weight, norm=norm
        )
    arcs, forces = (solved.arc, solved.force) if count else (np.zeros(0), np.zeros(0))
    order = np.argsort(arcs)
    listed = tuple(
        Contact(
            float(arcs[j]) * scale,
            float(forces[j]) / scale**2,
            (0.0, scale),
            "ambiguous",
            ((0.0, scale),),
        )
        for j in order
    )
    return LocalizeResult(
        "ambiguous" if listed else "no contact",
        listed,
        method,
        f"{method} gives a point and no interval",
        float(deviation.mean()) / scale if readings.known else 0.0,
        0.0,
        np.zeros(0),
        np.zeros(0),
    )


def least_absolute(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    length: float,
    span: npt.ArrayLike,
    free_curvature: npt.ArrayLike,
    count: int,
) -> tuple[float, tuple[tuple[Range, ...], ...]]:
    """Global 1-norm optimum for `count` contacts: objective and sets."""
    from thigmo.localization.exact import one_contact, several_contacts

    y = np.asarray(curvature, dtype=np.float64) - np.asarray(free_curvature, dtype=np.float64)
    if count == 0:
        return float(np.nansum(np.abs(y))), ()
    if count == 1:
        solution = one_contact(y, position, length, span=span)
    else:
        solution = several_contacts(
            y, position, length, contacts=count, span=span, optimum_set=True
        )
    return solution.objective, solution.ranges
