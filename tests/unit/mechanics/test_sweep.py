"""Whole sweeps of the rod: the readings of its steps, and derivatives as differences have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from thigmo.errors import DataError
from thigmo.mechanics import Obstacle, Peg, Rod, Sweep, Tube, Wall

LENGTH = 53.0
CENTERS = np.array([5.0, 15.0, 25.0, 35.0, 45.0])
SPANS = np.full(5, 5.5)
BENDS = np.arange(0.0, 0.026, 1e-3)
FOLDS = Tube(3.5, 0.01108)
COLUMNS = ("x", "y", "radius", "end_x", "end_y", "compliance")

ROOMS = {
    "side": [Peg(34.0, 10.0, 0.6)],
    "right": [Peg(34.0, -10.0, 0.6)],
    "corner and face": [Peg(43.855, 24.259, 0.6)],
    "two": [Peg(20.0, 4.2, 1.0), Peg(45.0, 12.0, 0.5)],
    "yielding": [Peg(45.0, 15.0, 1.5, compliance=2000.0)],
    "wall": [Wall(25.0, 12.0, 60.0, 14.0, 0.5)],
    "wall's end": [Wall(38.0, 10.0, 60.0, 25.0, 0.5)],
    "wall at the tip": [Wall(35.0, 22.0, 60.0, 17.0, 0.3, compliance=500.0)],
}
BODIES = {
    "flat": FOLDS,
    "giving base, round tip": replace(FOLDS, base_compliance_cm=4.0, tip_rounding_cm=1.75),
    # Two bends that turn about as much, so that it still lies near the rooms' obstacles.
    "curved at rest": replace(FOLDS, rest_curvature=((12.3, 0.006), (31.0, -0.005))),
}


def sweep(
    pegs: Sequence[Obstacle], tube: Tube = FOLDS, centers: npt.NDArray[np.float64] = CENTERS
) -> Sweep:
    sign = -1.0 if pegs[0].y < 0.0 else 1.0
    return Rod(tube, pegs).sweep(sign * BENDS, LENGTH, centers, SPANS)


def changed(
    pegs: Sequence[Obstacle], index: int, name: str, step: float, tube: Tube
) -> npt.NDArray[np.float64]:
    """Derivative of the readings by a number of an obstacle, from two sweeps beside it."""
    readings = []
    for way in (-1.0, 1.0):
        value = getattr(pegs[index], name) + way * step
        moved = [*pegs]
        moved[index] = replace(pegs[index], **{name: value})
        readings.append(sweep(moved, tube).readings)
    return np.asarray((readings[1] - readings[0]) / (2.0 * step))


def agrees(exact: npt.NDArray[np.float64], differences: npt.NDArray[np.float64]) -> None:
    """In all rows but those in which a touch begins or slips off between the two sweeps."""
    size = np.abs(differences).max()
    off = np.abs(exact - differences).max(axis=1) > 1e-4 * size + 1e-9
    assert size > 0.0
    assert off.sum() <= 1


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("room", ROOMS)
def test_derivatives_are_those_of_differences(room: str, body: str) -> None:
    pegs, tube = ROOMS[room], BODIES[body]
    swept = sweep(pegs, tube)
    assert np.isfinite(swept.contacts[..., 0]).any(axis=0).all()
    assert not swept.approximate.any()
    for index, peg in enumerate(pegs):
        names = ["x", "y", "radius"]
        if isinstance(peg, Wall):
            names += ["end_x", "end_y"]
        if peg.compliance:
            names.append("compliance")
        for name in names:
            step = 1e-2 if name == "compliance" else 1e-5
            column = swept.by_obstacle[:, :, index, COLUMNS.index(name)]
            differences = changed(pegs, index, name, step, tube)
            if np.abs(differences).max() > 1e-12:
                agrees(column, differences)


@pytest.mark.parametrize("rest", [(), BODIES["curved at rest"].rest_curvature])
@pytest.mark.parametrize("room", ROOMS)
def test_derivatives_by_the_body_are_those_of_differences(
    room: str, rest: tuple[tuple[float, float], ...]
) -> None:
    pegs = ROOMS[room]
    tube = replace(BODIES["giving base, round tip"], rest_curvature=rest)
    swept = sweep(pegs, tube)
    for column, name, step in ((0, "critical_moment", 1e-7), (1, "base_compliance_cm", 1e-4)):
        low, high = (
            sweep(pegs, replace(tube, **{name: getattr(tube, name) + way * step})).readings
            for way in (-1.0, 1.0)
        )
        differences = (high - low) / (2.0 * step)
        if np.abs(differences).max() > 1e-12:
            agrees(swept.by_body[:, :, column], differences)
    moved = (sweep(pegs, tube, CENTERS + way * 1e-3).readings for way in (-1.0, 1.0))
    low, high = moved
    assert swept.by_place == pytest.approx((high - low) / 2e-3, abs=2e-6)


@pytest.mark.parametrize("body", ["flat", "curved at rest"])
@pytest.mark.parametrize("room", ROOMS)
def test_a_sweep_reads_what_steps_read(room: str, body: str) -> None:
    pegs, tube = ROOMS[room], BODIES[body]
    sign = -1.0 if pegs[0].y < 0.0 else 1.0
    rod, stepped, out = Rod(tube, pegs), [], np.empty(CENTERS.size)
    for bend in sign * BENDS:
        rod.step(float(bend), LENGTH)
        rod.averages_into(CENTERS, SPANS, out)
        stepped.append(out.copy())
    swept = sweep(pegs, tube)
    assert swept.readings == pytest.approx(np.array(stepped), abs=1e-9)
    for contact in rod.contacts():
        assert swept.contacts[-1, contact.peg, :3] == pytest.approx(
            [contact.arc, contact.x, contact.y], abs=1e-6
        )


def test_nothing_is_touched_by_a_body_that_stays_clear() -> None:
    swept = sweep([Peg(38.0, 33.0, 0.6)], centers=np.array([5.0, 25.0, 50.0, 60.0, 45.0]))
    assert np.isnan(swept.contacts).all()
    assert swept.readings[:, :3] == pytest.approx(np.tile(BENDS[:, None], 3))
    assert np.all(swept.readings[:, 3] == 0.0)  # beyond the body
    assert np.all(swept.by_obstacle == 0.0)


def test_a_sweep_leaves_the_rod_where_it_was() -> None:
    rod = Rod(FOLDS, [Peg(34.0, 10.0, 0.6)])
    rod.step(0.02, LENGTH)
    before = rod.nodes()
    rod.sweep(BENDS, 40.0, CENTERS, 5.5)
    assert np.array_equal(rod.nodes(), before)


@pytest.mark.parametrize("bends", [[0.0, np.nan], [np.inf]])
def test_bends_that_are_no_numbers_are_refused(bends: list[float]) -> None:
    with pytest.raises(DataError, match="finite"):
        Rod(FOLDS, []).sweep(bends, LENGTH, CENTERS, SPANS)
