"""How a command ends that is interrupted: one line, and the status that shells expect.

SIGTERM is taken like Ctrl-C, so that a robot is vented on the way out; the status tells them apart.
Only the standard library is imported here: the first thing that `thigmo` does is to be ready.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from types import FrameType

_BOTH = (signal.SIGINT, signal.SIGTERM)
_caught = signal.SIGINT


def be_ready() -> None:
    """From now on SIGINT and SIGTERM are `KeyboardInterrupt`."""
    _handle(_interrupt)


def outlive_terminal() -> None:
    """From now on a terminal that is closed ends nothing; `thigmo stop` and Ctrl-C still do."""
    if sys.platform != "win32":
        signal.signal(signal.SIGHUP, signal.SIG_IGN)


def call(action: Callable[[], object]) -> None:
    """From now on they call `action`, until `be_ready`: an event loop must not be interrupted at
    any line.
    """

    def handle(number: int, frame: FrameType | None) -> None:
        global _caught
        _caught = signal.Signals(number)
        action()

    _handle(handle)


def be_done() -> None:
    """From now on they end the process without a word: nothing remains to be undone."""
    _handle(signal.SIG_DFL)


def _handle(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    for number in _BOTH:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as `nohup` and `&` have it
            signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _caught
    _caught = signal.Signals(number)
    raise KeyboardInterrupt


def status() -> int:
    """The exit status of a command that was interrupted: 130, or 143 after SIGTERM."""
    return 128 + _caught


def leave() -> None:
    """Say that nothing was done, and end at once: modules may be half imported."""
    sys.stderr.write("thigmo: interrupted; run it again\n")
    sys.stderr.flush()
    os._exit(status())
