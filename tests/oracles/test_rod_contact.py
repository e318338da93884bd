"""The rod among pegs: inequalities hold, the fold yields, and nothing hangs."""

from __future__ import annotations

from math import hypot

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rod_oracles import carried_moment, lagrangian, moment_imbalance

from thigmo.errors import DataError
from thigmo.mechanics import Peg, Rod, Solution, Tube, fold_share, solve

CENTERS = np.array([5.0, 15.0, 25.0, 35.0, 45.0])


def distance_to_skin(solution: Solution, peg: Peg) -> float:
    """Gap of a peg by brute force: least distance to points all over the skin."""
    radius = solution.tube.radius_cm
    least = np.inf
    for arc in np.linspace(0.0, solution.length, 4000):
        x, y, heading = solution.pose(float(arc))
        for side in (-1, 1):
            px = x - side * radius * np.sin(heading)
            py = y + side * radius * np.cos(heading)
            least = min(least, hypot(px - peg.x, py - peg.y))
    x, y, heading = solution.tip
    for across in np.linspace(-radius, radius, 400):
        px, py = x - across * np.sin(heading), y + across * np.cos(heading)
        least = min(least, hypot(px - peg.x, py - peg.y))
    return float(least) - peg.radius


@pytest.mark.parametrize(
    ("peg", "g", "kind"),
    [
        (Peg(34.0, 10.0, 0.6), 0.03, "side"),
        (Peg(34.0, -10.0, 0.6), -0.03, "side"),
        (Peg(43.855, 24.259, 0.6), 0.019, "corner"),
        (Peg(43.855, -24.259, 0.6), -0.019, "corner"),
        (Peg(43.855, 24.259, 0.6), 0.028, "face"),
    ],
)
def test_contact_touches_where_it_says(peg: Peg, g: float, kind: str) -> None:
    solution = solve(g, 53.0, pegs=[peg])
    (contact,) = solution.contacts
    assert contact.kind == kind
    assert distance_to_skin(solution, peg) == pytest.approx(0.0, abs=1e-4)
    assert hypot(contact.x - peg.x, contact.y - peg.y) == pytest.approx(peg.radius, abs=1e-7)
    # The force points from the peg's centre to the contact: it pushes, and without friction.
    out = np.array([contact.x - peg.x, contact.y - peg.y])
    force = np.array([contact.force_x, contact.force_y])
    assert float(force @ out) == pytest.approx(peg.radius * float(np.hypot(*force)), rel=1e-7)
    if kind == "side":
        assert contact.tangential == 0.0
        assert np.sign(contact.normal) == -np.sign(peg.y)
    else:
        assert contact.arc == 53.0
        assert contact.tangential < 0.0
    if kind == "corner":
        lever = abs(contact.couple / contact.tangential)
        assert lever == pytest.approx(1.75)


@given(
    places=st.lists(
        st.tuples(st.floats(4.0, 56.0), st.floats(2.0, 30.0), st.booleans(), st.floats(0.1, 2.0)),
        min_size=1,
        max_size=4,
    ),
    g=st.floats(-0.05, 0.05),
    length=st.floats(9.0, 53.0),
    critical=st.sampled_from([None, 0.005, 0.01108, 0.033]),
)
def test_any_room_gives_a_body_that_overlaps_nothing(
    places: list[tuple[float, float, bool, float]],
    g: float,
    length: float,
    critical: float | None,
) -> None:
    pegs = [Peg(x, (1.75 + r + y) * (1 if up else -1), r) for x, y, up, r in places]
    rod = Rod(Tube(3.5, critical), pegs)
    rod.step(0.0, length)
    for u in (0.5, 1.0, 0.3, 0.0):
        rod.step(g * u, length)
        solution = rod.solution()
        assert np.isfinite(solution.x).all()
        assert np.isfinite(solution.curvature).all()
        assert solution.status != "approximate"
        touching = {contact.peg for contact in solution.contacts}
        for index, peg in enumerate(pegs):
            assert solution.locate(peg)[0] > -1e-6
            assert index not in touching or solution.locate(peg)[0] < 1e-6
        assert moment_imbalance(solution) < 1e-8
        last = max((contact.arc for contact in solution.contacts), default=0.0)
        assert np.abs(carried_moment(solution)[solution.s > last + 1e-9]).max(initial=0.0) < 1e-9
        for contact in solution.contacts:
            out = (contact.x - pegs[contact.peg].x, contact.y - pegs[contact.peg].y)
            assert contact.force_x * out[0] + contact.force_y * out[1] >= -1e-12  # never pulls
        if critical is not None:
            assert abs(solution.base_moment) <= critical * (1 + 1e-6)
            if solution.fold_angle:
                assert abs(solution.base_moment) == pytest.approx(critical, rel=1e-6)
                assert solution.fold_angle * solution.base_moment > 0


