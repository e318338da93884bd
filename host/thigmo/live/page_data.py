"""What the page shows of a run beside its stream: telemetry as rows of numbers, live as JSON text
and of a finished run as one block of 32-bit floats; the robot's build and, where the robot is
emulated, the pegs of its room; of a finished run what else was published.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import chain
from math import isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thigmo.files import DATA_BYTES, read_file
from thigmo.link.protocol import MOST_MUSCLES, MOST_SENSORS
from thigmo.record import RunFolder
from thigmo.stream import Contacts, Message, Telemetry, read_messages, to_json
from thigmo.stream.recorded import wiring_in
from thigmo.wiring import Wiring

_MOST_ROWS = 60_000  # five minutes at full rate, twenty at 50 Hz

# Of a row, for the largest board; `page/store.js` has the same.
_COUNTS = {
    "pressure": MOST_MUSCLES, "demand": MOST_MUSCLES, "drive": MOST_MUSCLES,
    "curvature": MOST_SENSORS, "expected": MOST_SENSORS,
}  # fmt: skip
COLUMNS = (
    "t_s",
    *(f"{name}_{n}" for name, count in _COUNTS.items() for n in range(count)),
    "length_cm",
    "motor",
)
_DIGITS = 5  # 1/cm: a hundredth of a sensor's noise


def row(telemetry: Telemetry) -> tuple[float, ...]:
    """A reading's numbers in the order of `COLUMNS`; NaN where one is not known."""
    groups = (
        telemetry.pressure_psi, telemetry.demand_psi, telemetry.drive_ma,
        telemetry.curvature_per_cm, telemetry.expected_per_cm,
    )  # fmt: skip
    padded = [
        (*values, *[nan] * (count - len(values)))
        for values, count in zip(groups, _COUNTS.values(), strict=True)
    ]
    return telemetry.t_s, *chain(*padded), telemetry.length_cm, telemetry.motor


def row_text(telemetry: Telemetry) -> str:
    """A row as JSON."""
    return json.dumps([round(x, _DIGITS) if isfinite(x) else None for x in row(telemetry)])


def text(message: Message) -> bytes:
    """A message as JSON; of contacts with the words in which every view says them."""
    encoded = to_json(message)
    if not isinstance(message, Contacts):
        return encoded
    words = [
        {
            "place": contact.place_text, "along": contact.along_text,
            "interval": contact.interval_text, "force": contact.force_text,
            "certainty": contact.certainty_text, "kind": contact.kind_text,
        }
        for contact in message.contacts
    ]  # fmt: skip
    return b'%b,"words":%b}' % (encoded[:-1], json.dumps(words).encode())


def board(telemetry: Telemetry) -> dict[str, Any]:
    """What a reading says besides numbers."""
    return {name: getattr(telemetry, name) for name in ("state", "activity", "faults")}


def thinned(count: int, most: int) -> slice:
    """Every nth of `count` entries, at most `most` of them, the last one included."""
    step = max(1, -(-count // most))
    return slice((count - 1) % step, None, step)


def block(readings: Sequence[Telemetry], origin_s: float, most: int) -> NDArray[np.float32]:
    """At most this many readings, in the order of time, as (columns, rows); NaN is not known.

    Their time is counted from an origin: 32 bits do not hold that of a computer that has been on
    for a month.
    """
    kept = readings[thinned(len(readings), most)] if readings else []
    table = np.array([row(reading) for reading in kept]).reshape(-1, len(COLUMNS))
    table[:, 0] -= origin_s
    return np.ascontiguousarray(table.T, dtype=np.float32)


def body(wiring: Wiring) -> dict[str, Any]:
    """The robot's build."""
    config = wiring.config
    return {
        "length_cm": config.body.length_cm,
        "radius_cm": config.body.radius_cm,
        "muscles": [
            {"name": muscle.name, "side": muscle.side, "output": output}
            for output, muscle in enumerate(config.muscles)
        ],
        "columns": [column._asdict() for column in wiring.columns if column.side],
    }


def pegs(folder: str) -> list[dict[str, float]]:
    """Pegs of an emulated room, which the run folder's contacts.json has after the first stage."""
    try:
        document = read_file(Path(folder) / "contacts.json", DATA_BYTES) if folder else b"{}"
        truth = json.loads(document).get("truth")
    except (OSError, ValueError, RecursionError, AttributeError):
        return []  # the run's own report tells what is wrong with its folder
    return list(truth["pegs"]) if truth else []


class PastRun:
    """A finished run. Raises RunFolderError as `read_messages` does."""

    def __init__(self, folder: Path) -> None:
        self._folder = str(folder)
        self._document = RunFolder(folder).read_document()
        messages = list(read_messages(folder))
        self._readings = [message for message in messages if isinstance(message, Telemetry)]
        self._slow_messages: list[Message] = [
            message for message in messages if not isinstance(message, Telemetry)
        ]
        self._origin_s = min((message.t_s for message in messages), default=0.0)

    def page(self) -> dict[str, Any]:
        """What the page gets of it."""
        document = self._document
        return {
            "run": {
                "id": self._folder, "name": document.name, "url": document.url,
                "folder": self._folder, "t_s": self._origin_s, "virtual": False,
            },
            "result": {
                "outcome": document.outcome, "effort": document.effort, "skips": document.skips,
                "robot_time_s": document.robot_time_s, "length_cm": document.length_cm,
                "contacts": len(document.contacts), "error_cm": document.error_cm,
                "missed": None if document.missed is None else len(document.missed),
                "false": None if document.false is None else len(document.false),
                "map": RunFolder(self._folder).map_path.is_file(),
            },
            "body": body(wiring_in(self._folder)),
            "truth": pegs(self._folder),
        }  # fmt: skip

    def facts(self) -> bytes:
        """All messages but readings, and when the board's state changed, as JSON."""
        boards = json.dumps(self._boards())
        messages = b",".join(text(message) for message in self._slow_messages)
        return b'{"origin_s":%r,"boards":%b,"messages":[%b]}' % (
            self._origin_s, boards.encode(), messages,
        )  # fmt: skip

    def readings(self) -> bytes:
        """All readings: 32-bit little-endian floats, column by column (`COLUMNS`)."""
        return block(self._readings, self._origin_s, _MOST_ROWS).astype("<f4").tobytes()

    def _boards(self) -> list[dict[str, Any]]:
        boards: list[dict[str, Any]] = []
        last: dict[str, Any] = {}
        for reading in self._readings:
            if (now := board(reading)) != last:
                boards.append({"t": reading.t_s - self._origin_s, **now})
                last = now
        return boards
