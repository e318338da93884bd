"""Large deflections of the body against round pegs, under point forces, or pushed to a given force.

Use `solve` for one equilibrium, `Rod` to follow a robot through time (each step starts from the
last), and `push` for the direct question "what does the body do when a contact presses with force f
at arc a": no peg needs to be known, nothing is iterated, so tests of estimators use it as truth.

Model: planar, inextensible, EI = 1 (forces in 1/cm^2, moments in 1/cm), natural curvature g,
clamped at the base at (0, 0) heading along x. Contacts are unilateral and frictionless. The base
folds when the contact moment there reaches `critical_moment`: it then stays at that value, and the
fold's angle is spread over one diameter from the base. See `kernel.py` for the method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import ceil, cos, sin
from typing import Literal

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError
from thigmo.mechanics import kernel
from thigmo.mechanics.contact import Peg, PegContact, describe

Floats = npt.NDArray[np.float64]
Status = Literal["converged", "relaxed", "approximate"]
_STATUS: tuple[Status, ...] = ("converged", "relaxed", "approximate")
_NO_LOADS = np.empty((0, 5))
_NO_FOLD = 1e300


@dataclass(frozen=True, slots=True)
class Tube:
    """Section and base of the body.

    Attributes:
        diameter_cm: inflated diameter; also the length over which the fold is spread.
        critical_moment: contact moment (1/cm) at which the base folds; None = never.
    """

    diameter_cm: float = 3.5
    critical_moment: float | None = None

    @property
    def radius_cm(self) -> float:
        """Tube radius."""
        return self.diameter_cm / 2


@dataclass(frozen=True, slots=True)
class PointForce:
    """A given force at an arc length (1/cm^2): following the body, or dead in the workspace.

    Attributes:
        arc: where (cm from the base).
        normal: following component along the body's left normal; positive bends left.
        tangential: following component along the tangent.
        x, y: dead component.
    """

    arc: float
    normal: float = 0.0
    tangential: float = 0.0
    x: float = 0.0
    y: float = 0.0


@dataclass(frozen=True, slots=True)
class Residuals:
    """How well the equations hold.

    Attributes:
        position: largest distance between a contact's locus and its peg (cm).
        overlap: deepest penetration of any other peg (cm, >= 0).
        moment: largest disagreement (1/cm) between the moment integrated along the body and the
            moment of the contact forces about the same point.
        tip_moment, tip_force: what is left at the free end beyond the last contact.
    """

    position: float
    overlap: float
    moment: float
    tip_moment: float
    tip_force: float


@dataclass(frozen=True)
class Solution:
    """One equilibrium.

    Attributes:
        s, heading, curvature, x, y: the centreline at the mesh's nodes and the contacts, each of
            shape (n,). `curvature` leaves out the fold, which is `fold_angle` spread over
            [0, diameter].
        length: everted length (cm).
        free_curvature: natural curvature as given: one value, or nodes over [0, length].
        contacts: touching pegs, base first.
        fold_angle: rad, with sign; 0 unless the base folds.
        base_moment: contact moment at the base (1/cm).
        status: "converged"; "relaxed" = found by going downhill after a snap, then converged;
            "approximate" = penalty accuracy only (see residuals).
        iterations: Newton iterations.
    """

    s: Floats
    heading: Floats
    curvature: Floats
    x: Floats
    y: Floats
    length: float
    free_curvature: Floats
    tube: Tube
    contacts: tuple[PegContact, ...]
    fold_angle: float
    base_moment: float
    status: Status
    iterations: int
    residuals: Residuals
    _nodes: Floats = field(repr=False)

    def averages(self, centers: npt.ArrayLike, spans: npt.ArrayLike) -> Floats:
        """Mean curvature (1/cm) over spans (cm) centred at arcs (cm), fold included; shape (N,).

        A span of 0 gives the value at the centre.
        """
        x = np.ascontiguousarray(np.atleast_1d(np.asarray(centers, dtype=np.float64)))
        width = np.ascontiguousarray(np.broadcast_to(np.asarray(spans, dtype=np.float64), x.shape))
        out = np.empty_like(x)
        kernel.averages(
            x, width, self._nodes, len(self._nodes), self.fold_angle, self.tube.diameter_cm, out
        )
        return out

    def pose(self, arc: float) -> tuple[float, float, float]:
        """(x, y, heading) of the centreline at an arc length."""
        x, y, heading = kernel.pose(
            float(arc), self._nodes, len(self._nodes), self.fold_angle, self.tube.diameter_cm
        )
        return float(x), float(y), float(heading)

    @property
    def tip(self) -> tuple[float, float, float]:
        """(x, y, heading) of the tip."""
        return float(self.x[-1]), float(self.y[-1]), float(self.heading[-1])

    def gap(self, peg: Peg) -> float:
        """Distance between the skin and a peg (cm), negative inside."""
        return self.locate(peg)[0]

    def locate(self, peg: Peg) -> tuple[float, float]:
        """(gap, arc) of a peg: distance from the skin and the arc of the closest point."""
        gap, place = kernel.gap_to(
            peg.x, peg.y, peg.radius, self.tube.radius_cm, self._nodes, len(self._nodes),
            self.fold_angle, self.tube.diameter_cm,
        )  # fmt: skip
        arc = kernel.skin(place, self.length, self.tube.radius_cm, peg.radius)[0]
        return float(gap), float(arc)

    @property
    def energy(self) -> float:
        """Bending energy of the contact curvature plus the fold's work (EI = 1, 1/cm)."""
        m = self.curvature - _along(self.free_curvature, self.length, self.s)
        step = np.diff(self.s)
        cumulative = _cumulative(self.free_curvature, self.length)
        free = np.array(
            [kernel.free_angle(s, self.length, self.free_curvature, cumulative) for s in self.s]
        )
        turn = np.diff(self.heading - self._fold_heading(self.s) - free)
        # Simpson's rule, with the value in the middle from the turn over the interval.
        mean = np.where(step > 0, turn / np.where(step > 0, step, 1.0), m[:-1])
        centre = 1.5 * mean - 0.25 * (m[1:] + m[:-1])
        bending = float(np.sum(step * (m[:-1] ** 2 + 4 * centre**2 + m[1:] ** 2)) / 12)
        return bending + abs(self.fold_angle) * (self.tube.critical_moment or 0.0)

    def _fold_heading(self, s: Floats) -> Floats:
        share = np.minimum(s, self.tube.diameter_cm) / self.tube.diameter_cm
        return np.asarray(self.fold_angle * share, dtype=np.float64)


