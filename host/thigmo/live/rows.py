"""Telemetry as rows of numbers, which is how the page's charts take it: live as JSON text, and of a
finished run as one block of 32-bit floats.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thigmo.stream import Telemetry

# Of a row; `page/store.js` has the same.
COLUMNS = (
    "t_s",
    *(f"{name}_{side}" for name in ("pressure", "demand", "drive") for side in ("left", "right")),
    *(f"curvature_{n}" for n in range(10)),
    *(f"expected_{n}" for n in range(10)),
    "length_cm",
    "motor",
)
_DIGITS = 5  # 1/cm: a hundredth of a sensor's noise


def row(telemetry: Telemetry) -> tuple[float, ...]:
    """A reading's numbers in the order of `COLUMNS`; NaN where one is not known."""
    return (
        telemetry.t_s,
        *telemetry.pressure_psi,
        *telemetry.demand_psi,
        *telemetry.drive_ma,
        *telemetry.curvature_per_cm,
        *telemetry.expected_per_cm,
        telemetry.length_cm,
        telemetry.motor,
    )


def row_text(telemetry: Telemetry) -> str:
    """A row as JSON."""
    return json.dumps([round(x, _DIGITS) if isfinite(x) else None for x in row(telemetry)])


def board(telemetry: Telemetry) -> dict[str, Any]:
    """What a reading says besides numbers."""
    return {
        "state": telemetry.state,
        "activity": telemetry.activity,
        "faults": list(telemetry.faults),
    }


def thinned(count: int, most: int) -> slice:
    """Every nth of `count` entries, at most `most` of them, the last one included."""
    step = max(1, -(-count // most))
    return slice((count - 1) % step, None, step)


def block(readings: Sequence[Telemetry], origin_s: float, most: int) -> NDArray[np.float32]:
    """Readings by column.

    Args:
        readings: in the order of time.
        origin_s: robot time from which theirs is counted: 32 bits do not hold that of a computer
            that has been on for a month.
        most: rows to keep.

    Returns:
        (columns, rows), NaN where a number is not known.
    """
    kept = readings[thinned(len(readings), most)] if readings else []
    table = np.array([row(reading) for reading in kept]).reshape(-1, len(COLUMNS))
    table[:, 0] -= origin_s
    return np.ascontiguousarray(table.T, dtype=np.float32)
