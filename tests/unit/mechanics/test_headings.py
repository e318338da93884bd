"""A string of IMUs: differences of headings as readings, with the errors that neighbours share."""

from __future__ import annotations

import numpy as np
import pytest

import thigmo
from thigmo.errors import DataError

LENGTH, ERROR = 100.0, 0.005
ARC = np.linspace(0.0, 96.0, 13)  # the base, and twelve IMUs
SIGMA = np.array([0.0, *np.full(12, ERROR)])


def _headings(contact: float, force: float) -> np.ndarray:
    """Of a straight cantilever: the integral of force times lever from the base."""
    reach = np.minimum(ARC, contact)
    return force * (contact * reach - reach**2 / 2)


def _answers(seed: int, count: int):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        contact = rng.uniform(30.0, 95.0)
        noisy = _headings(contact, 0.008 / contact) + SIGMA * rng.standard_normal(13)
        yield contact, thigmo.from_headings(noisy, ARC, SIGMA)


def test_errors_that_neighbours_share_give_intervals_that_hold_the_contact() -> None:
    held, widths, alone = [], [], []
    for contact, rows in _answers(5, 150):
        known = {"position": rows.position, "span": rows.span, "length": LENGTH, "held_end": False}
        answer = thigmo.localize(
            rows.curvature, noise=1e-6, shared_errors=rows.shared_errors, **known
        )
        sigma = np.linalg.norm(rows.shared_errors, axis=1)
        apart = thigmo.localize(rows.curvature, noise=sigma, **known)
        low, high = answer.contacts[0].interval
        held.append(low <= contact <= high)
        widths.append(high - low)
        alone.append(np.diff(apart.contacts[0].interval)[0])
    assert np.mean(held) >= 0.9
    # As if each reading had errors of its own, places would be known much worse.
    assert np.median(widths) < 0.75 * np.median(alone)


def test_full_turns_are_taken_out_and_frames_are_rows() -> None:
    headings = 0.1 * np.arange(13) * np.array([[1.0], [2.0]]) * 8
    wound = (headings + np.pi) % (2 * np.pi) - np.pi
    rows = thigmo.from_headings(wound, ARC, ERROR)
    assert rows.curvature == pytest.approx(np.full((2, 12), 0.1) * np.array([[1.0], [2.0]]))
    assert rows.shared_errors.sum(axis=1) == pytest.approx(np.zeros(12))


def test_headings_that_fit_no_body_are_refused() -> None:
    with pytest.raises(DataError, match="sort them"):
        thigmo.from_headings(np.zeros(3), [0.0, 20.0, 10.0], ERROR)
    with pytest.raises(DataError, match="4 headings at 3 arcs"):
        thigmo.from_headings(np.zeros(4), [0.0, 10.0, 20.0], ERROR)
