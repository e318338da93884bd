"""Consecutive readings as columns: what a record takes.

A board sends two hundred readings a second. A record is in no hurry: it takes them in blocks, each
at a tenth of what its readings would cost one by one. `protobuf.packed` makes their bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from thigmo.stream.messages import Telemetry

Phase = tuple[str, str, tuple[str, ...]]
"""State, activity and faults of a reading, by the schema's names."""


@dataclass(frozen=True, slots=True)
class TelemetryBlock:
    """Readings, oldest first."""

    numbers: dict[str, Any]  # of `Telemetry`'s numbers by name: (n,), or (n, k) of a tuple of k
    phases: list[Phase]  # (n,)

    def __len__(self) -> int:
        return len(self.phases)

    def telemetry(self, index: int) -> Telemetry:
        """One reading as a message."""
        state, activity, faults = self.phases[index]
        values: dict[str, Any] = {"state": state, "activity": activity, "faults": faults}
        for name, column in self.numbers.items():
            value = column[index].tolist()
            values[name] = tuple(value) if isinstance(value, list) else value
        return Telemetry(**values)
