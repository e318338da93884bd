"""Spans, fold and the small-deflection beam against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from thigmo.mechanics import Peg, Rod, Tube, critical_moment, phi, solve


@given(arc=st.floats(0.0, 60.0), center=st.floats(3.0, 50.0), span=st.floats(0.01, 6.0))
def test_phi_is_the_mean_lever_over_the_span(arc: float, center: float, span: float) -> None:
    low, high = center - span / 2, center + span / 2
    mean = quad(lambda s: max(arc - s, 0.0), low, high, points=[min(max(arc, low), high)])[0] / span
    assert float(phi(arc, center, span)) == pytest.approx(mean, abs=1e-7)


def test_phi_without_span_is_the_lever_and_arguments_broadcast() -> None:
    levers = phi(np.array([[10.0], [30.0]]), np.array([5.0, 15.0, 45.0]), 0.0)
    assert levers.tolist() == [[5.0, 0.0, 0.0], [25.0, 15.0, 0.0]]


def test_critical_moment_scales_with_body_pressure() -> None:
    assert critical_moment(0.01108, 0.49, 0.49) == 0.01108
    assert critical_moment(0.01108, 0.49, 1.47) == pytest.approx(3 * 0.01108)


def beam(pegs: list[Peg], g: float, critical: float | None = None) -> Rod:
    body = Rod(Tube(3.5, critical), pegs, model="beam")
    body.step(g, 53.0)
    return body


def test_beam_against_one_peg_is_the_textbook_prop() -> None:
    # Propped cantilever: the prop takes back g a^2 / 2 - c over the compliance a^3 / 3.
    body = beam([Peg(40.0, -4.0, 0.6)], -0.004)
    level = -4.0 + 1.75 + 0.6
    force = (level + 0.004 * 40**2 / 2) / (40**3 / 3)
    (contact,) = body.contacts()
    assert contact.normal == pytest.approx(force)
    assert contact.arc == 40.0
    assert body.pose(40.0)[1] == pytest.approx(level)


def test_beam_folds_at_its_critical_moment() -> None:
    body = beam([Peg(40.0, -4.0, 0.6)], -0.01, critical=0.002)
    assert body.base_moment == pytest.approx(0.002)
    assert body.fold_angle > 0
    assert body.pose(40.0)[1] == pytest.approx(-4.0 + 1.75 + 0.6)


@given(
    pegs=st.lists(st.tuples(st.floats(5.0, 55.0), st.floats(2.4, 8.0), st.booleans()), max_size=4),
    g=st.floats(-0.02, 0.02),
)
def test_beam_contacts_are_complementary(pegs: list[tuple[float, float, bool]], g: float) -> None:
    room = [Peg(x, y if up else -y, 0.6) for x, y, up in pegs]
    body = Rod(Tube(), room, model="beam")
    body.step(g, 53.0)
    for contact in body.contacts():
        assert contact.normal * room[contact.peg].y <= 0
    touching = {contact.peg for contact in body.contacts()}
    for index, peg in enumerate(room):
        if peg.x < 53.0 and index not in touching:
            side = 1.0 if peg.y < 0 else -1.0
            level = peg.y + side * (1.75 + 0.6)
            # Of two pegs in one place one touches; the pose beside it is interpolated.
            assert side * (body.pose(peg.x)[1] - level) > -1e-4


def test_beam_is_the_limit_of_the_rod_for_small_bends() -> None:
    peg = Peg(40.0, -2.4, 0.6)
    small = beam([peg], -1e-3)
    exact = solve(-1e-3, 53.0, pegs=[peg])
    assert small.contacts()[0].normal == pytest.approx(exact.contacts[0].normal, rel=2e-3)
    assert small.pose(53.0)[1] == pytest.approx(exact.tip[1], abs=2e-3)
