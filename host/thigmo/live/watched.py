"""The run that is looked at: found, attached to, and read by a thread of its own.

The thread takes messages off the run's stream as they come, so that a busy server delays them and
never the run. What it has taken is fetched in one go, many times a second.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from contextlib import suppress

from thigmo.errors import LinkError, ThigmoError
from thigmo.stream import Command, Message, RemoteRun, attach, running

_MOST_WAITING = 20_000  # messages; who is that far behind loses some, and is told by the run
_LOOK_S = 0.3  # between two looks for a run
_ROOM_S = 0.02  # between two looks whether messages were taken


class Watched:
    """Attaches to runs, one after the other.

    Args:
        url: of the robot whose runs to look at; None takes any run, the youngest first.

    Attributes:
        looked: set once a run that was under way at the start is known.
        heard_s: when the run was last heard of, by the monotonic clock.
    """

    def __init__(self, url: str | None) -> None:
        self._robot = url and _robot(url)
        self._waiting: deque[Message | None] = deque()
        self._run: RemoteRun | None = None
        self._closed = threading.Event()
        self.looked = threading.Event()
        self.heard_s = time.monotonic()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def take(self) -> list[Message | None]:
        """What has come since the last call, oldest first. A `Hello` begins a run, None ends it."""
        return [self._waiting.popleft() for _ in range(len(self._waiting))]

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
            runs = [each for each in running() if self._robot in (None, _robot(each.hello.url))]
            with suppress(LinkError):  # it has just ended
                if runs:
                    with attach(runs[-1].address) as run:
                        self._read(run)
                    continue
            self.looked.set()
            self._closed.wait(_LOOK_S)

    def _read(self, run: RemoteRun) -> None:
        self._run = run
        self._take(run.hello)
        self.looked.set()
        # It ends, or speaks another version of the stream.
        with suppress(EOFError, ThigmoError):
            while not self._closed.is_set():
                if len(self._waiting) >= _MOST_WAITING:
                    self._closed.wait(_ROOM_S)
                elif (message := run.get(0.2)) is not None:
                    self._take(message)
        self._run = None
        self._waiting.append(None)

    def _take(self, message: Message) -> None:
        self.heard_s = time.monotonic()
        self._waiting.append(message)


def _robot(url: str) -> str:
    """A URL without what two URLs of one robot may differ in."""
    device = url.partition("?baud=")[0]
    return os.path.realpath(device) if device.startswith("/") else device
