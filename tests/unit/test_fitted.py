"""From the fit's answers to the map: sides, stages, places and what is said of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import nan
from typing import Any

import numpy as np
import pytest
from fits import a_fit

from thigmo.config import RobotConfig, Side
from thigmo.exploration.map import ContactMap
from thigmo.exploration.stage import Interpreter
from thigmo.exploration.stall import Obstruction
from thigmo.field import FieldContact
from thigmo.field.answer import UNEXPLAINED_WORDS
from thigmo.record import Ellipse, Obstacle
from thigmo.robot import ContactTrigger, Peak, SweepFrame, SweepResult
from thigmo.wiring import Wiring

CONFIG = RobotConfig()


@dataclass
class Fits:
    """Answers of the fit, and how often it was asked."""

    answers: list[FieldContact] = field(default_factory=list)
    asked: int = 0

    def __call__(self, *_: Any, **__: Any) -> list[FieldContact]:
        self.asked += 1
        return self.answers


@pytest.fixture
def fits(monkeypatch: pytest.MonkeyPatch) -> Fits:
    fits = Fits()
    monkeypatch.setattr("thigmo.exploration.fitted.contacts", fits)
    return fits


def _sweep(
    side: Side = "left", length_cm: float = 53.0, *, held_at_rest: float = 0.0
) -> SweepResult:
    """A sweep to one side, with a base that is held back at rest and by nothing else."""
    way = 1.0 if side == "left" else -1.0
    bends = way * np.linspace(0.0, 0.03, 80)
    frames = [
        SweepFrame(side, n / 20, 600 * abs(bend), bend, -way * held_at_rest)
        for n, bend in enumerate(bends.tolist())
    ]
    curvature = np.repeat(bends[:, None], 10, axis=1) - way * held_at_rest
    peak = Peak(side, 4.0, length_cm, curvature[-1], bends[-1], 18.0, 0x3FF, 10)
    return SweepResult([], [peak], frames, curvature, sensors=0x3FF)


def _mapped(fits: Fits, *answers: FieldContact, side: Side = "left") -> ContactMap:
    fits.answers = list(answers)
    room = ContactMap(Wiring.laid_out(CONFIG))
    room.add_sweep(_sweep(side), 2, [side])
    return room


def test_a_fit_is_made_once_for_so_many_sweeps(fits: Fits) -> None:
    room = _mapped(fits, a_fit(45.0))
    assert room.contacts == room.contacts
    assert fits.asked == 1  # the right side was not swept
    room.add_sweep(_sweep(), 2, ["left"])
    assert len(room.contacts) == 1
    assert fits.asked == 2


def test_a_contact_of_the_right_side_lies_on_the_right(fits: Fits) -> None:
    (left,) = _mapped(fits, a_fit(45.0)).contacts
    (right,) = _mapped(fits, a_fit(45.0), side="right").contacts
    assert (right.x_cm, right.y_cm) == (left.x_cm, -left.y_cm)
    assert right.normal_rad == -left.normal_rad
    assert right.force_per_cm2 == -left.force_per_cm2
    assert right.covariance_cm2[0][1] == pytest.approx(-left.covariance_cm2[0][1])
    assert right.track == [(x, -y) for x, y in left.track]


@pytest.mark.parametrize(
    ("fit", "status"),
    [
        (a_fit(45.0), "localized"),
        (a_fit(45.0, width_cm=11.0), "ambiguous"),
        (a_fit(45.0, probability=0.9), "ambiguous"),
        (a_fit(45.0, doubt=UNEXPLAINED_WORDS), "ambiguous"),
    ],
)
def test_only_a_sure_and_narrow_place_that_the_model_explains_is_localized(
    fits: Fits, fit: FieldContact, status: str
) -> None:
    (contact,) = _mapped(fits, fit).contacts
    assert contact.status == status
    assert contact.model == "peg, by 1 sweep"
    assert contact.doubt == fit.doubt


def test_what_is_likely_nothing_is_on_no_map(fits: Fits) -> None:
    assert _mapped(fits, a_fit(45.0, probability=0.4)).contacts == []


def test_two_contacts_of_one_side_are_two_obstacles(fits: Fits) -> None:
    """The fit has already told them apart, however near they are."""
    room = _mapped(fits, a_fit(45.0), a_fit(44.0, x_cm=40.2, y_cm=19.8))
    assert len(room.contacts) == 2


def test_the_cells_along_the_body_hold_the_samples(fits: Fits) -> None:
    room = _mapped(fits, a_fit(45.0, width_cm=4.0))
    (fitted,) = room.fitted("left")
    places, mass = fitted.cells(53.0)
    assert mass.sum() == pytest.approx(1.0)
    assert places @ mass == pytest.approx(45.0, abs=0.05)
    assert np.sqrt(mass @ (places - 45.0) ** 2) == pytest.approx(4.0 / 3.92, abs=0.2)
    end = _mapped(fits, a_fit(54.0, width_cm=0.2)).fitted("left")[0].cells(53.0)[1]
    assert end[-1] == pytest.approx(1.0, abs=1e-3)  # what lies beyond the end bears on it


def test_a_side_that_feels_nothing_new_is_not_measured(fits: Fits) -> None:
    interpreter = Interpreter(Wiring.laid_out(CONFIG))
    fits.answers = [a_fit(39.0, 40.0)]
    short = _sweep(length_cm=40.0)
    interpreter.take(short, 2)
    assert interpreter.felt_sides(short) == {"left"}
    longer = _sweep(length_cm=53.0)
    interpreter.take(longer, 2)
    assert interpreter.felt_sides(longer) == set()  # it passed what the shorter body touched
    fits.answers = [a_fit(45.0, felt_at_cm=(40.0, 53.0), width_cm=2.0)]
    interpreter.take(longer, 2)
    assert interpreter.felt_sides(longer) == interpreter.placed_sides(longer) == {"left"}
    fits.answers = [a_fit(45.0, felt_at_cm=(40.0, 53.0), width_cm=6.0)]
    interpreter.take(longer, 2)
    assert interpreter.felt_sides(longer) == {"left"}
    assert interpreter.placed_sides(longer) == set()


def test_a_contact_that_is_localized_where_the_map_has_an_obstacle_is_not_measured(
    fits: Fits,
) -> None:
    fits.answers = [a_fit(45.0, width_cm=6.0)]
    (contact,) = _mapped(fits, *fits.answers).contacts
    covariance = ((0.1, 0.0), (0.0, 0.1))
    mapped = Obstacle(
        contact.x_cm, contact.y_cm, covariance, Ellipse.of(covariance),
        [(contact.x_cm, contact.y_cm)], "felt", "localized", normal_rad=0.0,
    )  # fmt: skip
    elsewhere = replace(mapped, x_cm=contact.x_cm - 20.0, track=[(contact.x_cm - 20.0, 0.0)])
    for obstacle, placed in ((mapped, {"left"}), (elsewhere, set())):
        interpreter, sweep = Interpreter(Wiring.laid_out(CONFIG), [obstacle]), _sweep()
        interpreter.take(sweep, 2)
        assert interpreter.placed_sides(sweep) == placed


def test_a_side_whose_trigger_fired_is_unsure_until_the_fit_knows_a_contact(fits: Fits) -> None:
    interpreter = Interpreter(Wiring.laid_out(CONFIG))
    fits.answers = [a_fit(45.0, probability=0.1)]
    sweep = replace(_sweep(), triggers=[ContactTrigger("left", 3.0, -0.006)])
    interpreter.take(sweep, 2)
    assert interpreter.felt_sides(sweep) == set()
    assert interpreter.unsure_sides(sweep) == {"left"}
    assert interpreter.unsure_sides(_sweep()) == set()
    fits.answers = [a_fit(45.0)]
    interpreter.take(sweep, 2)
    assert interpreter.felt_sides(sweep) == {"left"}
    assert interpreter.unsure_sides(sweep) == set()
    held = _sweep(held_at_rest=0.007)
    caught = replace(sweep, frames=held.frames, curvature=held.curvature)
    assert interpreter.unsure_sides(caught) == set()


def test_a_body_that_was_held_bent_before_its_sweep_says_nothing_of_that_side(fits: Fits) -> None:
    fits.answers = [a_fit(45.0)]
    interpreter = Interpreter(Wiring.laid_out(CONFIG))
    caught = _sweep(held_at_rest=0.007)
    interpreter.take(caught, 2)
    assert interpreter.felt_sides(caught) == set()
    assert interpreter.map.contacts == []
    assert fits.asked == 0


def test_a_stage_says_what_it_felt_and_how_well(fits: Fits) -> None:
    fits.answers = [a_fit(45.0)]
    interpreter = Interpreter(Wiring.laid_out(CONFIG))
    sweep = _sweep()
    interpreter.take(sweep, 2)
    (answer,) = interpreter.localize(sweep, None, 2, 2)
    assert (answer.side, answer.status, answer.probability) == ("left", "localized", 1.0)
    assert "at 45.0 cm along the body, 95 % 44.0 to 46.0" in answer.message
    assert answer.mass.sum() == pytest.approx(1.0)
    assert not answer.message.endswith(UNEXPLAINED_WORDS)
    entry = interpreter.entry(1.0, 53.0, sweep, [answer], 2)
    assert entry.shapes[-1].side == "left"


def test_a_stage_says_why_its_place_is_a_guess(fits: Fits) -> None:
    fits.answers = [a_fit(45.0, doubt=UNEXPLAINED_WORDS)]
    interpreter = Interpreter(Wiring.laid_out(CONFIG))
    sweep = _sweep()
    interpreter.take(sweep, 2)
    (answer,) = interpreter.localize(sweep, None, 2, 2)
    assert answer.status == "ambiguous"
    assert answer.message.endswith(UNEXPLAINED_WORDS)


def test_two_pegs_of_a_side_are_one_of_two_each(fits: Fits) -> None:
    near, far = _mapped(fits, a_fit(24.0, 40.0, x_cm=22.0, y_cm=6.0), a_fit(46.0)).contacts
    assert [near.status, far.status] == ["localized", "localized"]
    assert near.model == "peg, by 1 sweep; one of 2 on this side"
    assert [near.everted_length_cm, far.everted_length_cm] == [40.0, 53.0]


def test_a_wall_has_a_face_in_the_room_and_no_radius(fits: Fits) -> None:
    fit = a_fit(53.0, kind="wall", peg_radius_cm=nan, explanations={"wall": 0.97, "two pegs": 0.03})
    (contact,) = _mapped(fits, fit, side="right").contacts
    assert contact.kind == "wall"
    assert contact.fit_radius_cm is None
    assert contact.surface == [(x, -y) for x, y in fit.face.tolist()]
    assert contact.certainty_text == "localized, > 99 %; wall 97 %, two pegs 3 %"


@pytest.mark.parametrize(("end_x", "likelier"), [(44.0, True), (60.0, False)])
def test_a_wall_that_was_touched_and_leads_into_the_path_is_the_likelier_cause_of_a_stall(
    fits: Fits, end_x: float, likelier: bool
) -> None:
    wall = a_fit(53.0, kind="wall", peg_radius_cm=nan)
    face = np.array([[40.0, 8.0], [end_x, 2.0]])  # the path is crossed at 45.3 cm, or beyond
    room = _mapped(fits, replace(wall, face=face))
    room.add_obstruction(Obstruction(45.5, 45.0, (44.0, 46.0), 3, 0.0))
    assert room.stall is not None
    assert (room.stall.wall > room.stall.obstacle) == likelier


def test_what_gave_way_is_said_with_its_kind(fits: Fits) -> None:
    (contact,) = _mapped(fits, replace(a_fit(45.0), gave_way_at=0.012)).contacts
    assert contact.certainty_text == "localized, > 99 %; peg that gave way"
    assert contact.gave_way_per_cm == 0.012
