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
from typing import Any, TextIO, cast

# The reader went, or the terminal was closed.
_LEFT = (errno.EPIPE, errno.EIO, errno.ENXIO, errno.EBADF)
# A reader of stderr that takes nothing, such as a terminal that is held (Ctrl-S), is waited for.
_PATIENCE_S = 1.0
_PIECE_BYTES = 512  # what a pipe or terminal that is ready takes without making its writer wait


class Unread(io.RawIOBase):
    """A raw stream that loses what it cannot write.

    Args:
        raw: where to.
        patient: wait for a reader who takes nothing, however long.
    """

    def __init__(self, raw: io.RawIOBase, *, patient: bool) -> None:
        self._raw = raw
        self._patient = patient
        self._stalled = False
        self.lost: OSError | None = None  # why, once something was

    def writable(self) -> bool:
        """It is."""
        return True

    def fileno(self) -> int:
        """The file's number, as of the stream below."""
        return self._raw.fileno()

    def isatty(self) -> bool:
        """Whether it is a terminal that is still there."""
        return self._raw.isatty()

    def write(self, data: bytes, /) -> int:  # type: ignore[override]
        """Write what can be written; all of it counts as written."""
        if self.lost is not None:
            return len(data)
        try:
            if not self._patient and not self._taken():
                return len(data)
            piece = data if self._patient else memoryview(data)[:_PIECE_BYTES]
            return self._raw.write(piece) or 0
        except OSError as error:
            self.lost = error
            return len(data)

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
    buffer: Any = stream.buffer
    raw = Unread(getattr(buffer, "raw", buffer), patient=patient)
    return io.TextIOWrapper(
        io.BufferedWriter(cast("io.RawIOBase", raw)),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=stream.isatty() or not patient,
    )


def lost() -> bool:
    """Say in one line if a part of the result was lost that somebody may want; whether so."""
    sys.stdout.flush()
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    if not isinstance(raw, Unread) or raw.lost is None or raw.lost.errno in _LEFT:
        return False
    sys.stderr.write(f"thigmo: the output was lost: {raw.lost.strerror}; write it elsewhere\n")
    return True
