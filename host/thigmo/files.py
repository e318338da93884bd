"""Files that are whole or absent: a full disk or a crash leaves what was there before.

What is read may come from anybody: it has a limit of size, and is a regular file.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

CONFIG_BYTES = 4 << 20  # of a file that people write; robot.toml has some 10 kB
DATA_BYTES = 256 << 20  # of a table, a map or a document; a run's of an hour has some 10 MB
RECORD_BYTES = 4 << 30  # of a record, which grows by half a gigabyte in an hour


def read_file(path: str | os.PathLike[str], most_bytes: int) -> bytes:
    """Content of a regular file. Raises OSError: also for anything else, which may never end, and
    for a larger file.
    """
    # A pipe without a writer would keep `open` waiting.
    descriptor = os.open(
        path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    )
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file", str(path))
        if status.st_size > most_bytes:
            most = f"{most_bytes >> 20} MB"
            raise OSError(errno.EFBIG, f"it is larger than {most}", str(path))
        return file.read()


def why_unreadable(error: Exception) -> str:
    """The reason of a parser's error, on one line; its own limits in a reader's words."""
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    if "integer string conversion" in str(error):
        return "a number in it has too many digits"
    return " ".join(str(error).split())


@contextmanager
def whole_file(path: str | os.PathLike[str], *, text: bool = False) -> Iterator[IO[Any]]:
    """Open a file that takes the place of `path` when the block ends, on disk by then.

    Where the block or the disk fails, `path` is as it was. Text is UTF-8, its line ends as they are
    written. Raises OSError.
    """
    target = Path(path)
    partial = target.with_name(f"{target.name}.partial")
    try:
        with (
            partial.open("w", encoding="utf-8", newline="") if text else partial.open("wb") as file
        ):
            yield file
            file.flush()
            os.fsync(file.fileno())
        partial.replace(target)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Replace a file's content, of text or bytes; on disk on return. Raises OSError."""
    with whole_file(path, text=isinstance(content, str)) as file:
        file.write(content)