@given(x=st.floats(3.0, 52.0), y=st.floats(-2.0, 2.0), radius=st.floats(0.3, 1.5))
def test_peg_inside_the_straight_body_is_pushed_out(x: float, y: float, radius: float) -> None:
    solution = solve(0.01, 53.0, pegs=[Peg(x, y, radius)])
    assert np.isfinite(solution.x).all()
    # A peg beside the clamped base cannot be cleared by more than bending allows.
    if x > 12.0:
        assert solution.locate(Peg(x, y, radius))[0] > -1e-2


def test_two_opposed_pegs_press_from_both_sides() -> None:
    pegs = [Peg(45.0, 9.0, 0.6), Peg(20.0, -2.5, 0.6)]
    solution = solve(0.035, 53.0, pegs=pegs)
    assert [c.peg for c in solution.contacts] == [1, 0]
    assert solution.contacts[0].normal > 0 > solution.contacts[1].normal


def test_body_between_pegs_has_the_least_energy() -> None:
    pegs = [Peg(45.0, 9.0, 0.6), Peg(20.0, -2.5, 0.6)]
    solution = solve(0.035, 53.0, pegs=pegs)
    assert len(solution.contacts) == 2
    arcs = np.linspace(0.0, 53.0, 10601)
    rest = lagrangian(solution, pegs, arcs, np.zeros(arcs.size))
    for wave in range(1, 9):
        turn = 1e-3 * np.sin((wave - 0.5) * np.pi * arcs / 53.0)
        up, down = (lagrangian(solution, pegs, arcs, sign * turn) for sign in (1, -1))
        assert up + down - 2 * rest > 0.0
        assert abs(up - down) < 0.1 * (up + down - 2 * rest)


def test_base_folds_at_the_critical_moment_and_stays_there() -> None:
    critical, peg = 0.01108, Peg(45.0, 12.0, 0.6)
    rod = Rod(Tube(3.5, critical), [peg])
    rod.step(0.0, 53.0)
    moments, folds = [], []
    for g in np.linspace(0.0, 0.03, 61):
        rod.step(g, 53.0)
        moments.append(abs(rod.base_moment))
        folds.append(abs(rod.fold_angle))
    folded = np.array(folds) > 0
    assert folded.any()
    assert not folded[: int(np.argmax(folded))].any()
    assert np.array(moments)[folded] == pytest.approx(critical, rel=1e-9)
    assert np.all(np.diff(np.array(folds)[folded]) > 0)


def test_fold_is_spread_over_one_diameter_in_shape_and_sensors() -> None:
    rod = Rod(Tube(3.5, 0.01108), [Peg(45.0, 12.0, 0.6)])
    rod.step(0.0, 53.0)
    rod.step(0.028, 53.0)
    solution = rod.solution()
    psi = solution.fold_angle
    assert psi < 0
    base = solution.averages([5.0], 5.5)[0]
    smooth = np.interp(np.linspace(2.25, 7.75, 2001), solution.s, solution.curvature).mean()
    assert base - smooth == pytest.approx(psi * fold_share([5.0], 5.5, 3.5)[0], abs=2e-7)
    assert fold_share([5.0], 5.5, 3.5)[0] == pytest.approx(1.25 / 5.5 / 3.5)
    turn = solution.pose(3.5)[2] - np.trapezoid(
        np.interp(np.linspace(0, 3.5, 500), solution.s, solution.curvature),
        np.linspace(0, 3.5, 500),
    )
    assert turn == pytest.approx(psi, abs=1e-5)


def test_tip_that_slips_off_its_peg_snaps_free() -> None:
    rod = Rod(Tube(3.5, 0.01108), [Peg(46.0, 12.0, 0.6)])
    rod.step(0.0, 48.0)
    touched = False
    for g in np.linspace(0.0, 0.06, 241):
        rod.step(g, 48.0)
        touched |= rod.touching > 0
    solution = rod.solution()
    assert touched
    assert not solution.contacts
    assert solution.averages(CENTERS[:4], 5.5) == pytest.approx(np.full(4, 0.06), abs=1e-9)


def test_body_leaves_its_peg_when_it_bends_back() -> None:
    rod = Rod(Tube(3.5, 0.01108), [Peg(40.0, 9.0, 0.6)])
    rod.step(0.0, 53.0)
    for g in (0.03, 0.0, -0.02):
        rod.step(g, 53.0)
    solution = rod.solution()
    assert not solution.contacts
    assert solution.fold_angle == 0.0
    assert solution.averages(CENTERS, 5.5) == pytest.approx(np.full(5, -0.02), abs=1e-9)


def test_history_decides_on_which_side_of_a_peg_the_body_lies() -> None:
    peg = Peg(35.0, 8.0, 0.6)
    rod = Rod(Tube(), [peg])
    rod.step(0.0, 30.0)
    rod.step(0.03, 30.0)  # curls up short of the peg
    rod.step(0.03, 53.0)  # then grows beside it
    above = rod.solution()
    below = solve(0.03, 53.0, pegs=[peg])
    assert above.locate(peg)[0] > -1e-6
    assert below.contacts[0].normal < 0
    assert not any(c.normal < 0 for c in above.contacts)


