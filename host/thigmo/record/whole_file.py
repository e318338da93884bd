"""Files of a run folder: on disk whole or not at all, and read with errors that say what to do.

A crash leaves the file of before.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError

from thigmo.config import invalid_entry
from thigmo.errors import RunFolderError

T = TypeVar("T")


def write_whole(path: Path, data: bytes) -> None:
    """Replace a file's content; on disk on return. Raises RunFolderError if that fails."""
    partial = path.with_name(f"{path.name}.partial")
    with RunFolderError.from_os(f"cannot write {path}", "free some space, or check permissions"):
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)


def read_json(
    kind: TypeAdapter[T], path: str | os.PathLike[str], *, missing: str, invalid: str
) -> T:
    """Read a JSON file of a kind. Raises RunFolderError, which says what to do where it is so."""
    try:
        return kind.validate_json(Path(path).read_bytes())
    except OSError as error:
        raise RunFolderError(f"cannot read {path}: {error.strerror}", missing) from error
    except ValidationError as error:
        raise RunFolderError(invalid_entry(path, error), invalid) from error
