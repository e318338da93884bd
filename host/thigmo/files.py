"""Files that are whole or absent: a full disk or a crash leaves what was there before."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any


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
