"""The method `field`: the map's contacts by one fit to all sweeps of a side (`thigmo.field`).

Kept beside the map, live and in replays; what a frame felt still steers the sweeps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thigmo.config import SIGN, RobotConfig, Side
from thigmo.errors import DataError
from thigmo.exploration.prior import boost, match
from thigmo.exploration.sighting import LEVEL
from thigmo.field import Atlas, FieldContact, Swept, contacts, read
from thigmo.localization import METHODS, check_method
from thigmo.localization.priors import narrow
from thigmo.record import MapContact, Obstacle
from thigmo.robot import SensorTable, SweepResult
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring

FIELD = "field"  # the method; its single frames are localized as by "posterior"
_MAP_ERRS = 1.3  # bends of the atlas over the map's highest


def check_exploration_method(method: str) -> None:
    """Raises DataError if explorations have no such method."""
    if method == FIELD:
        return
    if method not in METHODS:
        try:
            check_method(method)
        except DataError as error:
            raise DataError(error.what, f"use one of {', '.join((*METHODS, FIELD))}") from None


def frame_method(method: str) -> str:
    """The method of `localize` for the single frames of an exploration."""
    return METHODS[0] if method == FIELD else method


class FittedMap:
    """Contacts of each side by all of its sweeps so far."""

    def __init__(self, config: RobotConfig, prior: Sequence[Obstacle] = ()) -> None:
        self._config, self._prior = config, prior
        self._sweeps: dict[Side, list[Swept]] = {side: [] for side in config.sides}
        self._known: dict[Side, tuple[int, list[MapContact]]] = {}
        bend = max(
            zone.inflate.curvature(muscle.max_pressure_psi)
            for muscle in config.muscles
            for zone in muscle.maps
        )
        self._atlas = Atlas(config.body.length_cm, _MAP_ERRS * bend)

    def add(self, sweep: SweepResult, zone: int) -> None:
        """Take a sweep, in a zone of body pressure, for each side that it bent the body to."""
        for side in {peak.side for peak in sweep.peaks}:
            self._sweeps[side].append(Swept(sweep, zone))

    def contacts(self, side: Side) -> list[MapContact]:
        """What the sweeps of one side touched, in the workspace."""
        if side not in self._sweeps:
            return []
        count, known = self._known.get(side, (0, []))
        if count != len(self._sweeps[side]):
            known = self._fit(side)
            self._known[side] = len(self._sweeps[side]), known
        return known

    def _fit(self, side: Side) -> list[MapContact]:
        prepared = read(self._sweeps[side], side, self._config)
        if prepared is None:
            return []
        expected = None
        if self._prior:

            def expected(points: Floats) -> Floats:
                mirrored = points * [1.0, SIGN[side]]
                return boost(self._prior, mirrored, self._config.body.length_cm)

        found = contacts(*prepared, self._atlas, expected=expected)
        return [self._mapped(contact, side, len(found)) for contact in found]

    def _mapped(self, contact: FieldContact, side: Side, count: int) -> MapContact:
        """One of so many contacts of a side, in the workspace."""
        sign = SIGN[side]
        mirror = np.diag([1.0, sign])
        (xx, xy), (yx, yy) = (mirror @ contact.covariance_cm2 @ mirror).tolist()
        sure = narrow(contact.interval_cm, self._config.body.length_cm)
        localized = contact.places and sure and contact.probability >= LEVEL
        sweeps = self._sweeps[side]
        force = -sign * contact.force_per_cm2
        model = f"{contact.kind}, by {len(sweeps)} sweeps"
        model += f"; one of {count} on this side" if count > 1 else ""
        model += f"; {contact.doubt}" if contact.doubt else ""
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
            model=model,
            readings=int(
                SensorTable.of(Wiring.of(self._config)).usable(side, sweeps[-1].sweep.sensors).sum()
            ),
            merged=[length for length in contact.felt_at_cm if length < contact.length_cm - 0.1],
            probability=round(contact.probability, 4),
            peg_probability=round(contact.probability, 4),
            fit_log_odds=round(contact.log_odds, 2),
            fit_misfit=round(contact.misfit, 3),
            fit_samples=round(contact.effective, 1),
            fit_radius_cm=round(contact.peg_radius_cm, 2) if contact.kind == "peg" else None,
            fit_friction=round(contact.friction, 3),
            fit_yield_cm=round(contact.yield_cm, 3),
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
