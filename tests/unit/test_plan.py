"""Where the exploration stops: whole pitches, pressure boundaries, nothing half everted."""

from __future__ import annotations

import pytest

from thigmo.config import FlexSensor, RobotConfig
from thigmo.errors import ConfigError
from thigmo.exploration.plan import (
    growth_target,
    growth_zone,
    half_everted,
    next_stage,
    stage_lengths,
)
from thigmo.exploration.states import TRANSITIONS, State


def test_the_thesis_robot_stops_at_whole_pitches_and_at_its_full_length() -> None:
    assert stage_lengths(RobotConfig()) == [10, 20, 30, 40, 50, 53]


def _walk(config: RobotConfig, length: float) -> list[tuple[float, float]]:
    """(target, body pressure) of every growth from a length to the end."""
    steps = []
    while (stage := next_stage(config, length, swept=False)) is not None:
        while True:
            zone = growth_zone(config, length, stage)
            target = growth_target(config, length, stage)
            if target > length + 0.1:
                steps.append((target, config.body.zones[zone].pressure_psi))
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
    assert growth_zone(config, 26.5 + offset, 30) == 1
    assert growth_zone(config, 20 + offset, 30) == 0
    assert growth_zone(config, 53 + offset, 53) == 2


def test_a_run_may_start_anywhere() -> None:
    config = RobotConfig()
    assert next_stage(config, 13.0, swept=False) == 20
    assert next_stage(config, 53.0, swept=False) == 53
    assert next_stage(config, 53.0, swept=True) is None
    assert next_stage(config, 50.03, swept=True) == 53


def test_a_pitch_at_which_a_sensor_would_be_creased_is_left_out() -> None:
    right = FlexSensor(direction_deg=270, center_cm=5.0)
    config = RobotConfig(sensors=[*(FlexSensor(center_cm=c) for c in (5.0, 20.0)), right])
    assert half_everted(config, 20.0) == "left[1]"
    assert stage_lengths(config) == [10, 30, 40, 50, 53]
    config.column("left")[1].healthy = False
    assert half_everted(config, 20.0) == ""
    end = RobotConfig(sensors=[FlexSensor(center_cm=50.2)])
    with pytest.raises(ConfigError, match=r"left\[0\] lies in the tip's fold"):
        stage_lengths(end)


def test_every_state_is_reached_and_left() -> None:
    sources = {t.source for t in TRANSITIONS}
    targets = {t.target for t in TRANSITIONS} | {State.CONFIGURE}
    assert targets == set(State)
    assert sources == set(State) - {State.DONE}
    assert len({(t.source, t.outcome) for t in TRANSITIONS}) == len(TRANSITIONS)
