"""The map that grows while the robot explores: obstacles, each felt at one stage or at several.

`fitted.py` places what the sweeps of one side touched. The two muscles' contacts and the
obstructions of growth share the plane: where one place explains two of their obstacles better than
two places do, they are one, and the surer place stays.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from math import hypot
from typing import Any

import numpy as np

from thigmo.config import SIDES, Side
from thigmo.contact_status import LIKELY, SURE, narrow
from thigmo.exploration.fitted import FittedContact, SideFits
from thigmo.exploration.prior import match
from thigmo.exploration.stall import HeldBent, Obstruction, causes
from thigmo.exploration.workspace import (
    Bend,
    PlacedContact,
    place_contact,
    place_stalled_tip,
    ramp_knots,
)
from thigmo.record import MapContact, Obstacle, Stall, TrueContact
from thigmo.robot import SweepResult
from thigmo.wiring import Wiring

# No place is known better than this: the peg's own size and the slide along it.
_FLOOR_CM = 1.0
_REACH = 3000.0 / 53**2  # of the length squared: where an obstacle may be, what a body sweeps
_ANOTHER = 0.3  # prior odds of one more obstacle
_ASIDE = 5.0 / 53  # of the length: a body that leans so near a stall leans on what stopped it
_TWO_SIDED = 1.96  # standard errors of a normal distribution that hold 95 %
_SAME_LENGTH_CM = 0.5  # of two measurements at one stage


class ContactMap:
    """The obstacles that a run has found, in the workspace.

    `MapContact.known` is the obstacle of the prior map that a contact is matched with.
    """

    def __init__(self, wiring: Wiring, prior: Sequence[Obstacle] = ()) -> None:
        self._config = wiring.config
        self._prior = prior
        self.fits = SideFits(wiring, prior)
        self._obstructions: list[MapContact] = []
        self.stall: Stall | None = None  # what stopped the growth
        self._points: list[MapContact] = []  # by a method without intervals
        self._known: list[MapContact] | None = []  # None: something was added since

    def add_sweep(self, sweep: SweepResult, body_pressure: int, sides: Collection[Side]) -> None:
        """Add a sweep's readings towards these sides, made at a body pressure."""
        self.fits.add(sweep, body_pressure, sides)
        self._known = None

    def add_points(self, points: Iterable[MapContact]) -> None:
        """Add contacts of unknown error: nothing shows which of them are the same obstacle."""
        self._points += points
        self._known = None

    def fitted(self, side: Side) -> list[FittedContact]:
        """What the sweeps of one side touched, the unlikely included."""
        return self.fits.contacts(side)

    @property
    def contacts(self) -> list[MapContact]:
        """One for each obstacle, in the order of their discovery."""
        if self._known is None:
            self._known = self._explained()
        return list(self._known)

    def _explained(self) -> list[MapContact]:
        detected = [fitted.contact for side in SIDES for fitted in self.fits.contacts(side)]
        likely = [contact for contact in detected if contact.probability > LIKELY]
        likely.sort(key=lambda contact: min([*contact.merged, contact.everted_length_cm]))
        known: list[MapContact] = []
        reach_cm2 = _REACH * self._config.body.length_cm**2
        for contact in [*likely, *self._obstructions]:
            same = next(
                (n for n, earlier in enumerate(known) if _one_place(earlier, contact, reach_cm2)),
                None,
            )
            if same is None:
                known.append(contact)
            else:
                first, second = sorted((known[same], contact), key=_rank)
                lengths = {*first.merged, *second.merged, second.everted_length_cm}
                merged = sorted(lengths - {first.everted_length_cm})
                known[same] = replace(first, merged=merged)
        return known + self._points

    def tried(self, obstruction: Obstruction, *, moved_on: bool) -> None:
        """Add the outcome of a stalled growth that was tried again at a higher body pressure.

        If the tip `moved_on`, it had lacked pressure, and no obstacle is added.
        """
        if moved_on:
            self.stall = causes(obstruction, self._walls(), moved_on=True)
        else:
            self.add_obstruction(obstruction, moved_on=False)

    def _walls(self) -> list[list[tuple[float, float]]]:
        return [contact.surface for contact in self.contacts if contact.kind == "wall"]

    def add_obstruction(self, obstruction: Obstruction, *, moved_on: bool | None = None) -> None:
        """Add an obstruction of growth; `moved_on` is that of `causes`."""
        low, high = obstruction.interval_cm
        radius = self._config.body.radius_cm
        full_cm = self._config.body.length_cm
        probability, kind, unread_cm = 1.0, "peg", 0.0
        if isinstance(obstruction, HeldBent):
            model = "growth bent the body: its zeros moved"
            if self.stall and abs(obstruction.arc_cm - self.stall.length_cm) < _ASIDE * full_cm:
                # At the higher pressure the tip went round what had stopped it.
                self.stall = replace(self.stall, obstacle=probability, wall=0.0, pressure=0.0)
            placed = place_contact(
                Bend(
                    obstruction.length_cm,
                    0.0,
                    ramp_knots([(obstruction.arc_cm, obstruction.force_per_cm2)]),
                    curvature_se=obstruction.curvature_se,
                ),
                obstruction.arc_cm,
                obstruction.force_per_cm2,
                obstruction.interval_cm,
                radius_cm=radius,
            )
        else:
            self.stall = causes(obstruction, self._walls(), moved_on=moved_on)
            probability = round(1.0 - self.stall.pressure, 4)
            kind = "wall" if self.stall.wall > self.stall.obstacle else "peg"
            if probability <= LIKELY:
                return
            model = self.stall.words
            # Farther out than its sensors tell, a caught body may bend as far as its muscles do.
            most_bend = max(muscle.most_bend for muscle in self._config.muscles)
            unread_cm = obstruction.unread * most_bend / 12**0.5 * obstruction.arc_cm**2
            placed = place_stalled_tip(
                obstruction.body or Bend(high, 0.0), obstruction.arc_cm, (low, high), radius,
                unread_cm,
            )  # fmt: skip
        sure = narrow(obstruction.interval_cm, full_cm) and probability >= SURE
        sure &= narrow((-_TWO_SIDED * unread_cm, _TWO_SIDED * unread_cm), full_cm)
        contact = self._contact(
            placed,
            arc_cm=obstruction.arc_cm,
            force_per_cm2=obstruction.force_per_cm2,
            interval_cm=obstruction.interval_cm,
            status="localized" if sure else "ambiguous",
            everted_length_cm=obstruction.length_cm,
            side="",
            model=model,
            readings=obstruction.sensors,
            kind=kind,
            probability=probability,
        )
        self._obstructions.append(contact)
        self._known = None

    def _contact(self, placed: PlacedContact, **facts: Any) -> MapContact:
        """A contact at its place, matched with the obstacles of the prior map."""
        contact = MapContact(**facts, **placed._asdict())
        return replace(contact, known=match(self._prior, contact))


