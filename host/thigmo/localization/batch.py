"""`localize_batch`: many frames at once, compiled from end to end.

Without Python between rows: the exact 1-norm or 2-norm optimum (microseconds a row), or the plain
one-contact posterior with its interval and status. Rows of a study that want everything `localize`
knows go through `localize_rows`, over joblib's backends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numba
import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled_parallel
from thigmo.errors import DataError
from thigmo.localization import prior
from thigmo.localization.frame import Frame
from thigmo.localization.influence import Sensors
from thigmo.localization.posterior import one_contact
from thigmo.localization.prior import BaseMoment
from thigmo.localization.readings import TRUST, normalise
from thigmo.localization.result import LocalizeResult, Status

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class BatchResult:
    """One contact for each of B rows, in the caller's units.

    Attributes:
        arc: (B,) place.
        force: (B,) normal force over EI.
        low, high: (B,) ends of the 95 % interval ("exact") or of the optimum set ("l1", "l2").
        found: (B,) whether there is evidence for a contact ("exact"), else whether force is not 0.
        status: (B,) as in `localize` ("exact"); "ambiguous" without a posterior.
        objective: (B,) least 1-norm or 2-norm; NaN for "exact".
    """

    arc: Array
    force: Array
    low: Array
    high: Array
    found: Flags
    status: list[Status]
    objective: Array

    def __len__(self) -> int:
        return len(self.arc)


@compiled_parallel
def _posteriors(
    y: Array,
    free: Array,
    low: Array,
    high: Array,
    variance: Array,
    known: bool,
    mean: Array,
    spread: Array,
    weight: Array,
    out: Array,
) -> None:
    """Rows of (arc, force, low, high, log odds, modes) of the plain one-contact posterior."""
    for row in numba.prange(y.shape[0]):
        n = 0
        for i in range(y.shape[1]):
            if not np.isnan(y[row, i]):
                n += 1
        if n == 0:
            out[row, :] = 0.0
            out[row, 3] = 1.0
            continue
        part = np.empty((4, n))
        k = 0
        most = free[row]
        for i in range(y.shape[1]):
            if not np.isnan(y[row, i]):
                part[0, k] = y[row, i]
                part[1, k] = low[i]
                part[2, k] = high[i]
                part[3, k] = variance[i]
                most = max(most, abs(y[row, i]))
                k += 1
        if known:
            for k in range(n):
                part[3, k] = max(part[3, k], max(TRUST * most, 1e-9) ** 2)
        sensors = Sensors(part[1], part[2], np.empty((0, 5)), np.empty((n, 4)))
        frame = Frame(part[0], part[3], known, np.empty((n, 0)), sensors)
        found = one_contact(frame, BaseMoment(mean, spread, weight))
        out[row, 0] = found.arc
        out[row, 1] = found.force
        out[row, 2] = found.low
        out[row, 3] = found.high
        out[row, 4] = found.evidence - found.null
        out[row, 5] = found.pieces.shape[0]
        out[row, 6] = n


def localize_batch(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    *,
    length: float,
    span: npt.ArrayLike = 0.0,
    free_curvature: npt.ArrayLike = 0.0,
    noise: npt.ArrayLike | None = None,
    method: Literal["l1", "l2", "exact"] = "l1",
    threads: int = 1,
) -> BatchResult:
    """One contact in each row of readings from the same sensors.

    Args:
        curvature: (B, N) readings; NaN marks a missing one.
        position: (N,) sensor centres.
        length: everted length.
        span: scalar or (N,).
        free_curvature: scalar, (N,) or (B, 1) for one value a row.
        noise: as in `localize`; weights the residuals of "l1" and "l2" if it is (N,).
        method: "l1" (the exact optimum of the thesis's objective and its set, fastest), "l2", or
            "exact" (the posterior of the plain beam, with evidence, interval and status).
        threads: cores to use; 0 for all of them.

    Raises:
        DataError: as `localize`; no row is skipped silently (a row without any finite reading
            has no contact).
    """
    readings = np.asarray(curvature, dtype=np.float64)
    if readings.ndim != 2 or readings.shape[1] == 0:
        raise DataError(f"curvature has shape {readings.shape}", "give (B, N) readings")
    free = np.asarray(free_curvature, dtype=np.float64)
    if free.ndim > 2 or (free.ndim == 2 and free.shape != (len(readings), 1)):
        raise DataError(f"free_curvature has shape {free.shape}", "give a scalar, (N,) or (B, 1)")
    if np.isinf(readings).any() or not np.isfinite(free).all():
        raise DataError("a reading is infinite", "mark missing sensors with NaN")
    # One frame of zeros checks what all rows share.
    checked = normalise(
        np.zeros(readings.shape[1]),
        position,
        length,
        span,
        free if free.ndim < 2 else 0.0,
        noise,
    )
    y = np.ascontiguousarray(readings - free)
    workers = _cores() if threads == 0 else threads
    scale = checked.length
    if method in ("l1", "l2"):
        from thigmo.localization.exact import one_contact_batch

        weight = 1.0 if noise is None else 1.0 / np.sqrt(checked.variance)
        solved = one_contact_batch(
            y,
            np.asarray(position, dtype=np.float64),
            scale,
            span=span,
            weight=weight / np.max(weight),
            norm=1 if method == "l1" else 2,
            threads=workers,
        )
        return BatchResult(
            solved.arc,
            solved.force,
            solved.low,
            solved.high,
            solved.force != 0.0,
            ["ambiguous"] * len(y),
            solved.objective,
        )
    if method != "exact":
        raise DataError(f"unknown method {method!r}", 'use "l1", "l2" or "exact"')
    out = np.zeros((len(y), 7))
    before = numba.get_num_threads()
    numba.set_num_threads(max(1, min(workers, _cores())))
    try:
        _posteriors(
            np.clip(y * scale, -1e6, 1e6),
            np.broadcast_to(np.abs(free).max(axis=-1) if free.ndim else abs(free), len(y)) * scale,
            checked.low,
            checked.high,
            checked.variance,
            checked.known,
            *prior.BASE_MOMENT,
            out,
        )
    finally:
        numba.set_num_threads(before)
    counts = np.maximum(out[:, 6], 1.0)
    threshold = np.where(checked.known, 2.0, 2.0 + 5.0 / counts)
    found = out[:, 4] > threshold
    wide = (out[:, 3] - out[:, 2] > prior.WIDTH_SHARE) | (out[:, 5] != 1.0)
    status: list[Status] = []
    for is_found, is_wide, log_odds in zip(found, wide, out[:, 4], strict=True):
        if is_found:
            status.append("ambiguous" if is_wide else "localized")
        else:
            status.append("below detection" if log_odds > prior.HINT else "no contact")
    return BatchResult(
        out[:, 0] * scale,
        out[:, 1] / scale**2,
        out[:, 2] * scale,
        out[:, 3] * scale,
        found,
        status,
        np.full(len(y), np.nan),
    )


def localize_rows(
    curvature: npt.ArrayLike, position: npt.ArrayLike, *, jobs: int = 1, **options: Any
) -> list[LocalizeResult]:
    """`localize` on every row, over joblib: all cores, or any backend it has been given.

    Wrap the call in `joblib.parallel_config(backend="dask")` (or "ray") to spread it over a
    cluster.

    Args:
        curvature: (B, N).
        position: (N,).
        jobs: joblib's n_jobs; -1 for all cores.
        options: keyword arguments of `localize`.
    """
    from joblib import Parallel, delayed

    from thigmo.localization.estimate import localize

    rows = np.asarray(curvature, dtype=np.float64)
    if jobs == 1:
        return [localize(row, position, **options) for row in rows]
    task: Callable[..., Any] = delayed(_some_rows)
    parts = np.array_split(rows, max(1, min(len(rows), 4 * abs(jobs) if jobs > 0 else 64)))
    answers = Parallel(n_jobs=jobs)(task(part, position, options) for part in parts)
    return [answer for part in answers for answer in part]


def _some_rows(
    rows: Array, position: npt.ArrayLike, options: dict[str, Any]
) -> list[LocalizeResult]:
    from thigmo.localization.estimate import localize

    return [localize(row, position, **options) for row in rows]


def _cores() -> int:
    """Threads that numba may use."""
    return int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
