"""Runs that the page starts: `thigmo explore` as a process of its own.

It is not this process's business what becomes of the page: a run goes on when its page's server is
killed. One that is ended in good order terminates the run first, which vents the robot.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence

from thigmo.link.transport import emulated

_PATIENCE_S = 10.0  # for a run to vent its robot
_LINES = 20


class StartedRun:
    """A run that the page started, with further `options` of `thigmo explore`."""

    def __init__(self, url: str, options: Sequence[str], *, realtime: bool) -> None:
        self._said: deque[str] = deque(maxlen=_LINES)
        self.question = ""  # to the operator, which the run waits to be answered
        pace = ["--realtime"] if realtime and emulated(url) else []
        explore = [sys.executable, "-m", "thigmo", "explore", "--robot", url, "--prompts-piped"]
        # A session of its own: Ctrl-C at the server's terminal is not meant for the run.
        self._process = subprocess.Popen(
            [*explore, *options, *pace],
            stdin=subprocess.PIPE,
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

    def answer(self, text: str) -> None:
        """Answer the question, in one line."""
        assert self._process.stdin is not None
        if not self.question:
            return
        self.question = ""
        with contextlib.suppress(OSError):  # it has just ended
            self._process.stdin.write(" ".join(text.split()) + "\n")
            self._process.stdin.flush()

    def failure(self) -> str:
        """Why it ended early, in its own last words; empty if it did not, or is under way."""
        if not self._process.poll():
            return ""
        self._listener.join()
        last = next((line for line in reversed(self._said) if line.startswith("thigmo: ")), "")
        return last.removeprefix("thigmo: ") or f"it ended with status {self._process.returncode}"

    def end(self) -> None:
        """Terminate it, which vents the robot, and wait for that."""
        self._process.terminate()
        try:
            self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _listen(self) -> None:
        """Thread: questions, and what it says besides."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith('{"question": '):
                self.question = json.loads(line)["question"]
            else:
                self._said.append(line.strip())
        self.question = ""
