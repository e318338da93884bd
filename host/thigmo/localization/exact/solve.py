"""Entrances to the exact solvers: arrays in, checked once, compiled kernels called, results out."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thigmo.errors import DataError
from thigmo.localization.exact.branch_and_bound import fit_several
from thigmo.localization.exact.cells import Search
from thigmo.localization.exact.dense_one_contact import fit_dense_rows
from thigmo.localization.exact.knots import best_knots
from thigmo.localization.exact.one_contact_l1 import fit_l1_rows
from thigmo.localization.exact.one_contact_l2 import fit_l2_rows
from thigmo.localization.exact.refinement import refine
from thigmo.localization.exact.response import (
    PIECES,
    RANGES,
    WRITTEN,
    Readings,
    inverse_spans,
)

Floats = NDArray[np.float64]
Norm = Literal[1, 2]

# Kernels are given writable arrays only: numba compiles them once more for read-only ones, and what
# it compiles twice may differ in the last digit.
_PLAIN: tuple[Literal["C"], Literal["A"], Literal["W"]] = ("C", "A", "W")

# Enumeration grows with the cube of the sensors; beyond this many the branch and bound is faster.
ENUMERATED = 32
# The branch and bound over several contacts is used up to this many sensors, by contacts.
BOUNDED = {1: 32, 2: 128, 3: 64}
# Grid of knots for more sensors than that.
KNOTS = 192
# Places on it from which to refine, by norm.
STARTS = (4, 8)


@dataclass(frozen=True, slots=True)
class Solution:
    """The global optimum of one problem.

    Attributes:
        objective: the least sum of |r| or r^2.
        arc: (C,) contact arcs, ascending; where the optimum is a range, the middle of its widest.
        force: (C,) forces over EI that belong to `arc`; 0 means that no contact fits better.
        ranges: per contact, the disjoint arc ranges ((low, high), ...) on which the objective is
            within tolerance of its minimum (the other parameters being free); low == high at a
            single point. Empty where the set was not asked for.
        gap: objective minus a proven lower bound; at most the tolerance unless a search was cut;
            inf for several contacts on more sensors than the branch and bound takes.
        nodes: bounds computed on the way (0 where the answer was enumerated).
    """

    objective: float
    arc: Floats
    force: Floats
    ranges: tuple[tuple[tuple[float, float], ...], ...]
    gap: float
    nodes: int = 0


@dataclass(frozen=True, slots=True)
class BatchSolution:
    """Global optima of B one-contact problems: arrays of shape (B,).

    `low` and `high` span the optimum set; `pieces` counts its disjoint ranges, whose ends are in
    `ranges` (B, 4, 2), padded with NaN (ranges beyond the fourth are merged into the fourth).
    A row without a finite reading has objective 0, force 0 and the whole [0, length] as its set.
    """

    objective: Floats
    arc: Floats
    force: Floats
    low: Floats
    high: Floats
    pieces: NDArray[np.int64]
    ranges: Floats


def one_contact(
    curvature: ArrayLike,
    position: ArrayLike,
    length: float,
    *,
    span: ArrayLike = 0.0,
    weight: ArrayLike = 1.0,
    norm: Norm = 1,
    force_bounds: tuple[float, float] = (-np.inf, np.inf),
    tolerance: float = 1e-9,
) -> Solution:
    """Global optimum for one contact with a in [0, length] and f in `force_bounds`.

    Args:
        curvature: (N,) readings above free curvature; NaN marks a missing sensor.
        position: (N,) sensor centres.
        length: everted length, > 0.
        span: scalar or (N,) sensor lengths, >= 0.
        weight: scalar or (N,) factor on each residual (1 / sigma), >= 0.
        norm: 1 for the sum of |r|, 2 for the sum of r^2.
        force_bounds: least and largest f; (0, inf) for a contact on a known side.
        tolerance: relative to the objective at f = 0; decides what counts as equal in `ranges`.

    Raises:
        DataError: shapes that do not match, or values that are not finite where they must be.
    """
    # The shortest way to the kernel: this is called once a frame.
    y = np.array(curvature, np.float64)
    n = y.size
    sensors = np.empty((1, 3, n))
    forces = _forces(force_bounds)
    found = np.empty((1, WRITTEN))
    try:
        sensors[0, 0], sensors[0, 1], sensors[0, 2] = position, span, weight
        ends = np.array((length,), np.float64)
        fine = y.ndim == 1 and _kernel(norm, n, forces)(
            y[None], sensors, ends, forces, float(tolerance), found
        )
    except (TypeError, ValueError):
        fine = False
    if not fine:
        _refuse(y[None], position, span, weight, length)
    best = found[0]
    _, _, _, pieces, *ranges = best.tolist()
    last = 2 * int(pieces)
    return Solution(
        objective=float(best[0]),
        arc=best[1:2],
        force=best[2:3],
        ranges=(tuple(zip(ranges[0:last:2], ranges[1:last:2], strict=True)),),
        gap=0.0,
    )


def one_contact_batch(
    curvature: ArrayLike,
    position: ArrayLike,
    length: ArrayLike,
    *,
    span: ArrayLike = 0.0,
    weight: ArrayLike = 1.0,
    norm: Norm = 1,
    force_bounds: tuple[float, float] = (-np.inf, np.inf),
    tolerance: float = 1e-9,
    threads: int = 1,
) -> BatchSolution:
    """`one_contact` for each row of (B, N) readings, without Python between rows.

    Args:
        curvature: (B, N); NaN marks a missing sensor.
        position: (N,) or (B, N).
        length: scalar or (B,).
        span: scalar, (N,) or (B, N).
        weight: scalar, (N,) or (B, N).
        norm: 1 or 2.
        force_bounds: as in `one_contact`.
        tolerance: as in `one_contact`.
        threads: rows are divided among this many threads (the kernel releases the GIL).

    Raises:
        DataError: as `one_contact`.
    """
    y = np.require(curvature, np.float64, _PLAIN)
    if y.ndim != 2:
        raise DataError(f"curvature has shape {y.shape}, not (B, N)", "pass one row per problem")
    rows, n = y.shape
    x, spans, w, ends = _layout(position, span, weight, length, rows, n)
    forces = _forces(force_bounds)
    sensors = np.empty((max(len(x), len(spans), len(w)), 3, n))
    sensors[:, 0], sensors[:, 1], sensors[:, 2] = x, spans, w
    found = np.full((rows, WRITTEN), np.nan)
    fit = _kernel(norm, n, forces)

    def run(part: slice) -> bool:
        return fit(
            y[part],
            sensors if len(sensors) == 1 else sensors[part],
            ends if len(ends) == 1 else ends[part],
            forces,
            float(tolerance),
            found[part],
        )

    if threads > 1 and rows >= 2 * threads:
        cuts = np.linspace(0, rows, threads + 1).astype(int).tolist()
        parts = [slice(a, b) for a, b in itertools.pairwise(cuts)]
        with ThreadPoolExecutor(threads) as pool:
            fine = all(pool.map(run, parts))
    else:
        fine = run(slice(0, rows))
    if not fine:
        _refuse(y, position, span, weight, length)
    ranges = found[:, RANGES:].reshape(rows, PIECES, 2)
    pieces = found[:, 3].astype(np.int64)
    return BatchSolution(
        objective=found[:, 0],
        arc=found[:, 1],
        force=found[:, 2],
        low=ranges[:, 0, 0],
        high=ranges[np.arange(rows), np.maximum(pieces, 1) - 1, 1],
        pieces=pieces,
        ranges=ranges,
    )


def _kernel(norm: Norm, n: int, forces: tuple[float, float]) -> Callable[..., bool]:
    """The kernel over rows for n sensors."""
    if norm != 1:
        return fit_l2_rows
    if n > ENUMERATED and {-forces[0], forces[1]} <= {0.0, np.inf}:
        return fit_dense_rows
    return fit_l1_rows


def _refuse(
    y: Floats, position: ArrayLike, span: ArrayLike, weight: ArrayLike, length: ArrayLike
) -> NoReturn:
    """Say what a kernel found not usable in rows of readings."""
    if y.ndim != 2:
        raise DataError(f"curvature has shape {y.shape[1:]}, not (N,)", "pass one row of readings")
    _layout(position, span, weight, length, *y.shape)
    raise DataError("curvature is infinite", "use NaN for a missing sensor")


def _layout(
    position: ArrayLike, span: ArrayLike, weight: ArrayLike, length: ArrayLike, rows: int, n: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Positions, spans, weights as (1 or B, N) and lengths as (1 or B,), checked."""
    arrays = []
    for name, given in (("position", position), ("span", span), ("weight", weight)):
        array = np.asarray(given, dtype=np.float64)
        if array.ndim < 2:
            array = array.reshape(1, -1)
        try:
            array = np.broadcast_to(array, (len(array), n))
        except ValueError:
            array = array[:0]
        if array.ndim != 2 or len(array) not in (1, rows):
            raise DataError(f"{name} does not match curvature ({rows}, {n})", "check its shape")
        if not np.isfinite(array).all() or (name != "position" and (array < 0.0).any()):
            raise DataError(f"{name} has a value that is not usable", "check that it is finite")
        arrays.append(np.require(array, np.float64, _PLAIN))
    ends = np.atleast_1d(np.require(length, np.float64, _PLAIN))
    if ends.ndim != 1 or len(ends) not in (1, rows):
        raise DataError(f"length has shape {ends.shape}", "pass one length, or one for each row")
    if not (np.isfinite(ends).all() and (ends > 0.0).all()):
        raise DataError("length is not positive", "pass the everted length")
    return arrays[0], arrays[1], arrays[2], ends


