"""Zeroing a body that may still drift: wait, and try again.

Calibration and `thigmo feel` call it; an exploration counts its tries among its own states.
"""

from __future__ import annotations

from collections.abc import Callable

from thigmo.errors import CommandRefusedError
from thigmo.robot.robot import Robot

_TRIES = 3


def zero_when_steady(
    robot: Robot,
    sensors: int = -1,
    *,
    pause_s: float,
    say: Callable[[str], None] = lambda text: None,
) -> None:
    """Zero the sensors of a mask, -1 for all; while they drift, wait and try again, twice at most.

    Args:
        pause_s: time from one try to the next, s.
        say: called with a progress message.

    Raises:
        CommandRefusedError: they still drift, or the board refuses for another reason.
    """
    for tries in range(1, _TRIES + 1):
        try:
            robot.zero(sensors)
        except CommandRefusedError as error:
            if error.reason != "drifting" or tries == _TRIES:
                raise
            say("readings still drift; waiting")
            robot.wait(pause_s)
        else:
            return
