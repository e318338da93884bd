"""The run that is looked at: found, attached to, and read by a thread of its own.

The thread takes messages off the run's stream as they come, so that a busy server delays them and
never the run. What it has taken is fetched in one go, many times a second.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from dataclasses import dataclass

from thigmo.errors import LinkError, ThigmoError
from thigmo.stream import Command, Hello, Message, RemoteRun, attach, running

_MOST_WAITING = 20_000  # messages; a server that is that far behind has lost its viewers' interest
_LOOK_S = 0.3  # between two looks for a run


@dataclass(frozen=True, slots=True)
class Taken:
    """What has come since it was last asked for.

    Attributes:
        run: whose messages these are; None before the first run.
        ended: the run is over, and these are its last.
        messages: oldest first.
    """

    run: Hello | None
    ended: bool
    messages: list[Message]


class Watched:
    """Attaches to runs, one after the other.

    Args:
        url: of the robot whose runs to look at; None takes any run, the youngest first.

    Attributes:
        looked: set once a run that was under way at the start is known.
        heard_s: when the run was last heard of, by the monotonic clock.
    """

    def __init__(self, url: str | None) -> None:
        self._url = url
        self._lock = threading.Lock()
        self._batches: deque[Taken] = deque()
        self._waiting: list[Message] = []
        self._run: RemoteRun | None = None
        self._hello: Hello | None = None
        self._closed = threading.Event()
        self.looked = threading.Event()
        self.heard_s = time.monotonic()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def take(self) -> Taken:
        """What has come since the last call. At a change from one run to the next the call returns
        the rest of the first one only."""
        with self._lock:
            if self._batches:
                return self._batches.popleft()
            messages, self._waiting = self._waiting, []
            return Taken(self._hello, self._run is None, messages)

    def send(self, command: Command) -> None:
        """Tell the run to pause, to go on or to stop.

        Raises:
            LinkError: no run is under way.
        """
        run = self._run
        if run is None:
            raise LinkError("no run is under way", "start one with `thigmo explore`")
        run.send(command)

    def close(self) -> None:
        """Look no more."""
        self._closed.set()
        self._thread.join()

    def _follow(self) -> None:
        while not self._closed.is_set():
            run = self._find()
            if run is None:
                self.looked.set()
                self._closed.wait(_LOOK_S)
                continue
            with run:
                self._read(run)

    def _find(self) -> RemoteRun | None:
        runs = [each for each in running() if self._url is None or same(each.hello.url, self._url)]
        if not runs:
            return None
        try:
            return attach(runs[-1].address)
        except LinkError:
            return None  # it has just ended

    def _read(self, run: RemoteRun) -> None:
        with self._lock:
            if self._waiting:
                self._batches.append(Taken(self._hello, True, self._waiting))
            self._waiting, self._run, self._hello = [], run, run.hello
            self.heard_s = time.monotonic()
        self.looked.set()
        try:
            while not self._closed.is_set():
                message = run.get(0.2)
                if message is not None:
                    with self._lock:
                        self.heard_s = time.monotonic()
                        self._waiting.append(message)
                        del self._waiting[:-_MOST_WAITING]
        except (EOFError, ThigmoError):
            pass  # it has ended, or speaks another version of the stream
        with self._lock:
            self._batches.append(Taken(self._hello, True, self._waiting))
            self._waiting, self._run = [], None


def same(one: str, other: str) -> bool:
    """Whether two URLs name one robot."""
    return _real(one) == _real(other)


def _real(url: str) -> str:
    device = url.partition("?baud=")[0]
    return os.path.realpath(device) if device.startswith("/") else device
