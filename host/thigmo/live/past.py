"""What the page shows of a run beside its stream: the robot's build and, where the robot is
emulated, the pegs of its room; of a finished run all readings as one block, and what else was told.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from thigmo.config import SIDES, RobotConfig
from thigmo.errors import ConfigError
from thigmo.live.rows import block, board
from thigmo.record import RunFolder
from thigmo.stream import Message, Telemetry, read_messages, to_json

_MOST_ROWS = 60_000  # five minutes at full rate, twenty at 50 Hz


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


class PastRun:
    """A finished run.

    Args:
        folder: of the run.

    Raises:
        RunFolderError: it holds no record, or one of an earlier version.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = str(folder)
        self._document = RunFolder(folder).read_document()
        messages = list(read_messages(folder))
        self._readings = [each for each in messages if isinstance(each, Telemetry)]
        self._others: list[Message] = [each for each in messages if not isinstance(each, Telemetry)]
        self._origin_s = min((each.t_s for each in messages), default=0.0)

    def page(self) -> dict[str, Any]:
        """What the page is told of it."""
        return {
            "run": {
                "id": self._folder, "name": self._document.name, "url": self._document.url,
                "folder": self._folder, "t_s": self._origin_s, "virtual": False,
            },
            "body": body(self._folder),
            "truth": pegs(self._folder),
        }  # fmt: skip

    def facts(self) -> bytes:
        """All messages but readings, and when the board's state changed, as JSON."""
        boards = json.dumps(self._boards())
        others = b",".join(to_json(each) for each in self._others)
        return b'{"origin_s":%r,"boards":%b,"messages":[%b]}' % (
            self._origin_s, boards.encode(), others,
        )  # fmt: skip

    def readings(self) -> bytes:
        """All readings: 32-bit little-endian floats, column by column (`rows.COLUMNS`)."""
        return block(self._readings, self._origin_s, _MOST_ROWS).astype("<f4").tobytes()

    def _boards(self) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = []
        last: dict[str, Any] = {}
        for reading in self._readings:
            if (now := board(reading)) != last:
                found.append({"t": reading.t_s - self._origin_s, **now})
                last = now
        return found
