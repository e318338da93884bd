"""One output driven as it is, in pushes that the board ends by itself: jog and press.

A push lasts at most half a second unless the host repeats it, so that a host that stops, for
whatever reason, stops the motion (the heartbeat's limit acts beside it). The board's own limits,
5 mA and a quarter of the motor's voltage, are compiled into it.
"""

from __future__ import annotations

from collections.abc import Callable

from thigmo.errors import ConfigError, RobotFaultError
from thigmo.link.protocol import Output
from thigmo.robot import JOG_CM, Robot

PRESS_PSI = 5.0
PRESS_S = 60.0

_PUSH_S = 0.4
_REPEAT_S = 0.15
_JOG_DUTY = 160  # of 800: beyond friction, a tenth of full speed
_STILL_S = 1.5
_STILL_CM = 0.02
_WRONG_CM = 0.2


def duty_of(milliampere: float) -> int:
    """Transducer duty of a current: 1599 is 20 mA."""
    return round(milliampere / 20.0 * 1599)


def push(robot: Robot, output: Output, level: int, seconds: float, muscle: int = 0) -> None:
    """Drive one output, a muscle's or the motor, for a while; refused unless armed, and for the
    motor vented."""
    end = robot.now() + seconds
    while (remaining_s := end - robot.now()) > 1e-9:
        robot.test_output(output, level, min(_PUSH_S, remaining_s + 1e-3), muscle)
        robot.wait(min(_REPEAT_S, remaining_s))


def jog(robot: Robot, cm: float) -> float:
    """Pay out (positive cm of tip) or wind in a little line, slowly; the length need not be known.

    Returns how far the encoder went, cm.

    Raises:
        ConfigError: farther than `JOG_CM`.
        RobotFaultError: the encoder stands still, or goes the other way.
        CommandRefusedError: not armed, or a muscle holds pressure.
    """
    if not 0 < abs(cm) <= JOG_CM:
        raise ConfigError(f"cannot jog by {cm:g} cm", f"give more than 0 and at most {JOG_CM:g} cm")
    sign = 1 if cm > 0 else -1
    start = robot.read(0.05).length_cm
    moved, best, best_s = 0.0, 0.0, robot.now()
    try:
        while moved < abs(cm):
            push(robot, Output.MOTOR, sign * _JOG_DUTY, _REPEAT_S)
            moved = sign * (robot.read(0.02).length_cm - start)
            if moved < -_WRONG_CM:
                raise RobotFaultError(
                    "the encoder goes the other way than the motor is driven",
                    "run `thigmo bringup`: it names the wires to swap",
                )
            if moved > best + _STILL_CM:
                best, best_s = moved, robot.now()
            elif robot.now() - best_s > _STILL_S:
                raise RobotFaultError(
                    "the motor is driven and the encoder stands still",
                    "free the spool, or run `thigmo bringup`",
                )
    finally:
        robot.vent()  # ends the push
    return sign * moved


def press(
    robot: Robot,
    name: str,
    psi: float,
    seconds: float,
    progress: Callable[[float], None] = lambda psi: None,
) -> float:
    """Give one transducer the current of a low pressure for a while, then vent.

    The loop is open: `progress` receives the measured pressure, and nothing else uses it.
    Returns the pressure at the end, psi.

    Raises:
        ConfigError: more than `PRESS_PSI`, for longer than `PRESS_S`, or no muscle of that name.
        CommandRefusedError: not armed.
        RobotFaultError: the board latched a fault.
    """
    if not 0 < psi <= PRESS_PSI or not 0 < seconds <= PRESS_S:
        raise ConfigError(
            f"cannot press with {psi:g} psi for {seconds:g} s",
            f"give more than 0, and at most {PRESS_PSI:g} psi and {PRESS_S:g} s",
        )
    muscle = robot.config.muscle_number(name)
    low, high = (robot.parameter(f"drive_{n}ma_cpsi")[0] / 100 for n in (4, 20))
    level = duty_of(max(4.0 + 16.0 * (psi - low) / (high - low), 0.0))
    reached, end = 0.0, robot.now() + seconds
    try:
        while robot.now() < end:
            push(robot, Output.TRANSDUCER, level, _REPEAT_S, muscle)
            reached = robot.read(0.02).pressure_psi[muscle]
            progress(reached)
    finally:
        robot.vent()
    return reached
