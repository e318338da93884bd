"""Where growth stops: the lengths at which the robot can sweep, and the body pressures up to them.

Of these lengths `effort` plans those at which it does.
"""

from __future__ import annotations

from itertools import count, takewhile

from thigmo.config import SAME_LENGTH_CM, SIDES, RobotConfig
from thigmo.errors import ConfigError, DataError

FOLD_MARGIN_CM = 0.5  # keep-out around a sensor's ends for the tip's fold; the board's default


def half_everted(config: RobotConfig, length_cm: float) -> str:
    """Name of a sensor that lies in the tip's fold at a length, or an empty string."""
    if not config.body.grows:
        return ""
    for side in SIDES:
        for index, sensor in enumerate(config.column(side)):
            passage = sensor.passes_at
            away_cm = passage.span_cm / 2 + FOLD_MARGIN_CM
            beyond_cm = length_cm - passage.center_cm
            if sensor.healthy and -away_cm < beyond_cm < away_cm - 1e-6:
                return f"{side}[{index}]"
    return ""


def stage_lengths(config: RobotConfig) -> list[float]:
    """Everted lengths (cm) at which to sweep: whole pitches, the last step shorter.

    A body that does not grow has one.

    Pitches at which a sensor would lie in the fold are omitted: a bend there would crease it.
    Raises ConfigError if one does at the full length.
    """
    full = config.body.length_cm
    if sensor := half_everted(config, full):
        raise ConfigError(
            f"sensor {sensor} lies in the tip's fold at the full length",
            "mark it unhealthy, or correct its centre and span in robot.toml",
        )
    if not config.body.grows:
        return [full]
    pitches = (number * config.body.pitch_cm for number in count(1))
    whole = takewhile(lambda length: length <= full - SAME_LENGTH_CM, pitches)
    return [*(length for length in whole if not half_everted(config, length)), full]


def short_of(config: RobotConfig, length_cm: float) -> RobotConfig:
    """The robot as it is planned for where it may not grow beyond a length (cm).

    It ends at the last of its stages before that. Raises DataError if there is none.
    """
    stages = [stage for stage in stage_lengths(config) if stage <= length_cm]
    if not stages:
        raise DataError(
            f"the map has an obstacle in the robot's path at {length_cm:.1f} cm, before any stage",
            "correct the map, turn the robot, or leave --map out",
        )
    body = config.body.model_copy(update={"length_cm": stages[-1]})
    return config.model_copy(update={"body": body})


def growth_body_pressure(config: RobotConfig, length_cm: float, target_cm: float) -> int:
    """Number of the body pressure for growing on from a length towards a target.

    On a boundary growth needs the next pressure; without growth, that of the length.
    """
    ahead = (
        min(length_cm + SAME_LENGTH_CM, target_cm)
        if target_cm > length_cm + SAME_LENGTH_CM
        else target_cm
    )
    return config.body.pressure_number(ahead)


def growth_target(config: RobotConfig, length_cm: float, stage_cm: float) -> float:
    """How far to grow before the stage, or a body-pressure boundary or whole pitch before it.

    At each stop the sensors show whether the tip has come as far as the encoder says.
    """
    ends = [*(pressure.until_cm for pressure in config.body.pressures), *stage_lengths(config)]
    return min(
        (end for end in ends if length_cm + SAME_LENGTH_CM < end < stage_cm - SAME_LENGTH_CM),
        default=stage_cm,
    )


def trial_body_pressure(config: RobotConfig, body_pressure: int) -> int | None:
    """Number of the next higher body pressure, at which a stalled growth is tried again.

    None: the robot has no higher one with maps.
    """
    pressures = config.body.pressures
    above = [
        n
        for n, pressure in enumerate(pressures)
        if pressure.pressure_psi > pressures[body_pressure].pressure_psi
    ]
    return min(above, key=lambda n: pressures[n].pressure_psi, default=None)
