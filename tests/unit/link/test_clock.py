"""The device's clock: unwrapping, and the map to host time under jitter and skew."""

from __future__ import annotations

import pickle
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from thigmo.link.clock import DeviceClock

WRAP = 1 << 32


@given(st.integers(0, WRAP - 1), st.lists(st.integers(0, (WRAP >> 1) - 1), max_size=50))
def test_unwrapping_follows_any_step_below_half_a_wrap(start: int, steps: list[int]) -> None:
    clock = DeviceClock()
    true = clock.unwrap(start)
    for step in steps:
        true += step
        assert clock.unwrap(true % WRAP) == true


def test_an_older_stamp_does_not_turn_the_clock_back() -> None:
    clock = DeviceClock()
    newest = clock.unwrap(WRAP - 10)
    assert clock.unwrap(5) == newest + 15
    assert clock.unwrap(WRAP - 20) == newest - 10
    assert clock.unwrap(6) == newest + 16


def run(seconds: float, skew: float, offset_s: float, seed: int) -> tuple[DeviceClock, float]:
    """Ten round trips a second, most of them late on one leg; the host's time at the end."""
    rng = random.Random(seed)
    clock = DeviceClock()
    t = 100.0
    while t < 100.0 + seconds:
        there = 0.001 + rng.expovariate(1 / 0.003)
        back = 0.001 + rng.expovariate(1 / 0.003)
        device_us = round((t + there - offset_s) / skew * 1e6)
        clock.pair(t, t + there + back, clock.unwrap(device_us % WRAP))
        t += 0.1
    return clock, t


@pytest.mark.parametrize("skew", [1.0, 1.005, 0.995])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_map_holds_to_a_millisecond_with_a_resonator_half_a_percent_off(
    skew: float, seed: int
) -> None:
    clock, t = run(120.0, skew, 90.0, seed)
    for ago in (0.0, 30.0, 100.0):
        device = (t - ago - 90.0) / skew * 1e6
        assert clock.to_host(device) == pytest.approx(t - ago, abs=1e-3)


def test_one_pair_is_enough_to_begin_with() -> None:
    clock = DeviceClock()
    with pytest.raises(LookupError):
        clock.to_host(0)
    clock.pair(1.0, 1.004, 500)
    assert clock.synchronised
    assert clock.to_host(500 + 1_000_000) == pytest.approx(2.002)


def test_pairs_that_waited_for_bytes_ahead_do_not_count_beside_others() -> None:
    """All round trips take as long, and each byte ahead shifts the stamp by 44 us."""
    clock, rng = DeviceClock(), random.Random(1)
    for number in range(600):
        t = 1.0 + 0.1 * number
        ahead = rng.randrange(20, 60) if rng.random() < 0.8 else 0
        device_us = round((t + 0.005) * 1e6) + 44 * ahead
        clock.pair(t, t + 0.01, device_us, waited_s=0.009 if ahead else 0.0)
    assert clock.to_host(61e6) == pytest.approx(61.0, abs=5e-5)


def test_across_a_wrap_the_map_goes_on() -> None:
    clock, t = run(60.0, 1.0, 100.0 - 4290.0, 4)
    assert clock.to_host((t + 4190.0) * 1e6) == pytest.approx(t, abs=2e-4)


def test_memory_is_bounded() -> None:
    hour, _ = run(3600.0, 1.0, 0.0, 5)
    longer, _ = run(3.0 * 3600.0, 1.0, 0.0, 5)
    assert len(pickle.dumps(longer)) <= 1.01 * len(pickle.dumps(hour))
