"""Robots from their descriptions alone explore: three rooms of each, one of them empty."""

from __future__ import annotations

from pathlib import Path

import pytest

from thigmo.design import draft
from thigmo.emulator.reach import room_for
from thigmo.errors import RobotFaultError
from thigmo.studies.robots import ROBOTS, THESIS, visit
from thigmo.studies.rooms import explored

OTHERS = [name for name in ROBOTS if name != THESIS]


@pytest.mark.ci
@pytest.mark.parametrize("name", OTHERS)
def test_a_described_robot_finds_pegs_and_says_nothing_in_an_empty_room(name: str) -> None:
    found = [visit((name, seed, True)) for seed in (1, 2)]
    assert not any(one.status.startswith("aborted") for one in found)
    assert sum(one.missed for one in found) <= 1
    assert not any(one.wrong for one in found)
    # 12 and 28 cm where the inputs' order was taken for the sensors'.
    placed = [one for one in found if one.status == "localized"]
    assert not any(one.plane_cm > 0.06 * one.length_cm for one in placed)
    silent = visit((name, 3, False))
    assert silent.status == "silent"


def test_a_thick_body_that_the_spool_cannot_hold_is_told_what_to_change(tmp_path: Path) -> None:
    scene = room_for(draft(53, 5, 2, diameter_cm=6.0), 0, peg=False)
    scene.save(tmp_path / "thick.toml")
    with pytest.raises(RobotFaultError, match=r"1.47 psi pull 14.3 N .* fit a brake or lower"):
        explored(f"emulator://{tmp_path / 'thick.toml'}", tmp_path, 1)
