"""Files that are on disk whole or not at all: a crash leaves the one before."""

from __future__ import annotations

import os
from pathlib import Path

from thigmo.errors import RunFolderError


def write_whole(path: Path, data: bytes) -> None:
    """Replace a file's content; on disk on return.

    Raises:
        RunFolderError: the folder cannot be written.
    """
    partial = path.with_name(f"{path.name}.partial")
    try:
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        raise RunFolderError(
            f"cannot write {path}: {error.strerror}", "free some space, or check permissions"
        ) from error