def _cumulative(g: Floats, length: float) -> Floats:
    if g.size == 1:
        return np.zeros(1)
    cell = length / (g.size - 1)
    return np.concatenate(([0.0], np.cumsum(cell * (g[1:] + g[:-1]) / 2)))


def _along(g: Floats, length: float, s: Floats) -> Floats:
    if g.size == 1:
        return np.full_like(s, g[0])
    return np.interp(s, np.linspace(0.0, length, g.size), g)


def _curvature_nodes(free_curvature: npt.ArrayLike) -> Floats:
    g = np.ascontiguousarray(np.atleast_1d(np.asarray(free_curvature, dtype=np.float64)))
    if g.ndim != 1 or g.size == 0 or not np.all(np.isfinite(g)):
        raise DataError("free curvature must be a finite number or a one-dimensional array")
    return g


class Rod:
    """A body that remembers: each `step` starts from the last equilibrium, as a real one does.

    Args:
        tube: section and fold.
        pegs: obstacles, fixed for the rod's life.
        cell_cm: mesh width; 1 cm gives about 1e-6 cm at a vine robot's bends.
    """

    def __init__(self, tube: Tube, pegs: Sequence[Peg] = (), *, cell_cm: float = 1.0) -> None:
        if not 0.01 <= cell_cm <= 10:
            raise DataError("cell_cm must lie between 0.01 and 10")
        for peg in pegs:
            if not (peg.radius > 1e-3 and np.isfinite([peg.x, peg.y, peg.radius]).all()):
                raise DataError("a peg needs finite coordinates and a radius above 0.001 cm")
        self.tube = tube
        self.pegs = tuple(pegs)
        self.cell_cm = cell_cm
        self._pegs = np.array([(p.x, p.y, p.radius) for p in pegs], dtype=np.float64).reshape(-1, 3)
        self._reach = max((float(np.hypot(p.x, p.y)) + p.radius for p in pegs), default=0.0)
        self._who = np.zeros(kernel.MAX_CONTACTS, np.int64)
        self._force = np.zeros(kernel.MAX_CONTACTS)
        self._place = np.zeros(kernel.MAX_CONTACTS)
        self._warm = np.zeros(kernel.RECORD)
        size = 2 * kernel.MAX_CONTACTS + 2
        self._jac = np.zeros((size, size))
        self._info = np.zeros(4)
        self._length = 0.0
        self._cells = 0
        self._g = np.zeros(1)
        self._cum = np.zeros(1)
        self._curvature = np.zeros(1)
        self._nodes = np.zeros((1, 5))
        self._count = 0
        self._status = 0
        self._critical = _NO_FOLD if tube.critical_moment is None else tube.critical_moment
        self._loads = _NO_LOADS

    @property
    def critical_moment(self) -> float | None:
        """Moment at which the base folds; body pressure changes it."""
        return None if self._critical >= _NO_FOLD else self._critical

    @critical_moment.setter
    def critical_moment(self, value: float | None) -> None:
        self._critical = _NO_FOLD if value is None else value
        self.tube = Tube(self.tube.diameter_cm, value)
        self._warm[kernel.JAC] = 0.0
        self._warm[kernel.SIGN] = 0.0

    def step(self, free_curvature: npt.ArrayLike, length: float) -> None:
        """Follow the equilibrium to a new free curvature (1/cm) and everted length (cm).

        The way is cut into pieces in which the free tip would travel at most 1 cm.

        Raises:
            DataError: values that are not finite, or a length that is not positive.
        """
        g = _curvature_nodes(free_curvature)
        if not (np.isfinite(length) and length > 0):
            raise DataError("length must be positive")
        if self._length == 0.0:
            self._place_straight(g, length)
        g0, l0 = self._g, self._length
        if g0.size != g.size:
            n = max(g0.size, g.size)
            g0, g = _refine(g0, n), _refine(g, n)
        travel = float(np.max(np.abs(g - g0))) * max(length, l0) ** 2 / 2 + abs(length - l0)
        pieces = max(1, ceil(travel))
        for i in range(1, pieces + 1):
            u = i / pieces
            self._advance(g0 + u * (g - g0), l0 + u * (length - l0), travel / pieces)

    def _place_straight(self, g: Floats, length: float) -> None:
        """Start straight, except that a rod that no peg can touch starts where it is."""
        tip = float(np.max(np.abs(g))) * length
        free = not self.pegs and self._loads.shape[0] == 0 and tip < 50
        self._advance(g if free else np.zeros_like(g), length, 0.0)

    def _advance(self, g: Floats, length: float, travel: float) -> None:
        if length != self._length or self._cells == 0:
            cells = max(8, ceil(length / self.cell_cm - 1e-9))
            if cells != self._cells or length != self._length:
                old = (np.arange(self._cells) + 0.5) * (self._length / max(self._cells, 1))
                new = (np.arange(cells) + 0.5) * (length / cells)
                if self._cells:
                    self._curvature = np.interp(new, old, self._curvature, right=0.0)
                    self._slide(length)
                else:
                    self._curvature = np.zeros(cells)
            if cells != self._cells:
                extra = kernel.MAX_CONTACTS + self._loads.shape[0] + 4
                self._nodes = np.zeros((cells + extra, 5))
                self._cells = cells
            self._length = length
        self._g = g
        self._cum = _cumulative(g, length)
        self._status, self._count = kernel.equilibrium(
            length, self.tube.radius_cm, self.tube.diameter_cm, self._critical, g, self._cum,
            self._pegs, self._loads, self._cells, travel, self._who, self._force, self._place,
            self._warm, self._jac, self._curvature, self._nodes, self._info,
        )  # fmt: skip

    def _slide(self, length: float) -> None:
        """Growth happens at the tip: places on the left side, counted from the far end, move."""
        change = length - self._length
        for j in range(int(self._warm[kernel.COUNT])):
            radius = self._pegs[self._who[j], 2]
            kind = kernel.skin(self._place[j], self._length, self.tube.radius_cm, radius)[4]
            if kind == 4:
                self._place[j] += 2 * change
            elif kind > 0:
                self._place[j] += change
        self._warm[kernel.JAC] = 0.0

    def reset(self) -> None:
        """Forget everything: the next step starts from the straight body."""
        self._warm[:] = 0.0
        self._length = 0.0
        self._cells = 0
        self._g = np.zeros(1)

    def table(self) -> tuple[Floats, int]:
        """The node table (s, heading, curvature, x, y) and its number of rows; not a copy."""
        return self._nodes, self._count

    def assume_free(self, free_curvature: float, length: float) -> None:
        """Take over from a cheaper model: no contact, at this curvature and length."""
        self.reset()
        self._advance(np.array([free_curvature]), length, 0.0)

    @property
    def failed(self) -> bool:
        """The last step found no equilibrium at all (only possible under given forces)."""
        return self._count == 0

    @property
    def touching(self) -> int:
        """Number of pegs in contact."""
        return int(self._warm[kernel.COUNT])

    @property
    def approximate(self) -> bool:
        """The last equilibrium is of penalty accuracy only."""
        return self._status == kernel.APPROXIMATE

    @property
    def base_moment(self) -> float:
        """Contact moment at the base (1/cm)."""
        return float(self._info[3])

    @property
    def fold_angle(self) -> float:
        """Fold angle (rad)."""
        return float(self._warm[kernel.FOLD])

    def averages_into(self, centers: Floats, spans: Floats, out: Floats) -> None:
        """As Solution.averages, without copies; all arrays float64 of shape (N,)."""
        kernel.averages(
            centers, spans, self._nodes, self._count, self.fold_angle, self.tube.diameter_cm, out
        )

    def contacts(self) -> tuple[PegContact, ...]:
        """Touching pegs, base first."""
        found = []
        nodes, n, psi = self._nodes, self._count, self.fold_angle
        for j in range(self.touching):
            peg = int(self._who[j])
            radius = float(self._pegs[peg, 2])
            arc = kernel.skin(self._place[j], self._length, self.tube.radius_cm, radius)[0]
            pose = kernel.pose(arc, nodes, n, psi, self.tube.diameter_cm)
            found.append(
                describe(
                    peg, float(self._force[j]), float(self._place[j]), pose, self._length,
                    self.tube.radius_cm, radius,
                )
            )  # fmt: skip
        return tuple(sorted(found, key=lambda contact: contact.arc))

    def axial_push(self) -> float:
        """Force (1/cm^2) with which pegs push the tip back towards the base."""
        total = 0.0
        for j in range(self.touching):
            radius = self._pegs[self._who[j], 2]
            ot = kernel.skin(self._place[j], self._length, self.tube.radius_cm, radius)[2]
            total += float(self._force[j]) * ot
        return total

    def save(self) -> tuple[object, ...]:
        """State to come back to with `restore`."""
        return (
            self._who.copy(), self._force.copy(), self._place.copy(), self._warm.copy(),
            self._length, self._cells, self._g, self._cum, self._curvature.copy(),
            self._nodes.copy(), self._count, self._status, self._info.copy(), self._critical,
        )  # fmt: skip

    def restore(self, state: tuple[object, ...]) -> None:
        """Return to a saved state."""
        (
            who, force, place, warm, self._length, self._cells, self._g, self._cum, curvature,
            nodes, self._count, self._status, info, self._critical,
        ) = state  # type: ignore[assignment]  # fmt: skip
        self._who = np.array(who)
        self._force = np.array(force)
        self._place = np.array(place)
        self._warm = np.array(warm)
        self._curvature = np.array(curvature)
        self._nodes = np.array(nodes)
        self._info = np.array(info)
        self._warm[kernel.JAC] = 0.0

    def solution(self) -> Solution:
        """The present equilibrium."""
        if self._count == 0:
            raise DataError(
                "no equilibrium found under these forces", "apply them in smaller increments"
            )
        nodes = self._nodes[: self._count].copy()
        contacts = self.contacts()
        return Solution(
            s=nodes[:, kernel.S], heading=nodes[:, kernel.THETA], curvature=nodes[:, kernel.KAPPA],
            x=nodes[:, kernel.X], y=nodes[:, kernel.Y], length=self._length,
            free_curvature=self._g, tube=self.tube, contacts=contacts, fold_angle=self.fold_angle,
            base_moment=self.base_moment, status=_STATUS[self._status],
            iterations=int(self._info[0]),
            residuals=_residuals(nodes, contacts, self._loads, self._g, self._length, self._info),
            _nodes=nodes,
        )  # fmt: skip


