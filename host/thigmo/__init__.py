"""thigmo makes a soft growing robot feel: where along its body, how hard, and where in the room.

The public surface is what this file exports; names load on first use, so that `thigmo --help`
and the heartbeat process do not pay for matplotlib or OpenCV.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from thigmo import version

if TYPE_CHECKING:
    from thigmo.config import RobotConfig
    from thigmo.design import Identifiability, arc_bounds, identifiability
    from thigmo.errors import ThigmoError
    from thigmo.exploration.explore import explore
    from thigmo.exploration.replay import replay
    from thigmo.exploration.result import ExplorationResult, open_run
    from thigmo.localization import (
        BatchResult,
        Body,
        Contact,
        Errors,
        Localizer,
        LocalizeResult,
        Priors,
        Sensors,
        localize,
        localize_batch,
    )
    from thigmo.mechanics import from_headings
    from thigmo.record import (
        MapContact,
        ObstacleMap,
        OccupancyGrid,
        RunDocument,
        read_obstacles,
        read_readings,
        read_ros_map,
    )
    from thigmo.robot import Robot, connect

__version__ = version.VERSION

_NAMES = {
    "config": ["RobotConfig"],
    "design": ["Identifiability", "arc_bounds", "identifiability"],
    "errors": ["ThigmoError"],
    "exploration": ["ExplorationResult", "explore", "open_run", "replay"],
    "localization": [
        "BatchResult", "Body", "Contact", "Errors", "LocalizeResult", "Localizer", "Priors",
        "Sensors", "localize", "localize_batch",
    ],
    "mechanics": ["from_headings"],
    "record": [
        "MapContact", "ObstacleMap", "OccupancyGrid", "RunDocument", "read_obstacles",
        "read_readings", "read_ros_map",
    ],
    "robot": ["Robot", "connect"],
}  # fmt: skip
_HOME = {name: f"thigmo.{home}" for home, names in _NAMES.items() for name in names}

__all__ = [
    "BatchResult",
    "Body",
    "Contact",
    "Errors",
    "ExplorationResult",
    "Identifiability",
    "LocalizeResult",
    "Localizer",
    "MapContact",
    "ObstacleMap",
    "OccupancyGrid",
    "Priors",
    "Robot",
    "RobotConfig",
    "RunDocument",
    "Sensors",
    "ThigmoError",
    "__version__",
    "arc_bounds",
    "connect",
    "explore",
    "from_headings",
    "identifiability",
    "localize",
    "localize_batch",
    "open_run",
    "read_obstacles",
    "read_readings",
    "read_ros_map",
    "replay",
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
