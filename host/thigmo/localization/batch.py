"""`localize_batch`: the numbers of `localize`, row by row, without Python between the rows."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from thigmo.display import POINT_ESTIMATE
from thigmo.errors import DataError
from thigmo.localization.estimate import STATUSES, localizer_of
from thigmo.localization.readings import refusal, vector
from thigmo.localization.result import Array, Status


@dataclass(frozen=True, slots=True)
class BatchResult:
    """Contacts of M rows, in the caller's units; base to tip, NaN beyond the last.

    Attributes:
        status: (M,) as in `localize`.
        contacts: (M,) how many are listed.
        arc, force: (M, 3) of each.
        low, high: (M, 3) ends of its 95 % interval; of the whole body for "l1" and "l2".
        localized: (M, 3) whether it is.
        probability: (M,) that there is any contact; NaN for "l1" and "l2".
        log_odds: (M,) of that; NaN for "l1" and "l2".
        discarded: (M,) index of the reading taken for bad, or -1.
        objective: (M,) least norm of the residual of "l1" and "l2"; NaN for "posterior".
    """

    status: list[Status]
    contacts: npt.NDArray[np.int64]
    arc: Array
    force: Array
    low: Array
    high: Array
    localized: npt.NDArray[np.bool_]
    probability: Array
    log_odds: Array
    discarded: npt.NDArray[np.int64]
    objective: Array

    def __len__(self) -> int:
        return len(self.arc)

    def __repr__(self) -> str:
        count = Counter(self.status)
        every = *STATUSES, POINT_ESTIMATE
        told = ", ".join(f"{count[status]} {status}" for status in every if count[status])
        return f"BatchResult({len(self)} rows{': ' if told else ''}{told})"


def localize_batch(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    *,
    length: float,
    free_curvature: npt.ArrayLike = 0.0,
    method: Literal["posterior", "l1", "l2"] = "posterior",
    jobs: int = 1,
    **options: Any,
) -> BatchResult:
    """Contacts in each row of readings from the same sensors.

    Args:
        curvature: (M, N) readings; NaN marks a missing one.
        position: (N,) sensor centres.
        length: everted length.
        free_curvature: scalar, (N,) or (M, 1) or (M, N).
        method: as in `localize`.
        jobs: threads to share the rows.
        options: every other option of `localize`, the same for all rows.

    Raises:
        DataError: as `localize`, naming the row; no row is skipped silently.
    """
    table = np.ascontiguousarray(curvature, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] == 0:
        raise DataError(f"curvature has shape {table.shape}", "give (M, N) readings")
    count, width = table.shape
    free = np.asarray(free_curvature, dtype=np.float64)
    if free.ndim < 2:
        free = vector(free, "free_curvature", width)[None, :]
    if free.shape[0] not in (1, count) or free.shape[1] not in (1, width):
        raise DataError(
            f"free_curvature has shape {free.shape}", "give a scalar, (N,), (M, 1) or (M, N)"
        )
    localizer = localizer_of(position, width, length, method=method, **options)
    parts = np.array_split(np.arange(count), max(min(jobs, count), 1))

    def run(rows: npt.NDArray[np.int64]) -> tuple[Array, Array]:
        own = free if free.shape[0] == 1 else free[rows]
        return localizer.localize_rows(table[rows], np.ascontiguousarray(own))

    with ThreadPoolExecutor(len(parts)) as pool:
        found = list((pool.map if len(parts) > 1 else map)(run, parts))
    of_row, of_contact = (np.concatenate(each) for each in zip(*found, strict=True))
    status, contacts, problem, shows, probability, log_odds, discarded, objective = of_row.T
    wrong = np.flatnonzero(problem)
    if wrong.size:
        row = int(wrong[0])
        error = refusal(int(problem[row]), float(shows[row]), localizer.length)
        raise DataError(f"row {row}: {error.what}", error.next_step)
    arc, force, low, high, localized = np.moveaxis(of_contact, 2, 0)
    if method != "posterior":  # no narrower interval would hold
        low, high = np.where(np.isfinite(arc), [[[0.0]], [[localizer.length]]], np.nan)
    return BatchResult(
        [
            STATUSES[int(each)] if method == "posterior" else POINT_ESTIMATE
            for each in status.tolist()
        ],
        contacts.astype(np.int64),
        arc, force, low, high, localized == 1.0,
        probability, log_odds, discarded.astype(np.int64), objective,
    )  # fmt: skip
