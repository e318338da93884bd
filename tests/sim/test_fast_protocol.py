"""The default protocol against the thesis's: half of the robot time, the same peg, no false one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thigmo.exploration import explore, replay

SEEDS = (1, 2, 3)
TIME_SHARE = 0.5
PROMISED_CM = 3.0


def test_half_of_the_thesis_protocols_robot_time_finds_the_peg(tmp_path: Path) -> None:
    ours, theirs = [], []
    for seed in SEEDS:
        fast = explore("emulator://default", seed=seed, out=tmp_path, name=f"fast{seed}")
        slow = explore(
            "emulator://default", seed=seed, out=tmp_path, name=f"slow{seed}", protocol="thesis"
        )
        assert fast.document.error_x_cm is not None
        assert fast.document.error_x_cm <= PROMISED_CM
        assert len(fast.document.contacts) == 1
        ours.append(fast.document.robot_time_s)
        theirs.append(slow.document.robot_time_s)
        again = replay(fast.folder).document
        assert [c.arc_cm for c in again.contacts] == pytest.approx(
            [c.arc_cm for c in fast.document.contacts]
        )
        assert [t.side for s in again.stages for t in s.triggers] == [
            t.side for s in fast.document.stages for t in s.triggers
        ]
    print(f"{np.mean(ours):.0f} s against {np.mean(theirs):.0f} s")
    assert np.mean(ours) <= TIME_SHARE * np.mean(theirs)


@pytest.mark.parametrize("seed", [1, 5])
def test_an_empty_room_is_silent(tmp_path: Path, seed: int) -> None:
    result = explore("emulator://empty", seed=seed, out=tmp_path)
    assert result.document.outcome == "full length"
    assert result.document.contacts == []
