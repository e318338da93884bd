"""A measured rod with one contact, at its tip (README beside the data)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import thigmo

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "fbg-rod" / "rod2.csv"
LENGTH = 0.200


@pytest.fixture(scope="module")
def rod():
    if not DATA.exists():
        pytest.skip(f"no measured rod at {DATA}")
    strain = np.loadtxt(DATA, delimiter=",")[1:, 1:]
    angle = -0.7194 + np.arange(3) * 2 * np.pi / 3
    radius = 37.534162e-6
    design = np.column_stack([np.ones(3), radius * np.cos(angle), radius * np.sin(angle)])
    bending = np.linalg.lstsq(design, strain, rcond=None)[0][1:].T
    plane = np.linalg.svd(bending, full_matrices=False)[2][0]
    curvature = bending @ plane
    return np.arange(1, 21) * 0.01, curvature * np.sign(curvature[0]), np.hypot(*bending.T), bending


def subsets():
    """Evenly spaced samples, four to ten of them."""
    for count in range(4, 11):
        step = 20 // count
        yield np.unique(np.rint(np.linspace(0, 19, count)).astype(int))
        yield from (first + step * np.arange(count) for first in range(step))


def test_all_samples_place_the_tip_contact_and_show_a_load_beside_it(rod):
    position, *curvatures, _ = rod
    for curvature in curvatures:
        result = thigmo.localize(curvature, position, length=LENGTH)
        (contact,) = result.contacts
        assert abs(contact.arc - LENGTH) <= 0.02 * LENGTH
        assert contact.interval[0] <= LENGTH <= contact.interval[1] * (1 + 1e-9)
        assert result.status == "localized"
        # The rod bends by 90 degrees and the coupling loads it with more than a normal force.
        assert result.parameters["tip_moment"] != 0.0


def test_every_evenly_spaced_subset_covers_the_tip(rod):
    position, *curvatures, _ = rod
    for curvature in curvatures:
        for choice in subsets():
            result = thigmo.localize(curvature[choice], position[choice], length=LENGTH)
            contact = result.contacts[-1]
            assert contact.interval[0] <= LENGTH <= contact.interval[1] * (1 + 1e-9), choice


def test_in_space_both_planes_place_the_tip_and_nothing_else(rod):
    bends = rod[3]
    off, covered, elsewhere = [], [], 0
    for noise in (0.05, 0.1, None):
        for choice in [np.arange(20), *subsets()]:
            result = thigmo.localize(
                bends[choice].ravel(), np.repeat(rod[0][choice], 2), length=LENGTH, noise=noise,
                angle=np.tile([0.0, np.pi / 2], len(choice)),
            )  # fmt: skip
            last = result.contacts[-1]
            off.append(abs(last.arc - LENGTH))
            covered.append(last.interval[1] >= LENGTH * (1 - 1e-9))
            elsewhere += any(
                c.status == "localized" and c.interval[1] < 0.98 * LENGTH for c in result.contacts
            )
    assert np.mean(off) <= 0.02 * LENGTH
    assert np.mean(covered) >= 0.91
    assert elsewhere == 0
