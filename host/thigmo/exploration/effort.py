"""How much robot time a run spends, and on what: the dial between seconds and centimetres.

Every run grows, settles, zeroes and sweeps. What can be chosen is at how many lengths it sweeps,
whether a contact that was felt is measured by slower sweeps, and how long sensors that have just
everted stand still before they count. An effort is one such choice, by name or for a budget of
robot seconds. What a run leaves out, and what that costs, it says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

from thigmo.config import SAME_LENGTH_CM, SIDES, RobotConfig
from thigmo.errors import DataError
from thigmo.exploration.plan import stage_lengths
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


@dataclass(frozen=True, slots=True)
class Effort:
    """What a run does for its map."""

    name: str
    stops: int  # lengths at which it sweeps, at most
    # slow sweeps that measure a contact at a stop; 0: the readings of the first sweep count
    measurements: int
    # a young sensor counts once its rest is known to this multiple of its noise
    rest_noise: float = 1.0
    # whether every measurement may raise the body pressure, and not the full length's alone, after
    # which nothing lowers it again
    raises_often: bool = False
    time_s: float = inf  # budget of robot time

    def lengths(self, config: RobotConfig) -> list[float]:
        """Everted lengths (cm) at which to sweep, ascending.

        The longest bodies reach and feel most, so the shortest are omitted first. One less than
        half a pitch behind the full length tells little that the full length does not.
        """
        *rest, full = stage_lengths(config)
        near = [length for length in rest if full - length < config.body.pitch_cm / 2]
        far = [length for length in rest if length not in near]
        kept = [full, *far[-_FAR_FIRST:][::-1], *near, *far[:-_FAR_FIRST][::-1]]
        return sorted(kept[: self.stops])

    def skips(self, config: RobotConfig) -> str:
        """What this effort omits and what that costs, for the operator; empty if nothing."""
        said = []
        stops = self.stops_after(config, 0.0, _BEGINS_S, swept=False)
        last = stops[-1]
        if short := [each for each in stage_lengths(config) if each < last and each not in stops]:
            where = ", ".join(f"{length:g}" for length in short)
            said.append(f"no sweeps at {where} cm, so obstacles that only they reach are missed")
        if last < config.body.length_cm - SAME_LENGTH_CM:
            said.append(f"it ends at {last:g} cm, so obstacles farther out are not felt")
        if self.measurements == 0:
            said.append("no second, slower sweep of a contact, so its place is less certain")
        elif self.rest_noise == inf:
            said.append("no wait until new sensors have settled, so places are less certain")
        said += [
            f"no sweeps towards {muscle.name}, because no healthy sensor at the base responds to "
            "them, so obstacles there are not felt"
            for muscle in Wiring.of(config).unguarded_muscles
        ]
        return "; ".join(said)

    def expected_s(
        self,
        config: RobotConfig,
        stops: Sequence[float],
        length_cm: float = 0.0,
        settles_s: float = 0.0,
    ) -> float:
        """Robot time (s) that sweeps at these lengths take, grown to from another.

        There the sensors at the base settle for `settles_s` yet. From half of the full length on a
        contact is expected at every other stop.
        """
        speed = config.spool.max_speed_cm_s
        columns = (config.column(side) for side in SIDES)
        base_cm = max((c[0].center_cm + c[0].span_cm / 2 for c in columns if c), default=0.0)
        pitches = stage_lengths(config)
        boundaries = [zone.until_cm for zone in config.body.zones]
        spent, settled_s = 0.0, settles_s
        if length_cm < base_cm:
            spent = _PRESSURE_S
            settled_s = spent + (base_cm - length_cm) / speed + config.board.settle_s
        for stop in stops:
            passed = [
                end for end in {*pitches, *boundaries} if length_cm + SAME_LENGTH_CM < end < stop
            ]
            spent += max(stop - length_cm, 0.0) / speed + _GROWS_MORE_S * (1 + len(passed))
            spent += _PRESSURE_S * sum(end in boundaries for end in passed)
            look_s = 2 * (rising_period_s(config, config.body.zone_at(stop)) / 4 + _VENTS_S)
            spent = max(spent + _ZERO_S, settled_s + _ZERO_SETTLED_S) + look_s
            if self.measurements and stop > config.body.length_cm / 2:
                spent += self.measurement_s(config, stop) / 2
            length_cm = stop
        return spent

    def whole_run_s(self, config: RobotConfig) -> float:
        """Robot time (s) that a run takes from its beginning."""
        stops = self.stops_after(config, 0.0, _BEGINS_S, swept=False)
        return _BEGINS_S + self.expected_s(config, stops)

    def raises(self, config: RobotConfig, length_cm: float) -> bool:
        """Whether a measurement at a length may raise the body pressure."""
        return self.raises_often or length_cm > config.body.length_cm - SAME_LENGTH_CM

    def measurement_s(self, config: RobotConfig, length_cm: float) -> float:
        """Robot time (s) that the measurement of a contact at a length takes."""
        full = length_cm > config.body.length_cm - SAME_LENGTH_CM
        turns = (1 if full else 2) if self.raises(config, length_cm) else 0
        rest_s = _REST_S / self.rest_noise
        return rest_s + turns * _PRESSURE_S + self.measurements * _MEASURE_S

    def stops_after(
        self,
        config: RobotConfig,
        length_cm: float,
        spent_s: float,
        *,
        swept: bool,
        settles_s: float = 0.0,
    ) -> list[float]:
        """The lengths (cm) at which to sweep from here on; empty at the end.

        The sensors at the base settle for `settles_s` yet. Of the stops that the budget has no time
        for, the shortest are omitted; for the last, its contact's measurement is (`measures`).
        Where the budget is too short for the full length as well, the run ends at the longest that
        it allows.
        """
        reached_cm = length_cm + (SAME_LENGTH_CM if swept else -SAME_LENGTH_CM)

        def fits(effort: Effort, stops: list[float]) -> bool:
            needed_s = effort.expected_s(config, stops, length_cm, settles_s)
            return spent_s + needed_s <= self.time_s

        stops = [stop for stop in self.lengths(config) if stop > reached_cm]
        while len(stops) > 1 and not fits(self, stops):
            stops = stops[1:]
        if len(stops) > 1:
            return stops
        look = replace(self, measurements=0)
        farther = [stop for stop in stage_lengths(config) if stop > reached_cm]
        return [stop for stop in farther if fits(look, [stop])][-1:]

    def measures(self, config: RobotConfig, length_cm: float, spent_s: float) -> bool:
        """Whether a contact at a length is measured: a budget leaves time for the full length."""
        full_cm = config.body.length_cm
        after = [full_cm] if length_cm < full_cm - SAME_LENGTH_CM else []
        look = replace(self, measurements=0)
        needed_s = self.measurement_s(config, length_cm) + look.expected_s(config, after, length_cm)
        return self.measurements > 0 and spent_s + needed_s <= self.time_s


_FAR_FIRST = 2  # whole pitches that come before the one near the full length
EFFORTS = {
    each.name: each
    for each in (
        Effort("quick", 3, 1, rest_noise=inf),
        Effort("default", 4, 1),
        Effort("careful", 6, 2, rest_noise=0.5, raises_often=True),
    )
}
THESIS = Effort("thesis", 99, 0)  # stops at every pitch
# From the least to the most, for budgets.
_LADDER = (
    Effort("least", 1, 0),
    Effort("less", 2, 0),
    EFFORTS["quick"],
    Effort("more than quick", 3, 1),
    EFFORTS["default"],
    Effort("more than default", 6, 1),
    EFFORTS["careful"],
)


def chosen_effort(protocol: str, effort: str | None, time_s: float | None) -> Effort:
    """The effort of a name, before the robot and its budget's share are known.

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


def within(time_s: float, config: RobotConfig) -> Effort:
    """The most careful effort that a budget of robot time (s) allows.

    Raises DataError if it is too short for any sweep.
    """
    left_s = time_s - _BEGINS_S
    fitting = [
        each for each in _LADDER if each.expected_s(config, each.lengths(config)) <= left_s
    ] or [_LADDER[0]]
    effort = replace(fitting[-1], name=f"{time_s:g} s", time_s=time_s)
    if not effort.stops_after(config, 0.0, _BEGINS_S, swept=False):
        least = _BEGINS_S + effort.expected_s(config, stage_lengths(config)[:1])
        raise DataError(
            f"{time_s:g} s of robot time is too little for a sweep",
            f"give --time {least + 1:.0f} or more",
        )
    return effort
