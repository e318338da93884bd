"""What a page of `thigmo watch` asked for is shown there, and a motion ends when the page has gone.

The page sends a sign of life four times a second while somebody can see it. The page's server hands
each on to the command that moves the robot, as a byte on its standard input. A page that is closed,
hidden or cut off, and a server that hangs or is killed, all look alike here: the signs stop.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Annotated

import typer

from thigmo.errors import LinkError, StoppedByViewerError

if TYPE_CHECKING:
    from thigmo.robot import Robot
    from thigmo.stream import Command

ByPageOption = Annotated[
    bool, typer.Option("--by-page", hidden=True)  # for the page, which starts commands
]
_SILENT_S = 1.5  # six signs
_SEEN_S = 3.0  # for the page to look at a command that it has started
_LAST_S = 0.6  # of readings after its end: a board sends two a second at least
_LOOK_S = 0.05


@contextmanager
def shown(robot: Robot, command: str, wanted: bool) -> Iterator[None]:
    """Where it is `wanted`: show a command to viewers, up to how it leaves the board."""
    if not wanted:
        yield
        return

    def refuse(command: Command, text: str) -> None:
        """It cannot be paused; a stop goes to the process that owns the port."""

    with robot.serve(command, "", refuse) as server:
        until_s = robot.now() + _SEEN_S
        while not server.viewers and robot.now() < until_s:
            robot.wait(_LOOK_S, despite_faults=True)
        try:
            yield
        finally:
            with suppress(LinkError):  # the command itself reports a link that has failed
                robot.wait(_LAST_S, despite_faults=True)


@contextmanager
def dead_man_switch(robot: Robot, motion: str, wanted: bool) -> Iterator[None]:
    """As `shown`; the motion goes on only while the page is there, and the robot is then disarmed.

    Raises StoppedByViewerError once the page has gone, with the motor braked, the valves at 0 mA,
    and whether the board has confirmed that.
    """
    if not wanted:
        yield
        return
    signs = _Signs()
    robot.while_waiting(signs.check)
    with shown(robot, motion, wanted):
        try:
            yield
            robot.disarm()
        except StoppedByViewerError as gone:
            confirmed = robot.make_safe()
            gone.add_note("the board has confirmed" if confirmed else "the board does NOT confirm")
            raise


class _Signs:
    """Signs of life on standard input."""

    def __init__(self) -> None:
        self._heard_s = time.monotonic()
        threading.Thread(target=self._listen, daemon=True).start()

    def check(self) -> None:
        """Raise StoppedByViewerError if there was none for too long."""
        if time.monotonic() - self._heard_s > _SILENT_S:
            raise StoppedByViewerError(
                "the page that moved the robot is closed, hidden or cut off: the motor is braked",
                "open the page again to go on",
            )

    def _listen(self) -> None:
        """Thread. It reads the descriptor itself: a thread that waits in `sys.stdin` would keep
        Python from ending."""
        while os.read(sys.stdin.fileno(), 4096):
            self._heard_s = time.monotonic()
        self._heard_s = float("-inf")
