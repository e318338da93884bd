"""The posterior over several contacts' places, cut into cells that are fine where it matters.

A cell is a box: contact j lies somewhere in the j-th of C intervals, base to tip. It is halved in
the directions in which the log density changes much within it, unless its best point, judged by the
slopes at its middle, is far below the top.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled, compiled_inner
from thigmo.localization.frame import Frame, Levels, Work, empty_work
from thigmo.localization.marginal import prepare_levels
from thigmo.localization.node_choices import (
    Factor,
    Places,
    empty_factor,
    empty_places,
    fill_places,
    fit_forces,
    mean_forces,
    more_room,
    pattern_weights,
    products,
    slopes,
)
from thigmo.localization.prior import BaseMoment

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]

# Intervals along the body of the first cells, by number of contacts.
FIRST = (0, 24, 12, 8)
# Log density below the top from which a cell is not halved.
REACH = 9.0
# From here on it is kept as it is, without a thought for outliers.
FLIP_REACH = 6.0
# Finest interval, most turns of halving, and most cells of a turn.
LEAST_WIDTH = 2.0**-17
MOST_TURNS = 40
MOST_CELLS = 30_000


class Model(NamedTuple):
    """What is assumed of the contacts.

    Attributes:
        frame: what was read.
        levels: noise levels and the outliers of the present pattern.
        prior: of each contact's moment at the base; their spreads count, not their means.
        stretch: half width of the stretch over which each contact spreads.
    """

    frame: Frame
    levels: Levels
    prior: BaseMoment
    stretch: float


class Room(NamedTuple):
    """Room to weigh one cell; `halved` (C,) marks the directions in which it is halved."""

    factor: Factor
    work: Work
    halved: Flags


class Leaves(NamedTuple):
    """Cells that were not halved further.

    Attributes:
        arcs: (K, C) their middles.
        width: (K, C) their sides.
        logp: (K,) log likelihood at the middle, outlier patterns around the present one included.
        force: (K, C) posterior means there (of cells near the top).
        level: (K,) the noise level with the most weight.
    """

    arcs: Array
    width: Array
    logp: Array
    force: Array
    level: Indices


@compiled
def first_cells(contacts: int) -> Indices:
    """(K, C) all ordered choices of the first intervals."""
    m = FIRST[contacts]
    count = 1
    for j in range(contacts):
        count = count * (m + j) // (j + 1)
    out = np.zeros((count, contacts), dtype=np.int64)
    for r in range(1, count):
        out[r] = out[r - 1]
        j = contacts - 1
        while out[r, j] == m - 1:
            j -= 1
        out[r, j:] = out[r, j] + 1
    return out


@compiled_inner
def halves(cell: Indices, cut: Flags, half: Indices, out: Indices) -> int:
    """The ordered choices of halves of a cell's intervals.

    Args:
        cell: (C,) its intervals.
        cut: (C,) which of them are halved; equal intervals all or none.
        half: (M,) the lower half of each interval.
        out: (2^C or more, C) written.

    Returns:
        How many.
    """
    c = cell.shape[0]
    count = 0
    for bits in range(1 << c):
        wanted = True
        for j in range(c):
            upper = (bits >> j) & 1
            if not cut[j]:
                wanted = wanted and upper == 0
                out[count, j] = cell[j]
                continue
            if j > 0 and cell[j] == cell[j - 1] and upper < (bits >> (j - 1)) & 1:
                wanted = False
            out[count, j] = half[cell[j]] + upper
        if wanted:
            count += 1
    return count


@compiled_inner
def directions(
    cell: Indices,
    width: Array,
    gradient: Array,
    curvature: Array,
    behind: float,
    tolerance: float,
    cut: Flags,
) -> bool:
    """Mark in which directions a cell is to be halved; returns whether in any.

    Args:
        cell: (C,) its intervals.
        width: (M,) of all intervals.
        gradient, curvature: (C,) of the log density at its middle.
        behind: nats from its middle to the top.
        tolerance: change over a cell near the top that is left.
        cut: (C,) written.
    """
    c = cell.shape[0]
    ahead = 0.0
    most = 0.0
    for j in range(c):
        size = width[cell[j]]
        change = abs(gradient[j]) * size
        ahead += 0.5 * change
        most = max(most, change + 0.25 * curvature[j] * size * size)
    # By concavity no point of the cell lies higher than its middle by more than `ahead`.
    least = tolerance * (1.0 + max(behind, 0.0) / 3.0)
    for j in range(c):
        cut[j] = False
    if behind - ahead > REACH or most <= least:
        return False
    any_cut = False
    for j in range(c):
        size = width[cell[j]]
        change = abs(gradient[j]) * size + 0.25 * curvature[j] * size * size
        cut[j] = change > max(least, 0.5 * most) and size > LEAST_WIDTH
        any_cut = any_cut or cut[j]
    for j in range(1, c):
        if cell[j] == cell[j - 1] and (cut[j] or cut[j - 1]):
            cut[j] = True
            for m in range(j - 1, -1, -1):
                if cell[m] == cell[j]:
                    cut[m] = True
    return any_cut


class Weighed(NamedTuple):
    """Cells at their middles.

    Attributes:
        logp: (K,) log likelihood.
        force: (K, C) posterior means.
        gradient, curvature: (K, C) how logp changes with each place, as `slopes`.
        level, component: (K,) noise level and prior component with the most weight.
    """

    logp: Array
    force: Array
    gradient: Array
    curvature: Array
    level: Indices
    component: Indices


@compiled
def room_for(cells: int, contacts: int) -> Weighed:
    """Room for `cells` cells."""
    shape = (cells, contacts)
    return Weighed(
        np.empty(cells),
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
        np.empty(cells, dtype=np.int64),
        np.empty(cells, dtype=np.int64),
    )


@compiled_inner
def weigh_cells(cells: Indices, places: Places, model: Model, room: Room, out: Weighed) -> float:
    """Weigh cells (K, C) at their middles; returns the highest log likelihood."""
    frame, levels, prior, _ = model
    factor = room.factor
    top = -1e300
    for r in range(cells.shape[0]):
        value, s, k = fit_forces(cells[r], places, levels.const, prior, factor)
        top = max(top, value)
        slopes(
            cells[r],
            s,
            places,
            frame.y,
            levels,
            factor,
            room.work,
            out.gradient[r],
            out.curvature[r],
        )
        for j in range(cells.shape[1]):
            out.force[r, j] = factor.force[j]
        out.logp[r] = value
        out.level[r] = s
        out.component[r] = k
    return top


@compiled_inner
def other_patterns(
    cell: Indices, at: int, weighed: Weighed, places: Places, model: Model, factor: Factor
) -> float:
    """Log of the weight of all outlier patterns around the present one, at cell number `at`."""
    frame, levels, prior, _ = model
    s = weighed.level[at]
    products(cell, places, s, factor.gram)
    mean_forces(cell, places, s, weighed.component[at], prior, factor)
    extra, _, _ = pattern_weights(cell, s, places, frame.y, levels, factor)
    return math.log(extra)


@compiled_inner
def halve_intervals(cell: Indices, places: Places, used: int, model: Model, room: Room) -> int:
    """Work out the halves of a cell's intervals that are to be halved, behind `used` places.

    Returns:
        How many places there are now.
    """
    frame, levels, _, stretch = model
    for j in range(cell.shape[0]):
        at = cell[j]
        if room.halved[j] and places.half[at] < 0:
            width = 0.5 * places.width[at]
            places.half[at] = used
            for upper in range(2):
                places.arcs[used + upper] = places.arcs[at] + (upper - 0.5) * width
                places.width[used + upper] = width
                places.half[used + upper] = -1
            fill_places(places, used, used + 2, frame, levels, stretch, room.work)
            used += 2
    return used


@compiled_inner
def keep(
    cell: Indices,
    at: int,
    weighed: Weighed,
    top: float,
    places: Places,
    model: Model,
    factor: Factor,
    leaves: Leaves,
    count: int,
) -> None:
    """Write cell number `at` as the leaf number `count`."""
    for j in range(cell.shape[0]):
        leaves.arcs[count, j] = places.arcs[cell[j]]
        leaves.width[count, j] = places.width[cell[j]]
        leaves.force[count, j] = weighed.force[at, j]
    leaves.logp[count] = weighed.logp[at]
    leaves.level[count] = weighed.level[at]
    if weighed.logp[at] > top - FLIP_REACH:
        leaves.logp[count] += other_patterns(cell, at, weighed, places, model, factor)


@compiled_inner
def halve_or_keep(
    cells: Indices,
    weighed: Weighed,
    top: float,
    tolerance: float,
    places: Places,
    used: int,
    model: Model,
    room: Room,
    finer: Indices,
    leaves: Leaves,
    count: int,
) -> tuple[int, int, int]:
    """Halve cells whose density still changes; keep the others as leaves.

    Args:
        cells: (K, C).
        weighed: what `weigh_cells` found of them.
        top: highest log likelihood so far.
        tolerance: change over a cell near the top that is left.
        places: new halves are worked out behind those in use.
        used: how many are.
        model: as given to `cut`.
        room: for one cell.
        finer: (K 2^C, C) written: the halves; no rows if none is wanted.
        leaves: written behind the first `count`.
        count: how many there are.

    Returns:
        How many halves; how many leaves and places there are now.
    """
    write = 0
    for r in range(cells.shape[0]):
        cell = cells[r]
        if finer.shape[0] > 0 and directions(
            cell,
            places.width,
            weighed.gradient[r],
            weighed.curvature[r],
            top - weighed.logp[r],
            tolerance,
            room.halved,
        ):
            used = halve_intervals(cell, places, used, model, room)
            write += halves(cell, room.halved, places.half, finer[write:])
        else:
            keep(cell, r, weighed, top, places, model, room.factor, leaves, count)
            count += 1
    return write, count, used


@compiled
def room_for_leaves(leaves: Leaves, count: int, size: int) -> Leaves:
    """The first `count` leaves, with room for `size` in all."""
    c = leaves.arcs.shape[1]
    out = Leaves(
        np.empty((size, c)),
        np.empty((size, c)),
        np.empty(size),
        np.empty((size, c)),
        np.empty(size, dtype=np.int64),
    )
    out.arcs[:count] = leaves.arcs[:count]
    out.width[:count] = leaves.width[:count]
    out.logp[:count] = leaves.logp[:count]
    out.force[:count] = leaves.force[:count]
    out.level[:count] = leaves.level[:count]
    return out


@compiled
def cut(contacts: int, model: Model, tolerance: float) -> Leaves:
    """Cut the posterior into cells over which its log changes by less than about `tolerance`.

    The model's levels are prepared.
    """
    c = contacts
    frame, levels, _, stretch = model
    prepare_levels(frame, 0.0, levels)
    used = FIRST[c]
    places = empty_places(256, frame, levels)
    room = Room(empty_factor(c), empty_work(frame), np.empty(c, dtype=np.bool_))
    for j in range(used):
        places.arcs[j] = (j + 0.5) / used
        places.width[j] = 1.0 / used
    fill_places(places, 0, used, frame, levels, stretch, room.work)
    cells = first_cells(c)
    weighed = room_for(256, c)
    none = np.empty((0, c))
    leaves = room_for_leaves(Leaves(none, none, none[:, 0], none, cells[:0, 0].copy()), 0, 512)
    count = 0
    top = -1e300
    for turn in range(MOST_TURNS):
        size = cells.shape[0]
        if size > weighed.logp.shape[0]:
            weighed = room_for(2 * size, c)
        if count + size > leaves.logp.shape[0]:
            leaves = room_for_leaves(leaves, count, 2 * (count + size))
        while used + 2 * min(c * size, used) > places.arcs.shape[0]:
            places = more_room(places, frame, levels)
        top = max(top, weigh_cells(cells, places, model, room, weighed))
        last = turn == MOST_TURNS - 1 or size > MOST_CELLS
        finer = np.empty((0 if last else size << c, c), dtype=np.int64)
        write, count, used = halve_or_keep(
            cells, weighed, top, tolerance, places, used, model, room, finer, leaves, count
        )
        if write == 0:
            break
        cells = finer[:write]
    return room_for_leaves(leaves, count, count)


@compiled
def cell_masses(leaves: Leaves) -> tuple[Array, float, float]:
    """(K,) masses relative to the densest middle, their sum, and that middle's log likelihood.

    Places are uniform over the body and ordered: an order of C counts for C! of them.
    """
    count, c = leaves.arcs.shape
    top = leaves.logp.max()
    mass = np.empty(count)
    total = 0.0
    factorial = 1.0
    for j in range(c):
        factorial *= j + 1.0
    for r in range(count):
        value = np.exp(leaves.logp[r] - top) * factorial
        repeat = 1.0
        for j in range(c):
            value *= leaves.width[r, j]
            # Of a cell on the diagonal only the ordered part counts.
            same = j > 0 and leaves.arcs[r, j] == leaves.arcs[r, j - 1]
            repeat = repeat + 1.0 if same else 1.0
            value /= repeat
        mass[r] = value
        total += value
    return mass, total, top
