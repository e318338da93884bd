"""Which program has a serial port open, in the operator's words.

A port that is in use takes no stop from outside: the operator must know which program to end.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

PROCESSES = Path("/proc")  # on Linux only; elsewhere nobody is named
_MOST_LETTERS = 60


def processes(port: str) -> Iterator[Path]:
    """Folders in /proc of the other processes that have it open, as far as this user may look."""
    device = os.path.realpath(port)
    for process in PROCESSES.glob("[1-9]*"):
        if process.name != str(os.getpid()) and _holds(process, device):
            yield process


def owner(port: str) -> str:
    """ " by process 4242 (socat ...)", or several; empty where that cannot be known."""
    owners = [words(int(process.name)) for process in processes(port)]
    if not any(owners) and PROCESSES.is_dir() and _hides_processes():
        return " by another user's program"
    return " and".join(filter(None, owners))


def words(pid: int) -> str:
    """ " by process 4242 (socat ...)"; empty where it has ended."""
    with suppress(OSError):
        arguments = (PROCESSES / str(pid) / "cmdline").read_bytes().decode(errors="replace")
        line = " ".join(arguments.split("\0")).strip()
        label = line if len(line) <= _MOST_LETTERS else f"{line[: _MOST_LETTERS - 3]}..."
        return f" by process {pid} ({label})"
    return ""


def _hides_processes() -> bool:
    """Whether processes are hidden from this one."""
    return hasattr(os, "getuid") and os.getuid() != 0


def _holds(process: Path, device: str) -> bool:
    with suppress(OSError):  # it may have ended, or be another user's
        for file in (process / "fd").iterdir():
            with suppress(OSError):
                if str(file.readlink()) == device:
                    return True
    return False
