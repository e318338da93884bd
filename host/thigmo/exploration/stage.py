"""One stage of an exploration, from its sweep to its entry in contacts.json.

Shared by the live run and the replay of a record, so that both say the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import deepcopy
from dataclasses import replace

import numpy as np

from thigmo.config import SIDES, SIGN, RobotConfig, Side
from thigmo.exploration.fitted import FIELD, FittedMap, frame_method
from thigmo.exploration.map import ContactMap
from thigmo.exploration.measuring import (
    caught_sides,
    held_back,
    pressed_enough,
)
from thigmo.exploration.peak import PeakAnswer, localize_peak
from thigmo.exploration.reference import FreeResponse, gain_errors
from thigmo.exploration.scoring import judged
from thigmo.exploration.sighting import (
    LEVEL,
    LIKELY,
    bend_grid,
    passed_before,
    passed_freely,
    touch_mass,
)
from thigmo.exploration.workspace import centreline, common_error, measured_bend
from thigmo.record import Obstacle, RunDocument, Shape, Stage, Trigger
from thigmo.robot import Peak, SensorTable, SweepResult, mean_peak
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring

_SHAPES_A_SIDE = 12
_AVERAGED = 5  # frames behind a shape, a quarter of a second
# A 95 % interval this narrow ends a sweep, in diameters of the tube. Contacts on the tip's end need
# it: at 5 cm they were 0.8 cm farther off on a tube of 3.5 cm, for 7 s of robot time less.
ENOUGH = 3.0 / 3.5
# Probability from which a contact counts although the base shows no touch.
_CERTAIN = 0.99
_CAUGHT = "the body was held bent before the muscle bent it: its tip is caught, place unknown"
_NO_TOUCH = "the base was not held back as by an obstacle: noise, or a map that bends too much"


class Interpreter:
    """Reads a run's sweeps in their order, and learns from those without contact."""

    def __init__(
        self, config: RobotConfig, prior: Sequence[Obstacle] = (), method: str = "posterior"
    ) -> None:
        self._config = config
        self._method = frame_method(method)
        self._prior = prior
        wiring = Wiring.of(config)
        self._table = SensorTable.of(wiring)
        self._base_noise = float(self._table.noise[[*wiring.base_inputs]].max(initial=0.0))
        self._response = FreeResponse(config)
        self._bends = bend_grid(config.body.length_cm)
        fitted = FittedMap(config, prior) if method == FIELD else None
        self.map = ContactMap(config, prior, fitted)  # contacts so far

    def felt_sides(self, sweep: SweepResult) -> set[Side]:
        """Sides on which a sweep touched something, and whose body was not caught before."""
        touched = {side for side in SIDES if np.ptp(self._touch(sweep, side)) > 0}
        return touched - caught_sides(sweep)

    def _touch(self, sweep: SweepResult, side: Side) -> Floats:
        return touch_mass(sweep.frames, side, self._bends, self._base_noise)

    def localize(
        self, sweep: SweepResult, measuring: SweepResult | None, zone: int, measured_zone: int
    ) -> list[PeakAnswer]:
        """Contacts of a stage: where a touch was found, or the readings leave no doubt.

        Of a side that was measured again, that peak counts.
        """
        self.map.add_sweep(sweep, zone)
        if measuring:
            self.map.add_sweep(measuring, measured_zone)
        felt, caught = self.felt_sides(sweep), caught_sides(sweep)
        if measuring:
            caught |= caught_sides(measuring)
        again = {
            side: [peak for peak in measuring.peaks if peak.side == side] if measuring else []
            for side in SIDES
        }
        answers = []
        for peak in sweep.peaks:
            side = peak.side
            if side in caught or not self._table.usable(side, peak.sensors).any():
                continue  # no sensor is everted and healthy
            touch = self._touch(sweep, side)
            if measuring and again[side] and np.ptp(slow := self._touch(measuring, side)) > 0:
                touch = slow  # it swings less as it begins, and has more frames around its touch
            self._learn(self._response, sweep, side, zone, touch)
            if measuring:
                self._learn(self._response, measuring, side, measured_zone, touch)
            final = mean_peak(again[side] or [peak])
            at = measured_zone if again[side] else zone
            answer = self._localize(final, at, self._response, touch)
            certain = any(sighting.contact.probability > _CERTAIN for sighting in answer.sightings)
            if side in felt or certain:
                answers.append(answer)
            elif not any(sighting.contact.probability > LIKELY for sighting in answer.sightings):
                self._response.learn(sweep, side, zone)
            if side in felt:
                self.map.add_passed(passed_before(touch, self._bends, peak))
            elif answer.result.status == "no contact":
                self.map.add_passed(passed_freely(self._bends, peak))
        return answers

    def so_far(self, so_far: SweepResult, zone: int) -> PeakAnswer | None:
        """The answer so far, on the way up; None where no sensor is everted and healthy."""
        peak = so_far.peaks[-1]
        if not self._table.usable(peak.side, peak.sensors).any():
            return None
        response = deepcopy(self._response)
        touch = self._touch(so_far, peak.side)
        self._learn(response, so_far, peak.side, zone, touch)
        return self._localize(peak, zone, response, touch)

    def _learn(
        self, response: FreeResponse, sweep: SweepResult, side: Side, zone: int, touch: Floats
    ) -> None:
        """Learn from a sweep what it read before its touch, if it has one."""
        if np.ptp(touch) > 0:
            surely = np.searchsorted(np.cumsum(touch), 1 - LEVEL)
            response.learn(sweep, side, zone, float(self._bends[surely]))

    def _localize(self, peak: Peak, zone: int, response: FreeResponse, touch: Floats) -> PeakAnswer:
        return localize_peak(peak, self._config, zone, response, touch, self._prior, self._method)

    def placed(self, answer: PeakAnswer) -> bool:
        """Whether an answer has one contact whose place is known well enough."""
        if len(answer.sightings) != 1:
            return False
        low, high = self.map.interval(answer.sightings[0])
        return (
            answer.sightings[0].probability >= LEVEL
            and high - low <= ENOUGH * self._config.body.diameter_cm
        )

    def add(self, answers: Iterable[PeakAnswer]) -> None:
        """Put what a stage felt on the map."""
        for answer in answers:
            for sighting in answer.sightings:
                self.map.add(sighting)

    def entry(
        self,
        t_s: float,
        length_cm: float,
        sweep: SweepResult,
        answers: Sequence[PeakAnswer],
        zone: int,
    ) -> Stage:
        """The stage's entry in contacts.json."""
        said = {each.shape.side: (each.result.status, each.result.message) for each in answers}
        said |= {side: ("ambiguous", _CAUGHT) for side in caught_sides(sweep) if side not in said}
        shapes = _swept_shapes(length_cm, zone, sweep, self._config)
        return Stage(
            everted_length_cm=length_cm,
            body_pressure_psi=self._config.body.zones[zone].pressure_psi,
            t_s=t_s,
            shapes=[*shapes, *(answer.shape for answer in answers)],
            triggers=[
                Trigger(
                    t.side, t.t_s, t.excess_per_cm, *said.get(t.side, ("no contact", _NO_TOUCH))
                )
                for t in sweep.triggers
            ],
            held_back_per_cm={
                side: round(float(held.max()), 6)
                for side in SIDES
                if (held := held_back(sweep.frames, side)).size
            },
        )

    def judged(self, document: RunDocument) -> RunDocument:
        """The document with the map's contacts, their errors, and what was missed or is false."""
        known = replace(
            document, contacts=self.map.contacts, stall=self.map.stall or document.stall
        )
        return judged(known, self._config, self._prior)


