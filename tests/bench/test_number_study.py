"""The study of the two claims: what it draws, counts and promises."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo_bench.studies import Context, load
from thigmo_bench.studies.number import _countable, by_prior, calibration, pairs


def test_the_error_of_calibration_is_that_of_its_bins() -> None:
    sure = np.array(
        [[0.95, 0.05, 0, 0, 0]] * 10 + [[0.25, 0.75, 0, 0, 1]] * 3 + [[0.25, 0.75, 0, 0, 0]]
    )
    rows, error = calibration(sure)
    assert [row["count"] for row in rows] == [4, 10]
    assert error == pytest.approx((10 * 0.05 + 4 * 0.0) / 14)


def test_a_contact_counts_from_three_standard_errors() -> None:
    arcs = np.array([30.0, 50.0])
    assert _countable(arcs, np.array([1e-4, 1e-4])) == 2
    assert _countable(arcs, np.array([1e-4, 1e-7])) == 1
    assert _countable(arcs, np.array([1e-6, 1e-7])) == 0


def test_frames_of_the_prior_hold_every_number_with_its_odds() -> None:
    frames = by_prior(((3,), 150))
    assert frames[:, :4].sum(axis=1) == pytest.approx(1.0, abs=1e-6)
    assert 0.6 < np.mean(frames[:, 4] == 0) < 0.95
    assert calibration(frames)[1] < 0.1


def test_pairs_that_the_bound_tells_apart_are_found() -> None:
    frames = pairs(((5,), 80))
    near, far = frames[frames[:, 0] < 3.0], frames[frames[:, 0] > 6.0]
    assert near[:, 2].mean() > 0.6 > far[:, 2].mean()


def test_the_study_runs_small() -> None:
    outcome = load("number")(Context(seed=2, scale="quick"))
    assert outcome.figures.keys() == {"number", "trade"}
    assert {row["claim"] for row in outcome.tables["trade"]} == {"number", "place"}
    assert outcome.claims[0].holds  # the calibration; shares of so few frames decide nothing
