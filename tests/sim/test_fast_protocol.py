"""The default protocol against the thesis's: half of the robot time, the same peg, no false one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thigmo_bench.studies.rooms import explored

SEEDS = (1, 2, 3)
TIME_SHARE = 0.5
PROMISED_CM = 3.0


@pytest.mark.ci
def test_half_of_the_thesis_protocols_robot_time_finds_the_peg(tmp_path: Path) -> None:
    ours_cm, thesis_cm = [], []
    for seed in SEEDS:
        fast = explored("emulator://default", tmp_path / f"fast{seed}", seed)
        slow = explored("emulator://default", tmp_path / f"slow{seed}", seed, protocol="thesis")
        assert fast.document.error_x_cm is not None
        assert fast.document.error_x_cm <= PROMISED_CM
        assert len(fast.document.contacts) == 1
        ours_cm.append(fast.document.robot_time_s)
        thesis_cm.append(slow.document.robot_time_s)
    print(f"{np.mean(ours_cm):.0f} s against {np.mean(thesis_cm):.0f} s")
    assert np.mean(ours_cm) <= TIME_SHARE * np.mean(thesis_cm)