def test_growth_keeps_contacts_where_they_are_in_the_room() -> None:
    rod = Rod(Tube(), [Peg(25.0, 7.0, 0.6)])
    rod.step(0.0, 40.0)
    rod.step(0.03, 40.0)
    before = rod.solution()
    for length in np.arange(40.0, 53.0, 0.1):
        rod.step(0.03, float(length))
    after = rod.solution()
    assert len(before.contacts) == len(after.contacts) == 1
    assert after.contacts[0].arc == pytest.approx(before.contacts[0].arc, abs=1e-8)
    assert after.contacts[0].normal == pytest.approx(before.contacts[0].normal, rel=1e-8)


@pytest.mark.parametrize("offset", [0.0, 1e-6, 0.3, -1.2])
def test_growing_into_a_peg_ahead_bends_the_body_aside(offset: float) -> None:
    peg = Peg(34.0, offset, 0.8)
    rod = Rod(Tube(3.5, 0.01108), [peg])
    for length in np.arange(20.0, 42.0, 0.1):
        rod.step(0.0, float(length))
        assert rod.axial_push() < 0.05
    solution = rod.solution()
    assert solution.locate(peg)[0] > -1e-3
    assert abs(solution.tip[1]) > 0.1


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_contact_slides_from_the_side_over_the_corner_onto_the_face(side: float) -> None:
    # The peg goes round the end of a body that lies straight, always deep enough to be touched.
    length, tube, radius, deep = 53.0, 1.75, 0.6, 0.01
    quarter = np.linspace(0.0, np.pi / 2, 16)
    away = radius - deep
    path = [
        *((x, tube + away) for x in np.linspace(length - 2.0, length, 12)),
        *((length + away * np.sin(b), tube + away * np.cos(b)) for b in quarter),
        *((length + away, y) for y in np.linspace(tube, 0.2, 12)),
    ]
    kinds, before = [], None
    for x, y in path:
        (contact,) = solve(0.0, length, pegs=[Peg(float(x), side * float(y), radius)]).contacts
        kinds.append(contact.kind)
        point = np.array([contact.x, contact.y])
        if before is not None:
            assert np.hypot(*(point - before)) < 0.3
        before = point
    assert list(dict.fromkeys(kinds)) == ["side", "corner", "face"]


@given(
    x=st.floats(10.0, 50.0),
    y=st.floats(2.5, 12.0),
    g=st.floats(0.0005, 0.012),
    tolerance=st.sampled_from([0.02, 0.1, 0.5]),
)
def test_automatic_choice_keeps_its_error_bound(
    x: float, y: float, g: float, tolerance: float
) -> None:
    peg = Peg(x, -y, 0.6)
    bodies = [
        Rod(Tube(3.5, 0.01108), [peg], model=model, tolerance_cm=tolerance)
        for model in ("auto", "elastica")
    ]
    for body in bodies:
        body.step(0.0, 53.0)
        for u in np.linspace(0.0, 1.0, 9)[1:]:
            body.step(-g * u, 53.0)
    auto, exact = bodies
    for arc in np.linspace(5.0, 53.0, 9):
        a, b = auto.pose(float(arc)), exact.pose(float(arc))
        error = hypot(a[0] - b[0], a[1] - b[1])
        assert error <= auto.error_bound_cm + 1e-4
        assert error <= tolerance + 1e-4
    assert auto.counts["arc"] >= 1
    assert (auto.model == "beam") <= (auto.error_bound_cm <= tolerance)


def test_overridden_choice_is_obeyed() -> None:
    for model in ("arc", "beam", "elastica"):
        body = Rod(Tube(), [Peg(30.0, -4.0, 0.6)], model=model)
        body.step(0.0, 53.0)
        body.step(-0.01, 53.0)
        assert set(body.counts) == {model}
        assert (body.touching == 0) == (model == "arc")


@pytest.mark.parametrize("friction", [0.1, 0.6])
def test_friction_drags_what_slides_and_never_more_than_its_share(friction: float) -> None:
    """A bending body's skin slides towards its base over a peg, and friction pulls it back."""
    rod = Rod(Tube(3.5, None), [Peg(30.0, 10.0, 0.6)], friction=friction)
    shares: list[float] = []
    for curvature in np.linspace(0.0, 0.03, 61):
        rod.step(float(curvature), 50.0)
        shares += [contact.tangential / abs(contact.normal) for contact in rod.contacts()]
    assert max(map(abs, shares)) <= friction + 1e-9
    # It slides; what the body rolled over the peg in the last step is not yet slid back.
    assert 0.95 * friction < shares[-1] <= friction
    smooth = Rod(Tube(3.5, None), [Peg(30.0, 10.0, 0.6)])
    for curvature in np.linspace(0.0, 0.03, 61):
        smooth.step(float(curvature), 50.0)
    assert smooth.contacts()[0].tangential == 0.0
    assert smooth.contacts()[0].arc > rod.contacts()[0].arc  # it slid further


def test_a_friction_that_cannot_be_is_refused() -> None:
    with pytest.raises(DataError, match="friction must lie between 0 and 2"):
        Rod(Tube(), [], friction=-0.1)
