"""One stage of an exploration, from its sweeps to its entry in contacts.json.

Shared by the live run and the replay of a record, so that both say the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import nan

import numpy as np
from numpy.typing import NDArray

from thigmo.config import SIDES, SIGN, Side
from thigmo.contact_status import LIKELY
from thigmo.exploration.fitted import FittedContact, cells
from thigmo.exploration.frame import localize_frame, point_estimates
from thigmo.exploration.map import ContactMap
from thigmo.exploration.measuring import caught_sides, curvature_deficit, pressed_enough
from thigmo.exploration.methods import FIELD, THESIS
from thigmo.exploration.scoring import judged
from thigmo.exploration.workspace import Bend, centreline, common_error, measured_bend
from thigmo.record import MapContact, Obstacle, RunDocument, Shape, Stage, Trigger
from thigmo.robot import TRIGGER_PER_CM, Peak, SensorTable, SweepResult, mean_peak
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring

_SHAPES_A_SIDE = 12
_AVERAGED = 5  # frames behind a shape, a quarter of a second
# Width of a 95 % interval, in diameters of the tube, below which a side is not measured again.
ENOUGH = 1.2
_CAUGHT = "the body was held bent before the muscle bent it: its tip is caught, place unknown"
_NO_TOUCH = "no obstacle explains these sweeps better than noise, or a map that bends too much"


@dataclass(frozen=True, slots=True)
class SideAnswer:
    """What the sweeps of one side felt at a stage."""

    side: Side
    length_cm: float
    shape: Shape  # of the body at the peak, by its readings
    places: Floats  # (n,) middles of cells along the body, cm; empty without a contact
    mass: Floats  # (n,) posterior of the contact's arc, of sum one
    status: str  # "localized", "ambiguous", "no contact", or "point estimate"
    hypothesis: str  # what explains the readings
    message: str  # the answer in words
    probability: float  # that there is a contact
    points: tuple[MapContact, ...] = ()  # for the map, by a method without intervals


class Interpreter:
    """Reads a run's sweeps in their order.

    Attributes:
        map: the contacts so far.
    """

    def __init__(self, wiring: Wiring, prior: Sequence[Obstacle] = (), method: str = FIELD) -> None:
        self._wiring, self._config = wiring, wiring.config
        self._thesis = method == THESIS
        self._prior = prior
        self._table = SensorTable.laid_out(wiring)
        self.map = ContactMap(wiring, prior)

    def take(self, sweep: SweepResult, body_pressure: int) -> None:
        """Take a sweep, at a body pressure."""
        if not self._thesis:
            self.map.add_sweep(sweep, body_pressure, self._readable_sides(sweep))

    def _readable_sides(self, sweep: SweepResult) -> list[Side]:
        """Sides with a peak that sensors read, before which nothing held the body bent."""
        caught = caught_sides(sweep, self._table)
        readable = [peak.side for peak in sweep.peaks if self._use(peak).any()]
        return [side for side in dict.fromkeys(readable) if side not in caught]

    def _use(self, peak: Peak) -> NDArray[np.bool_]:
        """Mask of the sensors that read a peak."""
        return self._table.readable(peak.side, peak.sensors, peak.curvature)

    def felt_sides(self, sweep: SweepResult) -> set[Side]:
        """Sides on which a sweep that was taken touched something."""
        sides = self._readable_sides(sweep)
        if self._thesis:
            held = {side: curvature_deficit(sweep.frames, side).max(initial=0.0) for side in sides}
            return {side for side in sides if held[side] > TRIGGER_PER_CM}
        return {side for side in sides if self._felt(side, sweep)}

    def unsure_sides(self, sweep: SweepResult) -> set[Side]:
        """Sides on which the trigger fired in a sweep that is not known to have touched anything.

        What is touched from a sweep's start on, such as a peg beside the straight body, stops the
        sweep before there are readings enough: swept again, slowly, it is felt.
        """
        triggered = {trigger.side for trigger in sweep.triggers}
        return triggered & set(self._readable_sides(sweep)) - self.felt_sides(sweep)

    def _felt(self, side: Side, sweep: SweepResult) -> list[FittedContact]:
        """The likely contacts of a side that a sweep touched, by the fit to all sweeps."""
        lengths = {peak.length_cm for peak in sweep.peaks if peak.side == side}
        return [
            fitted
            for fitted in self.map.fitted(side)
            if fitted.contact.probability > LIKELY and any(map(fitted.felt_at, lengths))
        ]

    def hangs(self, sweep: SweepResult) -> bool:
        """Whether the last side's sweep began with a body that something holds: it still does."""
        return bool(sweep.frames) and sweep.frames[-1].side in caught_sides(sweep, self._table)

    def placed_sides(self, sweep: SweepResult) -> set[Side]:
        """Sides whose one contact is placed so well that it needs no measurement."""
        if self._thesis:
            return set()
        detected = {side: self._felt(side, sweep) for side in self._readable_sides(sweep)}
        return {
            side
            for side, contacts in detected.items()
            if len(contacts) == 1 and self._well_placed(contacts[0].contact)
        }

    def _well_placed(self, contact: MapContact) -> bool:
        if contact.status != "localized":
            return False
        if contact.known is not None:  # felt where the map has it
            return True
        low, high = contact.interval_cm
        return high - low <= ENOUGH * self._config.body.diameter_cm

    def localize(
        self,
        sweep: SweepResult,
        measuring: SweepResult | None,
        body_pressure: int,
        measured_body_pressure: int,
    ) -> list[SideAnswer]:
        """What a stage felt; of a side that was measured again, at that peak."""
        detected = self.felt_sides(sweep)
        answers = []
        for side in self._readable_sides(sweep):
            again = [peak for peak in measuring.peaks if peak.side == side] if measuring else []
            peak = mean_peak(again or [peak for peak in sweep.peaks if peak.side == side])
            if side not in detected or not self._use(peak).any():
                continue
            if self._thesis:
                bent_at = measured_body_pressure if again else body_pressure
                answers.append(self._by_frame(peak, bent_at))
            else:
                answers.append(self._by_fit(peak, self._felt(side, sweep)))
        return answers

    def so_far(self, sweep: SweepResult, body_pressure: int) -> SideAnswer | None:
        """What a sweep that goes on has felt, for viewers; None where no sensor can be read."""
        peak = sweep.peaks[-1]
        if not self._use(peak).any():
            return None
        if self._thesis:
            return self._by_frame(peak, body_pressure)
        partial = self.map.fits.so_far(peak.side, sweep, body_pressure)
        if partial is None or not partial.arcs.size:
            return None
        places, mass = cells(
            partial.arcs, partial.weights, peak.length_cm, 0.5 * partial.spacing_cm
        )
        low, high = np.interp((0.025, 0.975), np.cumsum(mass), places)
        likely = partial.probability > LIKELY
        return SideAnswer(
            peak.side,
            peak.length_cm,
            self._shape(peak),
            places,
            mass,
            "ambiguous" if likely else "no contact",
            "one peg, while the sweep goes on",
            f"{low:.0f} to {high:.0f} cm along the body, so far" if likely else "nothing, so far",
            partial.probability,
        )

    def _by_fit(self, peak: Peak, felt: Sequence[FittedContact]) -> SideAnswer:
        places, _ = felt[0].cells(peak.length_cm)
        contacts = [fitted.contact for fitted in felt]
        sure = all(contact.status == "localized" for contact in contacts)
        return SideAnswer(
            peak.side,
            peak.length_cm,
            self._shape(peak),
            places,
            np.mean([fitted.cells(peak.length_cm)[1] for fitted in felt], axis=0),
            "localized" if sure else "ambiguous",
            contacts[0].model,
            "; ".join(_words(contact) for contact in contacts),
            max(contact.probability for contact in contacts),
        )

    def _by_frame(self, peak: Peak, body_pressure: int) -> SideAnswer:
        result = localize_frame(peak, self._wiring, body_pressure)
        return SideAnswer(
            peak.side,
            peak.length_cm,
            self._shape(peak),
            result.places,
            result.mass,
            result.status,
            result.hypothesis,
            result.message,
            nan,
            tuple(
                point_estimates(
                    result, peak, self._bend(peak), int(self._use(peak).sum()),
                    self._config.body.radius_cm,
                )
            ),
        )  # fmt: skip

    def _bend(self, peak: Peak) -> Bend:
        """The body at a peak, as its sensors see it."""
        use = self._use(peak)
        return measured_bend(peak.length_cm, self._table.center_cm[use], peak.curvature[use])

    def _shape(self, peak: Peak) -> Shape:
        return Shape(peak.side, peak.pressure_psi, centreline(self._bend(peak)).poses(1.0))

    def add(self, answers: Sequence[SideAnswer]) -> None:
        """Put what a stage felt on the map; what is fitted is there already."""
        for answer in answers:
            self.map.add_points(answer.points)

    def entry(
        self,
        t_s: float,
        length_cm: float,
        sweep: SweepResult,
        answers: Sequence[SideAnswer],
        body_pressure: int,
    ) -> Stage:
        """The stage's entry in contacts.json."""
        verdicts = {answer.side: (answer.status, answer.message) for answer in answers}
        verdicts |= {
            side: ("ambiguous", _CAUGHT)
            for side in caught_sides(sweep, self._table)
            if side not in verdicts
        }
        shapes = _swept_shapes(length_cm, body_pressure, sweep, self._wiring)
        return Stage(
            everted_length_cm=length_cm,
            body_pressure_psi=self._config.body.pressures[body_pressure].pressure_psi,
            t_s=t_s,
            shapes=[*shapes, *(answer.shape for answer in answers)],
            triggers=[
                Trigger(
                    t.side, t.t_s, t.excess_per_cm, *verdicts.get(t.side, ("no contact", _NO_TOUCH))
                )
                for t in sweep.triggers
            ],
            curvature_deficit_per_cm={
                side: round(float(deficit.max()), 6)
                for side in SIDES
                if (deficit := curvature_deficit(sweep.frames, side)).size
            },
        )

    def judged(self, document: RunDocument) -> RunDocument:
        """The document with the map's contacts, their errors, and what was missed or is false."""
        known = replace(
            document, contacts=self.map.contacts, stall=self.map.stall or document.stall
        )
        return judged(known, self._config, self._prior)