def _refine(g: Floats, n: int) -> Floats:
    return (
        np.interp(np.linspace(0, 1, n), np.linspace(0, 1, g.size), g)
        if g.size > 1
        else np.full(n, g[0])
    )


def _residuals(
    nodes: Floats,
    contacts: tuple[PegContact, ...],
    loads: Floats,
    g: Floats,
    length: float,
    info: Floats,
) -> Residuals:
    """Moment balance about every node from positions alone, beside what the kernel reports."""
    s, x, y = nodes[:, kernel.S], nodes[:, kernel.X], nodes[:, kernel.Y]
    moment = np.zeros(len(s))
    tip_moment = tip_force = 0.0
    for contact in contacts:
        beyond = s <= contact.arc + 1e-9
        moment += beyond * ((contact.x - x) * contact.force_y - (contact.y - y) * contact.force_x)
    for arc, normal, tangential, fx, fy in loads:
        i = int(np.argmin(np.abs(s - arc)))
        c, d = cos(nodes[i, kernel.THETA]), sin(nodes[i, kernel.THETA])
        px, py = tangential * c - normal * d + fx, tangential * d + normal * c + fy
        moment += (s <= arc + 1e-9) * ((x[i] - x) * py - (y[i] - y) * px)
    carried = nodes[:, kernel.KAPPA] - _along(g, length, s)
    end = max([contact.arc for contact in contacts] + [float(load[0]) for load in loads] + [0.0])
    free = s > end + 1e-9
    if free.any():
        tip_moment = float(np.max(np.abs(carried[free])))
        tip_force = float(np.max(np.abs(np.diff(carried[free]))) if free.sum() > 1 else 0.0)
    else:
        tip = carried[-1] - moment[-1]
        tip_moment = abs(float(tip))
    return Residuals(
        position=float(info[1]),
        overlap=float(-info[2]) if info[2] < 0 else 0.0,
        moment=float(np.max(np.abs(carried - moment))),
        tip_moment=tip_moment,
        tip_force=tip_force,
    )


