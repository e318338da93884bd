"""A line by its curvature: headings along it, and its points."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo.mechanics import heading_along, traced


def test_headings_of_a_circle_and_points_on_it() -> None:
    arc = np.linspace(0.0, 10.0, 101)
    heading = heading_along(np.full((2, 101), 0.05), 0.1)
    assert heading == pytest.approx(np.tile(0.05 * arc, (2, 1)))
    x, y = traced(heading, 0.1)
    assert x[1] == pytest.approx(np.sin(0.05 * arc) / 0.05, abs=1e-4)
    assert y[1] == pytest.approx((1 - np.cos(0.05 * arc)) / 0.05, abs=1e-4)


def test_headings_of_a_curvature_that_grows_are_exact_at_any_spacing() -> None:
    arc = np.array([0.0, 0.5, 2.0, 3.0])
    assert heading_along(0.02 * arc, np.diff(arc)) == pytest.approx(0.01 * arc**2)
