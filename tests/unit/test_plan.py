"""Where the exploration stops: whole pitches, pressure boundaries, nothing half everted."""

from __future__ import annotations

import pytest

from thigmo.config import FlexSensor, RobotConfig
from thigmo.errors import ConfigError, DataError
from thigmo.exploration.effort import EFFORTS, THESIS, Plan, Planner, chosen_effort, within
from thigmo.exploration.growth import (
    growth_body_pressure,
    growth_target,
    half_everted,
    stage_lengths,
)
from thigmo.exploration.states import TRANSITIONS, State
from thigmo.field import expected_sweeps
from thigmo.wiring import Wiring


def test_the_thesis_robot_stops_at_whole_pitches_and_at_its_full_length() -> None:
    assert stage_lengths(RobotConfig()) == [10, 20, 30, 40, 50, 53]


def next_stage(config: RobotConfig, length: float, *, swept: bool) -> float | None:
    """The next stage of the thesis's protocol, which stops at every pitch."""
    plan = Planner(Wiring.laid_out(config), THESIS).plan(length, swept_cm=[length] if swept else [])
    return next(iter(plan.stops), None)


def _walk(config: RobotConfig, length: float) -> list[tuple[float, float]]:
    """(target, body pressure) of every growth from a length to the end."""
    steps = []
    while (stage := next_stage(config, length, swept=False)) is not None:
        while True:
            body_pressure = growth_body_pressure(config, length, stage)
            target = growth_target(config, length, stage)
            if target > length + 0.1:
                steps.append((target, config.body.pressures[body_pressure].pressure_psi))
                length = target
            if target == stage:
                break
        if next_stage(config, length, swept=True) is None:
            break
        length += 0.11  # leave the swept stage
    return steps


def test_growth_stops_at_each_body_pressure_boundary() -> None:
    assert _walk(RobotConfig(), 0.0) == [
        (10, 1.47),
        (20, 1.47),
        (26.5, 1.47),
        (30, 1.01),
        (35.3, 1.01),
        (40, 0.49),
        (50, 0.49),
        (53, 0.49),
    ]


@pytest.mark.parametrize("offset", [-0.05, 0.0, 0.05])
def test_the_spools_tolerance_at_a_boundary_does_not_repeat_it(offset: float) -> None:
    config = RobotConfig()
    assert growth_target(config, 26.5 + offset, 30) == 30
    assert growth_body_pressure(config, 26.5 + offset, 30) == 1
    assert growth_body_pressure(config, 20 + offset, 30) == 0
    assert growth_body_pressure(config, 53 + offset, 53) == 2


def test_a_run_may_start_anywhere() -> None:
    config = RobotConfig()
    assert next_stage(config, 13.0, swept=False) == 20
    assert next_stage(config, 53.0, swept=False) == 53
    assert next_stage(config, 53.0, swept=True) is None
    assert next_stage(config, 50.03, swept=True) == 53


def test_a_pitch_at_which_a_sensor_would_be_creased_is_left_out() -> None:
    right = FlexSensor(angle_deg=270, center_cm=5.0)
    config = RobotConfig(sensors=[*(FlexSensor(center_cm=c) for c in (5.0, 20.0)), right])
    assert half_everted(config, 20.0) == "left[1]"
    assert stage_lengths(config) == [10, 30, 40, 50, 53]
    config.column("left")[1].healthy = False
    assert half_everted(config, 20.0) == ""
    end = RobotConfig(sensors=[FlexSensor(center_cm=50.2)])
    with pytest.raises(ConfigError, match=r"left\[0\] lies in the tip's fold"):
        stage_lengths(end)


def test_an_effort_is_a_budget_and_careful_omits_nothing() -> None:
    config = RobotConfig()
    wiring = Wiring.laid_out(config)
    planners = {name: Planner(wiring, effort) for name, effort in EFFORTS.items()}
    plans = {name: planner.plan() for name, planner in planners.items()}
    assert plans["careful"].stops == tuple(stage_lengths(config))
    assert set(plans["quick"].stops) <= set(plans["default"].stops) < set(plans["careful"].stops)
    assert plans["default"].stops[-1] == 53
    assert "10, 20" in planners["default"].skips()
    assert planners["careful"].skips() == ""
    late = planners["default"].plan(50.0, 1000.0, [40.0, 50.0])
    assert late == plans["default"]._replace(stops=(53.0,))  # it takes what time it needs


