"""Forces in newtons hold against the studies' rod, another solver than ours."""

from __future__ import annotations

import numpy as np
import pytest

import thigmo
from thigmo.errors import DataError
from thigmo.localization import Localizer, Quantity
from thigmo_bench.studies import contact_scenes
from thigmo_bench.studies.loads import DENSE, MOST_TURN, ROD_CM, ROD_NOISE
from thigmo_bench.studies.rod import Floats, solve
from thigmo_bench.studies.scenes import (
    BOTH,
    COLUMN,
    CRITICAL,
    LENGTH,
    ROBOT,
    SIGMA,
    SPAN,
    STATED,
)

EI, ERROR = 400.0, 0.1  # N cm^2


def holds(quantity: Quantity | None, truth: float) -> bool:
    assert quantity is not None
    low, high = quantity.interval
    return low <= truth <= high


@pytest.mark.parametrize(
    ("bent", "position"), [(False, BOTH), (True, COLUMN), (True, DENSE)], ids=str
)
def test_forces_across_the_body_are_held_by_their_intervals(bent: bool, position: Floats) -> None:
    rng = np.random.default_rng(24)
    count = 150
    free = contact_scenes.signs(rng, count) * rng.uniform(0.005, 0.05, count) * bent
    arc = rng.uniform(15.0, LENGTH, count)
    size = np.minimum(CRITICAL, 0.9 * np.abs(free)) if bent else np.full(count, CRITICAL)
    side = -np.sign(free) if bent else contact_scenes.signs(rng, count)
    force = side * rng.uniform(0.3, 1.0, count) * size / arc
    scenes = contact_scenes.one_contact(arc, force, free, position)
    localizer = Localizer.of(
        position=position, length=LENGTH, span=SPAN, noise=SIGMA, stiffness=(EI, ERROR), **ROBOT
    )
    held = []
    for clean, g, over in zip(scenes.curvature, free, force, strict=True):
        frame = clean + SIGMA * rng.standard_normal(clean.size)
        result = localizer.localize(frame, free_curvature=g)
        if len(result.contacts) == 1:
            (contact,) = result.contacts
            assert contact.newtons is not None
            truth = over * EI * (1.0 + ERROR * rng.standard_normal())
            held.append(holds(contact.newtons.across, truth))
            if contact.end_offset is None and "end" not in result.hypothesis:
                assert contact.newtons.along is None
    assert len(held) > 0.8 * count
    assert np.mean(held) >= 0.92


@pytest.mark.parametrize("sensors", [5, 20])
def test_loads_on_the_end_are_told_apart(sensors: int) -> None:
    rng = np.random.default_rng(4)
    position = (np.arange(sensors) + 0.5) * ROD_CM / sensors
    localizer = Localizer.of(
        position=position, length=ROD_CM, noise=ROD_NOISE, held_end=True, contacts=1,
        critical_curvature=np.inf, stiffness=(EI, 0.0), **STATED,
    )  # fmt: skip
    held: list[list[bool]] = [[], [], []]
    wider = []
    while len(held[0]) < 150:
        force = contact_scenes.signs(rng, 1)[0] * rng.uniform(0.5, 5.0) / ROD_CM**2
        slant, couple = rng.uniform(-np.pi / 3, np.pi / 3), rng.uniform(-1.5, 1.5) / ROD_CM
        across, along = force * np.cos(slant), force * np.sin(slant)
        end = np.full((1, 1), ROD_CM)
        body = solve(end, np.full((1, 1), across), length=ROD_CM, tangential=along, couple=couple)
        if np.abs(body.base[0]) > MOST_TURN:
            continue
        clean = body.readings(position)[0]
        result = localizer.localize(clean + ROD_NOISE * rng.standard_normal(sensors))
        if "end wrench" not in result.hypothesis:
            continue
        load = result.contacts[-1].newtons
        assert load is not None
        truths = (across * EI, -along * EI, couple * EI)  # the rod's tangent points outwards
        for hits, quantity, truth in zip(held, (load.across, load.along, load.couple), truths,
                                         strict=True):  # fmt: skip
            hits.append(holds(quantity, truth))
        if load.along is not None:
            wider.append(np.ptp(load.along.interval) / np.ptp(load.across.interval))
    for hits in held:
        assert np.mean(hits) >= 0.9
    assert np.median(wider) > 2.0  # a force along the body is known far worse


def test_newtons_scale_with_the_unit_of_length() -> None:
    curvature = 3e-4 * np.clip(38.0 - COLUMN, 0.0, None)
    said = {"noise": SIGMA, "held_end": False}
    cm = thigmo.localize(curvature, COLUMN, length=53.0, stiffness=(EI, ERROR), **said)
    said["noise"] = SIGMA / 10.0
    mm = thigmo.localize(
        curvature / 10.0, 10.0 * COLUMN, length=530.0, stiffness=(100.0 * EI, ERROR), **said
    )
    assert cm.contacts[0].newtons is not None
    assert mm.contacts[0].newtons is not None
    assert mm.contacts[0].newtons.across.value == pytest.approx(
        cm.contacts[0].newtons.across.value, rel=1e-6
    )
    assert "N" in cm.contacts[0].force_text


@pytest.mark.parametrize("stiffness", [0.0, (500.0,), (0.0, 0.1), (500.0, -1.0), "EI"])
def test_a_stiffness_that_is_none_is_refused(stiffness: object) -> None:
    with pytest.raises(DataError, match="stiffness"):
        Localizer.of(position=COLUMN, length=LENGTH, stiffness=stiffness)
