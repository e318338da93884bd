"""The contacts of each side, for the map: one fit to all frames of its sweeps (`thigmo.field`)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from thigmo.config import SAME_LENGTH_CM, SIGN, Side
from thigmo.contact_status import SURE, narrow
from thigmo.exploration.prior import KnownPlaces, match
from thigmo.field import (
    Atlas,
    FieldContact,
    PartialAnswer,
    Swept,
    contacts,
    partial_answer,
    read,
)
from thigmo.record import Explanation, MapContact, Obstacle
from thigmo.robot import SweepResult
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring

_MAP_ERRS = 1.3  # bends of the atlas over the map's highest
_CELL_CM = 0.5  # of the posterior along the body
_SMOOTH_CM = 0.25  # one sigma by which a sample of the arc is spread over the cells


@lru_cache(maxsize=4)
def _atlas(length_cm: float, most_bend: float) -> Atlas:
    """The atlas of a robot's body, kept for its runs and replays: making it takes two seconds."""
    return Atlas(length_cm, most_bend)


@dataclass(frozen=True, slots=True)
class FittedContact:
    """A contact for the map, with the samples of its arc along the body."""

    contact: MapContact
    arcs: Floats  # (n,) cm
    weights: Floats  # (n,) of sum one

    def felt_at(self, length_cm: float) -> bool:
        """Whether a sweep at an everted length touched it."""
        lengths = [*self.contact.merged, self.contact.everted_length_cm]
        return any(abs(length - length_cm) < SAME_LENGTH_CM for length in lengths)

    def cells(self, length_cm: float) -> tuple[Floats, Floats]:
        """Middles (n,) of cells along a body, cm, and the posterior mass (n,) of each."""
        return cells(self.arcs, self.weights, length_cm, _SMOOTH_CM)


def cells(
    arcs: Floats, weights: Floats, length_cm: float, smooth_cm: float
) -> tuple[Floats, Floats]:
    """Middles (n,) of cells along a body, cm, and the mass (n,) that weighed arcs give each.

    `smooth_cm`: one sigma by which an arc is spread.
    """
    edges = np.linspace(0.0, length_cm, max(round(length_cm / _CELL_CM), 1) + 1)
    below = ndtr((edges[:, None] - arcs) / smooth_cm) @ weights
    below[0], below[-1] = 0.0, 1.0  # what bears on the end lies in the last cell
    return 0.5 * (edges[1:] + edges[:-1]), np.diff(below)


def is_localized(contact: FieldContact, length_cm: float) -> bool:
    """Whether a contact of the fit counts as localized on a body of this whole length."""
    sure = narrow(contact.interval_cm, length_cm)
    return contact.places and sure and contact.probability >= SURE


