"""The rod that is curved at rest, against circles, a straight rod, and the balance of moments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rod_oracles import moment_imbalance

from thigmo.errors import DataError
from thigmo.mechanics import Peg, Rod, Solution, Tube, Wall, push, rest_mean, rest_turn, solve

LENGTH = 53.0
BENT = Tube(3.5, None, rest_curvature=((8.0, 0.0), (29.7, 0.025), (46.0, -0.03)))
CENTERS = np.array([5.0, 15.0, 25.0, 35.0, 45.0])


def traced_error_cm(solution: Solution) -> float:
    """Largest distance between the nodes and the line that their headings trace."""
    arcs = np.linspace(0.0, solution.length, 20_001)
    poses = np.array([solution.pose(float(arc)) for arc in arcs])
    middle = (poses[1:, 2] + poses[:-1, 2]) / 2
    x = np.concatenate([[0.0], np.cumsum(np.cos(middle))]) * arcs[1]
    y = np.concatenate([[0.0], np.cumsum(np.sin(middle))]) * arcs[1]
    return float(np.hypot(x - poses[:, 0], y - poses[:, 1]).max())


def turn_error_rad(solution: Solution) -> float:
    """Largest difference between the nodes' headings and the sum of all bends before them."""
    bends = solution.curvature
    turned = np.concatenate([[0.0], np.cumsum((bends[1:] + bends[:-1]) / 2 * np.diff(solution.s))])
    expected = turned + rest_turn(solution.tube.rest_curvature, solution.s)
    return float(np.abs(solution.heading - expected).max())


@pytest.mark.parametrize("model", ["arc", "auto", "elastica"])
@pytest.mark.parametrize("g", [-0.02, 0.0, 0.03])
def test_a_free_body_is_a_chain_of_circles(g: float, model: str) -> None:
    rod = Rod(BENT, model=model)  # type: ignore[arg-type]
    rod.step(g, LENGTH)
    place, heading, start = 0.0 + 0.0j, 0.0, 0.0
    for end, curvature in (*BENT.rest_curvature, (LENGTH, 0.0)):
        bend = curvature + g
        turn = bend * (end - start)
        step = (np.exp(1j * turn) - 1.0) / (1j * bend) if bend else end - start
        place += np.exp(1j * heading) * step
        heading, start = heading + turn, end
    assert rod.pose(LENGTH) == pytest.approx((place.real, place.imag, heading), abs=2e-6)
    expected = g + rest_mean(BENT.rest_curvature, CENTERS, np.full(5, 5.5))
    assert rod.solution().averages(CENTERS, 5.5) == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("critical", [None, 0.01108])
def test_one_bend_of_the_whole_body_is_a_free_curvature(
    critical: float | None, friction: float
) -> None:
    pegs = [Peg(34.0, 22.0, 1.5), Wall(20.0, 30.0, 30.0, 40.0, 0.5)]
    bent = Rod(Tube(3.5, critical, rest_curvature=((60.0, 0.02),)), pegs, friction=friction)
    straight = Rod(Tube(3.5, critical), pegs, friction=friction)
    straight.step(0.02, LENGTH)
    bent.step(0.0, LENGTH)
    for g in np.arange(0.001, 0.02, 0.001).tolist():
        bent.step(g, LENGTH)
        straight.step(0.02 + g, LENGTH)
    assert bent.touching
    assert bent.pose(LENGTH) == pytest.approx(straight.pose(LENGTH), abs=1e-6)
    assert bent.base_moment == pytest.approx(straight.base_moment, abs=1e-8)


@given(
    st.floats(-8e-4, 8e-4),
    st.floats(5.0, 52.0),
    st.floats(-0.02, 0.02),
    st.lists(st.floats(-0.04, 0.04), min_size=1, max_size=4),
)
def test_moments_balance_and_headings_are_the_sum_of_all_bends(
    force: float, arc: float, g: float, bends: list[float]
) -> None:
    ends = np.linspace(0.0, LENGTH, len(bends) + 1)[1:].tolist()
    tube = Tube(3.5, rest_curvature=tuple(zip(ends, bends, strict=True)))
    solution = push(force, arc, free_curvature=g, length=LENGTH, tube=tube)
    assert moment_imbalance(solution) < 1e-8
    assert turn_error_rad(solution) < 2e-4  # of the trapezoidal rule on cells of 1 cm


def test_a_body_that_is_pushed_lies_where_its_headings_trace() -> None:
    solution = push(-6e-4, 48.0, free_curvature=0.01, length=LENGTH, tube=BENT)
    assert traced_error_cm(solution) < 1e-4
    finer = push(-6e-4, 48.0, free_curvature=0.01, length=LENGTH, tube=BENT, cell_cm=0.1)
    assert solution.tip == pytest.approx(finer.tip, abs=1e-5)


def test_a_peg_in_the_way_of_the_body_at_rest_pushes_it_aside() -> None:
    """It overlaps the peg by 2 cm, twice as much as Newton takes: the descent in energy begins."""
    free = solve(0.0, LENGTH, tube=BENT)
    x, y, heading = free.pose(40.0)
    peg = Peg(x - 1.2 * np.sin(heading), y + 1.2 * np.cos(heading), 1.5)
    rod = Rod(BENT, [peg])
    rod.step(0.0, LENGTH)
    solution = rod.solution()
    (contact,) = solution.contacts
    assert contact.normal < 0.0  # to the right, away from the peg on its left
    assert abs(solution.locate(peg)[0]) < 1e-6
    assert moment_imbalance(solution) < 1e-8
    assert turn_error_rad(solution) < 2e-4


@pytest.mark.parametrize(
    "pieces", [((10.0, 0.01), (10.0, 0.02)), ((-1.0, 0.01),), ((10.0, np.nan),)]
)
def test_pieces_that_do_not_follow_each_other_are_refused(
    pieces: tuple[tuple[float, float], ...],
) -> None:
    with pytest.raises(DataError, match="ascend"):
        Rod(replace(BENT, rest_curvature=pieces))


def test_the_beam_does_not_stand_for_a_body_that_is_curved_at_rest() -> None:
    with pytest.raises(DataError, match="straight at rest"):
        Rod(BENT, model="beam")
    x, y, heading = solve(0.0, LENGTH, tube=BENT).pose(50.0)
    near = Peg(x - 2.3 * np.sin(heading), y + 2.3 * np.cos(heading), 0.5)
    rod = Rod(BENT, [near], model="auto", tolerance_cm=100.0)
    for g in np.linspace(0.0, 0.004, 9).tolist():
        rod.step(g, LENGTH)
    assert rod.touching
    assert set(rod.counts) == {"arc", "elastica"}
