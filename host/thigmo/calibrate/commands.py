"""Which commands calibrate a robot; without what the calibration itself loads, for other commands.

`steps` has the table behind them.
"""

from __future__ import annotations

from thigmo.config import RobotConfig
from thigmo.sensors import KINDS


def commands_of(config: RobotConfig, robot: str) -> list[str]:
    """The commands that calibrate a robot, whose URL is `robot`, in their order."""
    commands = []
    if config.muscles or config.board_sensors:
        commands.append(f"thigmo calibrate all --robot {robot}")
    if not (config.muscles and config.board_sensors):
        kinds = {sensor.kind for sensor in config.sensors}
        commands += [
            f"thigmo calibrate {name} --csv FILE"
            for name, kind in KINDS.items()
            if kind.calibrated_by_file and name in kinds
        ]
    return commands
