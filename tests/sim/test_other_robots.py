"""Robots from their descriptions alone explore: three rooms of each, and one without a peg."""

from __future__ import annotations

import pytest

from thigmo.studies.robots import ROBOTS, THESIS, visit

pytestmark = pytest.mark.ci
OTHERS = [name for name in ROBOTS if name != THESIS]


@pytest.mark.parametrize("name", OTHERS)
def test_a_described_robot_finds_pegs_and_says_nothing_in_an_empty_room(name: str) -> None:
    found = [visit((name, seed, True)) for seed in (1, 2)]
    assert not any(one.status.startswith("aborted") for one in found)
    assert sum(one.missed for one in found) <= 1
    assert not any(one.wrong for one in found)
    silent = visit((name, 3, False))
    assert silent.status == "silent"