def solve(
    free_curvature: npt.ArrayLike,
    length: float,
    *,
    tube: Tube | None = None,
    pegs: Sequence[Peg] = (),
    forces: Sequence[PointForce] = (),
    cell_cm: float = 1.0,
) -> Solution:
    """Equilibrium of the body among pegs and under given forces.

    With pegs the answer depends on how the body came there: it starts straight at its full length
    and the free curvature then rises in steps (pegs that overlap the straight body push it aside).
    Forces are raised in steps too. Use `Rod` for another history.

    Args:
        free_curvature: g, 1/cm: one value, or nodes evenly spaced over [0, length], linear between.
        length: everted length, cm.
        tube: diameter and fold; default 3.5 cm without a fold.
        pegs: round obstacles.
        forces: point forces; not together with pegs.
        cell_cm: mesh width.

    Raises:
        DataError: bad values, pegs together with forces, or no equilibrium under the forces.
    """
    rod = Rod(tube or Tube(), pegs, cell_cm=cell_cm)
    if not forces:
        rod.step(free_curvature, length)
        return rod.solution()
    if pegs:
        raise DataError("pegs and given forces cannot be combined", "use one or the other")
    table = np.array([(f.arc, f.normal, f.tangential, f.x, f.y) for f in forces])
    if not np.all(np.isfinite(table)) or np.any(table[:, 0] < 0) or np.any(table[:, 0] > length):
        raise DataError("forces must be finite and act between 0 and the length")
    g = _curvature_nodes(free_curvature)
    dead = bool(np.any(table[:, 3:] != 0))
    done, step = 0.0, 1.0
    if dead:
        largest = float(np.max(np.hypot(table[:, 3], table[:, 4]))) * length**2
        step = 1.0 / max(1.0, ceil(largest + float(np.max(np.abs(g))) * length))
    rod._loads = np.ascontiguousarray(table * 0.0)
    rod._advance(g * 0.0, length, 0.0)
    while done < 1.0 - 1e-12:
        state = rod.save()
        u = min(1.0, done + step)
        rod._loads = np.ascontiguousarray(table * u)
        rod._warm[kernel.VALID] = 0.0
        rod._advance(g * u, length, 0.0)
        if rod.failed:
            rod.restore(state)
            step /= 2
            if step < 1e-4:
                raise DataError("no equilibrium found under these forces", "reduce them")
        else:
            done = u
    return rod.solution()


