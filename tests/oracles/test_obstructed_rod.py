"""The studies' independent rod among obstacles: against closed forms, itself and the product's rod.

The two rods share no code: `thigmo.mechanics` follows a shooting method with exact derivatives, the
studies' rod differences of Runge-Kutta integrations. What both say of walls, friction, and of what
yields, rests on their agreement and on the cases that closed forms decide.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from thigmo.mechanics import Obstacle, Peg, Rod, Tube, Wall
from thigmo_bench.studies.obstructed import Mechanics, Obstacles, Sweeper, Swept

LENGTH, RADIUS, CRITICAL = 53.0, 1.75, 0.01108
COLUMN = np.array([5.0, 15.0, 25.0, 35.0, 45.0])
SPAN = 5.5
BENDS = np.arange(1e-3, 0.0241, 1e-3)  # 1/cm
PEGS = [Peg(34.0, 10.0, 0.6), Peg(43.855, 24.259, 0.6), Peg(45.0, 15.0, 1.5), Peg(20.0, 4.0, 1.0)]
COUNT = len(PEGS)
IDEAL = Mechanics.ideal(COUNT, length=LENGTH, radius=RADIUS, critical=CRITICAL)


def columns(obstacles: list[Peg]) -> Obstacles:
    return Obstacles.pegs(*np.array([[peg.x, peg.y, peg.radius] for peg in obstacles]).T)


def swept(mechanics: Mechanics, obstacles: Obstacles) -> Swept:
    rooms = obstacles.x.shape[0]
    return Sweeper(mechanics, obstacles).sweep(
        np.tile(BENDS[:, None], (1, rooms)), COLUMN, SPAN
    )  # fmt: skip


def disagreement(
    truth: Swept, obstacle: Callable[[int], Obstacle], tube: Tube, friction: float = 0.0
) -> np.ndarray:
    """(rooms, bends) largest difference of a reading from the product's rod, 1/cm."""
    off = []
    for room in range(truth.readings.shape[1]):
        rod = Rod(tube, [obstacle(room)], friction=friction)
        ours = rod.sweep(np.concatenate([[0.0], BENDS]), LENGTH, COLUMN, SPAN)
        off.append(np.abs(truth.readings[:, room] - ours.readings[1:]).max(axis=1))
    return np.array(off)


FOLDS = Tube(2 * RADIUS, CRITICAL)


@pytest.mark.parametrize(
    ("mechanics", "tube", "compliance", "share"),
    [
        (IDEAL, FOLDS, 0.0, 0.98),
        (replace(IDEAL, base_compliance=np.full(COUNT, 4.0)),
         replace(FOLDS, base_compliance_cm=4.0), 0.0, 0.98),
        (replace(IDEAL, rounding=np.full(COUNT, RADIUS)),
         replace(FOLDS, tip_rounding_cm=RADIUS), 0.0, 0.98),
        # One end jumps from its corner to its face or off the yielding peg: dynamics would decide.
        (IDEAL, FOLDS, 1000.0, 0.94),
    ],
    ids=["ideal", "base", "round tip", "yielding"],
)  # fmt: skip
def test_both_rods_agree_where_nothing_rubs(
    mechanics: Mechanics, tube: Tube, compliance: float, share: float
) -> None:
    pegs = columns(PEGS)
    truth = swept(mechanics, replace(pegs, compliance=pegs.compliance + compliance))
    assert not truth.ended.any()
    assert (truth.push[-1] > 0.0).sum() >= COUNT - 1
    off = disagreement(truth, lambda n: replace(PEGS[n], compliance=compliance), tube)
    # Where a touch begins or slips off between two bends, the rods may differ in that row.
    assert np.quantile(off, share) < 1e-7


def test_both_rods_agree_at_straight_walls() -> None:
    line = np.array([[45.0, 15.0, 0.1], [34.0, 10.0, 0.1], [40.0, 12.0, -0.1], [48.0, 16.0, 0.2]])
    x, y, angle = line.T[:, :, None]
    thickness = np.full_like(x, 0.3)
    truth = swept(IDEAL, Obstacles(x, y, thickness, angle, np.zeros_like(x)))
    assert np.all(truth.push[-1] > 0.0)

    def wall(room: int) -> Wall:
        (px, py, way), half = line[room], 25.0
        dx, dy = half * math.cos(way), half * math.sin(way)
        return Wall(px - dx, py - dy, px + dx, py + dy, 0.3)

    off = disagreement(truth, wall, FOLDS)
    assert np.quantile(off, 0.98) < 1e-7