def _forces(force_bounds: tuple[float, float]) -> tuple[float, float]:
    least, largest = float(force_bounds[0]), float(force_bounds[1])
    if not least <= largest or least == np.inf or largest == -np.inf:
        raise DataError(f"force_bounds {force_bounds} hold no force", "pass (least, largest)")
    return least, largest


def several_contacts(
    curvature: ArrayLike,
    position: ArrayLike,
    length: float,
    *,
    contacts: int,
    span: ArrayLike = 0.0,
    weight: ArrayLike = 1.0,
    norm: Norm = 1,
    sign: Literal[-1, 0, 1] = 0,
    force_limit: float | None = None,
    tolerance: float = 1e-9,
    optimum_set: bool = False,
    max_nodes: int = 1_000_000,
) -> Solution:
    """Global optimum for one to three contacts 0 <= a_1 <= .. <= a_C <= length.

    Proven (see `gap`) up to 128 sensors for two contacts and 64 for three. With more, knots are
    found exactly on a grid by dynamic programming (least squares, point sensors) and refined
    locally with the true spans and norm, forces unlimited: no proof.

    Args:
        curvature: (N,) readings above free curvature; NaN marks a missing sensor.
        position: (N,) sensor centres.
        length: everted length, > 0.
        contacts: C, 1 to 3.
        span: scalar or (N,).
        weight: scalar or (N,).
        norm: 1 or 2.
        sign: of every force; 0 for either.
        force_limit: largest |f|. Without one, two opposed contacts that merge into a couple of
            endless force can fit better than any true pair; by default 20 times the largest
            reading over the length, which keeps opposed contacts about length / 20 apart.
        tolerance: relative to the objective without contact: the search ends when the gap is
            below it.
        optimum_set: also find each contact's arc ranges (milliseconds).
        max_nodes: the search is cut after this many nodes; `gap` then says what is proven.

    Raises:
        DataError: as `one_contact`, or a number of contacts other than 1, 2 or 3.
    """
    if contacts not in (1, 2, 3):
        raise DataError(f"cannot fit {contacts} contacts", "ask for 1, 2 or 3")
    y = np.asarray(curvature, dtype=np.float64)
    if y.ndim != 1 or np.isinf(y).any():
        raise DataError("curvature is not a row of numbers", "use NaN for a missing sensor")
    x, spans, w, ends = _layout(position, span, weight, length, 1, len(y))
    end = float(ends[0])
    order = np.argsort(x[0], kind="stable")
    order = order[np.isfinite(y[order]) & (w[0, order] > 0.0)]
    # Everything in units of the length and of the readings' size: bounds stay well scaled.
    size = float(np.abs(y[order]).max(initial=0.0))
    unit = size if size > 0.0 else 1.0
    y = y[order] / unit
    spans = spans[0, order] / end
    w = w[0, order]
    heavy = float(w.max(initial=0.0)) or 1.0
    w = w / heavy
    low = x[0, order] / end - 0.5 * spans
    readings = Readings(y, low, spans, inverse_spans(spans), w)
    rest = float((w * np.abs(y)).sum() if norm == 1 else ((w * y) ** 2).sum())
    slack = tolerance * rest
    limit = 20.0 if force_limit is None else force_limit * end / unit
    if not limit > 0.0:
        raise DataError("force_limit is not positive", "pass the largest |force| over EI")
    arcs = np.empty(contacts)
    forces = np.empty(contacts)
    back = heavy * unit if norm == 1 else (heavy * unit) ** 2
    limits = np.zeros((contacts, 2))
    limits[:, 1] = 1.0
    if len(y) > BOUNDED[contacts] and sign == 0:
        best = _dense_several(readings, norm, arcs, forces)
        by_arc = np.argsort(arcs, kind="stable")
        return Solution(
            objective=best * back,
            arc=arcs[by_arc] * end,
            force=forces[by_arc] * (unit / end),
            ranges=(),
            gap=np.inf,
        )

    def search(goal: float) -> tuple[float, float, int]:
        what = Search(contacts, norm, sign, limit, slack, goal, max_nodes)
        return fit_several(readings, 1.0, what, limits, found, pushed)

    found, pushed = arcs, forces
    best, lower, nodes = search(np.inf)
    ranges: tuple[tuple[tuple[float, float], ...], ...] = ()
    if optimum_set:
        edges = np.unique(np.clip(np.concatenate([low, low + spans, [0.0, 1.0]]), 0.0, 1.0))
        found, pushed = np.empty(contacts), np.empty(contacts)

        def reached(contact: int, place: float) -> bool:
            limits[:] = (0.0, 1.0)
            limits[contact] = place
            return search(best + 3.0 * slack)[0] <= best + 2.0 * slack

        ranges = tuple(
            (_range_around(reached, contact, float(place), edges, end),)
            for contact, place in enumerate(np.sort(arcs))
        )
    by_arc = np.argsort(arcs, kind="stable")
    return Solution(
        objective=best * back,
        arc=arcs[by_arc] * end,
        force=forces[by_arc] * (unit / end),
        ranges=ranges,
        gap=(best - lower) * back,
        nodes=nodes,
    )


