"""What an answer says of its own worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thigmo.field import Readings, Stage
from thigmo.field.answer import (
    EARLY_WORDS,
    RIVAL_WORDS,
    UNEXPLAINED_WORDS,
    UNMODELLED,
    _at_an_end,
    _doubt,
    _face,
    _placed,
    _touched_in_passing,
    _widened,
)
from thigmo.field.fit import ALIKE
from thigmo.field.hypotheses import PEG, PEGS, WALL, Body, faced
from thigmo.field.posterior import Samples

STAGES = Stage(50.0, 2), Stage(53.0, 2)


def _readings() -> Readings:
    """Two sweeps, at two lengths, of which the first bins are bent by 0.006 1/cm."""
    bend = np.tile(np.linspace(0.006, 0.03, 8), 2)
    number = np.repeat([0, 1], 8)
    return Readings(
        curvature=np.zeros((16, 3)), noise=np.full((16, 3), 1e-3), bend=bend, rate=0.0 * bend,
        stage=number, sweep=number, zeroing=number, stages=STAGES,
        centers=np.array([5.0, 25.0, 45.0]), spans=np.full(3, 5.5),
        fold_moment=np.full(3, 0.011), radius=1.75,
    )  # fmt: skip


def _samples(touch_bend: float, felt: tuple[bool, bool]) -> Samples:
    """Samples of a peg at 45 cm that the free body touches at this bend."""
    rng = np.random.default_rng(1)
    arcs = 45.0 + 0.5 * rng.standard_normal(200)
    q = np.array([PEG.columns((a, touch_bend, -0.8), 0.0, 0.1, 0.1, 0.0) for a in arcs])
    place = np.column_stack([arcs, 0.8 * arcs, 0.2 * arcs, 1.2 + 0 * arcs, 2e-4 + 0 * arcs])
    touch = np.stack([place if on else np.full_like(place, np.nan) for on in felt], axis=1)
    even = np.full(200, 1 / 200)
    return Samples(
        PEG, q, np.ones((200, 1)), touch[:, :, None], even, np.zeros((200, 1)), 0.5, -10.0
    )


@pytest.mark.parametrize(
    ("touch_bend", "felt", "places"),
    [
        (0.009, (True, False), True),
        (0.003, (True, False), False),  # no reading shows when, and no other length
        (0.003, (True, True), True),
    ],
)
def test_a_touch_that_no_reading_shows_is_placed_by_two_lengths_and_not_by_one(
    touch_bend: float, felt: tuple[bool, bool], places: bool
) -> None:
    contact = _placed(
        _readings(), [_samples(touch_bend, felt)], 0, 9.0, "", face=np.zeros((0, 2)),
    )  # fmt: skip
    assert contact.places == places
    assert (contact.doubt == EARLY_WORDS) == (not places)


def test_a_touch_of_the_end_is_as_unsure_as_the_shape_of_the_end() -> None:
    inside = _samples(0.009, (False, True))
    ahead = inside.touch + np.array([7.0, 0.0, 0.0, 0.0, 0.0])
    contacts = [
        _placed(_readings(), [samples], 0, 9.0, "", face=np.zeros((0, 2)))
        for samples in (inside, replace(inside, touch=ahead))
    ]
    added = contacts[1].covariance_cm2 - contacts[0].covariance_cm2
    assert added == pytest.approx(0.875**2 * np.eye(2), rel=0.1)
    low = [contact.arc_cm - contact.interval_cm[0] for contact in contacts]
    assert low[1] - low[0] == pytest.approx(1.75, rel=0.1)  # a tube radius


def test_the_face_of_a_wall_reaches_from_the_first_touch_to_the_last() -> None:
    body = Body(radius=1.75, longest=53.0, most_bend=0.03, fold_error=0.1, yield_unit=1.0)
    q = np.array([[0.012, 0.4 + off, -0.8, 0.5, 0.0, 0.1, 0.1, 0.0] for off in (-0.02, 0.0, 0.02)])
    wall = faced(q[1, :4], body)
    way = np.array([wall.end_x - wall.x, wall.end_y - wall.y])
    way /= np.hypot(*way)
    first = WALL.skin(q[1], body)[0]
    last = first + 6.0 * way
    touch = np.full((3, 2, 1, 5), np.nan)
    touch[:, 1, 0] = [53.0, *last, 2e-4, 1.2]
    even = np.full(3, 1 / 3)
    samples = Samples(WALL, q, np.ones((3, 1)), touch, even, np.zeros((3, 1)), 0.5, -10.0)
    assert _face(samples, 0, body) == pytest.approx(np.array([first, last]), abs=1e-9)
    pegs = Samples(PEG, q, np.ones((3, 1)), touch, even, np.zeros((3, 1)), 0.5, -10.0)
    assert _face(pegs, 0, body).shape == (0, 2)


def _spread(explanations: list[Samples]) -> np.ndarray:
    """Standard deviations of the place that explanations give, in x and y."""
    contact = _placed(_readings(), explanations, 0, 9.0, "", face=np.zeros((0, 2)))
    return np.sqrt(np.diag(contact.covariance_cm2) - 0.01)  # but for the everted length's error


def test_samples_that_are_a_quarter_of_enough_place_half_as_well() -> None:
    many = _samples(0.009, (True, True))
    weight = np.full(200, 1e-9)
    weight[:12] = 1 / 12
    few = replace(many, weight=weight)
    known = np.cov(few.touch[:, 1, 0, 1:3].T, bias=True, aweights=_widened(weight))
    assert _spread([few]) == pytest.approx(UNMODELLED * np.sqrt(50 / 12 * np.diag(known)))
    assert _spread([many]) == pytest.approx(UNMODELLED * many.touch[:, 1, 0, 1:3].std(axis=0))


def test_what_no_model_explains_is_somewhere_along_the_body() -> None:
    unexplained = replace(_samples(0.009, (True, True)), misfit=60.0)
    contact = _placed(_readings(), [unexplained], 0, 9.0, UNEXPLAINED_WORDS, face=np.zeros((0, 2)))
    assert contact.interval_cm == (0.0, 53.0)
    widest = np.sqrt(np.linalg.eigvalsh(contact.covariance_cm2)[-1])
    assert widest == pytest.approx(53.0 / 2)
    assert np.sqrt(contact.weights @ (contact.arcs - contact.arc_cm) ** 2) == pytest.approx(
        53.0 / 2
    )


@pytest.mark.parametrize("draws", [3, 200])
def test_too_few_draws_that_agree_place_a_contact_nowhere(draws: int) -> None:
    many = _samples(0.009, (True, True))
    weight = np.full(draws, 1e-200)
    weight[0] = 1.0
    few = replace(
        many, q=many.q[:draws], model=many.model[:draws], touch=many.touch[:draws],
        compliance=many.compliance[:draws], weight=weight,
    )  # fmt: skip
    contact = _placed(_readings(), [few], 0, 9.0, UNEXPLAINED_WORDS, face=np.zeros((0, 2)))
    assert contact.interval_cm == (0.0, 53.0)
    assert np.sqrt(np.linalg.eigvalsh(contact.covariance_cm2)) == pytest.approx([26.5, 26.5])


def test_a_contact_that_no_peak_shows_is_where_the_free_body_first_touched_it() -> None:
    body = Body(radius=1.75, longest=53.0, most_bend=0.03, fold_error=0.1, yield_unit=1.0)
    passed = _touched_in_passing(_samples(0.009, (False, False)), _readings(), body)
    contact = _placed(_readings(), [passed], 0, 9.0, "", face=np.zeros((0, 2)))
    turn = 45.0 * 0.009
    skin = (np.sin(turn), 1 - np.cos(turn)) / np.array(0.009)
    skin += 1.75 * np.array([-np.sin(turn), np.cos(turn)])
    assert contact.arc_cm == pytest.approx(45.0, abs=0.2)
    assert (contact.x_cm, contact.y_cm) == pytest.approx(skin, abs=0.2)
    assert contact.normal_rad == pytest.approx(turn + np.pi / 2, abs=0.02)
    assert contact.force_per_cm2 == 0.0
    touched = _samples(0.009, (True, False))
    assert np.array_equal(
        _touched_in_passing(touched, _readings(), body).touch, touched.touch, equal_nan=True
    )


def test_a_touch_near_any_stops_end_may_be_farther_back() -> None:
    """A flat end reaches a peg beside it sooner than a round one does."""
    radius = _readings().radius
    ends = np.array([stage.length for stage in STAGES])
    near = np.array([ends[0] - 0.9 * radius, ends[0] + 1.9 * radius, ends[0] - 1.1 * radius])
    assert _at_an_end(near, _readings()).tolist() == [True, True, False]


def test_an_explanation_that_is_as_likely_counts_with_its_own_place() -> None:
    peg = _samples(0.009, (True, True))
    apart = peg.touch + np.array([0.0, 3.0, 0.0, 0.0, 0.0])
    far = peg.touch + 20.0
    pegs = replace(
        peg, hypothesis=PEGS, q=np.zeros((200, PEGS.unknowns)),
        touch=np.concatenate([far, apart], axis=2),
    )  # fmt: skip
    x, y = UNMODELLED * peg.touch[:, 1, 0, 1:3].std(axis=0)
    assert _spread([peg, pegs]) == pytest.approx(np.sqrt([x**2 + UNMODELLED**2 * 9.0 / 2, y**2]))
    unlikely = replace(pegs, log_evidence=peg.log_evidence - 20.0)
    assert _spread([peg, unlikely]) == pytest.approx([x, y], rel=1e-3)


def test_beyond_one_peg_an_explanation_must_leave_no_more_than_is_usual() -> None:
    """What one peg does not explain may be a row of dowels, which is no hypothesis."""
    peg = replace(_samples(0.009, (True, True)), misfit=1.2 / ALIKE)
    assert _doubt([peg], _readings()) == ""
    pegs = replace(peg, hypothesis=PEGS)
    assert _doubt([pegs], _readings()) == UNEXPLAINED_WORDS
    assert _doubt([replace(pegs, misfit=0.9 / ALIKE)], _readings()) == ""


def test_an_explanation_with_a_likely_rival_is_doubted() -> None:
    peg = _samples(0.009, (True, True))
    for behind, doubt in ((2.0, RIVAL_WORDS), (4.0, "")):
        rival = replace(peg, log_evidence=peg.log_evidence - behind)
        assert _doubt([peg, rival], _readings()) == doubt
