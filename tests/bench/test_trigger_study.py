"""The trigger's study measures the firmware's trigger, and its rule chooses what it says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thigmo.emulator.board import FLEX_RIGHT
from thigmo_bench.studies.trigger import (
    DEFAULT,
    THRESHOLD,
    allowed,
    best_setting,
    hum_borne,
    quantile,
    room,
)
from thigmo_bench.studies.trigger_sessions import (
    Session,
    Setting,
    false_alarms,
    halves_of,
    latencies,
    record,
    replay,
)

FAST, SLOW = Setting(0, 1, 500), Setting(6, 12, 500)


@pytest.fixture(scope="module")
def noisy() -> Session:
    return record(room("white", 2.0), 1, halves_of([0, 1, 0, 1]), threshold=THRESHOLD)


def test_noise_alarms_a_trigger_of_single_samples_and_not_one_that_averages(noisy: Session) -> None:
    assert false_alarms(noisy, replay(noisy, FAST)) == 4
    assert false_alarms(noisy, replay(noisy, SLOW)) == 0


def test_hum_alarms_a_long_average_and_what_is_borne_grows_as_the_rule_says() -> None:
    quiet = record(room("white", 0.0), 1, halves_of([0, 1]), threshold=THRESHOLD)
    flex = np.isin(quiet.conversions[:, 1], (0, FLEX_RIGHT))

    def alarms(setting: Setting, counts: float) -> int:
        hummed = quiet.conversions.copy()
        wave = counts * np.sin(0.1 * np.pi * hummed[flex, 0])  # 50 Hz
        hummed[flex, 2] += np.rint(wave).astype(int)
        loud = replace(quiet, conversions=hummed)
        return false_alarms(loud, replay(loud, setting))

    long, short = Setting(5, 1, 500), Setting(4, 6, 500)
    assert alarms(long, 0) == 0
    assert alarms(long, 20) == 2
    assert alarms(DEFAULT, 20) == 0
    counts = np.arange(2, 40)
    borne = [
        counts[max(np.flatnonzero([alarms(session, n) == 0 for n in counts]))]
        for session in (long, short)
    ]
    assert borne[1] / borne[0] == pytest.approx(hum_borne(short) / hum_borne(long), rel=0.15)


@pytest.mark.parametrize("setting", [Setting(0, 3, 500), Setting(4, 6, 500), Setting(6, 1, 500)])
def test_a_step_of_two_thresholds_takes_half_the_window_and_the_debounce(setting: Setting) -> None:
    quiet = room("white", 0.0)
    session = record(
        quiet, 1, halves_of([0, 1], [2000, 2500]), step=2 * THRESHOLD, threshold=THRESHOLD
    )
    half_window = 2**setting.filter_log2 / 2
    # The free body's own error (lag, map) stands beside the step: a tenth of the threshold.
    assert latencies(session, replay(session, setting)) == pytest.approx(
        half_window + setting.debounce_ms, abs=1 + 0.25 * half_window
    )


def test_a_step_below_the_threshold_is_not_reported() -> None:
    session = record(
        room("white", 0.0), 1, halves_of([0], [2000]), step=0.5 * THRESHOLD, threshold=THRESHOLD
    )
    assert latencies(session, replay(session, DEFAULT)).tolist() == [np.inf]


def test_the_rule_takes_the_shortest_latency_of_what_is_allowed() -> None:
    # too many alarms; late at pegs; as early but slow to steps; chosen; hum alarms it
    tried = [Setting(n, ms, 500) for n, ms in ((5, 9), (1, 12), (4, 12), (4, 9), (4, 6))]
    candidates = allowed(tried, [3.0, 0.0, 0.5, 1.0, 0.0])
    assert candidates == [1, 2, 3]
    steps = [5.0, 8.0, 20.0, 18.0, 1.0]
    assert best_setting(candidates, steps, [10.0, 90.0, 40.0, 49.0, 1.0]) == 3
    assert best_setting(candidates, steps, [10.0, 90.0, 40.0, 51.0, 1.0]) == 2


def test_a_missed_contact_is_infinitely_late_and_an_alarm_before_a_step_is_none() -> None:
    values = np.array([-3.0, 4.0, 6.0, np.inf])
    assert quantile(values, 0.5, early=False) == 6.0
    assert quantile(values, 0.5, early=True) == 4.0
    assert quantile(values, 0.9, early=True) == np.inf
    assert np.isnan(quantile(np.array([-3.0]), 0.9, early=False))