def _range_around(
    reached: Callable[[int, float], bool], contact: int, place: float, edges: Floats, unit: float
) -> tuple[float, float]:
    """The connected range of one contact's arc on which the optimum is reached."""
    ends = []
    for step in (-1.0, 1.0):
        good, bad = place, np.nan
        if reached(contact, min(max(place + step * 1e-6, 0.0), 1.0)):
            for edge in edges[::-1] if step < 0.0 else edges:
                if (edge - good) * step <= 0.0:
                    continue
                if not reached(contact, float(edge)):
                    bad = float(edge)
                    break
                good = float(edge)
        while abs(bad - good) > 1e-7:
            middle = 0.5 * (good + bad)
            if reached(contact, middle):
                good = middle
            else:
                bad = middle
        ends.append(good * unit)
    return ends[0], ends[1]


def _dense_several(readings: Readings, norm: int, arcs: Floats, forces: Floats) -> float:
    """Knots on a grid, then refined; for L1 once more with weights that resist outliers."""
    y, low, span, _, w = readings
    centre = low + 0.5 * span
    knots = np.linspace(max(float(centre[0]), 1.0 / KNOTS), 1.0, KNOTS)
    tries = STARTS[norm - 1]
    values = np.empty(tries)
    index = np.empty((tries, len(arcs)), dtype=np.int64)
    weight = w
    best = np.inf
    for _ in range(2 if norm == 1 else 1):
        best_knots(centre, y, weight, knots, len(arcs), values, index)
        for start in index[np.isfinite(values)]:
            trial, push = knots[start], np.zeros(len(arcs))
            value = refine(readings, 1.0, norm, (1.0 / KNOTS, 0.1 / KNOTS), trial, push)
            if value < best:
                best = value
                arcs[:], forces[:] = trial, push
        model = np.zeros(len(y))
        for arc, force in zip(arcs, forces, strict=True):
            model += force * np.maximum(arc - centre, 0.0)
        gap = np.abs(y - model)
        weight = np.sqrt(w / np.maximum(gap, 0.1 * float(np.median(gap)) + 1e-12))
    return refine(readings, 1.0, norm, (0.1 / KNOTS, 1e-10), arcs, forces)
