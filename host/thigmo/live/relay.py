"""Ways from runs to views and back: the stream of the run that is looked at, and its stop.

A view's stop is for one robot: that of the run under way, else that of the view's address, else
that of the run that has ended; only a view that knows of no robot stops all of this user's. How it
reaches the robot is `robot.stopping`'s; one that is emulated inside its run also ends with the run.
A `Relay` passes a run's messages on to another tool, and that tool's stops to the robot: what ROS 2
and Foxglove share. Nothing here drives a robot: if it is killed, the run goes on.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

from thigmo.errors import LinkError, ThigmoError
from thigmo.link.address import names
from thigmo.robot.stopping import Stopped, WayTo, stop_all, stop_robot, way_to
from thigmo.stream import (
    Command,
    Hello,
    Message,
    RemoteRun,
    RunState,
    Telemetry,
    Watchable,
    attach,
    running,
)

_MOST_WAITING = 20_000  # messages; a view that is so far behind loses some, and the run says so
_SEARCH_S = 0.3  # between two looks for a run
_ROOM_S = 0.02  # between two looks whether messages were taken
_LOOK_S = 0.02  # between two looks at the stream
_TELL_S = 1.0
_LOOKS_WITHIN_S = 10.0  # for runs that are under way at the start, on a computer that is busy
_STOP_S = 5.0  # for an emulated run to end
_LOST = "stop not connected, use the e-stop"


@dataclass(frozen=True, slots=True)
class Target:
    """Whom a view's stop is for.

    Attributes:
        url: the robot's address; None for all of this user's that are in use.
        run: what is under way there, if anything is known to be.
    """

    url: str | None
    run: Hello | None = None

    @classmethod
    def of(cls, url: str | None, run: Hello | None, *, under_way: bool) -> Target:
        """The target of a view of an address, and of the run that it shows or has shown last."""
        if run is not None and under_way:
            return cls(run.url, run)
        if url is None and run is not None and not run.virtual:
            return cls(run.url)
        return cls(url)

    @property
    def program(self) -> int | None:
        """Process that emulates the robot; None if the address alone tells which robot it is."""
        return self.run.pid if self.run is not None and self.run.virtual else None

    def way(self) -> tuple[WayTo, str]:
        """As `robot.stopping.way_to`. The robot of a run under way is never nothing to stop."""
        if self.program is not None:
            return "owner", ""
        way, why_not = way_to(self.url)
        return ("lost", why_not) if way == "none" and self.run is not None else (way, why_not)


class Watched:
    """Attaches to a robot's runs, or to any, one after the other: the one that was chosen by its
    process, else the youngest.

    A thread of its own takes messages off the run's stream as they come, so that a busy server
    delays them and never the run. What it has taken is fetched in one go, many times a second.
    """

    def __init__(self, url: str | None, pid: int | None = None) -> None:
        self.url = url
        self._chosen = pid  # process of the run that is shown; None takes the youngest
        self._waiting: deque[Message | None] = deque()
        self._run: RemoteRun | None = None
        self._ended = threading.Event()  # the run that is attached to
        self._closed = threading.Event()
        self._hung: set[str] = set()  # streams of runs that do not answer
        self.looked = threading.Event()  # once a run that was under way at the start is known
        self.heard_s = time.monotonic()  # when the run was last heard of
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def take(self) -> list[Message | None]:
        """What has come since the last call, oldest first. A `Hello` begins a run, None ends it."""
        return [self._waiting.popleft() for _ in range(len(self._waiting))]

    def runs(self) -> list[Hello]:
        """The runs to choose from, the youngest last."""
        return [run.hello for run in self._runs()]

    def choose(self, pid: int | None) -> None:
        """Look at the run of a process, as soon as it is there; None takes the youngest next."""
        self._chosen = pid

    @property
    def chosen(self) -> int | None:
        """The process that was chosen, until its run has ended."""
        return self._chosen

    def send(self, command: Command, text: str = "") -> None:
        """Command the run, as `RemoteRun.send`. Raises LinkError if none is under way."""
        run = self._run
        if run is None:
            raise LinkError("no run is under way", "start one with `thigmo explore`")
        run.send(command, text)

    def stop(self, target: Target) -> list[Stopped]:
        """Stop a robot, or all, from any thread, and wait for seconds at most: what came of it, for
        each robot. Empty if there is none to stop.
        """
        ended, run = self._ended, self._run
        if target.program is None:
            return stop_all() if target.url is None else stop_robot(target.url)
        stopped = stop_robot(target.url or "", target.program)
        confirmed = stopped and not any(result.failure for result in stopped)
        if confirmed or run is None or run.hello != target.run:
            return stopped
        # Its program hangs, ends, or has no board that takes stops: it ends with its run.
        with suppress(LinkError):  # it has just ended
            run.send("stop")
        if ended.wait(_STOP_S):
            return [Stopped(run.hello.url, f"the end of its run {run.hello.name}")]
        failure = f"the run {run.hello.name} does not answer; end its program"
        return stopped or [Stopped(run.hello.url, failure=failure)]

    def close(self) -> None:
        """Close the relay's view of the run."""
        self._closed.set()
        self._thread.join()

    def _follow(self) -> None:
        while not self._closed.is_set():
            chosen = self._chosen
            runs = [
                watchable for watchable in self._runs() if chosen in (None, watchable.hello.pid)
            ]
            with suppress(LinkError):  # it has just ended
                if runs:
                    with attach(runs[-1].address) as run:
                        self._read(run)
                    continue
            self.looked.set()
            self._closed.wait(_SEARCH_S)

    def _runs(self) -> list[Watchable]:
        wanted = self.url and set(names(self.url))
        return [
            run for run in running(self._hung) if not wanted or wanted & {*names(run.hello.url)}
        ]

    def _read(self, run: RemoteRun) -> None:
        self._run, self._ended = run, threading.Event()
        self._take(run.hello)
        self.looked.set()
        try:
            while not self._closed.is_set() and self._chosen in (None, run.hello.pid):
                if len(self._waiting) >= _MOST_WAITING:
                    self._closed.wait(_ROOM_S)
                elif (message := run.get(0.2)) is not None:
                    self._take(message)
        except EOFError:
            self._ended.set()
        except ThigmoError:
            pass  # it speaks another version of the stream
        self._run = None
        if self._chosen == run.hello.pid:
            self._chosen = None
        self._waiting.append(None)

    def _take(self, message: Message) -> None:
        self.heard_s = time.monotonic()
        self._waiting.append(message)


