"""Frames of records that were written before messages counted their arrays, in today's layout.

They were of a left and a right muscle and ten sensors, in the order that arrays have now: what is
missing are the counts. Read through by `record.log`.
"""

from __future__ import annotations

from thigmo.link import protocol as wire
from thigmo.link.framing import FrameError, decode, rewritten

WITHOUT_COUNTS = "063720f1"  # schema hash
_MUSCLES, _SENSORS = 2, 10
# Where a payload of today has its counts.
_COUNTS: dict[int, dict[int, int]] = {
    wire.Telemetry.ID: {4: _SENSORS, 25: _MUSCLES},
    wire.Snapshot.ID: {9: _SENSORS, 30: _MUSCLES},
    wire.StatusReport.ID: {16: _MUSCLES},
    wire.SetPressure.ID: {0: _MUSCLES},
    wire.Sweep.ID: {0: _MUSCLES},
}
# Output and muscle of what test_output then drove: transducers, motor, vents.
_OUTPUTS = {
    0: (wire.Output.TRANSDUCER, 0),
    1: (wire.Output.TRANSDUCER, 1),
    3: (wire.Output.VENT, 0),
    4: (wire.Output.VENT, 1),
}


def with_counts(stuffed: bytes) -> bytes:
    """A frame as it was on the wire, without its closing zero, with the counts put in."""
    try:
        frame = decode(stuffed)
    except FrameError:
        return stuffed  # as it was heard
    payload = frame.payload
    if frame.id == wire.TestOutput.ID and payload:
        output, muscle = _OUTPUTS.get(payload[0], (wire.Output.MOTOR, 0))
        payload = bytes([output, muscle]) + payload[1:]
    for at, count in _COUNTS.get(frame.id, {}).items():
        payload = payload[:at] + bytes([count]) + payload[at:]
    return stuffed if payload is frame.payload else rewritten(frame, payload)
