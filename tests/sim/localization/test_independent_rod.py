"""Localization of pegs that another solver of the rod (`shooting_rod`) bends the body into."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from shooting_rod import CRITICAL, PEG, TUBE, Pressed, room, touched

import thigmo
from thigmo.localization import ContactFilter, priors

SIGMA = 6e-4
FREES = np.array([0.01, 0.016, 0.022, 0.028, 0.034, 0.04])
LENGTHS = (53.0, 36.0)
ROOMS = 40  # of each length


@pytest.fixture(scope="module")
def rooms(many):
    """(frames, readings, sensors, span, side that the body bends to) of each room."""
    out = []
    for length in LENGTHS:
        for index in range(many(ROOMS)):
            rng = np.random.default_rng([2026, int(length), index])
            frames = room(rng, FREES, length)
            span = (0.0, 5.5)[index % 2]
            side = (-1.0, 1.0)[index // 2 % 2]
            position = np.arange(5.0, length - 2.75, 10.0)
            clean = [
                np.full(len(position), free) if frame is None else frame.readings(position, span)
                for frame, free in zip(frames, FREES, strict=True)
            ]
            noise = SIGMA * rng.standard_normal((len(FREES), len(position)))
            out.append((frames, side * np.array(clean) + noise, position, span, side))
    return out


def test_shooting_agrees_with_collocation() -> None:
    # The same peg in the room, as a boundary value problem from the base.
    pressed = Pressed(40.0, 3e-4, 0.03, 53.0)
    heading, x, y, base = pressed._shot(np.zeros(1))[:, 0]
    cosine, sine = np.cos(heading), np.sin(heading)
    # The base's frame: where the contact's section is, and its normal force.
    turn = np.array([[cosine, sine], [-sine, cosine]])
    force = turn @ [0.0, -pressed.force]

    def slope(_, state):
        return np.array(
            [
                state[3],
                np.cos(state[0]),
                np.sin(state[0]),
                np.sin(state[0]) * force[0] - np.cos(state[0]) * force[1],
            ]
        )

    def ends(near, far):
        return np.array([near[0], near[1], near[2], far[3] - pressed.free])

    arcs = np.linspace(0.0, pressed.arc, 40)
    solved = solve_bvp(slope, ends, arcs, np.full((4, 40), 0.03) * arcs, tol=1e-8)
    assert solved.success
    assert solved.y[3, 0] == pytest.approx(base, abs=1e-8)
    assert solved.y[1:3, -1] == pytest.approx(-turn @ [x, y], abs=1e-5)


@pytest.mark.ci
def test_pegs_touch_the_end_as_often_as_the_prior_says(rooms) -> None:
    ends = np.mean([frames[-1].u > frames[-1].length for frames, *_ in rooms])
    assert 0.5 * np.exp(priors.END) < ends < 2.0 * np.exp(priors.END)


def _check(rooms, answer, *, mean_error: float, found: float) -> None:
    """Coverage, honesty and mean error of one method over the rooms."""
    felt, covered, sure, wrong, errors = 0, 0, 0, 0, []
    for frames, readings, position, span, side in rooms:
        last = frames[-1]
        options = {"length": last.length, "span": span, "noise": SIGMA, "tube_radius": TUBE}
        result = answer(readings, position, side * FREES, options)
        if not result.contacts:
            continue
        (contact,) = result.contacts
        inside = contact.interval[0] - 1e-6 <= last.arc <= contact.interval[1] + 1e-6
        felt += 1
        covered += inside
        sure += result.status == "localized"
        wrong += result.status == "localized" and not inside
        errors.append(abs(contact.arc - last.arc))
        # The peg resists the bend; on the face its push has no normal part to speak of.
        assert contact.end_offset is not None or contact.force * side < 0.0
    assert felt >= found * len(rooms)
    assert covered >= 0.9 * felt
    assert wrong <= 0.08 * sure
    assert sure >= 0.12 * felt
    assert np.mean(errors) < mean_error


@pytest.mark.ci
def test_one_frame(rooms) -> None:
    def last(readings, position, frees, options):
        return thigmo.localize(readings[-1], position, free_curvature=frees[-1], **options)

    _check(rooms, last, mean_error=3.0, found=0.95)


@pytest.mark.ci
def test_one_obstacle_at_rest(rooms) -> None:
    def obstacle(readings, position, frees, options):
        felt = ContactFilter(position, most_curvature=frees[-1], peg_radius=PEG, **options)
        felt.update(readings, frees)
        return felt.result()

    _check(rooms, obstacle, mean_error=3.0, found=0.95)


def test_without_noise_the_side_is_found_at_any_bend() -> None:
    for length, free, arc in ((53.0, 0.02, 45.0), (53.0, 0.06, 33.0), (30.0, 0.04, 22.0)):
        pressed = Pressed(arc, 0.8 * CRITICAL / arc, free, length)
        position = np.arange(5.0, length, 10.0)
        for span in (0.0, 5.5):
            on_it = position[position + span / 2 <= length]
            result = thigmo.localize(
                pressed.readings(on_it, span), on_it,
                length=length, span=span, free_curvature=free, noise=1e-6,
            )  # fmt: skip
            assert result.contacts[0].arc == pytest.approx(arc, abs=0.1)


def test_a_body_at_its_touch_is_the_free_body() -> None:
    peg = touched(40.0, 0.02, 53.0)
    assert Pressed(40.0, 0.0, 0.02, 53.0).missed(peg) == pytest.approx([0.0, 0.0], abs=1e-7)