def _words(contact: MapContact) -> str:
    """A contact of the fit for the operator."""
    low, high = contact.interval_cm
    place = f"at {contact.arc_cm:.1f} cm along the body, 95 % {low:.1f} to {high:.1f}"
    return f"{contact.model}, {place}" + (f"; {contact.doubt}" if contact.doubt else "")


def _gain_errors(wiring: Wiring) -> Floats:
    """(n,) relative standard error of each sensor's scale today; 1 where there is no sensor."""
    sensors = wiring.read_sensors
    return np.array([np.hypot(s.gain_error, s.drift_se) if s else 1.0 for s in sensors])


def _swept_shapes(
    length_cm: float, body_pressure: int, sweep: SweepResult, wiring: Wiring
) -> list[Shape]:
    """A dozen shapes of the body on each half sweep's way up, until its base is near its fold.

    They follow the readings, and not the map: a peg may hold the body back long before the trigger
    fires. Nor do they bend further than the map says: pegs in the way of a bend only take from it,
    and so a sensor that reads too much makes no space free.
    """
    shapes = []
    table, gain = SensorTable.laid_out(wiring), _gain_errors(wiring)
    for side in SIDES:
        frames, readings = sweep.half(side)
        # A record with a gap may lack a sensor's zero.
        use = table.readable(side, sweep.sensors, readings)
        if not use.any() or not frames:
            continue
        readings = readings[:, use]
        pressure = np.array([frame.pressure_psi for frame in frames])
        held = curvature_deficit(frames, side)
        config = wiring.config
        folds = np.array([pressed_enough(deficit, config, body_pressure) for deficit in held])
        end = min([int(pressure.argmax()) + 1, *np.flatnonzero(folds)[:1]])
        way = SIGN[side]
        for part in np.array_split(np.arange(end), _SHAPES_A_SIDE):
            last = part[-_AVERAGED:]
            if not last.size:
                continue
            free = way * float(np.mean([frames[index].free_curvature for index in last]))
            bend = way * np.minimum(way * readings[last].mean(axis=0), free)
            error = np.hypot(table.noise[use], gain[use] * bend)
            poses = centreline(measured_bend(length_cm, table.center_cm[use], bend)).poses(1.0)
            se = common_error(length_cm, table.center_cm[use], np.diag(error**2))
            shapes.append(Shape(side, float(pressure[last].mean()), poses, round(se, 6)))
    return shapes
