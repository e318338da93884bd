"""Richer mechanics, each against the large-deflection rod: used where called for, and right."""

from __future__ import annotations

import numpy as np
import pytest

import thigmo
from thigmo.errors import DataError
from thigmo.mechanics import Peg, Tube, solve
from thigmo_bench.studies.rod import readings as true_readings
from thigmo_bench.studies.scenes import STATED

LENGTH, SPAN, SIGMA = 53.0, 5.5, 6e-4
COLUMN = np.array([5.0, 15.0, 25.0, 35.0, 45.0])
BOTH = np.tile(COLUMN, 2)
CRITICAL = 0.01108


def felt(arcs, forces, position, **scene):
    return true_readings(
        np.atleast_1d(arcs), np.atleast_1d(forces), position, length=LENGTH, span=SPAN, **scene
    )


def folded(arc, force, angle):
    """Both columns' readings of a body whose first 3.5 cm are folded by an angle."""
    free = np.array([angle / 3.5, 0.0, 0.0])
    return felt((3.5, arc), (0.0, force), BOTH, free_curvature=free)


def test_levers_of_the_bent_shape_remove_the_bias_of_actuated_contacts():
    rng = np.random.default_rng(21)
    worst = 0.0
    for _ in range(25):
        free = rng.uniform(0.02, 0.045) * rng.choice([-1.0, 1.0])
        arc = rng.uniform(25.0, 51.0)
        force = -np.sign(free) * rng.uniform(0.004, 0.02) / arc
        curvature = felt(arc, force, COLUMN, free_curvature=free)
        options = STATED | {"length": LENGTH, "span": SPAN, "free_curvature": free, "contacts": 1}
        result = thigmo.localize(curvature, COLUMN, noise=1e-6, **options)
        worst = max(worst, abs(result.contacts[0].arc - arc))
    assert worst <= 0.1


@pytest.mark.parametrize("free", [0.0, 0.03, 0.06])
def test_opposed_contacts_are_felt_where_one_alone_explains_nothing(free):
    rng = np.random.default_rng(77)
    answers = []
    for _ in range(25):
        distal = rng.uniform(40.0, 53.0)
        arcs = np.array([rng.uniform(18.0, distal - 15.0), distal])
        moments = CRITICAL * rng.uniform(1.0, 3.0, 2) * np.array([-1.0, 1.0])
        clean = felt(arcs, moments * rng.choice([-1.0, 1.0]) / arcs, BOTH, free_curvature=free)
        noisy = clean + SIGMA * rng.standard_normal(10)
        options = STATED | {"length": LENGTH, "span": SPAN, "free_curvature": free}
        answers.append(len(thigmo.localize(noisy, BOTH, noise=SIGMA, **options).contacts))
        pair = thigmo.localize(clean, BOTH, noise=1e-6, contacts=2, **options).contacts
        assert [contact.arc for contact in pair] == pytest.approx(arcs, abs=0.15)
    assert min(answers) >= 1
    assert np.mean(np.array(answers) == 2) >= 0.8


def test_an_oblique_force_on_the_tips_corner_is_recognised():
    rng = np.random.default_rng(22)
    for _ in range(10):
        free = rng.uniform(0.02, 0.045)
        force = -rng.uniform(0.006, 0.015) / LENGTH
        along = -abs(force) * rng.uniform(0.2, 1.0)
        curvature = felt(
            LENGTH, force, COLUMN, free_curvature=free, tangential=along, couple=-1.75 * along
        )
        result = thigmo.localize(
            curvature,
            COLUMN,
            length=LENGTH,
            span=SPAN,
            free_curvature=free,
            noise=1e-5,
            tube_radius=1.75,
        )
        assert result.hypothesis == "end wrench"
        assert result.contacts[0].arc == pytest.approx(LENGTH, abs=0.3)
        assert result.parameters["push_back"] == pytest.approx(-along, rel=0.2)


