"""thigmo makes a soft growing robot feel: where along its body, how hard, and where in the room.

The public surface is what this file exports; names load on first use, so that `thigmo --help`
and the heartbeat process do not pay for numba, matplotlib or OpenCV.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from thigmo.errors import ThigmoError
    from thigmo.exploration import explore
    from thigmo.localization import Contact, LocalizeResult, localize, localize_batch
    from thigmo.robot import Robot, connect

__version__ = "0.1.0"

_HOME = {
    "Contact": "thigmo.localization",
    "LocalizeResult": "thigmo.localization",
    "Robot": "thigmo.robot",
    "ThigmoError": "thigmo.errors",
    "connect": "thigmo.robot",
    "explore": "thigmo.exploration",
    "localize": "thigmo.localization",
    "localize_batch": "thigmo.localization",
}

__all__ = [
    "Contact",
    "LocalizeResult",
    "Robot",
    "ThigmoError",
    "__version__",
    "connect",
    "explore",
    "localize",
    "localize_batch",
]


def __getattr__(name: str) -> Any:
    """Import a public name from its home on first use."""
    if name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'thigmo' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
