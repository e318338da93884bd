"""Frames of records that were written by older schemas, in today's layout.

Before messages counted their arrays, they were of a left and a right muscle and ten sensors, in the
order that arrays have now: what is missing are the counts. Before boards read IMUs, no capacity
named them. Read through by `record.log`.
"""

from __future__ import annotations

from thigmo.link import protocol as wire
from thigmo.link.framing import FrameError, decode, rewritten

WITHOUT_COUNTS, WITHOUT_IMUS = OLDER_SCHEMAS = ("063720f1", "18614afe")  # schema hashes
_MUSCLES, _SENSORS = 2, 10
# By schema and message, the bytes that its payload lacks: their places today, and what they say.
_LACKING: dict[str, dict[int, dict[int, int]]] = {
    WITHOUT_IMUS: {wire.Capacity.ID: {4: 0}},
    WITHOUT_COUNTS: {
        wire.Telemetry.ID: {4: _SENSORS, 25: _MUSCLES},
        wire.Snapshot.ID: {9: _SENSORS, 30: _MUSCLES},
        wire.StatusReport.ID: {16: _MUSCLES},
        wire.SetPressure.ID: {0: _MUSCLES},
        wire.Sweep.ID: {0: _MUSCLES},
    },
}
# Output and muscle of what test_output then drove: transducers, motor, vents.
_OUTPUTS = {
    0: (wire.Output.TRANSDUCER, 0),
    1: (wire.Output.TRANSDUCER, 1),
    3: (wire.Output.VENT, 0),
    4: (wire.Output.VENT, 1),
}


def in_todays_layout(stuffed: bytes, schema: str) -> bytes:
    """A frame of an older schema as it was on the wire, without its closing zero, in today's."""
    try:
        frame = decode(stuffed)
    except FrameError:
        return stuffed  # as it was heard
    payload = frame.payload
    if schema == WITHOUT_COUNTS and frame.id == wire.TestOutput.ID and payload:
        output, muscle = _OUTPUTS.get(payload[0], (wire.Output.MOTOR, 0))
        payload = bytes([output, muscle]) + payload[1:]
    for at, byte in _LACKING[schema].get(frame.id, {}).items():
        payload = payload[:at] + bytes([byte]) + payload[at:]
    return stuffed if payload is frame.payload else rewritten(frame, payload)
