"""The one place that calls numba's compiler, with types that mypy can follow.

Only the exact point fits use it: nothing else is compiled at first use. Compiled functions are
cached on disk in a folder that is named by a hash of their sources, so no edit of a constant or of
a called function is ever missed. `make clean` empties it.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def cache_folder() -> Path:
    """Folder of the compiled code of just these sources, in the user's cache."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    digest = hashlib.sha256()
    for path in sorted((Path(__file__).parent / "localization").rglob("*.py")):
        digest.update(path.read_bytes())
    return home / "thigmo" / f"numba-{digest.hexdigest()[:16]}"


_CACHE = str(cache_folder())
_config: Any = numba.config


def compiled(function: F) -> F:
    """Compile a function on first use (nopython, cached on disk); its type is unchanged."""
    before = _config.CACHE_DIR
    _config.CACHE_DIR = _CACHE
    try:
        return cast(F, numba.njit(cache=True, error_model="numpy", nogil=True)(function))
    finally:
        _config.CACHE_DIR = before