def _one_place(a: MapContact, b: MapContact, reach_cm2: float) -> bool:
    """Whether one obstacle explains two contacts better than two obstacles do.

    Contacts can be the same obstacle if the two muscles' sweeps pressed the same skin of the body
    against them, or if growth met one of them. The fit has already separated the contacts of one
    muscle's sweeps.
    """
    by_growth = "" in (a.side, b.side)
    if a.side == b.side or not (by_growth or a.force_per_cm2 * b.force_per_cm2 > 0):
        return False
    covariance = np.asarray(a.covariance_cm2) + np.asarray(b.covariance_cm2)
    covariance += _FLOOR_CM**2 * np.eye(2)
    apart = np.array([a.x_cm - b.x_cm, a.y_cm - b.y_cm])
    squared = float(apart @ np.linalg.solve(covariance, apart))
    density = np.exp(-0.5 * squared) / (2 * np.pi * np.sqrt(np.linalg.det(covariance)))
    return bool(density * reach_cm2 > _ANOTHER)


def _rank(contact: MapContact) -> tuple[bool, float]:
    return (contact.status != "localized", contact.interval_cm[1] - contact.interval_cm[0])


def best_contact(contacts: Sequence[MapContact]) -> MapContact | None:
    """The contact that the run vouches for most: localized, with the narrowest interval."""
    return min(contacts, key=_rank, default=None)


def of_stage(true: TrueContact, length_cm: float, side: str) -> bool:
    """Whether a true contact belongs to a stage's side."""
    near = abs(true.everted_length_cm - length_cm) < _SAME_LENGTH_CM
    return near and true.side in ("", side)


def true_touches(contact: MapContact, truth: Iterable[TrueContact]) -> list[TrueContact]:
    """The true contacts that a contact may be.

    Those at its stage; and those of its side at the other stages that felt it, of pegs that were
    not touched at its own.
    """
    truth = list(truth)
    here = [t for t in truth if of_stage(t, contact.everted_length_cm, contact.side)]
    pegs = {true.peg for true in here}
    elsewhere = [
        true
        for true in truth
        if true.peg not in pegs
        and any(of_stage(true, length_cm, contact.side) for length_cm in contact.merged)
    ]
    return here + elsewhere


def errors(
    contacts: Sequence[MapContact], truth: Sequence[TrueContact]
) -> tuple[float | None, float | None]:
    """(|x error|, distance in the plane) of the best contact, cm; (None, None) without either.

    It is compared with the true contact points on the robot's skin that it may be, and of several
    with the nearest.
    """
    best = best_contact(contacts)
    if best is None:
        return None, None
    apart = [
        (abs(true.x_cm - best.x_cm), hypot(true.x_cm - best.x_cm, true.y_cm - best.y_cm))
        for true in true_touches(best, truth)
    ]
    return min(apart, key=lambda gap: gap[1], default=(None, None))


def peg_ahead(contacts: list[MapContact], length_cm: float, radius_cm: float) -> bool:
    """Whether a contact lies on the straight path in front of the tip, which would buckle there."""
    return any(
        contact.x_cm > length_cm - radius_cm and abs(contact.y_cm) < radius_cm + _FLOOR_CM
        for contact in contacts
    )
