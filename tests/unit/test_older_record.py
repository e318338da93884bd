"""A record of before messages counted their arrays is read as it was read then."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from thigmo.exploration.recorded import recorded_sweeps
from thigmo.link import protocol as wire
from thigmo.link.framing import decode
from thigmo.record import RunFolder

# A session on the emulator, and `recorded_sweeps` of it, by the code that wrote the record.
KEPT = Path(__file__).parent.parent / "data" / "record_063720f1"


def test_sweeps_are_those_of_before() -> None:
    (sweep,) = recorded_sweeps(KEPT)
    kept = json.loads((KEPT / "peaks.json").read_text())
    assert len(sweep.peaks) == len(kept) == 2
    for peak, (side, psi, free, sensors, count, curvature) in zip(sweep.peaks, kept, strict=True):
        assert (peak.side, peak.pressure_psi, peak.free_curvature) == (side, psi, free)
        assert (peak.sensors, peak.count) == (sensors, count)
        told = [np.nan if value is None else value for value in curvature]
        np.testing.assert_array_equal(peak.curvature, told)


def test_every_frame_decodes() -> None:
    log = RunFolder(KEPT).read_log()
    kinds = {type(decode(entry.frame).message()) for entry in log.entries}
    assert {wire.Telemetry, wire.Snapshot, wire.StatusReport, wire.Sweep} <= kinds
