"""The large-deflection rod against solutions that others found, and against itself."""

from __future__ import annotations

from math import cos, sin

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from rod_oracles import bending_energy, moment_imbalance
from scipy.integrate import quad

from thigmo.errors import DataError
from thigmo.mechanics import Peg, Tube, peg_for, push, solve
from thigmo_bench.studies import rod

CENTERS = np.array([5.0, 15.0, 25.0, 35.0, 45.0])


@pytest.mark.parametrize("turn", [0.2, 0.8, 1.5, 2.5])
def test_cantilever_under_a_force_across_its_tip_agrees_with_its_integrals(turn: float) -> None:
    """Of the angle from the tip: curvature^2 = 2 f sin(angle), so arc and reach are integrals."""
    length = 53.0
    # The substitution angle = v^2 takes the root out of the integrand.
    arc = quad(lambda v: 2.0 * v / np.sqrt(2.0 * np.sin(v * v)), 0.0, np.sqrt(turn))[0]
    force = (arc / length) ** 2
    solution = push(force, length, free_curvature=0.0, length=length)
    x, y, heading = solution.tip
    assert heading == pytest.approx(turn, abs=1e-6)
    # The base's lever, along the tip, and so its moment.
    assert x * cos(heading) + y * sin(heading) == pytest.approx(
        np.sqrt(2.0 * np.sin(turn) / force), abs=1e-4
    )
    assert moment_imbalance(solution) < 1e-9


@pytest.mark.parametrize("g", [-0.05, -1e-7, 0.0, 0.02, 0.11])
def test_free_body_is_a_circle(g: float) -> None:
    solution = solve(g, 53.0)
    turn = g * 53.0
    x = sin(turn) / g if g else 53.0
    y = (1 - cos(turn)) / g if g else 0.0
    assert solution.tip == pytest.approx((x, y, turn), abs=2e-6)
    assert solution.averages(CENTERS, 5.5) == pytest.approx(np.full(5, g), abs=1e-12)


def test_small_following_force_agrees_with_the_linear_beam() -> None:
    f, a, length = 1e-7, 40.0, 53.0
    solution = push(f, a, free_curvature=0.0, length=length)
    linear = f * np.clip(a - CENTERS, 0, None)
    assert solution.averages(CENTERS[:3], 5.5) == pytest.approx(linear[:3], rel=1e-8)
    assert solution.tip[1] == pytest.approx(f * a**2 * (3 * length - a) / 6, rel=1e-7)


def test_error_falls_with_the_fourth_power_of_the_mesh_width() -> None:
    tips = [
        np.array(push(-8e-4, 50.0, free_curvature=0.04, length=53.0, cell_cm=53 / n).tip)
        for n in (12, 24, 48, 384)
    ]
    coarse, middle, fine = (float(np.abs(tip - tips[-1]).max()) for tip in tips[:3])
    assert coarse / middle > 12
    assert middle / fine > 12
    assert fine < 1e-5


@given(
    arcs=st.lists(st.floats(4.0, 53.0), min_size=1, max_size=3, unique=True),
    g=st.floats(-0.04, 0.04),
    data=st.data(),
)
def test_pushed_body_agrees_with_an_independent_integration(
    arcs: list[float], g: float, data: st.DataObject
) -> None:
    forces = [data.draw(st.floats(-0.02, 0.02)) / arc for arc in arcs]
    solution = push(forces, arcs, free_curvature=g, length=53.0)
    other = rod.readings(
        np.array(arcs), np.array(forces), CENTERS, length=53.0, span=5.5, free_curvature=g
    )
    assert solution.averages(CENTERS, 5.5) == pytest.approx(other, abs=3e-8)


@given(arc=st.floats(12.0, 52.9), share=st.floats(0.01, 1.0), g=st.floats(0.003, 0.03))
def test_peg_that_pushes_is_found_again_by_solving(arc: float, share: float, g: float) -> None:
    # Pushing against the bend, as a robot that runs into a peg does.
    force = -share * g / arc
    direct = push(force, arc, free_curvature=g, length=53.0)
    peg = peg_for(direct.contacts[0], 0.6)
    assert abs(direct.locate(peg)[0]) < 1e-7
    assume(peg.y > 1.75 + 0.6)  # else the straight body lies on it or on its other side
    solution = solve(g, 53.0, pegs=[peg])
    (contact,) = solution.contacts
    assert contact.arc == pytest.approx(arc, abs=1e-6)
    assert contact.normal == pytest.approx(force, rel=1e-6, abs=1e-8)


def test_work_of_a_moving_peg_is_the_energy_gained() -> None:
    # Side, corner and face of the tip: the force is the gradient of the energy in each.
    length = 53.0
    for peg, g in (
        (Peg(34.0, 10.0, 0.6), 0.03),
        (Peg(43.855, 24.259, 0.6), 0.019),
        (Peg(43.855, 24.259, 0.6), 0.028),
    ):
        energies = []
        kinds = set()
        for dx in (-1e-3, 0.0, 1e-3):
            solution = solve(g, length, pegs=[Peg(peg.x + dx, peg.y, peg.radius)], cell_cm=0.5)
            energies.append(bending_energy(solution))
            contact = solution.contacts[0]
            kinds.add(contact.kind)
            if dx == 0.0:
                force_x = contact.force_x
        assert len(kinds) == 1
        assert (energies[2] - energies[0]) / 2e-3 == pytest.approx(force_x, rel=2e-4)


@given(
    x=st.floats(10.0, 50.0),
    y=st.floats(4.0, 25.0),
    g=st.floats(0.005, 0.04),
    fold=st.booleans(),
)
def test_mirrored_room_gives_the_mirrored_body(x: float, y: float, g: float, fold: bool) -> None:
    tube = Tube(3.5, 0.01108 if fold else None)
    left = solve(g, 53.0, tube=tube, pegs=[Peg(x, y, 0.8)])
    right = solve(-g, 53.0, tube=tube, pegs=[Peg(x, -y, 0.8)])
    assert left.tip == pytest.approx((right.tip[0], -right.tip[1], -right.tip[2]), abs=1e-6)
    assert left.averages(CENTERS, 5.5) == pytest.approx(-right.averages(CENTERS, 5.5), abs=1e-8)
    assert [c.normal for c in left.contacts] == pytest.approx(
        [-c.normal for c in right.contacts], abs=1e-9
    )


def test_bad_input_is_refused() -> None:
    with pytest.raises(DataError):
        solve(float("nan"), 53.0)
    with pytest.raises(DataError):
        solve(0.01, 0.0)
    with pytest.raises(DataError):
        solve(0.01, 53.0, pegs=[Peg(10, 5, 0.0)])
    with pytest.raises(DataError):
        push(1e-4, 60.0, free_curvature=0.0, length=53.0)
