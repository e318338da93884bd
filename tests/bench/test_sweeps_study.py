"""The study of frames together: its rooms are what they say, and its scores count right."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo.studies import sweeps
from thigmo.studies.sweeps import judge, score


def test_readings_are_those_of_the_free_body_until_the_touch() -> None:
    there, clean = sweeps._rooms(3, 0, 6)
    before = np.isnan(there.u).T
    assert before.any()
    assert not before[:, -1].any()
    off = np.abs(clean - there.free.T[..., None]).max(axis=2)
    assert off[before].max() < 1e-9
    assert (off[:, -1] > 0.0).all()


def test_all_frames_are_judged_as_the_last_one_is() -> None:
    rows = judge(("none", 3, 0, 6))
    assert rows.keys() == sweeps.METHODS.keys()
    for name, each in rows.items():
        assert each.shape == (6, 5)
        found = score("none", name, each)
        assert found["listed"] >= 0.5
        assert found["mean_error_cm"] < 10.0


def test_scores_count_right() -> None:
    rows = np.array([
        [1.0, 1.0, 1.0, 0.5, 4.0], [1.0, 0.0, 1.0, 3.0, 2.0], [1.0, 0.0, 0.0, 9.0, 20.0],
        [0.0, np.nan, 0.0, np.nan, np.nan],
    ])  # fmt: skip
    found = score("none", "all frames", rows)
    assert (found["listed"], found["localized"], found["wrong"]) == (0.75, 0.5, 0.25)
    assert found["covered"] == pytest.approx(1 / 3)
    assert found["median_width_cm"] == 4.0
