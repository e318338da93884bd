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


def pegs(folder: str) -> list[dict[str, float]]:
    """Pegs of an emulated room, which the run folder's contacts.json has after the first stage."""
    try:
        truth = json.loads((Path(folder) / "contacts.json").read_bytes())["truth"] if folder else {}
    except (OSError, ValueError, KeyError):
        return []  # the run's own report tells what is wrong with its folder
    return list(truth["pegs"]) if truth else []
