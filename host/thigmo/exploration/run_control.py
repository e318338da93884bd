"""What an exploration shows to its viewers, and what they may request.

All of it goes to the robot's hub, beside the telemetry. Requests come from other threads (a viewer
on the run's socket); the exploration obeys them when it next waits, or between stages.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from contextlib import suppress

from thigmo.errors import StoppedByViewerError
from thigmo.exploration.stage import Interpreter, SideAnswer
from thigmo.link import protocol as wire
from thigmo.robot import Robot, SweepResult
from thigmo.stream import Command, Message, Posterior, Question

_SWEEPING_S = 0.49  # robot time between two partial answers; each takes up to a tenth of a second


class Live:
    """Publishes an exploration on its robot's hub."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._felt_s = float("-inf")

    def tell(self, message: Callable[..., Message], *fields: object) -> None:
        """Publish a message of now, made of its fields after the times."""
        t_s = self._robot.now()
        self._robot.hub.publish(message(t_s, self._robot.epoch_s + t_s, *fields))

    def sweeping(
        self, interpreter: Interpreter, so_far: SweepResult, body_pressure: int, length_cm: float
    ) -> None:
        """Show what a sweep feels while it goes on, twice a second, if anybody looks.

        The map does not depend on it.
        """
        if not self._robot.hub.wanted(Posterior) or self._robot.now() - self._felt_s < _SWEEPING_S:
            return
        if (answer := interpreter.so_far(so_far, body_pressure)) is not None:
            self.posterior(length_cm, answer, sweeping=True)

    def posterior(self, length_cm: float, answer: SideAnswer, *, sweeping: bool = False) -> None:
        """What the sweep of one side showed; `sweeping` while it goes on."""
        self._felt_s = self._robot.now()
        self.tell(
            Posterior,
            answer.side,
            length_cm,
            tuple(answer.places.tolist()),
            tuple(answer.mass.tolist()),
            answer.status,
            answer.hypothesis,
            answer.message,
            answer.probability,
            sweeping,
        )


class RunControl:
    """Requests of viewers to one run. For several threads."""

    def __init__(self) -> None:
        self._stopped = threading.Event()
        self._answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.paused = False  # the run is to wait before its next stage

    def command(self, command: Command, text: str = "") -> None:
        """Take a request, or an answer."""
        if command == "stop":
            self._stopped.set()
        elif command == "answer":
            self._answers.put(text)
        else:
            self.paused = command == "pause"

    def forget_answers(self) -> None:
        """Drop answers to what was asked before."""
        while not self._answers.empty():
            self._answers.get()

    def answer(self) -> str | None:
        """An answer, if one has come."""
        with suppress(queue.Empty):
            return self._answers.get_nowait()
        return None

    def wait(self, seconds: float) -> None:
        """Let the clock run, until a stop comes at most."""
        self._stopped.wait(seconds)

    def obey_stop(self) -> None:
        """Called while the robot is waited for; StoppedByViewerError if a viewer wants so."""
        if self._stopped.is_set():
            problem, cure = wire.Fault.STOPPED.words  # as the board's fault says it
            raise StoppedByViewerError(f"{wire.Fault.STOPPED.key}: {problem}", cure)


class Questions:
    """What a run asks its operator, on its stream; see `operator_prompts.Viewers`."""

    def __init__(self, robot: Robot, control: RunControl) -> None:
        self._live = Live(robot)
        self._control = control
        self.answer = control.answer

    def ask(self, question: str, unit: str = "") -> None:
        """Show a question, or take it away."""
        self._control.forget_answers()
        self._live.tell(Question, question, unit)
