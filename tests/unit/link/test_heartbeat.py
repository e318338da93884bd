"""The heart, the ledger of events, and the time-out for repeats."""

from __future__ import annotations

import random

from thigmo.link.framing import decode
from thigmo.link.heartbeat import HeartbeatSource
from thigmo.link.inbox import EventLedger
from thigmo.link.protocol import Heartbeat
from thigmo.link.round_trip import RoundTrip


def test_beats_come_at_their_period_and_rise() -> None:
    heart = HeartbeatSource(session=5, period_s=0.1)
    beats = [f for ms in range(1000) if (f := heart.beat(ms / 1000)) is not None]
    assert len(beats) == 10
    frames = [decode(b[:-1]) for b in beats]
    assert [f.message() for f in frames] == [Heartbeat(n) for n in range(1, 11)]
    assert {f.session for f in frames} == {5}


def test_late_beats_are_not_made_up_for() -> None:
    heart = HeartbeatSource(1, 0.1)
    assert heart.beat(0.0)
    assert heart.beat(5.0)
    assert heart.beat(5.05) is None


def test_the_heart_holds_while_the_board_is_mute() -> None:
    heart = HeartbeatSource(1, 0.1, hold_after=4)
    assert sum(heart.beat(n * 0.1) is not None for n in range(50)) == 4
    heart.heard()
    assert heart.beat(5.0)


def test_the_repeat_comes_after_the_measured_round_trip() -> None:
    trip = RoundTrip()
    before = trip.timeout_s
    for _ in range(50):
        trip.measure(0.03)
    assert 0.03 <= trip.timeout_s < before
    settled = trip.timeout_s
    trip.back_off()
    assert trip.timeout_s == min(2 * settled, 0.25)
    trip.measure(0.03)
    assert trip.timeout_s < 2 * settled


def test_events_in_order_are_acknowledged_one_by_one() -> None:
    ledger = EventLedger()
    for number in range(1, 70_000):
        number &= 0xFFFF
        assert ledger.take(number)
        assert ledger.acknowledge in (number, None)
        assert not ledger.take(number)


def test_no_event_is_acknowledged_over_a_gap() -> None:
    ledger = EventLedger()
    ledger.take(1)
    assert ledger.take(3)
    assert ledger.acknowledge == 1
    assert ledger.take(2)
    assert ledger.acknowledge == 3


def test_a_gap_that_stays_is_given_up() -> None:
    ledger = EventLedger()
    ledger.take(1)
    for _ in range(9):
        ledger.take(5)
        assert ledger.acknowledge == 1
    ledger.take(5)
    assert ledger.acknowledge == 5


def test_a_host_that_comes_late_waits_before_its_first_acknowledgement() -> None:
    ledger = EventLedger()
    assert ledger.take(41)
    assert ledger.take(40)
    assert ledger.acknowledge is None
    for _ in range(9):
        assert not ledger.take(40)
    assert ledger.acknowledge == 41


def test_reordered_repeats_at_a_fifth_lost_lose_no_event() -> None:
    for seed in range(50):
        rng = random.Random(seed)
        ledger, taken = EventLedger(), set()
        latched = list(range(1, 21))
        while latched:  # the board repeats all of them, the line loses and reorders
            for number in rng.sample(latched, len(latched)):
                if rng.random() < 0.8 and ledger.take(number):
                    taken.add(number)
            done = ledger.acknowledge or 0
            latched = [n for n in latched if n > done]
        assert taken == set(range(1, 21)), seed
