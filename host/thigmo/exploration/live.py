"""What an exploration tells those who watch it, and what they may ask of it.

All of it goes to the robot's hub, beside the telemetry. Requests come from other threads (a viewer
on the run's socket); the exploration obeys them when it next waits, or between stages.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from math import tanh

from thigmo.errors import StoppedByViewerError, ThigmoError
from thigmo.exploration.feel import Feeling
from thigmo.exploration.states import State
from thigmo.record import MapContact, OccupancyGrid
from thigmo.robot import Robot
from thigmo.stream import Command, Contacts, Event, Grid, Log, Posterior, RunState
from thigmo.stream.messages import Severity

# A viewer draws no faster, and a shape of the body comes each tenth of a second.
_SWEEPING_S = 0.095
_NOTHING_FELT = "nothing was felt at this stage"


class Live:
    """Publishes an exploration.

    Args:
        robot: whose hub and clock are used.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._felt_s = float("-inf")

    def _now(self) -> tuple[float, float]:
        t_s = self._robot.now()
        return t_s, self._robot.epoch_s + t_s

    def state(
        self,
        state: State,
        doing: str,
        stage_cm: float,
        done: float,
        *,
        paused: bool = False,
        outcome: str = "running",
    ) -> None:
        """What it does now."""
        self._robot.hub.publish(
            RunState(*self._now(), state.name, doing, stage_cm, done, paused, outcome)
        )

    def felt(self, length_cm: float, feelings: Sequence[Feeling]) -> None:
        """What a stage's sweeps told, of each side."""
        for feeling in feelings:
            self.feels(length_cm, feeling)
        if not feelings:
            now = self._now()
            self._robot.hub.publish(
                Posterior(*now, "", length_cm, (), (), "no contact", "", _NOTHING_FELT)
            )

    @property
    def due(self) -> bool:
        """Whether it is time for another posterior of mid-sweep: there are ten a second."""
        return self._robot.now() - self._felt_s >= _SWEEPING_S

    def feels(self, length_cm: float, feeling: Feeling, *, sweeping: bool = False) -> None:
        """What the sweep of one side told; `sweeping` while it goes on."""
        now, result = self._now(), feeling.result
        self._felt_s = now[0]
        self._robot.hub.publish(
            Posterior(
                *now,
                feeling.shape.side,
                length_cm,
                tuple(result.places.tolist()),
                tuple(result.probability.tolist()),
                result.status,
                result.hypothesis,
                result.message,
                (1.0 + tanh(result.log_odds / 2.0)) / 2.0,
                sweeping,
            )
        )

    def contacts(self, contacts: Sequence[MapContact]) -> None:
        """The map's contacts."""
        self._robot.hub.publish(Contacts(*self._now(), tuple(contacts)))

    def grid(self, grid: OccupancyGrid) -> None:
        """The map's cells."""
        self._robot.hub.publish(Grid.of(grid, *self._now()))

    def log(self, text: str, level: Severity = "info") -> None:
        """A line for the operator."""
        self._robot.hub.publish(Log(*self._now(), level, text))

    def aborted(self, error: BaseException, why: str) -> None:
        """It ends early."""
        what, cure = (error.what, error.next_step) if isinstance(error, ThigmoError) else (why, "")
        self._robot.hub.publish(Event(*self._now(), "aborted", "fault", what, cure))


class RunControl:
    """Requests of viewers to one run. For several threads."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._paused = False
        self._stopped = False

    def command(self, command: Command) -> None:
        """Take a request."""
        with self._changed:
            if command == "stop":
                self._stopped = True
            else:
                self._paused = command == "pause"
            self._changed.notify_all()

    @property
    def paused(self) -> bool:
        """Whether the run is to wait before its next stage."""
        return self._paused

    def wait(self, seconds: float) -> None:
        """Let the clock run, until another request comes at most."""
        with self._changed:
            self._changed.wait_for(lambda: self._stopped or not self._paused, seconds)

    def obey_stop(self) -> None:
        """Called while the robot is waited for.

        Raises:
            StoppedByViewerError: a viewer wants the robot stopped.
        """
        if self._stopped:
            raise StoppedByViewerError(
                "stopped from a viewer", "look at the robot, then let it go with `thigmo clear`"
            )
