"""What the page shows of a run besides its stream: the robot's build, and, where the robot is
emulated, the pegs of its room.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from thigmo.config import SIDES, RobotConfig
from thigmo.errors import ConfigError


def body(folder: str) -> dict[str, Any]:
    """The robot's build from the run folder's robot.toml, or the defaults' if there is none."""
    try:
        config = RobotConfig.load(Path(folder) / "robot.toml") if folder else RobotConfig()
    except ConfigError:
        config = RobotConfig()
    return {
        "length_cm": config.body.length_cm,
        "radius_cm": config.body.radius_cm,
        "sensors": {
            side: [sensor.center_cm for sensor in config.sensors.column(side)] for side in SIDES
        },
    }


class Truth:
    """Pegs of an emulated room, which contacts.json has after the first stage.

    Args:
        folder: of the run; empty if it has none.
    """

    def __init__(self, folder: str) -> None:
        self._path = Path(folder) / "contacts.json" if folder else None
        self._read_ns = 0
        self._pegs: list[dict[str, float]] = []

    def pegs(self) -> list[dict[str, float]]:
        """The pegs as known by now; reads the file if it is new."""
        if self._path is None:
            return self._pegs
        try:
            changed_ns = self._path.stat().st_mtime_ns
            if changed_ns != self._read_ns:
                self._read_ns = changed_ns
                truth = json.loads(self._path.read_bytes()).get("truth")
                self._pegs = truth["pegs"] if truth else []
        except (OSError, ValueError, KeyError):
            return self._pegs  # the run's own report tells what is wrong with its folder
        return self._pegs
