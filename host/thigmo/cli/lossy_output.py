"""Output that nobody reads is dropped, and stops nothing.

A reader may leave (`thigmo explore | head -1`), a terminal may be closed, a disk may be full. A
program that drives a robot goes on: what it prints to stdout and stderr is then dropped. If a
command's result was lost for another reason than that its reader left, the command says so at its
end. Only the standard library is imported here, because this runs before all else of `thigmo`.
"""

from __future__ import annotations

import errno
import io
import os
import select
import sys
from pathlib import Path
from typing import Any, TextIO

# The reader went, or the terminal was closed.
_LEFT = (errno.EPIPE, errno.EIO, errno.ENXIO, errno.EBADF)
# A reader of stderr that takes nothing, such as a terminal that is held (Ctrl-S), is waited for.
_PATIENCE_S = 1.0
_PIECE = 128  # characters, at most 512 bytes: a pipe or terminal that is ready takes them at once


class LossyOutput(io.TextIOWrapper):
    """A stream that loses what it cannot write.

    The stream below stays the standard library's own: a signal does not leave its writes half
    counted. With one written in Python, Ctrl-C at the wrong moment printed a text twice.

    Args:
        stream: where to.
        patient: wait for a reader who takes nothing, however long.
    """

    def __init__(self, stream: TextIO, *, patient: bool) -> None:
        raw: Any = getattr(stream.buffer, "raw", stream.buffer)
        super().__init__(
            io.BufferedWriter(raw),
            encoding=stream.encoding,
            errors=stream.errors,
            line_buffering=stream.isatty() or not patient,
        )
        self._patient = patient
        self._stalled = False
        self.lost: OSError | None = None  # why, once something was

    def write(self, text: str, /) -> int:
        """Write what can be written; all of it counts as written."""
        try:
            if self._patient:
                super().write(text)
            else:
                super().write(text[:0])  # raises at bytes: typer tells by it what a stream takes
                for start in range(0, len(text), _PIECE):
                    if self._taken():
                        super().write(text[start : start + _PIECE])
                        super().flush()
        except OSError as error:
            self._lose(error)
        return len(text)

    def flush(self) -> None:
        """Write what was kept back."""
        try:
            super().flush()
        except OSError as error:
            self._lose(error)

    def _lose(self, error: OSError) -> None:
        """Whatever is still to be written goes nowhere from now on."""
        self.lost = error
        nowhere = os.open(os.devnull, os.O_RDWR)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)

    def _taken(self) -> bool:
        """Whether the reader takes something, now or soon; one that has stalled gets no time."""
        if sys.platform == "win32":  # its pipes cannot be asked
            return True
        patience_s = 0.0 if self._stalled else _PATIENCE_S
        self._stalled = not select.select([], [self], [], patience_s)[1]
        return not self._stalled


def be_lossy() -> None:
    """From now on nothing that is printed can fail, nor land in a file that was opened since."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # closed: the next file that is opened would get this number
            os.open(os.devnull, os.O_RDWR)
    sys.stdout = _lossy(sys.stdout, patient=True)
    sys.stderr = _lossy(sys.stderr, patient=False)


def _lossy(stream: TextIO | None, *, patient: bool) -> TextIO:
    if stream is None:  # it was closed
        return Path(os.devnull).open("w")
    return LossyOutput(stream, patient=patient)


def lost() -> bool:
    """Say in one line if a part of the result was lost that somebody may want; whether so."""
    sys.stdout.flush()
    if not isinstance(sys.stdout, LossyOutput) or sys.stdout.lost is None:
        return False
    why = sys.stdout.lost
    if why.errno in _LEFT:
        return False
    sys.stderr.write(f"thigmo: the output was lost: {why.strerror}; write it elsewhere\n")
    return True
