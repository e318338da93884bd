"""The contacts of each side, for the map: fits of pegs to all frames of its sweeps.

One peg for all sweeps, or several that shared the stages among them (`thigmo.field` fits each).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from thigmo.config import SAME_LENGTH_CM, SIGN, RobotConfig, Side
from thigmo.contact_status import SURE
from thigmo.exploration.prior import boost, match
from thigmo.field import (
    ENOUGH,
    Atlas,
    FieldContact,
    Swept,
    contacts,
    read,
    untouched_evidence,
)
from thigmo.localization.priors import narrow
from thigmo.record import MapContact, Obstacle
from thigmo.robot import SweepResult
from thigmo.robot.curvature import Floats

_MAP_ERRS = 1.3  # bends of the atlas over the map's highest
_CELL_CM = 0.5  # of the posterior along the body
_SMOOTH_CM = 0.25  # one sigma by which a sample of the arc is spread over the cells
# Sum of squares over the number of independent readings beyond which one peg for all sweeps is
# compared with one for each stage, which takes time. A peg that explains its sweeps leaves about 1.
_DOUBTED = 1.15
_ROUGHLY = 15.0  # effective samples of a stage by itself: its evidence to a quarter of a nat
_SAME_SIGMA = 3.0  # within which two stages' places may be one


@lru_cache(maxsize=4)
def _atlas(length_cm: float, most_bend: float) -> Atlas:
    """An atlas that all runs of a robot and their replays share: making it takes two seconds."""
    return Atlas(length_cm, most_bend)


@dataclass(frozen=True, slots=True)
class FittedContact:
    """A contact for the map, with the samples of its arc along the body."""

    contact: MapContact
    arcs: Floats  # (n,) cm
    weights: Floats  # (n,) of sum one
    misfit: float  # 1 if the peg explains its sweeps
    log_evidence: float  # of these sweeps

    def felt_at(self, length_cm: float) -> bool:
        """Whether a sweep at an everted length touched it."""
        lengths = [*self.contact.merged, self.contact.everted_length_cm]
        return any(abs(length - length_cm) < SAME_LENGTH_CM for length in lengths)

    def cells(self, length_cm: float) -> tuple[Floats, Floats]:
        """Middles (n,) of cells along a body, cm, and the posterior mass (n,) of each."""
        edges = np.linspace(0.0, length_cm, max(round(length_cm / _CELL_CM), 1) + 1)
        below = ndtr((edges[:, None] - self.arcs) / _SMOOTH_CM) @ self.weights
        below[0], below[-1] = 0.0, 1.0  # what bears on the end lies in the last cell
        return 0.5 * (edges[1:] + edges[:-1]), np.diff(below)


class SideFits:
    """Fits to the sweeps of each side so far."""

    def __init__(self, config: RobotConfig, prior: Sequence[Obstacle] = ()) -> None:
        self._config, self._prior = config, prior
        self._sweeps: dict[Side, list[Swept]] = {side: [] for side in config.sides}
        self._known: dict[Side, tuple[int, list[FittedContact]]] = {}
        # By side and numbers of sweeps: a stage's own fit lasts while later stages come.
        self._groups: dict[tuple[Side, tuple[int, ...]], _Group] = {}
        bend = max(
            zone.inflate.curvature(muscle.max_pressure_psi)
            for muscle in config.muscles
            for zone in muscle.maps
        )
        self._atlas = _atlas(config.body.length_cm, _MAP_ERRS * bend)

    def add(self, sweep: SweepResult, zone: int, sides: Collection[Side]) -> None:
        """Take what a sweep, in a zone of body pressure, read on its way to these sides."""
        for side in sides:
            self._sweeps[side].append(Swept(sweep, zone))

    def contacts(self, side: Side) -> list[FittedContact]:
        """What the sweeps of one side touched, in the workspace."""
        if side not in self._sweeps:
            return []
        count, known = self._known.get(side, (0, []))
        if count != len(self._sweeps[side]):
            known = self._fit(side)
            self._known[side] = len(self._sweeps[side]), known
        return known

    def _fit(self, side: Side) -> list[FittedContact]:
        """One peg for all sweeps of a side, or several for its stages if that is likelier."""
        whole = self._group(side, range(len(self._sweeps[side])), ENOUGH)
        if all(fitted.misfit <= _DOUBTED for fitted in whole.found):
            return whole.found
        groups = self._stages_apart(side)
        apart = [group for group in groups if group.found]
        if len(apart) < 2 or sum(g.log_evidence for g in groups) <= whole.log_evidence:
            return whole.found
        return [_of_several(fitted) for group in apart for fitted in group.found]

    def _stages_apart(self, side: Side) -> list[_Group]:
        """The stages by themselves, those together for which one obstacle is likelier than two."""
        stages: dict[int, list[int]] = {}
        for number, swept in enumerate(self._sweeps[side]):
            length = round(swept.sweep.peaks[0].length_cm / SAME_LENGTH_CM)
            stages.setdefault(length, []).append(number)
        groups: list[_Group] = []
        for _, numbers in sorted(stages.items()):
            stage = self._group(side, numbers, _ROUGHLY)
            for n, other in enumerate(groups):
                if _may_be_one(stage, other):
                    joint = self._group(side, [*other.sweeps, *stage.sweeps], _ROUGHLY)
                    if joint.log_evidence > stage.log_evidence + other.log_evidence:
                        groups[n] = joint
                        break
            else:
                groups.append(stage)
        return groups

    def _group(self, side: Side, numbers: Iterable[int], enough: float) -> _Group:
        """What explains some of a side's sweeps, by their numbers, with errors of their own.

        `enough`: effective samples of a new fit.
        """
        sweeps = tuple(sorted(numbers))
        if (side, sweeps) not in self._groups:
            self._groups[side, sweeps] = self._fitted(side, sweeps, enough)
        return self._groups[side, sweeps]

    def _fitted(self, side: Side, sweeps: tuple[int, ...], enough: float) -> _Group:
        prepared = read([self._sweeps[side][n] for n in sweeps], side, self._config)
        if prepared is None:
            return _Group(sweeps, [], 0.0)
        expected = None
        if self._prior:

            def expected(points: Floats) -> Floats:
                mirrored = points * [1.0, SIGN[side]]
                return boost(self._prior, mirrored, self._config.body.length_cm)

        sensors = prepared[0].centers.size
        found = [
            FittedContact(
                self._mapped(contact, side, len(sweeps), sensors),
                contact.arcs,
                contact.weights,
                contact.misfit,
                contact.log_evidence,
            )
            for contact in contacts(*prepared, self._atlas, expected=expected, enough=enough)
        ]
        evidence = (
            sum(fitted.log_evidence for fitted in found) if found else untouched_evidence(*prepared)
        )
        return _Group(sweeps, found, evidence)

    def _mapped(self, contact: FieldContact, side: Side, sweeps: int, sensors: int) -> MapContact:
        """The contact by so many sweeps and sensors, in the workspace."""
        sign = SIGN[side]
        mirror = np.diag([1.0, sign])
        (xx, xy), (yx, yy) = (mirror @ contact.covariance_cm2 @ mirror).tolist()
        sure = narrow(contact.interval_cm, self._config.body.length_cm)
        localized = contact.places and sure and contact.probability >= SURE
        force = -sign * contact.force_per_cm2
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
            model=f"peg, by {sweeps} sweep{'s' if sweeps > 1 else ''}"
            + (f"; {contact.doubt}" if contact.doubt else ""),
            readings=sensors,
            merged=[length for length in contact.felt_at_cm if length < contact.length_cm - 0.1],
            probability=round(contact.probability, 4),
            peg_probability=round(contact.probability, 4),
            fit_log_odds=round(contact.log_odds, 2),
            fit_misfit=round(contact.misfit, 3),
            fit_samples=round(contact.effective, 1),
            fit_radius_cm=round(contact.peg_radius_cm, 2),
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


class _Group(NamedTuple):
    """Sweeps that felt one obstacle or nothing, and the fit to them."""

    sweeps: tuple[int, ...]  # their numbers
    found: list[FittedContact]
    log_evidence: float


def _of_several(fitted: FittedContact) -> FittedContact:
    """One of several obstacles, which are never localized.

    Stages that share obstacles do not check each other, and a peg at a wrong place explains a
    single stage as well as the right one.
    """
    model = f"{fitted.contact.model}; one of several, nearest here"
    contact = replace(fitted.contact, status="ambiguous", model=model)
    return replace(fitted, contact=contact)


def _may_be_one(one: _Group, other: _Group) -> bool:
    """Whether two groups' obstacles lie within each other's errors."""
    if not (one.found and other.found):
        return False
    a, b = one.found[0].contact, other.found[0].contact
    covariance = np.asarray(a.covariance_cm2) + np.asarray(b.covariance_cm2)
    apart = np.array([a.x_cm - b.x_cm, a.y_cm - b.y_cm])
    return float(apart @ np.linalg.solve(covariance, apart)) < _SAME_SIGMA**2
