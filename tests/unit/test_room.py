"""The room's posterior: what is one obstacle, what is a wall, and what stays open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thigmo.config import SIGN, RobotConfig, Side
from thigmo.exploration import room as room_module
from thigmo.exploration.map import ContactMap
from thigmo.exploration.room import Found, Room, touch_point
from thigmo.exploration.sighting import Passed, Sighting, arc_grid, bend_grid, shortest
from thigmo.exploration.workspace import Bend
from thigmo.localization import Contact
from thigmo.robot.curvature import Floats

CONFIG = RobotConfig()
RADIUS = CONFIG.body.radius_cm
ARCS = arc_grid(CONFIG.body.length_cm)
BENDS = bend_grid(CONFIG.body.length_cm)


def _touch(bend: float) -> Floats:
    mass = np.exp(-0.5 * ((BENDS - bend) / 7e-4) ** 2)
    return np.asarray(mass / mass.sum())


def _sighting(
    length: float,
    arc: float,
    deviation: float,
    bend: float = 0.015,
    *,
    side: Side = "left",
    probability: float = 1.0,
    expected: Floats | None = None,
    alone: bool = True,
) -> Sighting:
    mass = np.exp(-0.5 * ((ARCS - arc) / deviation) ** 2) * (length >= ARCS)
    interval = (arc - 1.96 * deviation, min(arc + 1.96 * deviation, length))
    way = SIGN[side]
    contact = Contact(arc, -2e-4 * way, interval, "localized", probability=probability)
    return Sighting(
        side, length, Bend(length, 0.02 * way), contact, mass / mass.sum(), _touch(bend),
        "plain beam", 4, alone, expected,
    )  # fmt: skip


def _explained(*seen: Sighting, passed: tuple[Passed, ...] = ()) -> list[Found]:
    return Room(ARCS, seen, passed, RADIUS).obstacles()


def test_what_a_sweep_cannot_place_lies_where_the_plane_has_room() -> None:
    """The area at a distance from the base grows with it."""
    (far,) = _explained(_sighting(53.0, 30.0, 1e3))
    assert far.arc_cm > 53.0 / 2 ** (1 / 2) - 0.5
    # Where the readings tell the place, the area hardly moves it.
    (known,) = _explained(_sighting(53.0, 30.0, 1.0))
    assert known.arc_cm == pytest.approx(30.0, abs=0.2)


def test_a_peg_felt_at_several_stages_is_one_obstacle_and_known_better() -> None:
    arcs = {40.0: 33.0, 50.0: 37.0, 53.0: 36.0}
    (peg,) = _explained(*(_sighting(length, arc, 2.0) for length, arc in arcs.items()))
    assert (peg.kind, peg.members, peg.status) == ("peg", (0, 1, 2), "localized")
    assert peg.arc_cm == pytest.approx(np.mean(list(arcs.values())), abs=0.5)
    (alone,) = _explained(_sighting(53.0, 36.0, 2.0))
    width, wide = (high - low for low, high in (peg.interval_cm, alone.interval_cm))
    # Errors that the stages share are not averaged away: n of them count as the root of n.
    assert 0.55 * wide < width < 0.9 * wide


def test_an_open_place_at_first_is_settled_by_the_stage_that_knows() -> None:
    (peg,) = _explained(_sighting(40.0, 34.0, 8.0), _sighting(50.0, 37.0, 1.5))
    assert peg.arc_cm == pytest.approx(37.0, abs=0.6)


def test_places_of_different_contacts_are_not_multiplied() -> None:
    """Two wide posteriors whose product is narrow, in between and where nothing is."""
    seen = _sighting(40.0, 26.0, 6.0, bend=0.012), _sighting(53.0, 40.0, 6.0, bend=0.019)
    found = _explained(*seen)
    assert not any(each.status == "localized" for each in found)
    for each, arc in zip(found, (26.0, 40.0), strict=True):
        low, high = each.interval_cm
        assert low < arc < high


def test_the_bend_at_which_a_touch_begins_tells_one_peg_from_two() -> None:
    same = _explained(_sighting(40.0, 36.0, 4.0, 0.015), _sighting(53.0, 38.0, 4.0, 0.0152))
    other = _explained(_sighting(40.0, 36.0, 4.0, 0.011), _sighting(53.0, 38.0, 4.0, 0.015))
    assert [each.members for each in same] == [(0, 1)]
    assert same[0].kinds["peg"] > 0.95
    # One in twenty touches is another's, so that two differ is not proof, and nothing is sure.
    assert other[0].kinds.get("peg", 0.0) < 0.7
    assert all(each.status == "ambiguous" for each in other)


def test_touches_of_the_straight_body_tell_less_of_what_they_touched() -> None:
    """Whatever stands beside the path touches a body that is hardly bent, anywhere along it."""
    odds = []
    for bend in (5e-4, 0.015):
        mass = np.exp(-0.5 * ((BENDS - bend) / 2.5e-4) ** 2)
        seen = _sighting(40.0, 36.0, 3.5, bend), _sighting(53.0, 43.0, 3.5, bend)
        (both,) = _explained(*(replace(each, touch=mass / mass.sum()) for each in seen))
        odds.append(both.kinds["peg"] / (1 - both.kinds["peg"]))
    assert odds[0] < 0.7 * odds[1]


def test_tips_that_slide_along_a_line_are_a_wall_with_its_surface() -> None:
    """A wall 12 cm to the left, parallel to the path of growth."""
    seen = []
    for length in (30.0, 40.0, 50.0, 53.0):
        arc = length - 0.5
        bend = float(BENDS[np.argmin([abs(touch_point(arc, b, "left", RADIUS)[1] - 12.0)
                                      for b in BENDS])])  # fmt: skip
        seen.append(_sighting(length, arc, 2.0, bend))
    (wall,) = _explained(*seen)
    assert (wall.kind, wall.members) == ("wall", (0, 1, 2, 3))
    assert wall.kinds["wall"] > 0.85  # or a peg or two beside a shorter wall
    assert np.abs(np.array(wall.surface)[:, 1] - 12.0).max() < 1.0
    contacts = ContactMap(CONFIG)
    for each in seen:
        contacts.add(each)
    (contact,) = contacts.contacts
    assert contact.kind == "wall"
    assert contact.surface == pytest.approx(np.array(wall.surface), abs=1e-3)
    assert contact.merged == [30.0, 40.0, 50.0]


def test_a_tip_at_a_wall_is_not_surely_the_peg_that_longer_bodies_lean_on() -> None:
    """A peg of 2 or 4 cm beyond the tip would explain all four touches; two dowels did, at 34.5."""
    seen = [_sighting(30.0, 26.7, 2.5, bend=0.0042)]
    seen += [_sighting(length, 32.6, 4.0, bend=6e-4) for length in (40.0, 50.0, 53.0)]
    clear = Passed("left", 30.0, (BENDS < 0.0036).astype(float))
    leaned = [each for each in _explained(*seen, passed=(clear,)) if 3 in each.members]
    assert leaned[0].kinds["peg"] < 0.8
    assert leaned[0].interval_cm[0] < 34.5 < leaned[0].interval_cm[1]


def test_where_a_shorter_body_passed_there_is_nothing() -> None:
    free = Passed("left", 40.0, np.ones(len(BENDS)))
    wide = _sighting(53.0, 40.0, 8.0)
    (peg,) = _explained(wide, passed=(free,))
    assert peg.arc_cm > 40.0 - RADIUS
    assert peg.interval_cm[0] > 36.0
    (unknown,) = _explained(wide)
    assert unknown.interval_cm[0] < 30.0
    # What was passed up to a bend says nothing of bends beyond it.
    short = Passed("left", 40.0, (BENDS < 0.012).astype(float))
    (beyond,) = _explained(wide, passed=(short,))
    assert beyond.interval_cm == pytest.approx(unknown.interval_cm, abs=0.5)


def test_what_is_likely_nothing_is_on_no_map_and_what_is_unsure_is_not_localized() -> None:
    (doubtful,) = _explained(_sighting(53.0, 40.0, 1.0, probability=0.8))
    assert doubtful.probability == pytest.approx(0.8, abs=0.05)
    assert doubtful.status == "ambiguous"
    assert _explained(_sighting(53.0, 40.0, 1.0, probability=0.2)) == []
    (twice,) = _explained(*(_sighting(at, 40.0, 1.0, probability=0.8) for at in (50.0, 53.0)))
    assert twice.probability > 0.95


def test_a_given_map_counts_once_and_not_for_each_stage() -> None:
    at = 1.0 + 14.0 * np.exp(-0.5 * ((ARCS - 42.0) / 1.5) ** 2)
    once = Room(ARCS, [_sighting(53.0, 38.0, 4.0, expected=at)], (), RADIUS).place(0)
    assert shortest(ARCS, once)[1] > 42.0
    assert float(once @ ARCS) > 39.0


def test_pegs_of_the_same_sweep_or_of_other_sides_stay_apart() -> None:
    contacts = ContactMap(CONFIG)
    contacts.add(_sighting(53.0, 45.0, 1.0))
    contacts.add(_sighting(53.0, 45.0, 1.0, side="right"))
    contacts.add(_sighting(53.0, 20.0, 1.0, alone=False))
    assert len(contacts.contacts) == 3


def test_ways_left_out_change_nothing_that_is_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    seen = []
    for length in (20.0, 30.0, 40.0, 50.0, 53.0):
        for arc, bend in ((17.0, 0.012), (28.0, 0.017))[: 1 + (length > 28.0)]:
            noise = 3e-4 * rng.standard_normal()
            seen.append(_sighting(length, arc, 2.0, bend + noise, alone=length < 28.0))
    few = _explained(*seen)
    monkeypatch.setattr(room_module, "_MOST_WAYS", 10**6)
    every = _explained(*seen)
    assert [each.members for each in few] == [each.members for each in every]
    assert [each.arc_cm for each in few] == pytest.approx([each.arc_cm for each in every], abs=0.1)
