"""A finished run for the page's player: all readings as one block, and what else was told."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from thigmo.live import facts
from thigmo.live.rows import block, board
from thigmo.record import RunFolder
from thigmo.stream import Message, Telemetry, read_messages, to_json

_MOST_ROWS = 60_000  # five minutes at full rate, twenty at 50 Hz


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
            "body": facts.body(self._folder),
            "truth": facts.pegs(self._folder),
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