def push(
    force: npt.ArrayLike,
    arc: npt.ArrayLike,
    *,
    free_curvature: npt.ArrayLike,
    length: float,
    tube: Tube | None = None,
    fold_angle: float = 0.0,
    corner: Sequence[tuple[float, float]] = (),
    cell_cm: float = 1.0,
) -> Solution:
    """What the body does when side contacts press with given normal forces at given arcs.

    A direct problem: one integration from the tip to the base, no iteration, any size of bend. The
    peg that does this is found with `peg_for`.

    Args:
        force: normal forces (1/cm^2, signed: positive bends left), scalar or shape (n,).
        arc: their arc lengths (cm), same shape.
        free_curvature: as in `solve`.
        length: everted length, cm.
        tube: diameter; its critical moment is ignored here, see fold_angle.
        fold_angle: angle of the base's fold (rad), spread over one diameter.
        corner: pairs (normal, tangential) of forces on a corner of the flat end: the sign of the
            normal tells the corner (positive: right), tangential <= 0 pushes towards the base.

    Raises:
        DataError: shapes that differ, values that are not finite, arcs beyond the length.
    """
    body = tube or Tube()
    f = np.atleast_1d(np.asarray(force, dtype=np.float64))
    a = np.atleast_1d(np.asarray(arc, dtype=np.float64))
    if f.shape != a.shape or f.ndim != 1 or not (np.isfinite(f).all() and np.isfinite(a).all()):
        raise DataError("force and arc must be finite and of the same shape (n,)")
    if np.any(a < 0) or np.any(a > length):
        raise DataError("arcs must lie between 0 and the length")
    g = _curvature_nodes(free_curvature)
    cum = _cumulative(g, length)
    cells = max(8, ceil(length / cell_cm - 1e-9))
    count = len(f) + len(corner)
    size = np.empty(count)
    place = np.empty(count)
    radius = np.full(count, 1.0)
    perimeter = 2 * length + np.pi + 2 * body.radius_cm
    for j, (fj, aj) in enumerate(zip(f, a, strict=True)):
        size[j] = abs(fj)
        place[j] = aj if fj >= 0 else perimeter - aj
    for j, (normal, tangential) in enumerate(corner, start=len(f)):
        size[j] = float(np.hypot(normal, tangential))
        place[j] = length + float(np.arctan2(max(-tangential, 0.0), abs(normal)))
        if normal < 0:
            place[j] = perimeter - place[j]
    nodes = np.zeros((cells + count + 4, 5))
    frames, base = np.zeros((count, 3)), np.zeros(4)
    n = kernel.shoot(
        count, size, place, radius, _NO_LOADS, 0.0, length, body.radius_cm, g, cum, fold_angle,
        body.diameter_cm, cells, True, nodes, frames, base,
    )  # fmt: skip
    table = nodes[:n].copy()
    contacts = []
    for j in range(count):
        at = float(kernel.skin(place[j], length, body.radius_cm, 1.0)[0])
        pose = kernel.pose(at, table, n, fold_angle, body.diameter_cm)
        contacts.append(
            describe(j, float(size[j]), float(place[j]), pose, length, body.radius_cm, 1.0)
        )
    info = np.array([0.0, 0.0, 0.0, base[3]])
    found = tuple(sorted(contacts, key=lambda contact: contact.arc))
    return Solution(
        s=table[:, kernel.S], heading=table[:, kernel.THETA], curvature=table[:, kernel.KAPPA],
        x=table[:, kernel.X], y=table[:, kernel.Y], length=length, free_curvature=g, tube=body,
        contacts=found, fold_angle=fold_angle, base_moment=float(base[3]), status="converged",
        iterations=0, residuals=_residuals(table, found, _NO_LOADS, g, length, info), _nodes=table,
    )  # fmt: skip


def peg_for(contact: PegContact, radius: float) -> Peg:
    """The round peg of a given radius (cm) that causes a contact."""
    size = float(np.hypot(contact.force_x, contact.force_y))
    if size == 0.0:
        raise DataError("a contact without force does not tell where its peg is")
    return Peg(
        x=contact.x - radius * contact.force_x / size,
        y=contact.y - radius * contact.force_y / size,
        radius=radius,
    )
