"""The map that grows while the robot explores: the pegs, each felt at one stage or at several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import hypot
from typing import Any

import numpy as np

from thigmo.config import RobotConfig
from thigmo.display import POINT_ESTIMATE
from thigmo.exploration.feel import WIDEST_CM, Felt, arc_grid, fused, median, shortest
from thigmo.exploration.met import Lean, Met
from thigmo.exploration.prior import match
from thigmo.exploration.workspace import Bend, PlacedContact, place_contact, ramp_knots
from thigmo.record import MapContact, Obstacle, TrueContact

# Two contacts are one if they differ by less than this many standard deviations in the plane...
_SAME_SIGMA = 3.0
# ...where no place is taken as known better than this: the peg's own size and the slide along it.
_FLOOR_CM = 1.0
_SAME_LENGTH_CM = 0.5  # of two measurements at one stage


class ContactMap:
    """Contacts in the workspace; one that is an obstacle of the map that was given says so.

    A contact that is the same as a known one within the uncertainty is fused with it: their
    posteriors over the arc are multiplied, for the peg stands still and the body near it bends
    alike at every length, and the result is placed through the newest shape.
    """

    def __init__(self, config: RobotConfig, prior: Sequence[Obstacle] = ()) -> None:
        self._config = config
        self._prior = prior
        self._pegs: list[list[Felt]] = []
        self._placed: list[MapContact] = []

    @property
    def contacts(self) -> list[MapContact]:
        """One for each peg, in the order of their discovery."""
        return list(self._placed)

    def add(self, felt: Felt) -> None:
        """Take a contact that a stage felt."""
        alone = self._place([felt])
        if alone.status == POINT_ESTIMATE:  # without its error, none is known to be another one
            self._pegs.append([felt])
            self._placed.append(alone)
            return
        for index, (known, stages) in enumerate(zip(self._placed, self._pegs, strict=True)):
            once_a_stage = all(abs(f.length_cm - felt.length_cm) > _FLOOR_CM for f in stages)
            again = _apart(known, alone) < _SAME_SIGMA or self._agree(stages, felt)
            if known.side == felt.side and once_a_stage and again:
                stages.append(felt)
                self._placed[index] = self._place(stages)
                return
            if _other_bend(known, alone):
                self._keep_surer(index, alone, [felt])
                return
        self._pegs.append([felt])
        self._placed.append(alone)

    def add_met(self, met: Met) -> None:
        """Take what growth met, which may have been felt before: of two, the surer stays."""
        low, high = met.interval_cm
        radius = self._config.body.radius_cm
        if isinstance(met, Lean):
            model = "growth bent the body: its zeros moved"
            placed = place_contact(
                Bend(met.length_cm, 0.0, ramp_knots([(met.arc_cm, met.force_per_cm2)])),
                met.arc_cm,
                met.force_per_cm2,
                met.interval_cm,
                radius_cm=radius,
                curvature_se=met.curvature_se,
            )
        else:
            model = "stalled growth: sensors that were due did not evert"
            # Anywhere in the interval along the path, and anywhere across the tip's face.
            along, across = (high - low) ** 2 / 12, (2 * radius) ** 2 / 12
            track = [(low, 0.0), (high, 0.0)]
            placed = PlacedContact(met.arc_cm, 0.0, 0.0, ((along, 0.0), (0.0, across)), track)
        contact = self._contact(
            placed,
            arc_cm=met.arc_cm,
            force_per_cm2=met.force_per_cm2,
            interval_cm=met.interval_cm,
            status=_status(met.interval_cm),
            everted_length_cm=met.length_cm,
            side="",
            model=model,
            readings=met.sensors,
        )
        for index, known in enumerate(self._placed):
            if known.status != POINT_ESTIMATE and _apart(known, contact) < _SAME_SIGMA:
                self._keep_surer(index, contact, [])
                return
        self._pegs.append([])
        self._placed.append(contact)

    def _keep_surer(self, index: int, again: MapContact, stages: list[Felt]) -> None:
        """Of a known peg and what is the same peg, the surer stays."""
        known = self._placed[index]
        if _rank(again) < _rank(known):
            self._pegs[index] = stages
            merged = [*known.merged, known.everted_length_cm]
            self._placed[index] = replace(again, merged=merged)

    def _contact(self, placed: PlacedContact, **told: Any) -> MapContact:
        """A contact at its place, with the obstacle of the map that was given that it is."""
        found = MapContact(**told, **placed._asdict())
        return replace(found, known=match(self._prior, found))

    def _agree(self, stages: Sequence[Felt], felt: Felt) -> bool:
        """Whether one place explains a known peg's posterior and a new one better than two do.

        The Bayes factor of one place against two, each anywhere along the body: a posterior with a
        mode at the known peg and another elsewhere is the known peg.
        """
        if not stages:
            return False  # what growth met has no posterior along the body
        mass = fused(arc_grid(self._config.body.length_cm), [f.mass for f in stages])
        return float(mass @ felt.mass) * len(mass) > 1.0

    def _place(self, stages: list[Felt]) -> MapContact:
        newest = stages[-1]
        contact = newest.contact
        arc, interval, status = contact.arc, contact.interval, str(contact.status)
        if len(stages) > 1:
            grid = arc_grid(self._config.body.length_cm)
            mass = fused(grid, [felt.mass for felt in stages])
            arc = median(grid, mass)
            interval = shortest(grid, mass)
            status = _status(interval)
        force = contact.force * contact.arc / arc if arc > 0 else contact.force
        offset = contact.end_offset
        if offset is not None and arc < contact.arc - _FLOOR_CM and newest.bend.excess:
            # Other stages say that it is on the side, where the same moment needs this force.
            offset, force = None, newest.bend.excess[0][1] / arc
        placed = place_contact(
            newest.bend,
            arc,
            force,
            interval,
            radius_cm=self._config.body.radius_cm,
            curvature_se=self._config.actuators.side(newest.side).offset_se,
            end_offset_cm=offset,
        )
        return self._contact(
            placed,
            arc_cm=arc,
            force_per_cm2=force,
            interval_cm=(float(interval[0]), float(interval[1])),
            status=status,
            everted_length_cm=newest.length_cm,
            side=newest.side,
            model=newest.hypothesis,
            readings=newest.readings,
            merged=[felt.length_cm for felt in stages[:-1]],
        )


def _status(interval: tuple[float, float]) -> str:
    return "localized" if interval[1] - interval[0] <= WIDEST_CM else "ambiguous"


def _other_bend(known: MapContact, alone: MapContact) -> bool:
    """Whether a contact is a known peg again, felt on the same side of the body by the other
    muscle: a peg that touches the straight robot. The bends differ, so the surer one stays.
    """
    same_skin = known.force_per_cm2 * alone.force_per_cm2 > 0
    return known.side != alone.side and same_skin and _apart(known, alone) < _SAME_SIGMA


def _apart(a: MapContact, b: MapContact) -> float:
    """Distance in the plane, in standard deviations."""
    covariance = np.asarray(a.covariance_cm2) + np.asarray(b.covariance_cm2)
    covariance += _FLOOR_CM**2 * np.eye(2)
    apart = np.array([a.x_cm - b.x_cm, a.y_cm - b.y_cm])
    return float(np.sqrt(apart @ np.linalg.solve(covariance, apart)))


def _rank(contact: MapContact) -> tuple[bool, float]:
    return (contact.status != "localized", contact.interval_cm[1] - contact.interval_cm[0])


def best_contact(contacts: Sequence[MapContact]) -> MapContact | None:
    """The contact that the run vouches for most: localized, with the narrowest interval."""
    return min(contacts, key=_rank, default=None)


def of_stage(true: TrueContact, length_cm: float, side: str) -> bool:
    """Whether a true contact belongs to a stage's side."""
    near = abs(true.everted_length_cm - length_cm) < _SAME_LENGTH_CM
    return near and true.side in ("", side)


def errors(
    contacts: Sequence[MapContact], truth: Sequence[TrueContact]
) -> tuple[float | None, float | None]:
    """(|x error|, distance in the plane) of the best contact, cm; (None, None) without either.

    It is compared with the true contact point on the robot's skin at the same stage's measurement;
    of several, with the nearest.
    """
    best = best_contact(contacts)
    apart = [
        (abs(true.x_cm - best.x_cm), hypot(true.x_cm - best.x_cm, true.y_cm - best.y_cm))
        for true in truth
        if best and of_stage(true, best.everted_length_cm, best.side)
    ]
    return min(apart, key=lambda gap: gap[1], default=(None, None))


def peg_ahead(contacts: list[MapContact], length_cm: float, radius_cm: float) -> bool:
    """Whether a contact lies on the straight path in front of the tip, which would buckle there."""
    return any(
        contact.x_cm > length_cm - radius_cm and abs(contact.y_cm) < radius_cm + _FLOOR_CM
        for contact in contacts
    )
