"""The trigger's study, checked on the image: the same contacts at the same microseconds."""

from __future__ import annotations

import pytest

from thigmo.emulator.mega_sim import SimulatedMega
from thigmo.emulator.plant import STEP_MS
from thigmo_bench.studies.trigger import DEFAULT, THRESHOLD, room
from thigmo_bench.studies.trigger_sessions import (
    OTHERS,
    Session,
    Setting,
    converse,
    halves_of,
    latencies,
    record,
    replay,
    with_setting,
)


@pytest.fixture(scope="module")
def stepped() -> Session:
    """A sweep to each side with all of the noise, and a contact of 1.5 thresholds in both."""
    halves = halves_of([0, 1], [2000, 2500])
    return record(room("all three", 1.0), 5, halves, step=1.5 * THRESHOLD, threshold=THRESHOLD)


@pytest.mark.parametrize("setting", [DEFAULT, Setting(2, 12, 500)])
def test_the_image_reports_the_contacts_of_the_virtual_board_at_its_times(
    stepped: Session, setting: Setting
) -> None:
    mega = SimulatedMega(stepped.seed, stepped.eeprom)
    mega.set_analog(OTHERS)
    mega.feed_trace(stepped.conversions)
    mega.run_to_tick()
    mega.step(1)
    script = with_setting(stepped.script, setting)
    on_mega = converse(mega, script, stepped.end_ms, lambda now: mega.step(STEP_MS))
    on_virtual = replay(stepped, setting)
    assert len(on_mega) >= 2
    assert on_mega.tolist() == on_virtual.tolist()
    assert all(0 < ms < 30 for ms in latencies(stepped, on_mega))
