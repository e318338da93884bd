"""Localization of pegs that the studies' rod, another solver than ours, bends the body into."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import thigmo
from thigmo.localization import priors
from thigmo_bench.studies.mistakes import Body, holds
from thigmo_bench.studies.pegs import Rooms, rooms
from thigmo_bench.studies.rod import readings, solve
from thigmo_bench.studies.scenes import CRITICAL, LENGTH, RADIUS, ROBOT, SIGMA, STATED

FRAMES = 6
LENGTHS = (53.0, 36.0)
ROOMS = 40  # of each length
MOST = 0.04


@pytest.fixture(scope="module")
def inflations() -> list[Rooms]:
    return [
        rooms(
            np.random.default_rng([2026, int(length)]), ROOMS, length=length, largest_free=MOST,
            frames=FRAMES, moment=(0.4, 1.0), radius=(0.25, 1.5),
        )
        for length in LENGTHS
    ]  # fmt: skip


@pytest.mark.ci
def test_pegs_touch_the_end_as_often_as_the_prior_says(inflations: list[Rooms]) -> None:
    ends = np.mean([drawn.u[-1] > drawn.length for drawn in inflations])
    assert 0.5 * np.exp(priors.END) < ends < 2.0 * np.exp(priors.END)


@pytest.mark.ci
def test_intervals_hold_and_contacts_are_found(inflations: list[Rooms]) -> None:
    felt, covered, sure, wrong, errors = 0, 0, 0, 0, []
    for drawn in inflations:
        position = np.arange(5.0, drawn.length - 2.75, 10.0)
        for span in (0.0, 5.5):
            clean = drawn.bodies(-1).readings(position, span)
            rng = np.random.default_rng([int(drawn.length), int(span)])
            noisy = clean + SIGMA * rng.standard_normal((FRAMES, *clean.shape))[-1]
            for room in range(int(span > 0.0), ROOMS, 2):
                side = (-1.0, 1.0)[room // 2 % 2]
                find = partial(
                    thigmo.localize, side * noisy[room], position,
                    free_curvature=side * drawn.free[-1, room], length=drawn.length, span=span,
                    noise=SIGMA, tube_radius=RADIUS, **STATED,
                )  # fmt: skip
                result = find()
                if not result.contacts:
                    continue
                (contact,), arc = result.contacts, drawn.arc[-1, room]
                low, high = contact.interval
                inside = low - 1e-6 <= arc <= high + 1e-6
                felt += 1
                covered += inside
                errors.append(abs(contact.arc - arc))
                # The peg resists the bend; on the face its push has no normal part to speak of.
                assert contact.end_offset is not None or contact.force * side < 0.0
                wrong += result.status == "localized" and not inside
                alone = find(contacts=1)  # two contacts would lie elsewhere
                (contact,) = alone.contacts
                low, high = contact.interval
                sure += alone.status == "localized"
                wrong += alone.status == "localized" and not low - 1e-6 <= arc <= high + 1e-6
    assert felt >= 0.95 * ROOMS * len(LENGTHS)
    assert covered >= 0.9 * felt
    assert wrong <= 0.03 * felt
    assert sure >= 0.12 * felt
    assert np.mean(errors) < 3.5


@pytest.mark.parametrize("span", [0.0, 5.5])
@pytest.mark.parametrize(
    ("length", "free", "arc"), [(53.0, 0.02, 45.0), (53.0, 0.06, 33.0), (30.0, 0.04, 22.0)]
)
def test_without_noise_the_side_is_found_at_any_bend(
    length: float, free: float, arc: float, span: float
) -> None:
    position = np.arange(5.0, length, 10.0)
    position = position[position + span / 2 <= length]
    force = np.array([-0.8 * CRITICAL / arc])
    curvature = readings(
        np.array([arc]), force, position, length=length, span=span, free_curvature=free
    )
    result = thigmo.localize(
        curvature, position, length=length, span=span, free_curvature=free, noise=1e-6
    )
    assert result.contacts[0].arc == pytest.approx(arc, abs=0.1)


@pytest.mark.parametrize(
    "body", [Body(False, 10), Body(True, 5), Body(True, 10)], ids=["straight", "bent, 5", "bent"]
)
def test_sets_hold_contacts_near_the_base_where_one_sensor_sees_them(body: Body) -> None:
    # Only the product of force and lever is known there, so the place may be far off.
    rng = np.random.default_rng([3, body.sensors])
    free = body.bent * rng.choice([-1.0, 1.0], 100) * rng.uniform(0.01, 0.04, 100)
    arcs = rng.uniform(6.0, 9.0, (100, 1))
    moment = rng.choice([-1.0, 1.0], arcs.shape) * rng.uniform(0.2, 1.0, arcs.shape) * CRITICAL
    bodies = solve(arcs, moment / arcs, length=LENGTH, free_curvature=free[:, None])
    noisy = bodies.readings(body.position, body.span)
    noisy += SIGMA * rng.standard_normal(noisy.shape)
    localizer = thigmo.Localizer.of(
        position=body.position, span=body.span, length=LENGTH, noise=SIGMA, **ROBOT
    )
    listed, held, wrong = 0, 0, 0
    for row, bend, truth in zip(noisy, free, arcs, strict=True):
        contacts = localizer.localize(row, free_curvature=bend).contacts
        listed += bool(contacts)
        held += any(holds(contact, truth) for contact in contacts)
        wrong += any(c.status == "localized" and not holds(c, truth) for c in contacts)
    assert listed >= 50
    assert held >= 0.92 * listed
    assert wrong <= 2
