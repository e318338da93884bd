"""How much robot time a run spends, and on what: the dial between seconds and centimetres.

Every run grows, settles, zeroes and sweeps. What can be chosen is at which lengths it sweeps, and
how many slower sweeps measure a contact that was felt. A plan is such a choice. Of the plans that
fit into a budget of robot time, the run takes the one by which the most pegs are expected to be
felt and placed, given the mechanics and the errors in robot.toml (`thigmo.field.expected`). An
effort is a budget, by name or in robot seconds. The run states what it omits and what that costs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import inf
from typing import NamedTuple

from thigmo.config import SAME_LENGTH_CM, SIDES
from thigmo.errors import DataError
from thigmo.exploration.growth import stage_lengths
from thigmo.field import ExpectedSweeps, expected_sweeps
from thigmo.robot import rising_period_s
from thigmo.wiring import Wiring

# What a step takes beside its motion, s: by the clock of emulated runs.
_BEGINS_S = 5.0  # the operator measures the length
_PRESSURE_S = 5.0  # the operator turns the regulator
_GROWS_MORE_S = 0.6  # speeding up and slowing down
_ZERO_S = 5.2  # two windows of drift, and the average
_ZERO_SETTLED_S = 3.2  # the same of a robot that has stood still: one window
_VENTS_S = 1.5  # after a side
_MEASURE_S = 6.6
_REST_S = 6.0  # of young sensors, on average

_MOST_MEASUREMENTS = 2
_PLACED = 3.0 / 53  # of the body's length: a 95 % interval by which a peg counts as placed
_SPARE_S = 10.0  # of a budget, about which a line is written
_MOST_SUBSETS = 8  # stops of which every subset is a plan; of more, the longest ones


class Plan(NamedTuple):
    """Where to sweep from here on."""

    stops: tuple[float, ...]  # everted lengths, cm, ascending; empty: the run is over
    # slow sweeps that measure a contact at a stop; 0: the readings of the first sweep count
    measurements: int


@dataclass(frozen=True, slots=True)
class Effort:
    """A budget of robot time, and how it is spent."""

    name: str
    share: float = 1.0  # of the robot time of a run that omits nothing
    # a young sensor counts once its rest is known to this multiple of its noise
    rest_noise: float = 1.0
    # whether every measurement may raise the body pressure, and not the full length's alone, after
    # which nothing lowers it again
    raises_often: bool = False
    measurements: int = _MOST_MEASUREMENTS  # of the plan, or the most that a plan may have
    time_s: float = inf  # budget in robot seconds, in place of the share


class Planner:
    """Plans of one robot's run, within its effort."""

    def __init__(self, wiring: Wiring, effort: Effort) -> None:
        self.wiring, self.config, self.effort = wiring, wiring.config, effort
        self._lengths = stage_lengths(wiring.config)

    @cached_property
    def _sides(self) -> list[ExpectedSweeps]:
        """Expected information of sweeps towards each side that the contact trigger guards."""
        unguarded = self.wiring.unguarded_muscles
        return [
            expected_sweeps(self.wiring, muscle.side, self._lengths)
            for muscle in self.config.muscles
            if muscle.side and muscle not in unguarded
        ]

    @cached_property
    def _effort_plan(self) -> Plan:
        """The plan of a named effort, from the beginning of a run."""
        if self.effort.share == 1.0:
            return Plan(tuple(self._lengths), self.effort.measurements)
        whole = Planner(self.wiring, EFFORTS["careful"])
        needed_s = whole.expected_s(Plan(tuple(self._lengths), _MOST_MEASUREMENTS))
        left_s = self.effort.share * (_BEGINS_S + needed_s) - _BEGINS_S
        best = self._best(self._lengths, left_s)
        # Of a robot with one stop, no share is enough.
        return best if best.stops else Plan((self._lengths[-1],), 1)

    def plan(
        self,
        length_cm: float = 0.0,
        spent_s: float = _BEGINS_S,
        swept_cm: Sequence[float] = (),
        settles_s: float = 0.0,
    ) -> Plan:
        """The plan, from a length on, by which the most pegs are expected to be felt and placed.

        A named effort is planned once and then takes the time that it needs. A budget is planned
        again at each stop.

        Args:
            length_cm: everted length now.
            spent_s: robot time of the budget that is spent.
            swept_cm: lengths at which the run has swept.
            settles_s: time until the sensors at the base have settled.
        """

        def ahead(stops: Sequence[float]) -> list[float]:
            reached_cm = length_cm - SAME_LENGTH_CM
            return [cm for cm in stops if cm > reached_cm and not _among(swept_cm, cm)]

        if self.effort.time_s == inf:
            whole = self._effort_plan
            return whole._replace(stops=tuple(ahead(whole.stops)))
        left_s = self.effort.time_s - spent_s
        return self._best(ahead(self._lengths), left_s, length_cm, swept_cm, settles_s)

    def _best(
        self,
        stops: Sequence[float],
        left_s: float,
        length_cm: float = 0.0,
        swept_cm: Sequence[float] = (),
        settles_s: float = 0.0,
    ) -> Plan:
        """The best plan by some of these stops that fits into the time; arguments as in `plan`."""
        whole = Plan(tuple(stops), self.effort.measurements)
        if not stops or self.expected_s(whole, length_cm, settles_s) <= left_s:
            return whole
        plans = [
            Plan(subset, measurements)
            for subset in _subsets(stops)
            for measurements in range(self.effort.measurements + 1)
        ]
        plans = _without_parts(
            [plan for plan in plans if self.expected_s(plan, length_cm, settles_s) <= left_s]
        )
        if len(plans) < 2:
            return plans[0] if plans else Plan((), 0)
        return max(plans, key=lambda plan: self._worth(plan, swept_cm))

    def _worth(self, plan: Plan, swept_cm: Sequence[float]) -> float:
        """Expected shares of pegs that are felt and that are placed, summed over the sides."""
        sweeps = [
            _among(swept_cm, length) + (1 + plan.measurements) * (length in plan.stops)
            for length in self._lengths
        ]
        return sum(sum(side.felt_and_placed(sweeps, _PLACED)) for side in self._sides)

    def expected_s(self, plan: Plan, length_cm: float = 0.0, settles_s: float = 0.0) -> float:
        """Robot time (s) that a plan takes from a length on.

        `settles_s` is the time until the sensors at the base have settled. Beyond half of the full
        length, a contact is expected at every other stop.
        """
        config = self.config
        speed = config.spool.max_speed_cm_s
        columns = (config.column(side) for side in SIDES)
        base_cm = max((c[0].center_cm + c[0].span_cm / 2 for c in columns if c), default=0.0)
        pitches = self._lengths
        boundaries = [pressure.until_cm for pressure in config.body.pressures]
        spent, settled_s = 0.0, settles_s
        if length_cm < base_cm:
            spent = _PRESSURE_S
            settled_s = spent + (base_cm - length_cm) / speed + config.board.settle_s
        for stop in plan.stops:
            passed = [
                end for end in {*pitches, *boundaries} if length_cm + SAME_LENGTH_CM < end < stop
            ]
            spent += max(stop - length_cm, 0.0) / speed + _GROWS_MORE_S * (1 + len(passed))
            spent += _PRESSURE_S * sum(end in boundaries for end in passed)
            look_s = 2 * (rising_period_s(config, config.body.pressure_number(stop)) / 4 + _VENTS_S)
            spent = max(spent + _ZERO_S, settled_s + _ZERO_SETTLED_S) + look_s
            if plan.measurements and stop > config.body.length_cm / 2:
                spent += self.measurement_s(stop, plan.measurements) / 2
            length_cm = stop
        return spent

    def whole_run_s(self) -> float:
        """Robot time (s) that a run takes from its beginning."""
        return _BEGINS_S + self.expected_s(self.plan())

    def raises(self, length_cm: float) -> bool:
        """Whether a measurement at a length may raise the body pressure."""
        return self.effort.raises_often or self._full(length_cm)

    def measurement_s(self, length_cm: float, measurements: int) -> float:
        """Robot time (s) that the measurements of a contact at a length take."""
        turns = (1 if self._full(length_cm) else 2) if self.raises(length_cm) else 0
        rest_s = _REST_S / self.effort.rest_noise
        return rest_s + turns * _PRESSURE_S + measurements * _MEASURE_S

    def measures(self, plan: Plan, length_cm: float, spent_s: float) -> bool:
        """Whether a contact at a length is measured: the budget leaves time for the plan's rest."""
        remainder = Plan(tuple(s for s in plan.stops if s > length_cm + SAME_LENGTH_CM), 0)
        needed_s = self.measurement_s(length_cm, plan.measurements)
        needed_s += self.expected_s(remainder, length_cm)
        return plan.measurements > 0 and spent_s + needed_s <= self.effort.time_s

    def _full(self, length_cm: float) -> bool:
        return length_cm > self.config.body.length_cm - SAME_LENGTH_CM

    def skips(self) -> str:
        """What this effort omits and what that costs, for the operator; empty if nothing."""
        omissions = []
        plan = self.plan()
        stops, measurements = plan
        last = stops[-1]
        if short := [cm for cm in self._lengths if cm < last and cm not in stops]:
            where = ", ".join(f"{length:g}" for length in short)
            omissions.append(
                f"no sweeps at {where} cm, so obstacles that only they reach are missed"
            )
        if last < self.config.body.length_cm - SAME_LENGTH_CM:
            omissions.append(f"it ends at {last:g} cm, so obstacles farther out are not felt")
        if measurements == 0:
            omissions.append("no second, slower sweep of a contact, so its place is less certain")
        omissions += [
            f"no sweeps towards {muscle.name}, because no healthy sensor at the base responds to "
            "them, so obstacles there are not felt"
            for muscle in self.wiring.unguarded_muscles
        ]
        spare_s = self.effort.time_s - _BEGINS_S - self.expected_s(plan)
        if _SPARE_S <= spare_s < inf:
            omissions.append(
                f"{spare_s:.0f} s of the budget are not planned, because no other "
                "sweep or measurement takes so little"
            )
        return "; ".join(omissions)


