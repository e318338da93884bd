"""Passes runs on to other tools, and their stops to the robot: what ROS 2 and Foxglove share.

A view is told of every message as it comes, and each second of how things are. It drives no robot:
if it is killed, the run goes on.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Protocol

from thigmo.errors import ThigmoError
from thigmo.live.stopping import stop_port, way_to
from thigmo.live.watched import Watched
from thigmo.stream import Hello, Message, RunState, Telemetry

_LOOK_S = 0.02  # between two looks at the stream
_TELL_S = 1.0
_LOOKS_WITHIN_S = 10.0  # for runs that are under way at the start, on a computer that is busy
_CLOSED = {"lost": "stop not connected: use the e-stop", "none": "no robot is in use"}


@dataclass(slots=True)
class Facts:
    """How things are."""

    run: Hello | None = None  # whose messages came last; None before the first
    under_way: bool = False  # it has not ended
    # state, board: last heard of it
    state: RunState | None = None
    board: Telemetry | None = None
    stop: str = ""  # why a stop would not reach the robot; empty if it would
    stopped: str = ""  # what the last stop of this run came to; empty before the first


class View(Protocol):
    """A tool that shows runs."""

    def publish(self, message: Message) -> None:
        """Show a message."""

    def tell(self, facts: Facts) -> None:
        """Show how things are."""


class Relay:
    """Passes on what a run says.

    Args:
        watched: the run. The relay closes it.
    """

    def __init__(self, watched: Watched) -> None:
        self._watched = watched
        self._closed = threading.Event()
        self._looked = threading.Event()
        self._told_s = float("-inf")
        self.facts = Facts()

    def run(self, view: View) -> None:
        """Pass messages on until `close`."""
        while not self._closed.is_set():
            if not self.pass_on(view):
                self._closed.wait(_LOOK_S)

    def pass_on(self, view: View) -> bool:
        """Pass on what has come; whether there was anything."""
        looked = self._watched.looked.is_set()
        taken = self._watched.take()
        for message in taken:
            if isinstance(message, Hello):
                self.facts = Facts(message, under_way=True)
                view.tell(self.facts)  # before any message of its own
            elif message is None:
                self.facts.under_way = False
            else:
                if isinstance(message, Telemetry):
                    self.facts.board = message
                elif isinstance(message, RunState):
                    self.facts.state = message
                view.publish(message)
        if looked:
            self._looked.set()
        now, facts = time.monotonic(), self.facts
        if now - self._told_s >= _TELL_S:
            self._told_s = now
            facts.stop = _CLOSED.get(way_to(facts.run if facts.under_way else None), "")
            view.tell(facts)
        return bool(taken)

    def stop(self) -> str:
        """Stop the robot, from any thread. Blocks until its board has confirmed it, for seconds at
        most.

        Returns:
            A line for the operator, which the view is soon told, too.
        """
        looked, facts = self._looked.is_set(), self.facts
        said = self._stop(facts)
        if said == _CLOSED["none"] and not looked:
            # A stop that was latched may come before the run that is under way is known.
            self._looked.wait(_LOOKS_WITHIN_S)
            facts = self.facts
            said = self._stop(facts)
        facts.stopped = said
        self._told_s = float("-inf")
        return said

    def _stop(self, facts: Facts) -> str:
        run = facts.run if facts.under_way else None
        try:
            if run is not None and run.virtual:
                self._watched.send("stop")
                return f"told {run.name} to stop"
            stopped = stop_port(run)
        except ThigmoError as error:
            return f"not stopped: {error}"
        return f"stopped {', '.join(stopped)}" if stopped else _CLOSED["none"]

    def close(self) -> None:
        """Pass nothing on any more; from any thread."""
        self._closed.set()
        self._watched.close()
