"""What an installation may lack: packages of the extras, and what only the sources bring.

The base localizes, explores and flashes. Code that needs more asks here first, so that a user reads
what to install and not a traceback.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from thigmo.errors import ThigmoError

if TYPE_CHECKING:
    from pandas import DataFrame

_MODULES = {
    "plot": ("matplotlib",),
    "camera": ("cv2", "matplotlib"),
    "live": ("aiohttp", "segno"),
    "foxglove": ("foxglove",),
    "ros": ("cyclonedds",),
    "tables": ("pandas", "pyarrow"),
    "bench": ("distributed", "pwlf", "ruptures", "sklearn"),
}


class NotInstalledError(ThigmoError):
    """What is asked for is not part of this installation."""


def require(extra: str, subject: str) -> None:
    """Raise NotInstalledError if `subject` lacks a package of the extra: plot, camera, live ..."""
    for module in _MODULES[extra]:
        if find_spec(module) is None:
            raise NotInstalledError(
                f"{subject} needs {module}, which is not installed",
                f"run `pip install 'thigmo[{extra}]'`",
            )


def data_frame(content: Sequence[Mapping[str, Any]] | Mapping[str, Any]) -> DataFrame:
    """Rows, or columns by name, as a pandas data frame. Raises NotInstalledError without it."""
    require("tables", "a data frame")
    from pandas import DataFrame

    return DataFrame(content)


def require_sources(module: str, subject: str) -> None:
    """Raise NotInstalledError if `subject` needs a module that wheels leave out."""
    if find_spec(module) is None:
        raise NotInstalledError(
            f"{subject} comes with the sources of thigmo, not with its wheel",
            "get them (the sdist, or a clone) and run `make install` there",
        )
