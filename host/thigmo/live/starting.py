"""Commands that the page starts, each as a process of its own: an exploration, and what finishes
the job on a robot that has stopped (clear, retract, jog).

An exploration goes on when its page's server is killed. One that is ended in good order terminates
it first, which vents the robot. A motion goes on only while the page is there, which tells so
several times a second.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from thigmo.link.transport import emulated

_PATIENCE_S = 10.0  # for a command to make its robot safe
_LINES = 20
_MOTIONS = ("retract", "jog")


@dataclass(frozen=True, slots=True)
class Parameter:
    """An option of `thigmo explore` that an operator changes on the page."""

    flag: str
    label: str
    help: str
    choices: tuple[str, ...] = ()  # empty: free text
    number: bool = False


class Started:
    """A command of `thigmo` with its arguments, which the page started.

    Attributes:
        spoke: whether its stream was seen.
    """

    def __init__(self, *command: str) -> None:
        self.name = command[0]
        self.spoke = False
        self.held = self.name in _MOTIONS
        self.on_robot = self.held or self.name == "clear"  # finishes the job of a run
        self._said: deque[str] = deque(maxlen=_LINES)
        # A session of its own: Ctrl-C at the server's terminal is not meant for it.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "thigmo", *command, *(["--by-page"] if self.on_robot else [])],
            stdin=subprocess.PIPE if self.held else subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    @property
    def pid(self) -> int:
        """Its process."""
        return self._process.pid

    @property
    def runs(self) -> bool:
        """Whether it is still under way."""
        return self._process.poll() is None

    def hold(self) -> None:
        """The page is there: a motion goes on."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError, ValueError):  # it has ended, or was let go
                self._process.stdin.write("\n")
                self._process.stdin.flush()

    def let_go(self) -> None:
        """The page has gone: a motion ends."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()

    def said(self) -> str:
        """What it said last, once it has ended well; empty before, and if it failed."""
        if self._process.poll() != 0:
            return ""
        self._listener.join()
        return self._said[-1] if self._said else ""

    def failure(self) -> str:
        """Why it ended early, in its own last words; empty if it did not, or is under way."""
        if not self._process.poll():
            return ""
        self._listener.join()
        last = next((line for line in reversed(self._said) if line.startswith("thigmo: ")), "")
        return last.removeprefix("thigmo: ") or f"it ended with status {self._process.returncode}"

    def end(self) -> None:
        """End it, which makes the robot safe, and wait for that."""
        self.let_go()
        if not self.held:
            self._process.terminate()
        try:
            self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _listen(self) -> None:
        """Thread: reads its output."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._said.append(line.strip())


def explore_options(out: Path, config: Path | None) -> tuple[str, ...]:
    """Options of the explorations that the page starts."""
    return ("--out", str(out), *(("--config", str(config)) if config else ()))


def exploration(url: str, options: Sequence[str], *, realtime: bool) -> Started:
    """An exploration of a robot, with further options, which asks its operator on the page."""
    pace = ["--realtime"] if realtime and emulated(url) else []
    return Started("explore", "--robot", url, "--asks-viewers", *options, *pace)
