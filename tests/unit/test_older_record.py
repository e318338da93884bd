"""Records of older schemas are read as they were read then."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from thigmo.exploration.recorded import recorded_sweeps
from thigmo.link import protocol as wire
from thigmo.link.framing import decode
from thigmo.record import OLDER_SCHEMAS, RunFolder

# Sessions on the emulator, and `recorded_sweeps` of them, by the code that wrote the record: before
# messages counted their arrays, and before a capacity counted IMUs.
KEPT = sorted((Path(__file__).parent.parent / "data").glob("record_*"))
KINDS = {wire.Telemetry, wire.Snapshot, wire.StatusReport, wire.Sweep}


def test_each_older_schema_has_a_record() -> None:
    assert {f"record_{schema}" for schema in OLDER_SCHEMAS} == {kept.name for kept in KEPT}


@pytest.mark.parametrize("folder", KEPT, ids=lambda folder: folder.name)
def test_sweeps_are_those_of_before(folder: Path) -> None:
    (sweep,) = recorded_sweeps(folder)
    kept = json.loads((folder / "peaks.json").read_text())
    assert len(sweep.peaks) == len(kept) > 0
    for peak, (side, psi, free, sensors, count, curvature) in zip(sweep.peaks, kept, strict=True):
        assert (peak.side, peak.pressure_psi, peak.free_curvature) == (side, psi, free)
        assert (peak.sensors, peak.count) == (sensors, count)
        said = [np.nan if value is None else value for value in curvature]
        np.testing.assert_array_equal(peak.curvature, said)


@pytest.mark.parametrize("folder", KEPT, ids=lambda folder: folder.name)
def test_every_frame_decodes(folder: Path) -> None:
    log = RunFolder(folder).read_log()
    messages = [decode(entry.frame).message() for entry in log.entries]
    assert {type(message) for message in messages} >= KINDS
    for message in messages:
        if isinstance(message, wire.Capacity):
            assert (message.imus, message.adc_bits, message.tick_us) == (0, 10, 1000)
