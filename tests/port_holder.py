"""The process at the host's end of a pseudo-terminal, and whether this computer lets it run.

A test of promises such as "a heartbeat every 0.1 s" gives the robot a clock that stands still while
that process is ready to run and does not get to. A process that waits where it should not is not
ready: for that one the clock goes on.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from thigmo.link.port_owner import processes


class PortHolder:
    """Whoever has a port open, beside this process.

    Args:
        port: path of the pseudo-terminal.
    """

    def __init__(self, port: str) -> None:
        self._port = port
        self._tasks: Path | None = None

    def look(self) -> None:
        """Find it, unless it is known and alive; to be called when it has written."""
        if self._tasks is not None and self._tasks.exists():
            return
        self._tasks = None
        for process in processes(self._port):
            self._tasks = process / "task"

    def held_up(self) -> bool:
        """Whether one of its threads is ready to run."""
        if self._tasks is None:
            return False
        with suppress(OSError):  # the process may have ended
            for task in self._tasks.glob("*/stat"):
                with suppress(OSError):  # a thread may have ended
                    if task.read_text().rpartition(")")[2].split()[0] == "R":
                        return True
        return False