@pytest.mark.parametrize("fold", [0.1, 0.3])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_base_fold_at_the_critical_moment_gives_place_and_angle(fold, sign):
    rng = np.random.default_rng(23)
    errors, angles = [], []
    for arc in (26.5, 39.75, 53.0) * 4:
        curvature = folded(arc, sign * CRITICAL / arc, sign * fold)
        curvature += SIGMA * rng.standard_normal(10)
        result = thigmo.localize(
            curvature, BOTH, length=LENGTH, span=SPAN, noise=SIGMA, critical_curvature=CRITICAL
        )
        assert "folded base" in result.hypothesis
        (contact,) = result.contacts
        errors.append(contact.arc - arc)
        angles.append(result.parameters["fold_angle"])
    # The thesis's coupled solver: 1.93 cm on average.
    assert np.mean(np.abs(errors)) < 1.9
    assert np.mean(angles) == pytest.approx(sign * fold, abs=0.05)


def test_a_suspected_fold_is_not_answered_with_a_confident_wrong_place():
    rng = np.random.default_rng(24)
    wrong = 0
    for arc in (26.5, 39.75, 53.0) * 8:
        curvature = folded(arc, CRITICAL / arc, 0.3) + SIGMA * rng.standard_normal(10)
        result = thigmo.localize(curvature, BOTH, length=LENGTH, span=SPAN, noise=SIGMA)
        wrong += result.status == "localized" and not any(
            c.interval[0] - 1e-6 <= arc <= c.interval[1] + 1e-6 for c in result.contacts
        )
    assert wrong <= 4


def on_the_end(pressure_curvature, peg_radius, place):
    """A body that has bent against a peg just off its tip, by the large-deflection rod."""
    touch = 0.021
    heading = touch * place
    reach = 1.75 + peg_radius
    peg = Peg(
        float(np.sin(heading)) / touch - reach * float(np.sin(heading)),
        float(1 - np.cos(heading)) / touch + reach * float(np.cos(heading)),
        peg_radius,
    )
    return solve(pressure_curvature, LENGTH, tube=Tube(3.5, CRITICAL), pegs=[peg])


@pytest.mark.parametrize("free", [0.0287, 0.0305, 0.0333])
@pytest.mark.parametrize("peg_radius", [0.6, 2.0])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_contact_on_the_end_is_not_pulled_inwards(free, peg_radius, sign):
    body = on_the_end(free, peg_radius, LENGTH)
    (truth,) = body.contacts
    assert truth.kind in ("corner", "face")
    result = thigmo.localize(
        sign * body.averages(COLUMN, SPAN),
        COLUMN,
        length=LENGTH,
        span=SPAN,
        free_curvature=sign * free,
        noise=2e-4,
        critical_curvature=CRITICAL,
        tube_radius=1.75,
    )
    # Five readings cannot always tell it from a contact on the side of a folded body.
    (contact,) = result.contacts
    assert contact.interval[1] == pytest.approx(LENGTH)
    if contact.arc == LENGTH:
        assert contact.end_offset == pytest.approx(-sign * truth.couple / truth.tangential, abs=1.9)
        assert result.parameters["push_back"] == pytest.approx(-truth.tangential, rel=0.5)
    else:
        assert sum(p for name, p in result.hypotheses.items() if "end wrench" in name) > 0.05


def test_a_known_range_holds_the_place_and_keeps_the_moment_at_the_base():
    readings = felt(49.0, 2e-4, COLUMN)
    options = STATED | {"length": LENGTH, "span": SPAN, "noise": 1e-3}
    free = thigmo.localize(readings, COLUMN, **options).contacts[0]
    result = thigmo.localize(readings, COLUMN, within=(48.25, LENGTH), **options)
    (contact,) = result.contacts
    assert 48.25 <= contact.interval[0] < contact.arc < contact.interval[1] <= LENGTH
    assert contact.interval[1] - contact.interval[0] < free.interval[1] - free.interval[0]
    assert contact.force * contact.arc == pytest.approx(free.force * free.arc, rel=0.05)
    assert result.status == "localized"


def test_readings_that_contradict_a_known_range_leave_the_place_open():
    readings = felt(22.0, 4e-4, COLUMN)
    options = STATED | {"length": LENGTH, "span": SPAN, "noise": 2e-4}
    (contact,) = thigmo.localize(readings, COLUMN, within=(48.25, LENGTH), **options).contacts
    assert contact.interval == pytest.approx((48.25, LENGTH), abs=1e-6)
    with pytest.raises(DataError, match="within"):
        thigmo.localize(readings, COLUMN, within=(30.0, 20.0), **options)