def _among(lengths_cm: Sequence[float], length_cm: float) -> bool:
    return any(abs(cm - length_cm) <= SAME_LENGTH_CM for cm in lengths_cm)


def _subsets(stops: Sequence[float]) -> list[tuple[float, ...]]:
    """Subsets of the stops; of many stops, those of the longest ones and nested longer ones."""
    far = stops[-_MOST_SUBSETS:]
    subsets = [s for count in range(1, len(far) + 1) for s in combinations(far, count)]
    near = len(stops) - len(far)
    return subsets + [tuple(stops[first:]) for first in range(near)]


def _without_parts(plans: Sequence[Plan]) -> list[Plan]:
    """Plans that are no part of another one, which tells more."""
    return [
        plan
        for plan in plans
        if not any(
            plan != rival
            and set(plan.stops) <= set(rival.stops)
            and plan.measurements <= rival.measurements
            for rival in plans
        )
    ]


EFFORTS = {
    effort.name: effort
    for effort in (
        Effort("quick", share=0.5),
        Effort("default", share=0.62),
        Effort("careful", rest_noise=0.5, raises_often=True),
    )
}
THESIS = Effort("thesis", measurements=0)  # stops at every pitch


def chosen_effort(protocol: str, effort: str | None, time_s: float | None) -> Effort:
    """The effort of a name, before the robot is known.

    Raises DataError for a name that there is not, or for a choice that contradicts another.
    """
    if protocol == "thesis":
        if effort is not None or time_s is not None:
            raise DataError(
                "the protocol `thesis` has no other effort", "leave --effort and --time out"
            )
        return THESIS
    if effort is not None and time_s is not None:
        raise DataError("--effort and --time are both given", "give one of them")
    if effort is not None and effort not in EFFORTS:
        raise DataError(f"there is no effort {effort!r}", f"choose from {', '.join(EFFORTS)}")
    return EFFORTS[effort or "default"]


def within(time_s: float, wiring: Wiring) -> Effort:
    """The effort of a budget of robot time (s).

    Raises DataError if it is too short for any sweep.
    """
    effort = Effort(f"{time_s:g} s", time_s=time_s)
    planner = Planner(wiring, effort)
    if not planner.plan().stops:
        looks = [planner.expected_s(Plan((stop,), 0)) for stop in stage_lengths(wiring.config)]
        raise DataError(
            f"{time_s:g} s of robot time is too little for a sweep",
            f"give --time {_BEGINS_S + min(looks) + 1:.0f} or more",
        )
    return effort
