"""The accuracy study: its scenes are what they say, its errors too, and its scores count right."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo_bench.studies import accuracy
from thigmo_bench.studies.accuracy import ERRORS, Case, Frame, judge, score
from thigmo_bench.studies.contact_scenes import GROUPS, one_contact
from thigmo_bench.studies.engine import Context
from thigmo_bench.studies.scenes import COLUMN, CRITICAL, LENGTH, RADIUS, SIGMA, SPAN


@pytest.mark.parametrize("group", GROUPS)
def test_scenes_have_what_their_bodies_read(group: str) -> None:
    scenes = GROUPS[group](np.random.default_rng(4), 6)
    assert scenes.curvature.shape == (6, scenes.position.size)
    assert np.isfinite(scenes.curvature).all()
    excess = scenes.curvature - scenes.free[:, None]
    if group.startswith("free"):
        assert np.all(excess == 0.0)
        assert np.isinf(scenes.bound).all()
    else:
        assert np.all((scenes.arcs > 0.0) & (scenes.arcs <= LENGTH))
        assert np.abs(excess).max() < 1.5 * CRITICAL
        assert np.all(scenes.bound > 0.0)
        # Whatever is distal of the contact bends as the free body does, but for its skin.
        distal = scenes.position[None] - SPAN / 2 > scenes.arcs + RADIUS
        assert np.abs(excess[distal]).max(initial=0.0) < 1e-9


def test_the_bound_is_that_of_a_beam_where_the_body_is_straight() -> None:
    # Readings f (a - x) of sensors at 5 .. 35 cm: for a known f, sigma / (f sqrt(n)).
    arc, force = 40.0, 2e-4
    scenes = one_contact(np.array([arc]), np.array([force]), np.zeros(1), COLUMN)
    levers = arc - COLUMN[:4]
    by_arc = force * np.ones(4)
    left = by_arc - levers * (by_arc @ levers) / (levers @ levers)
    assert scenes.bound[0] == pytest.approx(SIGMA / np.sqrt(left @ left), rel=0.03)


def test_other_readings_tell_of_a_bad_one_in_their_midst() -> None:
    rng = np.random.default_rng(8)
    scenes = GROUPS["peg"](rng, 40)
    noticed = {}
    for offset in (0.0, 8e-3):
        noise = SIGMA * rng.standard_normal((40, 5)) + offset * (COLUMN == 35.0)
        noticed[offset] = accuracy.other_readings_tell(
            [
                Frame(readings, COLUMN, free, {})
                for readings, free in zip(scenes.curvature + noise, scenes.free, strict=True)
            ]
        ).sum()
    assert noticed[0.0] <= 3
    assert noticed[8e-3] >= 30


def test_scores_count_what_they_say() -> None:
    nan = float("nan")
    rows = [
        # found, covered, wrong, squared error, bound, other readings tell, localized
        (1, 1, 0, 4.0, 2.0, 0, 1),
        (1, 0, 1, 36.0, 4.0, 1, 1),
        (1, 1, 0, 100.0, 9.0, 1, 0),
        (0, nan, 0, nan, 1.0, 0, 0),
    ]
    row = score(Case("peg", "none"), np.array(rows, dtype=float))
    assert (row["count"], row["found"], row["wrong"]) == (4, 0.75, 0.25)
    assert (row["localized"], row["wrong_of_localized"]) == (0.5, 0.5)
    assert row["covered"] == pytest.approx(2 / 3)
    assert row["wrong_against_others"] == 0.5
    assert row["rmse_over_bound"] == pytest.approx(np.sqrt(40.0 / 20.0))


def test_a_stated_error_is_no_worse_than_one_that_is_not() -> None:
    stated, silent = (
        score(case, judge((case, 0, 0, 25)))
        for case in (Case("bent", "map 10 %", stated) for stated in (True, False))
    )
    assert stated["covered"] > silent["covered"]
    assert stated["wrong"] <= silent["wrong"]


def test_the_study_makes_its_tables_claims_and_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy, "BATCH", 2)
    outcome = accuracy.run(Context(scale="quick"))
    errors, odds = outcome.tables["rows"], outcome.tables["odds"]
    # Each error in each of its groups; what can be stated, stated and not; no case twice.
    cases = [(row["error"], row["group"], row["stated"]) for row in errors]
    assert len(set(cases)) == len(cases)
    assert {(name, group) for name, error in ERRORS.items() for group in error.groups} == {
        (name, group) for name, group, _ in cases
    }
    statements = {(name, stated) for name, _, stated in cases}
    assert all((name, False) in statements for name, error in ERRORS.items() if error.tell)
    assert {row["odds"] for row in odds} == set(accuracy.ODDS)
    assert outcome.claims
    assert set(outcome.figures) == {"stated", "odds"}