class SideFits:
    """Fits to the sweeps of each side so far.

    Attributes:
        meanwhile: called often during a fit, which takes seconds; an exception in it ends the fit.
    """

    def __init__(self, wiring: Wiring, prior: Sequence[Obstacle] = ()) -> None:
        config = wiring.config
        self._wiring, self._config, self._prior = wiring, config, prior
        self._known_places = KnownPlaces(prior)
        self.meanwhile: Callable[[], None] | None = None
        self._sweeps: dict[Side, list[Swept]] = {side: [] for side in config.sides}
        self._known: dict[Side, tuple[int, list[FittedContact]]] = {}
        bend = max(muscle.most_bend for muscle in config.muscles)
        self._atlas = _atlas(config.body.length_cm, _MAP_ERRS * bend)

    def add(self, sweep: SweepResult, body_pressure: int, sides: Collection[Side]) -> None:
        """Add a sweep's readings towards these sides, made at a body pressure."""
        for side in sides:
            self._sweeps[side].append(Swept(sweep, body_pressure))

    def contacts(self, side: Side) -> list[FittedContact]:
        """What the sweeps of one side touched, in the workspace."""
        if side not in self._sweeps:
            return []
        count, known = self._known.get(side, (0, []))
        if count != len(self._sweeps[side]):
            known = self._fit(side)
            self._known[side] = len(self._sweeps[side]), known
        return known

    def so_far(self, side: Side, sweep: SweepResult, body_pressure: int) -> PartialAnswer | None:
        """What one side's sweeps say with a sweep that still goes on; None without a reading."""
        sweeps = [*self._sweeps[side], Swept(sweep, body_pressure)]
        prepared = read(sweeps, side, self._wiring)
        return None if prepared is None else partial_answer(*prepared, self._atlas)

    def _fit(self, side: Side) -> list[FittedContact]:
        sweeps = self._sweeps[side]
        prepared = read(sweeps, side, self._wiring)
        if prepared is None:
            return []
        expected = None
        if self._prior:

            def expected(points: Floats) -> Floats:
                mirrored = points * [1.0, SIGN[side]]
                return self._known_places.boost(mirrored, self._config.body.length_cm)

        side_contacts = contacts(
            *prepared, self._atlas, expected=expected, meanwhile=self.meanwhile
        )
        model = f"by {len(sweeps)} sweep{'s' if len(sweeps) > 1 else ''}"
        model += f"; one of {len(side_contacts)} on this side" if len(side_contacts) > 1 else ""
        sensors = prepared[0].centers.size
        return [
            FittedContact(
                self._mapped(contact, side, model, sensors), contact.arcs, contact.weights
            )
            for contact in side_contacts
        ]

    def _mapped(self, contact: FieldContact, side: Side, model: str, sensors: int) -> MapContact:
        """The contact by so many sensors, in the workspace; `model` says by what sweeps."""
        sign = SIGN[side]
        mirror = np.diag([1.0, sign])
        (xx, xy), (yx, yy) = (mirror @ contact.covariance_cm2 @ mirror).tolist()
        localized = is_localized(contact, self._config.body.length_cm)
        force = -sign * contact.force_per_cm2
        gave_way = ""
        if contact.gave_way_at is not None:
            gave_way = f" that gave way at {contact.gave_way_at:.4f} 1/cm"
        mapped = MapContact(
            arc_cm=contact.arc_cm,
            x_cm=contact.x_cm,
            y_cm=sign * contact.y_cm,
            force_per_cm2=force,
            interval_cm=contact.interval_cm,
            status="localized" if localized else "ambiguous",
            everted_length_cm=contact.length_cm,
            side=side,
            normal_rad=sign * contact.normal_rad,
            covariance_cm2=((xx, xy), (yx, yy)),
            track=[(round(x, 4), round(sign * y, 4)) for x, y in contact.track.tolist()],
            kind=contact.kind,
            model=f"{contact.kind}{gave_way}, {model}",
            doubt=contact.doubt,
            explanations=[Explanation(n, round(p, 4)) for n, p in contact.explanations.items()],
            surface=[(round(x, 4), round(sign * y, 4)) for x, y in contact.face.tolist()],
            readings=sensors,
            merged=[length for length in contact.felt_at_cm if length < contact.length_cm - 0.1],
            probability=round(contact.probability, 4),
            fit_log_odds=round(contact.log_odds, 2),
            fit_misfit=round(contact.misfit, 3),
            fit_samples=round(contact.effective, 1),
            fit_radius_cm=round(contact.peg_radius_cm, 2) if contact.kind == "peg" else None,
            fit_friction=round(contact.friction, 3),
            fit_yield_cm=round(contact.yield_cm, 3),
            gave_way_per_cm=None if contact.gave_way_at is None else sign * contact.gave_way_at,
        )
        if (newtons := self._newtons(force, contact)) is not None:
            mapped = replace(mapped, force_n=newtons[0], force_interval_n=newtons[1])
        return replace(mapped, known=match(self._prior, mapped))

    def _newtons(self, force: float, contact: FieldContact) -> tuple[float, list[float]] | None:
        """Force in newtons with its 95 % interval; None if the stiffness is not known."""
        if self._config.body.stiffness is None:
            return None
        stiffness, error = self._config.body.stiffness
        low, high = contact.force_interval_per_cm2
        size = contact.force_per_cm2
        below, above = (
            float(np.hypot(end - size, 1.96 * error * size)) * stiffness for end in (low, high)
        )
        value = force * stiffness
        outwards = float(np.sign(force))
        return value, sorted([value - outwards * below, value + outwards * above])
