"""The study of mistakes: its frames are what they say, and its counts count what they say."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo_bench.studies import Context, load
from thigmo_bench.studies.mistakes import (
    BENT,
    EMPTY_KINDS,
    FOLD,
    KINDS,
    OFFSET,
    STRAIGHT,
    TOUCHED_KINDS,
    Case,
    Seen,
    _claims,
    draw,
    judge,
    score,
    white,
)
from thigmo_bench.studies.scenes import SIGMA

RIGHT = Seen(
    localized=True,
    wrong=False,
    listed=1,
    held=1,
    off_cm=1.0,
    named=False,
    accused=False,
    remarked=False,
)


def pair(name: str, body, second: str = "one contact"):
    """The same bodies with a mistake and with another, or with none."""
    return (draw(np.random.default_rng(3), KINDS[kind], body, 40) for kind in (name, second))


def test_a_free_curvature_is_spoilt_as_its_kind_says() -> None:
    body = BENT[20]
    for name, factor in (("sign turned", -1.0), ("stated as 0", 0.0), ("10 % off", None)):
        spoilt, clean = pair(name, body)
        assert spoilt.given.free is not None
        ratio = spoilt.given.free / clean.true_free
        assert np.abs(np.abs(ratio - (factor or 0.0 if factor is not None else 1.0))).max() < 0.11
        if factor is not None:
            assert np.array_equal(spoilt.given.curvature, clean.given.curvature)
    spoilt, clean = pair("subtracted twice", body)
    assert np.allclose(spoilt.given.curvature, clean.given.curvature - clean.true_free[:, None])
    spoilt, _ = pair("not given", body)
    assert spoilt.given.free is None


def test_an_offset_is_shared_and_a_noise_is_only_stated_otherwise() -> None:
    spoilt, clean = pair("offset", STRAIGHT[10])
    assert np.abs(spoilt.given.curvature).mean() > 0.0
    assert np.abs(spoilt.given.curvature.mean(axis=1)).mean() > 0.5 * OFFSET
    spoilt, clean = pair("noise ten times too low", STRAIGHT[10])
    assert np.array_equal(spoilt.given.curvature, clean.given.curvature)


def test_a_fold_turns_the_base_and_leaves_the_rest() -> None:
    body = STRAIGHT[20]
    folded, touched = pair("fold of 5 degrees", body)
    extra = folded.given.curvature - touched.given.curvature
    # The first sensor spans 0 to 5.5 cm, and the fold 3.5.
    assert np.abs(extra[:, 0]).mean() == pytest.approx(FOLD / 5.5, rel=0.2)
    assert np.abs(extra[:, 3:]).max() < 12.0 * SIGMA


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_noise_has_the_correlation_that_is_asked_for(correlation: float) -> None:
    noise = white(np.random.default_rng(5), (4000, 8), correlation)
    assert noise.std() == pytest.approx(1.0, abs=0.03)
    assert np.mean(noise[:, 3] * noise[:, 4]) == pytest.approx(correlation, abs=0.05)


def test_the_truth_of_an_error_that_is_stated_is_found() -> None:
    for name in ("sign turned", "subtracted twice", "not given", "couple"):
        row = score(Case(name, BENT[20], True), judge((Case(name, BENT[20], True), 1, 0, 20)))
        assert row["covered"] > 0.8, name


def test_scores_tell_of_all_from_of_localized() -> None:
    wrong = RIGHT._replace(wrong=True, held=0)
    silent = RIGHT._replace(localized=False)
    row = score(Case("one contact", BENT[5], False), [wrong, RIGHT, silent, silent])
    assert (row["localized"], row["wrong"], row["wrong_of_localized"]) == (0.5, 0.25, 0.5)
    assert row["covered"] == 0.75


def test_each_promise_fails_by_the_frames_that_it_speaks_of() -> None:
    def rows(**spoilt: Seen):
        return [
            score(Case(name, body, stated),
                  50 * [(spoilt.get(name.replace(" ", "_")) if not stated else None)
                        or (RIGHT._replace(localized=False) if name in EMPTY_KINDS
                            else RIGHT._replace(named=True))])
            for name, kind in KINDS.items() for body in kind.bodies for stated in (False, True)
        ]  # fmt: skip

    assert all(claim.holds for claim in _claims(rows()))
    for name, row, words in (
        ("offset", RIGHT._replace(wrong=True), "offset, bent, 20 sensors: wrong of localized"),
        ("offset", RIGHT._replace(wrong=True), "offset, bent, 5 sensors: wrong of all"),
        ("empty", RIGHT, "empty: localized, most"),
        ("grip", RIGHT._replace(held=0), "grip: coverage, least"),
        ("grip", RIGHT._replace(localized=False), "grip, bent, 20 sensors: localized, over"),
        ("sign_turned", RIGHT, "sign turned, 20 sensors or more: named"),
        ("two_contacts", RIGHT._replace(accused=True), "250 frames"),
        ("two_contacts", RIGHT._replace(remarked=True), "250 frames"),
    ):
        broken = [claim.text for claim in _claims(rows(**{name: row})) if not claim.holds]
        assert any(text.startswith(words) for text in broken), (name, broken)


def test_the_study_runs_small() -> None:
    outcome = load("mistakes")(Context(seed=2, scale="quick", most=2))
    cases = [(row["kind"], row["body"], row["stated"]) for row in outcome.tables["rows"]]
    assert len(set(cases)) == len(cases)
    assert {row["kind"] for row in outcome.tables["rows"]} == {*TOUCHED_KINDS, *EMPTY_KINDS}
    assert set(outcome.figures) == {"chart"}
