"""The map that grows while the robot explores: obstacles, each felt at one stage or at several.

`room.py` says which sightings are one obstacle and where it is on the body; here it gets its place
in the plane. The two muscles' rooms and the obstructions of growth share that plane: where one
place explains two of their obstacles better than two places do, they are one, and the surer place
stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, nan
from typing import Any

import numpy as np

from thigmo.config import SIDES, RobotConfig
from thigmo.contact_status import POINT_ESTIMATE
from thigmo.exploration.fitted import FittedMap
from thigmo.exploration.prior import match
from thigmo.exploration.room import Found, Room
from thigmo.exploration.sighting import LEVEL, LIKELY, Passed, Sighting, arc_grid, shortest
from thigmo.exploration.stall import Lean, Obstruction, causes
from thigmo.exploration.workspace import Bend, PlacedContact, place_contact, ramp_knots
from thigmo.localization import Contact
from thigmo.localization.priors import narrow
from thigmo.record import MapContact, Obstacle, Stall, TrueContact
from thigmo.robot import SweepResult

# No place is known better than this: the peg's own size and the slide along it.
_FLOOR_CM = 1.0
_REACH = 3000.0 / 53**2  # of the length squared: where an obstacle may be, what a body sweeps
_ANOTHER = 0.3  # prior odds of one more obstacle, as in the room
_ASIDE = 5.0 / 53  # of the length: a body that leans so near a stall leans on what stopped it
_SAME_LENGTH_CM = 0.5  # of two measurements at one stage


class ContactMap:
    """Obstacles in the workspace; one that is an obstacle of the map that was given says so."""

    def __init__(
        self,
        config: RobotConfig,
        prior: Sequence[Obstacle] = (),
        fitted: FittedMap | None = None,
    ) -> None:
        self._config = config
        self._prior = prior
        self._fitted = fitted  # places contacts in place of what single frames felt
        self._arcs = arc_grid(config.body.length_cm)
        self._seen: list[Sighting] = []
        self._passed: list[Passed] = []
        self._obstructions: list[MapContact] = []
        self.stall: Stall | None = None  # what stopped the growth
        self._points: list[MapContact] = []  # by a method without intervals
        self._known: list[MapContact] | None = []  # None: something was added since

    def add(self, sighting: Sighting) -> None:
        """Take a contact that a stage felt.

        One without its error is a contact of its own: nothing tells whether it is another one.
        """
        if sighting.contact.status == POINT_ESTIMATE:
            self._points.append(self._place_point(sighting))
        else:
            self._seen.append(sighting)
        self._known = None

    def add_passed(self, passed: Passed) -> None:
        """Take what a sweep passed untouched."""
        self._passed.append(passed)
        self._known = None

    def add_sweep(self, sweep: SweepResult, zone: int) -> None:
        """Take a sweep in a zone of body pressure, where all sweeps together place contacts."""
        if self._fitted is not None:
            self._fitted.add(sweep, zone)
            self._known = None

    def interval(self, sighting: Sighting) -> tuple[float, float]:
        """The 95 % interval of a sighting's arc, with what earlier sweeps passed."""
        room = Room(self._arcs, [sighting], self._passed, self._config.body.radius_cm)
        return shortest(self._arcs, room.place(0))

    @property
    def contacts(self) -> list[MapContact]:
        """One for each obstacle, in the order of their discovery."""
        if self._known is None:
            self._known = self._explained()
        return list(self._known)

    def _explained(self) -> list[MapContact]:
        found: list[MapContact] = []
        for side in SIDES:
            if self._fitted is not None:
                some = self._fitted.contacts(side)
                found += [contact for contact in some if contact.probability > LIKELY]
                continue
            mine = [sighting for sighting in self._seen if sighting.side == side]
            passed = [each for each in self._passed if each.side == side]
            room = Room(self._arcs, mine, passed, self._config.body.radius_cm)
            found += [
                self._place(room, each) for each in room.obstacles() if each.probability > LIKELY
            ]
        found.sort(key=lambda contact: min([*contact.merged, contact.everted_length_cm]))
        known: list[MapContact] = []
        reach_cm2 = _REACH * self._config.body.length_cm**2
        for contact in [*found, *self._obstructions]:
            same = next(
                (n for n, other in enumerate(known) if _one_place(other, contact, reach_cm2)), None
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
        """Take a stall that was tried again at a higher body pressure.

        The tip that `moved_on` lacked pressure, and nothing stands there.
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
        probability, kind = 1.0, "peg"
        if isinstance(obstruction, Lean):
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
            # Anywhere in the interval along the path, and anywhere across the tip's face.
            along, across = (high - low) ** 2 / 12, (2 * radius) ** 2 / 12
            track = [(low, 0.0), (high, 0.0)]
            placed = PlacedContact(
                obstruction.arc_cm, 0.0, 0.0, ((along, 0.0), (0.0, across)), track
            )
        sure = narrow(obstruction.interval_cm, full_cm) and probability >= LEVEL
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
        """A contact at its place, with the obstacle of the map that was given that it is."""
        found = MapContact(**facts, **placed._asdict())
        return replace(found, known=match(self._prior, found))

    def _place_point(self, sighting: Sighting) -> MapContact:
        contact = sighting.contact
        return self._felt(
            sighting, contact.arc, contact.force, contact.interval, None,
            status=contact.status, probability=nan, peg_probability=nan, wall_probability=nan,
        )  # fmt: skip

    def _felt(
        self,
        sighting: Sighting,
        arc_cm: float,
        force_per_cm2: float,
        interval_cm: tuple[float, float],
        end_offset_cm: float | None,
        **facts: Any,
    ) -> MapContact:
        """A contact at its place on the body that a sighting bent."""
        contact = sighting.contact
        placed = place_contact(
            sighting.bend,
            arc_cm,
            force_per_cm2,
            interval_cm,
            radius_cm=self._config.body.radius_cm,
            end_offset_cm=end_offset_cm,
        )
        return self._contact(
            placed,
            arc_cm=arc_cm,
            force_per_cm2=force_per_cm2,
            **_newtons(contact, force_per_cm2 / contact.force if contact.force else 1.0),
            interval_cm=interval_cm,
            everted_length_cm=sighting.length_cm,
            side=sighting.side,
            model=sighting.hypothesis,
            readings=sighting.readings,
            **facts,
        )

    def _place(self, room: Room, found: Found) -> MapContact:
        """The obstacle where the longest body felt it."""
        members = [room.seen[i] for i in found.members]
        newest = members[-1]
        contact, arc = newest.contact, found.arc_cm
        force = contact.force * contact.arc / arc if arc > 0 else contact.force
        offset = contact.end_offset
        if offset is not None and arc < contact.arc - _FLOOR_CM and newest.bend.excess:
            # Other stages say that it is on the side, where the same moment needs this force.
            offset, force = None, newest.bend.excess[0][1] / arc
        return self._felt(
            newest, arc, force, found.interval_cm, offset,
            status=found.status,
            merged=[sighting.length_cm for sighting in members[:-1]],
            kind=found.kind,
            probability=round(found.probability, 4),
            peg_probability=round(found.kinds["peg"], 4),
            wall_probability=round(found.kinds["wall"], 4),
            surface=[(round(x, 4), round(y, 4)) for x, y in found.surface]
            if found.kind == "wall"
            else [],
        )  # fmt: skip


def _newtons(contact: Contact, times: float) -> dict[str, Any]:
    """A contact's force across the body, where the same moment needs this multiple of it."""
    if contact.newtons is None:
        return {}
    across = contact.newtons.across
    ends = sorted(times * end for end in across.interval)
    return {"force_n": times * across.value, "force_interval_n": ends}


def _one_place(a: MapContact, b: MapContact, reach_cm2: float) -> bool:
    """Whether one place explains two obstacles better than two do.

    They are of the two muscles' sweeps, on the same skin of the body, or growth met one of them.
    The room has already separated those of one muscle's sweeps.
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
