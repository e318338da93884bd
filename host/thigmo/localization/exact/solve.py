"""Entrances to the exact solvers: arrays in, checked once, compiled kernels called, results out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Norm = Literal[1, 2]


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
        gap: objective minus a proven lower bound; at most the tolerance unless a search was cut.
    """

    objective: float
    arc: Floats
    force: Floats
    ranges: tuple[tuple[tuple[float, float], ...], ...]
    gap: float


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
    raise NotImplementedError


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
    raise NotImplementedError


def several_contacts(
    curvature: ArrayLike,
    position: ArrayLike,
    length: float,
    *,
    contacts: int,
    span: ArrayLike = 0.0,
    weight: ArrayLike = 1.0,
    norm: Norm = 1,
    force_bounds: tuple[float, float] = (-np.inf, np.inf),
    tolerance: float = 1e-9,
    optimum_set: bool = False,
    max_nodes: int = 1_000_000,
) -> Solution:
    """Global optimum for one to three contacts 0 <= a_1 <= .. <= a_C <= length.

    Args:
        curvature: (N,) readings above free curvature; NaN marks a missing sensor.
        position: (N,) sensor centres.
        length: everted length, > 0.
        contacts: C, 1 to 3.
        span: scalar or (N,).
        weight: scalar or (N,).
        norm: 1 or 2.
        force_bounds: bounds on every f.
        tolerance: relative to the objective without contact: the search ends when the gap is
            below it.
        optimum_set: also find each contact's arc ranges (milliseconds).
        max_nodes: the search is cut after this many nodes; `gap` then says what is proven.

    Raises:
        DataError: as `one_contact`, or a number of contacts other than 1, 2 or 3.
    """
    raise NotImplementedError