def test_more_time_buys_more_and_is_kept_to() -> None:
    config = RobotConfig()
    wiring = Wiring.laid_out(config)
    planners = [Planner(wiring, within(t_s, wiring)) for t_s in (70, 100, 130, 170, 200, 300)]
    plans = [planner.plan() for planner in planners]
    sides = [expected_sweeps(wiring, "left", stage_lengths(config))]
    worth = []
    for planner, plan in zip(planners, plans, strict=True):
        assert plan.stops
        assert planner.expected_s(plan) <= planner.effort.time_s - 5.0
        sweeps = [(1 + plan.measurements) * (cm in plan.stops) for cm in stage_lengths(config)]
        worth.append(sum(sides[0].felt_and_placed(sweeps, 3.0 / 53)))
    assert worth == sorted(worth)
    assert worth[0] < worth[-1]
    assert plans[-1] == Plan(tuple(stage_lengths(config)), 2)


def test_a_budget_that_no_sweep_can_use_up_says_so() -> None:
    wiring = Wiring.laid_out(RobotConfig())
    assert "of the budget are not planned" in Planner(wiring, within(150.0, wiring)).skips()
    assert "of the budget" not in Planner(wiring, within(130.0, wiring)).skips()


def test_a_budget_that_runs_out_on_the_way_keeps_what_tells_most() -> None:
    wiring = Wiring.laid_out(RobotConfig())
    planner = Planner(wiring, within(150.0, wiring))
    planned = planner.plan()
    late = planner.plan(40.0, 110.0, [40.0])
    assert set(late.stops) <= set(planned.stops) - {40.0}
    assert late.stops
    assert planner.plan(40.0, 149.0, [40.0]).stops == ()
    # Too little for the full length, but not for a sweep.
    assert 0.0 < Planner(wiring, within(60.0, wiring)).plan().stops[-1] < 53


def test_a_plan_made_on_the_way_waits_for_what_settles_yet() -> None:
    config = RobotConfig()
    wiring = Wiring.laid_out(config)
    planner = Planner(wiring, within(160.0, wiring))
    both = Plan((50.0, 53.0), 2)
    spent = 160.0 - planner.expected_s(both, 40.0) - 0.1
    assert planner.plan(40.0, spent, [40.0]) == both
    settles = config.board.settle_s
    later = planner.plan(40.0, spent, [40.0], settles)
    assert (
        planner.expected_s(later, 40.0, settles)
        <= 160.0 - spent
        < planner.expected_s(both, 40.0, settles)
    )


@pytest.mark.parametrize(
    ("choice", "says"),
    [
        (("measure", "hasty", None), "choose from quick, default, careful"),
        (("measure", "quick", 100.0), "give one of them"),
        (("thesis", "quick", None), "leave --effort and --time out"),
        (("thesis", None, 100.0), "leave --effort and --time out"),
    ],
)
def test_a_choice_that_cannot_be_says_what_can(
    choice: tuple[str, str | None, float | None], says: str
) -> None:
    with pytest.raises(DataError) as refused:
        chosen_effort(*choice)
    assert says in refused.value.next_step


def test_a_budget_too_short_for_a_sweep_says_how_long_one_takes() -> None:
    wiring = Wiring.laid_out(RobotConfig())
    with pytest.raises(DataError) as refused:
        within(20.0, wiring)
    least = float(refused.value.next_step.split()[2])
    planner = Planner(wiring, within(least, wiring))
    assert len(planner.plan().stops) == 1


def test_every_state_is_reached_and_left() -> None:
    sources = {t.source for t in TRANSITIONS}
    targets = {t.target for t in TRANSITIONS} | {State.CONFIGURE}
    assert targets == set(State)
    assert sources == set(State) - {State.DONE}
    assert len({(t.source, t.outcome) for t in TRANSITIONS}) == len(TRANSITIONS)