def test_a_rubbing_body_slides_at_the_cone_and_never_leaves_it() -> None:
    friction = 0.3
    truth = swept(replace(IDEAL, friction=np.full(COUNT, friction)), columns(PEGS))
    touched = truth.push > 0.0
    cone = np.abs(truth.drag[touched]) / truth.push[touched]
    assert cone.max() <= friction * (1.0 + 1e-6)
    assert np.abs(truth.drag[-1]) == pytest.approx(friction * truth.push[-1])
    # The body slides on as it bends on, so friction is at its limit nearly always; ours has an
    # elastic slip of a millimetre before, which only the first rows after a touch can see.
    off = disagreement(truth, PEGS.__getitem__, FOLDS, friction)
    assert np.median(off) < 1e-7
    assert off.max() < 2e-4


def test_a_sticking_body_does_not_move_over_its_peg() -> None:
    """With friction beyond any need, the skin that touched first still touches."""
    truth = swept(replace(IDEAL, friction=np.full(COUNT, 50.0)), columns(PEGS))
    arc = truth.contacts[:, 0, 0, 0]
    heading = BENDS * arc  # of an almost free body
    rolled = PEGS[0].radius * np.nanmax(heading)
    assert np.nanmax(arc) - np.nanmin(arc) < rolled


def test_a_light_touch_is_a_cantilevers() -> None:
    """A peg a millimetre inside the free body: its force is 3 times the deflection over arc^3."""
    bend, arc, depth = 1e-4, 40.0, 0.05
    y = 0.5 * bend * arc**2 + RADIUS + 0.5 - depth
    peg = Obstacles.pegs(np.array([arc]), np.array([y]), np.array([0.5]))
    body = Mechanics.ideal(1, length=LENGTH, radius=RADIUS, critical=np.inf)
    truth = Sweeper(body, peg).sweep(np.array([[0.5 * bend], [bend]]), COLUMN, 0.0)
    assert truth.push[-1, 0, 0] == pytest.approx(3.0 * depth / arc**3, rel=2e-2)
    added = truth.readings[-1, 0] - bend
    expected = -truth.push[-1, 0, 0] * np.maximum(arc - COLUMN, 0.0)
    assert added == pytest.approx(expected, abs=1e-3 * np.abs(expected).max() + 1e-9)


def test_a_folded_base_carries_its_moment_and_no_more() -> None:
    truth = swept(IDEAL, columns(PEGS))
    folded = truth.fold != 0.0
    assert folded.any()
    assert np.abs(truth.base_moment[folded]) == pytest.approx(CRITICAL, rel=1e-6)
    assert np.abs(truth.base_moment).max() <= CRITICAL * (1.0 + 1e-6)
    assert np.all(truth.fold[folded] * truth.base_moment[folded] > 0.0)


def test_a_base_turns_by_its_compliance_and_a_peg_yields_by_its_own() -> None:
    giving = replace(IDEAL, base_compliance=np.full(COUNT, 4.0))
    truth = swept(giving, columns(PEGS))
    assert truth.base_turn == pytest.approx(4.0 * truth.base_moment)
    pegs = columns(PEGS)
    truth = swept(IDEAL, replace(pegs, compliance=pegs.compliance + 4000.0))
    for room, peg in enumerate(PEGS):
        x, y = truth.contacts[-1, room, 0, 1:]
        moved = math.hypot(x - peg.x, y - peg.y) - peg.radius
        if truth.push[-1, room, 0] > 0.0:
            assert moved == pytest.approx(-4000.0 * truth.push[-1, room, 0], rel=0.05) or moved > 0


@pytest.mark.parametrize("unknown", ["taper", "stiffness_wave", "bend_wave"])
def test_uneven_bodies_end_up_elsewhere(unknown: str) -> None:
    truth = swept(IDEAL, columns(PEGS))
    uneven = swept(replace(IDEAL, **{unknown: np.full(COUNT, 0.2)}), columns(PEGS))
    assert np.nanmax(np.abs(truth.readings - uneven.readings)) > 1e-4


def test_what_is_uneven_stays_where_it_is_as_the_body_grows() -> None:
    share = np.full(COUNT, 0.2)
    whole = replace(IDEAL, taper=share, stiffness_wave=share, bend_wave=share, phase=np.arange(4.0))
    arc, shorter = np.full(COUNT, 0.6 * LENGTH), replace(whole, length=0.8 * LENGTH)
    assert shorter.stiffness(arc) == pytest.approx(whole.stiffness(arc))
    assert shorter.evenness(arc) == pytest.approx(whole.evenness(arc))


def test_an_uneven_body_has_the_mean_bend_of_its_muscle() -> None:
    uneven = replace(IDEAL, bend_wave=np.full(COUNT, 0.2), phase=np.arange(4.0))
    nothing = Obstacles.pegs(*np.full((3, COUNT), np.nan))
    truth = Sweeper(uneven, nothing).sweep(
        np.tile(BENDS[:, None], (1, COUNT)), np.array([LENGTH / 2]), LENGTH
    )
    assert truth.readings[..., 0] == pytest.approx(np.tile(BENDS[:, None], (1, COUNT)), rel=1e-5)
