"""Large deflections of the body against pegs and walls, or pushed to a given force.

Use `solve` for one equilibrium, `Rod` to follow a robot through time (each step starts from the
last), `Rod.sweep` for the readings of a whole sweep and their derivatives, and `push` for the shape
of the body under a force f at arc a. `push` needs no peg and does not iterate, so tests of
estimators use it as truth.

The model is planar and inextensible with EI = 1 (forces in 1/cm^2, moments in 1/cm) and natural
curvature g beside that of its rest shape, clamped at the base at (0, 0) heading along x. Contacts
are unilateral, and without friction unless a `Rod` is given some. The base folds when the contact
moment there reaches `critical_moment`. The moment then stays at that value, and the angle of the
fold is spread over one diameter from the base. Base and obstacles may yield in proportion to what
acts on them. The compiled extension has the method (`rod.h`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError
from thigmo.mechanics import _rod

Floats = npt.NDArray[np.float64]
_TIP_PASSES = 8
Model = Literal["arc", "beam", "elastica"]
ModelChoice = Literal["auto", "arc", "beam", "elastica"]
# Relaxed: descended in energy after a snap, then converged. Approximate: as accurate as a penalty
# method.
Convergence = Literal["converged", "relaxed", "approximate"]
# On the side (force along the centreline's normal at the closest point), on a corner of the flat
# end (oblique force, a tube radius off the centreline), or on the face of the end.
Kind = Literal["side", "corner", "face"]


@dataclass(frozen=True, slots=True)
class Peg:
    """A round obstacle: centre and radius in cm."""

    x: float
    y: float
    radius: float
    # cm that its centre yields for each 1/cm^2 of force over EI, in the force's direction: cm^3
    compliance: float = 0.0


@dataclass(frozen=True, slots=True)
class Wall:
    """A straight obstacle with round ends: its surface lies `radius` cm from the line between two
    points (cm).
    """

    x: float
    y: float
    end_x: float
    end_y: float
    radius: float
    compliance: float = 0.0  # as a peg's


Obstacle = Peg | Wall


@dataclass(frozen=True, slots=True)
class PegContact:
    """One touching peg."""

    peg: int  # index into the pegs given
    arc: float  # arc length of the closest centreline point (cm); the everted length at the end
    kind: Kind  # where on the tube
    # Forces at `arc` along the body's normal (positive adds positive curvature) and along its
    # tangent (negative pushes towards the base; 0 on the side), 1/cm^2.
    normal: float
    tangential: float
    # Moment about the centreline, 1/cm, counter-clockwise; at a corner, its lever is the radius.
    couple: float
    x: float  # contact point on the skin (cm)
    y: float
    force_x: float  # force on the body in the workspace (1/cm^2)
    force_y: float


@dataclass(frozen=True, slots=True)
class Tube:
    """Section, base and rest shape of the body."""

    diameter_cm: float = 3.5  # inflated diameter; also the length over which the fold is spread
    # contact moment (1/cm) at which the base folds; None = never
    critical_moment: float | None = None
    # rad by which the base turns for each 1/cm of contact moment there: as much as so many cm of
    # body more; no sensor sees it
    base_compliance_cm: float = 0.0
    # radius of the end's corners: 0 is a flat end, the tube's radius a half circle
    tip_rounding_cm: float = 0.0
    # shape of the body that nothing bends: where each piece ends (cm) and its curvature (1/cm),
    # base first; straight beyond the last
    rest_curvature: tuple[tuple[float, float], ...] = ()

    @property
    def radius_cm(self) -> float:
        """Tube radius."""
        return self.diameter_cm / 2


class Solution:
    """One equilibrium of a rod, which later steps of the rod do not change."""

    def __init__(self, rod: Rod) -> None:
        self._body = rod.save()
        # The centreline at the mesh's nodes and the contacts, (n,) each. `curvature` is without the
        # fold, which is `fold_angle` spread over [0, diameter], and without the rest shape.
        self.s, self.heading, self.curvature, self.x, self.y = rod.nodes().T
        self.length = rod.length  # everted (cm)
        self.free_curvature = rod.free_curvature  # 1/cm
        self.tube = rod.tube
        self.contacts = rod.contacts()  # touching pegs, base first
        self.fold_angle = rod.fold_angle  # rad, with sign; 0 unless the base folds
        self.base_moment = rod.base_moment  # of the contacts (1/cm)
        self.status = rod.status

    def averages(self, centers: npt.ArrayLike, spans: npt.ArrayLike) -> Floats:
        """Mean curvature (1/cm) over spans (cm) centred at arcs (cm), shape (N,).

        Fold and rest shape are included. A span of 0 gives the value at the centre.
        """
        x = np.ascontiguousarray(np.atleast_1d(np.asarray(centers, dtype=np.float64)))
        width = np.ascontiguousarray(np.broadcast_to(np.asarray(spans, dtype=np.float64), x.shape))
        out = np.empty_like(x)
        self._body.averages_into(x, width, out)
        return out

    def pose(self, arc: float) -> tuple[float, float, float]:
        """(x, y, heading) of the centreline at an arc length."""
        return self._body.pose(arc)

    @property
    def tip(self) -> tuple[float, float, float]:
        """(x, y, heading) of the tip."""
        return float(self.x[-1]), float(self.y[-1]), float(self.heading[-1])

    def locate(self, peg: Peg) -> tuple[float, float]:
        """(gap, arc) of a peg: its distance from the skin, negative inside, and the nearest arc."""
        return self._body.locate(peg.x, peg.y, peg.radius)


@dataclass(frozen=True, slots=True)
class Sweep:
    """Readings of N sensors along a ladder of K free curvatures, among P obstacles.

    Derivatives are exact where nothing slips: they come from the equilibrium's own equations. They
    do not know that another obstacle may be touched, or that an end may slip off.
    """

    # (K, N) mean curvature over each sensor, 1/cm, fold and rest shape included
    readings: Floats
    by_place: Floats  # (K, N) for each cm that the sensor lies farther out
    # (K, N, P, 6) for each obstacle's x, y, radius, end_x, end_y (of a wall) and compliance
    by_obstacle: Floats
    # (K, N, 3) for the critical moment, the base's compliance and the coefficient of friction
    by_body: Floats
    # (K, P, 4) arc (cm), x and y of the contact (cm), and its force (1/cm^2); NaN without contact
    contacts: Floats
    # (K,) whether the equilibrium is only as exact as a penalty method; derivatives are 0 there
    approximate: npt.NDArray[np.bool_]


class Rod(_rod.Rod):
    """A body with a history: each `step` starts from the last equilibrium, as on a real robot.

    Args:
        tube: section and fold.
        pegs: obstacles, pegs and walls.
        cell_cm: mesh width; 1 cm gives an error of about 1e-6 cm at a vine robot's bends.
        model: "auto" uses the simplest sufficient model at each step: "arc" without contact, "beam"
            if the body is straight at rest and the beam's error bound meets the tolerance, else
            "elastica". Any of these three names is
            used for all steps ("arc" ignores pegs).
        tolerance_cm: largest error in position of the automatic choice.
        friction: Coulomb coefficient between skin and obstacles. With it, with walls, and with
            what yields, "auto" never uses "beam".
    """

    def __init__(
        self,
        tube: Tube,
        pegs: Sequence[Obstacle] = (),
        *,
        cell_cm: float = 1.0,
        model: ModelChoice = "elastica",
        tolerance_cm: float = 0.05,
        friction: float = 0.0,
    ) -> None:
        super().__init__(
            tube.diameter_cm, tube.critical_moment, _rows(pegs), cell_cm, model, tolerance_cm,
            friction, tube.base_compliance_cm, tube.tip_rounding_cm, tube.rest_curvature,
        )  # fmt: skip

    def sweep(
        self, bends: npt.ArrayLike, length: float, centers: npt.ArrayLike, spans: npt.ArrayLike
    ) -> Sweep:
        """Bend the free body at rest through a ladder of free curvatures, and read its sensors.

        The rod itself stays where it is. A body that touches nothing costs next to nothing, one
        that touches is always the elastica.

        Args:
            bends: (K,) free curvatures in their order, 1/cm.
            length: everted length, cm.
            centers: (N,) arcs of the sensors, cm.
            spans: (N,) their spans, or one for all; 0 reads the value at the centre.

        Raises:
            DataError: values that are not finite, or a length that is not positive.
        """
        ladder = np.ascontiguousarray(np.asarray(bends, dtype=np.float64))
        x = np.ascontiguousarray(np.asarray(centers, dtype=np.float64))
        width = np.ascontiguousarray(np.broadcast_to(np.asarray(spans, dtype=np.float64), x.shape))
        if not (np.isfinite(ladder).all() and np.isfinite(length) and length > 0.0):
            raise DataError("free curvatures must be finite numbers, and the length positive")
        readings, by_place, by, contacts, approximate = self._sweep(ladder, length, x, width)
        bodies = by.shape[2] - 3
        by_obstacle = by[:, :, :bodies].reshape(*readings.shape, contacts.shape[1], 6)
        # The solver moves a wall as a whole by x and y; here its last end stays where it is.
        by_obstacle[..., :2] -= by_obstacle[..., 3:5]
        return Sweep(
            readings, by_place, by_obstacle, by[:, :, bodies:], contacts, approximate.astype(bool)
        )

    def place(self, pegs: Sequence[Obstacle]) -> None:
        """Replace the pegs in the room.

        A body that touches neither old nor new pegs stays as it is. Otherwise it is bent again from
        straight, and pegs in its way push it aside.
        """
        self._place(_rows(pegs))

    @property
    def tube(self) -> Tube:
        """Section, fold, end and rest shape."""
        return Tube(
            self.diameter_cm, self.critical_moment, self.base_compliance_cm,
            self.tip_rounding_cm, self.rest_curvature,
        )  # fmt: skip

    def contacts(self) -> tuple[PegContact, ...]:
        """Touching pegs, base first."""
        return tuple(PegContact(*row) for row in self._contacts())

    def solution(self) -> Solution:
        """The present equilibrium."""
        return Solution(self)


def _rows(pegs: Sequence[Obstacle]) -> list[tuple[float, float, float, float, float, float]]:
    return [
        (peg.x, peg.y, peg.radius, peg.end_x - peg.x, peg.end_y - peg.y, peg.compliance)
        if isinstance(peg, Wall)
        else (peg.x, peg.y, peg.radius, 0.0, 0.0, peg.compliance)
        for peg in pegs
    ]


def solve(
    free_curvature: float,
    length: float,
    *,
    tube: Tube | None = None,
    pegs: Sequence[Obstacle] = (),
    cell_cm: float = 1.0,
) -> Solution:
    """Equilibrium of the body among pegs.

    With pegs the equilibrium depends on the history. Here the body starts straight at its full
    length (cm), pegs that overlap it push it aside, and the free curvature (1/cm) rises in steps.
    Use `Rod` for another history. The default tube is 3.5 cm wide and does not fold.
    """
    rod = Rod(tube or Tube(), pegs, cell_cm=cell_cm)
    rod.step(free_curvature, length)
    return rod.solution()


def push(
    force: npt.ArrayLike,
    arc: npt.ArrayLike,
    *,
    free_curvature: float,
    length: float,
    tube: Tube | None = None,
    fold_angle: float = 0.0,
    cell_cm: float = 1.0,
) -> Solution:
    """Equilibrium of the body under given normal forces at given arcs.

    This is one integration from tip to base, without iteration, for bends of any size. `peg_for`
    finds the peg that causes such a force.

    Args:
        force: normal forces (1/cm^2, signed as the curvature they add), scalar or shape (n,).
        arc: their arc lengths (cm), same shape.
        free_curvature: 1/cm.
        length: everted length, cm.
        tube: 3.5 cm wide unless given; its critical moment is ignored here.
        fold_angle: angle of the base's fold (rad), spread over one diameter.

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
    # The pegs' radius is arbitrary: nothing depends on it.
    end = 2.0 * length + np.pi + body.diameter_cm
    rod = Rod(body, [Peg(0.0, 0.0, 1.0)] * f.size, cell_cm=cell_cm)
    rod.press(np.abs(f), np.where(f < 0.0, end - a, a), fold_angle, free_curvature, length)
    return rod.solution()


def push_tip(moment: float, length: float) -> Solution:
    """Equilibrium of a straight body with a force normal to its tip that gives a base moment.

    The moment is over EI (1/cm), the length in cm. The base does not fold.
    """
    force = moment / length
    for _ in range(_TIP_PASSES):
        bent = push(force, length, free_curvature=0.0, length=length)
        force *= moment / abs(bent.base_moment)
    return push(force, length, free_curvature=0.0, length=length)


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