def _swept_shapes(
    length_cm: float, zone: int, sweep: SweepResult, config: RobotConfig
) -> list[Shape]:
    """A dozen shapes of the body on each half sweep's way up, until its base is near its fold.

    They follow the readings, and not the map: a peg may hold the body back long before the trigger
    fires. Nor do they bend further than the map says: pegs in the way of a bend only take from it,
    and so a sensor that reads too much makes no space free.
    """
    shapes = []
    table = SensorTable.of(Wiring.of(config))
    gain = gain_errors(config)
    for side in SIDES:
        frames, readings = sweep.half(side)
        # A record with a gap may lack a sensor's zero.
        use = table.usable(side, sweep.sensors) & np.isfinite(readings).all(axis=0)
        if not use.any() or not frames:
            continue
        readings = readings[:, use]
        pressure = np.array([frame.pressure_psi for frame in frames])
        held = held_back(frames, side)
        folds = np.array([pressed_enough(each, config, zone) for each in held])
        end = min([int(pressure.argmax()) + 1, *np.flatnonzero(folds)[:1]])
        way = SIGN[side]
        for part in np.array_split(np.arange(end), _SHAPES_A_SIDE):
            last = part[-_AVERAGED:]
            if not last.size:
                continue
            free = way * float(np.mean([frames[each].free_curvature for each in last]))
            bend = way * np.minimum(way * readings[last].mean(axis=0), free)
            error = np.hypot(table.noise[use], gain[use] * bend)
            poses = centreline(measured_bend(length_cm, table.center_cm[use], bend)).poses(1.0)
            se = common_error(length_cm, table.center_cm[use], np.diag(error**2))
            shapes.append(Shape(side, float(pressure[last].mean()), poses, round(se, 6)))
    return shapes
