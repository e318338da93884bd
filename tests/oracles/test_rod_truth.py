"""The studies' rod against collocation, a beam, and itself; pegs stand where bodies meet them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from thigmo_bench.studies.pegs import press, rooms
from thigmo_bench.studies.rod import readings, solve
from thigmo_bench.studies.scenes import CRITICAL, RADIUS

LENGTH = 53.0
COLUMN = np.array([5.0, 15.0, 25.0, 35.0, 45.0])


def test_two_loads_agree_with_collocation_from_the_base() -> None:
    """Every kind of load at once; solved again as a boundary value problem in the room's frame."""
    arcs, normal, along, couple = (20.0, 44.0), (4e-4, -5e-4), (-3e-4, 2e-4), (1e-3, -2e-3)
    free = 0.03

    def stiffness(arc):
        return 1.0 + 0.3 * np.sin(0.1 * arc)

    row = np.array([arcs])
    body = solve(
        row,
        np.array([normal]),
        length=LENGTH,
        free_curvature=free,
        tangential=np.array([along]),
        couple=np.array([couple]),
        stiffness=stiffness,
    )

    # Heading and moment of both pieces, side by side over a common 0..1.
    widths = (arcs[0], arcs[1] - arcs[0])

    def force(j, heading):
        return (
            along[j] * np.cos(heading) - normal[j] * np.sin(heading),
            along[j] * np.sin(heading) + normal[j] * np.cos(heading),
        )

    def slope(t, state, ends):
        """`ends`: heading where each load acts."""
        outer = force(1, ends[1])
        inner = tuple(a + b for a, b in zip(force(0, ends[0]), outer, strict=True))
        out = []
        for piece, (x, y) in enumerate((inner, outer)):
            heading, moment = state[2 * piece : 2 * piece + 2]
            arc = (0.0, arcs[0])[piece] + widths[piece] * t
            out += [
                widths[piece] * (free + moment / stiffness(arc)),
                widths[piece] * (np.sin(heading) * x - np.cos(heading) * y),
            ]
        return np.stack(out)

    def ends(near, far, ends):
        return np.array(
            [
                near[0],
                far[0] - near[2],
                far[1] - near[3] - couple[0],
                far[3] - couple[1],
                far[0] - ends[0],
                far[2] - ends[1],
            ]
        )

    grid = np.linspace(0.0, 1.0, 60)
    guess = np.zeros((4, grid.size))
    guess[0], guess[2] = 0.6 * grid, 0.6 + 0.7 * grid
    solved = solve_bvp(slope, ends, grid, guess, p=[0.6, 1.3], tol=1e-9, max_nodes=20000)
    assert solved.success
    assert body.base_moment[0] == pytest.approx(solved.y[1, 0], abs=1e-8)
    half = 2.75
    low, high = (solved.sol((COLUMN[:2] + d) / widths[0])[0] for d in (-half, half))
    assert body.readings(COLUMN[:2], 2 * half)[0, :1] == pytest.approx(
        (high - low)[:1] / (2 * half), abs=1e-8
    )
    assert -body.base[0, 0] == pytest.approx(solved.p[1], abs=1e-7)


def test_loads_on_top_of_each_other_add_and_bodies_do_not_mix() -> None:
    arcs = np.array([[30.0, 30.0], [12.0, 41.0]])
    normal = np.array([[2e-4, 1e-4], [-3e-4, 2e-4]])
    free = np.array([[0.02], [-0.01]])
    both = solve(arcs, normal, length=LENGTH, free_curvature=free).readings(COLUMN, 5.5)
    once = readings(
        np.array([30.0]), np.array([3e-4]), COLUMN, length=LENGTH, span=5.5, free_curvature=0.02
    )
    alone = readings(arcs[1], normal[1], COLUMN, length=LENGTH, span=5.5, free_curvature=-0.01)
    assert both == pytest.approx(np.stack([once, alone]), abs=1e-8)


def test_a_kink_is_seen_by_the_sensor_over_it_only() -> None:
    arcs, nothing = np.array([[16.0, 40.0]]), np.array([[0.0, 1e-4]])
    kinked = solve(arcs, nothing, length=LENGTH, kink=np.array([0.5, 0.0]))
    plain = solve(arcs, nothing, length=LENGTH)
    kink = kinked.readings(COLUMN, 5.5) - plain.readings(COLUMN, 5.5)
    assert kink[0, 1] == pytest.approx(0.5 / 5.5, rel=1e-2)
    assert np.abs(kink[0, 2:]).max() < 1e-8  # the kink turns what is distal of it as a whole
    points = kinked.readings(COLUMN)[0] - kinked.readings(COLUMN, 1e-2)[0]
    assert np.abs(points).max() < 1e-6


def test_a_fold_adds_its_angle_to_the_base() -> None:
    # A sensor over the whole body reads the turn of its end.
    arcs, normal, middle = np.array([3.5, 40.0]), np.array([0.0, 2e-5]), np.array([LENGTH / 2])
    folded, straight = (
        readings(arcs, normal, middle, LENGTH, length=LENGTH, free_curvature=np.array(free))
        for free in ([0.2 / 3.5, 0.0, 0.0], [0.0, 0.0, 0.0])
    )
    assert LENGTH * (folded - straight)[0] == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize("part", ["side", "corner", "anywhere"])
def test_pegs_stand_still_while_bodies_inflate_against_them(part) -> None:
    judged = rooms(
        np.random.default_rng(5), 12, length=LENGTH, largest_free=0.04, frames=4, part=part
    )
    assert judged.peg.shape == (2, 12)
    for frame in range(4):
        felt = np.isfinite(judged.u[frame])
        _, place = press(
            judged.u[frame, felt],
            judged.push[frame, felt],
            judged.free[frame, felt],
            judged.peg_radius[felt],
            LENGTH,
        )
        assert place == pytest.approx(judged.peg[:, felt], abs=1e-5)
    assert np.all(judged.push[-1] > 0.0)
    share = np.abs(judged.bodies(-1).base_moment) / CRITICAL
    assert np.all((share > 0.05) & (share < 1.0))
    if part == "side":
        assert np.all(judged.u[-1] <= LENGTH)
    if part == "corner":
        assert np.all(judged.arc[-1] == LENGTH)


def test_pegs_keep_off_the_body_that_does_not_touch_them_yet() -> None:
    judged = rooms(np.random.default_rng(6), 12, length=LENGTH, largest_free=0.04, frames=4)
    arcs = np.linspace(0.0, LENGTH, 2000)
    beside = 0
    for frame in range(4):
        away = np.isnan(judged.u[frame])
        for free, peg, radius in zip(
            judged.free[frame, away], judged.peg[:, away].T, judged.peg_radius[away], strict=True
        ):
            line = np.stack([np.sin(free * arcs), 1.0 - np.cos(free * arcs)]) / free
            distance = np.hypot(*(line - peg[:, None]))
            # Round the end the centreline comes closer than the skin.
            if distance.argmin() < len(arcs) - 1:
                beside += 1
                assert distance.min() > radius + RADIUS - 1e-3
    assert beside > 5