@dataclass(slots=True)
class Facts:
    """How things are."""

    run: Hello | None = None  # the run that sent the last message; None before the first
    under_way: bool = False  # it has not ended
    state: RunState | None = None  # last heard of it
    board: Telemetry | None = None  # last heard of it
    stop: str = ""  # why a stop would not reach the robot; empty if it would
    stopped: str = ""  # what the last stop came to; empty before the first


class View(Protocol):
    """A tool that shows runs."""

    def publish(self, message: Message) -> None:
        """Show a message."""

    def tell(self, facts: Facts) -> None:
        """Show how things are."""


class Relay:
    """Passes on what a run says to a view, as it comes, and each second how things are.

    It closes what it watches.
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
                self.facts = Facts(message, under_way=True, stopped=self.facts.stopped)
                view.tell(self.facts)  # before any message of its own
            elif message is None:
                self.facts.under_way = False
                view.tell(self.facts)  # how it ended, before the next one
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
            way, why_not = self._target(facts).way()
            facts.stop = f"{_LOST}: {why_not}" if way == "lost" else why_not
            view.tell(facts)
        return bool(taken)

    def stop(self) -> str:
        """Stop the robot, from any thread; a line for the operator, which the view gets, too.

        Blocks until its board has confirmed it, for seconds at most.
        """
        looked = self._looked.is_set()
        stopped = self._watched.stop(self._target(self.facts))
        if not stopped and not looked:
            # A stop that was latched may come before the run that is under way is known.
            self._looked.wait(_LOOKS_WITHIN_S)
            stopped = self._watched.stop(self._target(self.facts))
        summary = "; ".join(map(str, stopped)) or self._target(self.facts).way()[1]
        self.facts.stopped = summary
        self._told_s = float("-inf")
        return summary

    def _target(self, facts: Facts) -> Target:
        return Target.of(self._watched.url, facts.run, under_way=facts.under_way)

    def close(self) -> None:
        """Stop forwarding; from any thread."""
        self._closed.set()
        self._watched.close()
