"""The body that picks its own model: arc, beam or elastica, whichever is enough.

`arc` is exact while nothing touches and the natural curvature is one number; `beam` serves when its
error bound meets the tolerance; else `elastica`. The choice is made at every step, counted, and can
be overridden. The emulator's plant drives this class.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import ceil
from typing import Literal

import numpy as np
import numpy.typing as npt

from thigmo.mechanics import arc, beam, kernel
from thigmo.mechanics.contact import Peg, PegContact, describe
from thigmo.mechanics.elastica import Rod, Tube

Floats = npt.NDArray[np.float64]
Model = Literal["arc", "beam", "elastica"]
ModelChoice = Literal["auto", "arc", "beam", "elastica"]


class Body:
    """A robot body among pegs, followed through time with the least model that is good enough.

    Args:
        tube: section and fold.
        pegs: obstacles.
        model: "auto", or one model for all steps ("arc" feels no pegs).
        tolerance_cm: error in position that the automatic choice may make.
        cell_cm: mesh width.
    """

    def __init__(
        self,
        tube: Tube,
        pegs: Sequence[Peg] = (),
        *,
        model: ModelChoice = "auto",
        tolerance_cm: float = 0.05,
        cell_cm: float = 1.0,
    ) -> None:
        self.pegs = tuple(pegs)
        self.tolerance_cm = tolerance_cm
        self.model: Model = "arc"
        self.error_bound_cm = 0.0
        self.counts: Counter[str] = Counter()
        self.length = 0.0
        self.free_curvature = 0.0
        self._choice: ModelChoice = model
        self._cell_cm = cell_cm
        self._rod = Rod(tube, pegs, cell_cm=cell_cm)
        self._rod_current = False
        self._pegs = np.array([(p.x, p.y, p.radius) for p in pegs], dtype=np.float64).reshape(-1, 3)
        self._own = np.zeros((1, 5))
        self._own_count = 0
        self._touching = 0
        self._fold = 0.0
        self._who = np.zeros(kernel.MAX_CONTACTS, np.int64)
        self._force = np.zeros(kernel.MAX_CONTACTS)
        self._arcs = np.zeros(kernel.MAX_CONTACTS)

    @property
    def tube(self) -> Tube:
        """Section and fold."""
        return self._rod.tube

    @property
    def critical_moment(self) -> float | None:
        """Moment at which the base folds (1/cm); None = never."""
        return self._rod.critical_moment

    @critical_moment.setter
    def critical_moment(self, value: float | None) -> None:
        self._rod.critical_moment = value

    def place(self, pegs: Sequence[Peg]) -> None:
        """Put other pegs into the room, beside the body as it lies.

        A body that is clear of them stays where it is. One that is not, or was held by the old
        ones, bends up anew from straight, and pegs in its way push it aside.
        """
        g, length = self.free_curvature, self.length
        self.pegs = tuple(pegs)
        self._pegs = np.array([(p.x, p.y, p.radius) for p in pegs], dtype=np.float64).reshape(-1, 3)
        self._rod = Rod(self._rod.tube, pegs, cell_cm=self._cell_cm)
        self._rod_current = False
        self._touching = 0
        self.length = 0.0
        if length == 0.0:
            return
        cells = max(8, ceil(length / self._cell_cm - 1e-9))
        n = arc.fill(g, length, cells, self._own)
        if arc.clearance(g, length, self.tube.radius_cm, self._pegs, self._own, n) > 0:
            self._own_count = n
            self._set_free()
            self.length, self.free_curvature = length, g
        else:
            self.step(0.0, length)
            self.step(g, length)

    def step(self, free_curvature: float, length: float) -> None:
        """Move to a new free curvature (1/cm) and everted length (cm)."""
        cells = max(8, ceil(length / self._cell_cm - 1e-9))
        if len(self._own) < cells + 1:
            self._own = np.zeros((cells + 8, 5))
        if self._choice == "elastica":
            self._by_rod(free_curvature, length)
        elif self._choice == "arc":
            self._by_arc(free_curvature, length, cells)
        elif self._choice == "beam":
            self._by_beam(free_curvature, length, cells, 1e30)
        elif not self._free_arc(free_curvature, length, cells) and not self._by_beam(
            free_curvature, length, cells, self.tolerance_cm
        ):
            self._by_rod(free_curvature, length)
        self.length = length
        self.free_curvature = free_curvature
        self.counts[self.model] += 1

    def _free_arc(self, g: float, length: float, cells: int) -> bool:
        """Take the arc if the body was free, moves little and stays clear of every peg."""
        if self._touching:
            return False
        moved = abs(g - self.free_curvature) * length**2 / 2 + abs(length - self.length)
        if self.pegs and moved > 1.0 and self.length > 0:
            return False
        if self.pegs and self.length == 0 and g != 0:
            return False
        n = arc.fill(g, length, cells, self._own)
        if arc.clearance(g, length, self.tube.radius_cm, self._pegs, self._own, n) <= 0:
            return False
        self._own_count = n
        self._set_free()
        return True

    def _by_arc(self, g: float, length: float, cells: int) -> None:
        self._own_count = arc.fill(g, length, cells, self._own)
        self._set_free()

    def _set_free(self) -> None:
        self._rod_current = False
        self._touching = 0
        self._fold = 0.0
        self.error_bound_cm = 0.0
        self.model = "arc"

    def _by_beam(self, g: float, length: float, cells: int, tolerance: float) -> bool:
        critical = self._rod.critical_moment
        count, n, fold, bound = beam.equilibrium(
            g, length, self.tube.radius_cm, self.tube.diameter_cm,
            1e300 if critical is None else critical, self._pegs, cells, self._own, self._who,
            self._force, self._arcs,
        )  # fmt: skip
        if count < 0 or bound > tolerance:
            return False
        self._own_count = n
        self._touching = count
        self._fold = fold
        self._rod_current = False
        self.error_bound_cm = bound
        self.model = "beam"
        return True

    def _by_rod(self, g: float, length: float) -> None:
        rod = self._rod
        if not self._rod_current:
            if self.model == "arc" and self.length > 0:
                rod.assume_free(self.free_curvature, self.length)
            else:
                rod.reset()
                if self.length > 0:
                    rod.step(self.free_curvature, self.length)
            self._rod_current = True
        rod.step(g, length)
        self._touching = rod.touching
        self._fold = rod.fold_angle
        self.error_bound_cm = 1e-3 if rod.approximate else 1e-5
        self.model = "elastica"

    @property
    def touching(self) -> int:
        """Number of pegs in contact."""
        return self._touching

    @property
    def fold_angle(self) -> float:
        """Fold angle at the base (rad)."""
        return self._fold

    @property
    def base_moment(self) -> float:
        """Contact moment at the base (1/cm)."""
        if self.model == "elastica":
            return self._rod.base_moment
        n = self._touching
        return float(np.dot(self._force[:n], self._arcs[:n])) if self.model == "beam" else 0.0

    def _table(self) -> tuple[Floats, int]:
        if self.model == "elastica":
            return self._rod.table()
        return self._own, self._own_count

    def nodes(self) -> Floats:
        """Copy of the centreline: columns s, heading, curvature (without fold), x, y."""
        table, n = self._table()
        return table[:n].copy()

    def averages_into(self, centers: Floats, spans: Floats, out: Floats) -> None:
        """Mean curvature (1/cm) over spans, fold included, into `out`; all float64 (N,)."""
        table, n = self._table()
        kernel.averages(centers, spans, table, n, self._fold, self.tube.diameter_cm, out)

    def pose(self, at: float) -> tuple[float, float, float]:
        """(x, y, heading) of the centreline at an arc length."""
        table, n = self._table()
        x, y, heading = kernel.pose(float(at), table, n, self._fold, self.tube.diameter_cm)
        return float(x), float(y), float(heading)

    def contacts(self) -> tuple[PegContact, ...]:
        """Touching pegs, base first."""
        if self.model == "elastica":
            return self._rod.contacts()
        if self.model == "arc":
            return ()
        found = []
        for j in range(self._touching):
            peg = int(self._who[j])
            f, at = float(self._force[j]), float(self._arcs[j])
            radius = float(self._pegs[peg, 2])
            place = at if f >= 0 else 2 * self.length + np.pi * radius + self.tube.diameter_cm - at
            found.append(
                describe(
                    peg, abs(f), place, self.pose(at), self.length, self.tube.radius_cm, radius
                )
            )
        return tuple(sorted(found, key=lambda contact: contact.arc))

    def axial_push(self) -> float:
        """Force (1/cm^2) with which pegs push the tip back towards the base."""
        return self._rod.axial_push() if self.model == "elastica" else 0.0

    def save(self) -> tuple[object, ...]:
        """State to come back to with `restore`."""
        return (
            self._rod.save() if self._rod_current else None, self._own.copy(), self._own_count,
            self._touching, self._fold, self.length, self.free_curvature, self.model,
            self.error_bound_cm, self._who.copy(), self._force.copy(), self._arcs.copy(),
        )  # fmt: skip

    def restore(self, state: tuple[object, ...]) -> None:
        """Return to a saved state."""
        (
            rod, own, self._own_count, self._touching, self._fold, self.length,
            self.free_curvature, self.model, self.error_bound_cm, who, force, arcs,
        ) = state  # type: ignore[assignment]  # fmt: skip
        self._own, self._who = np.array(own), np.array(who)
        self._force, self._arcs = np.array(force), np.array(arcs)
        self._rod_current = rod is not None
        if rod is not None:
            self._rod.restore(rod)  # type: ignore[arg-type]
