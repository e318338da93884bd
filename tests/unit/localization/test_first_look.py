"""The short way to an answer gives what the long ones do."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from thigmo.localization import prior
from thigmo.localization.answer import contact_of, contacts_of
from thigmo.localization.first_look import Look, _look, first_look
from thigmo.localization.frame import Frame, empty_tried
from thigmo.localization.influence import STRAIGHT, influence, influences, sensors_on, shape_table
from thigmo.localization.marginal import independent_evidence
from thigmo.localization.model_choice import Options, best_model, stands
from thigmo.localization.models import evidence_of
from thigmo.studies.scenes import BOTH, LENGTH, SIGMA, SPAN, one_contact, two_contacts

AUTO = Options(None, "contact", "auto", prior.TUBE_RADIUS, prior.WIDTH_SHARE, None)


def look_at(curvature: np.ndarray) -> Look:
    return first_look(curvature, BOTH, LENGTH, SPAN, 0.0, SIGMA, 0.0)


@pytest.mark.parametrize("turn", [0.0, 1.5])
def test_influences_are_those_of_each_arc(turn: float) -> None:
    low = np.array([-0.02, 0.1, 0.5, 0.5, 0.97])
    high = np.array([0.05, 0.2, 0.5, 0.61, 1.04])
    table = shape_table(np.full(129, turn)) if turn else STRAIGHT
    sensors = sensors_on(table, low, high)
    arcs = np.linspace(0.0, 1.0, 63)
    frame = Frame(np.zeros(5), np.ones(5), True, np.empty((5, 0)), sensors)
    tried = empty_tried(frame, 64)
    influences(63, np.append(arcs, 0.0), sensors, tried.lever, tried.phi, tried.room)
    one = np.empty(5)
    for j, arc in enumerate(arcs):
        lever = influence(arc, sensors, one)
        assert tried.phi[:, j] == pytest.approx(one, abs=1e-12)
        assert tried.lever[j] == pytest.approx(lever, abs=1e-12)


def test_evidence_of_the_free_body_is_the_sum_over_patterns_of_outliers() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        y = rng.standard_normal(6) * rng.choice([1.0, 1.0, 1.0, 12.0], 6)
        variance = rng.uniform(0.5, 2.0, 6)
        patterns = itertools.product([False, True], repeat=6)
        total = 0.0
        for pattern in patterns:
            if sum(pattern) > 4:
                continue
            w = 1.0 / np.where(pattern, prior.OUTLIER_VARIANCE * variance, variance)
            total += (
                prior.OUTLIER_ODDS ** sum(pattern) * np.exp(0.5 * np.log(w) - 0.5 * w * y**2).prod()
            )
        frame = Frame(y, variance, True, np.empty((6, 0)), sensors_on(STRAIGHT, y, y))
        found = independent_evidence(frame, np.ones(1), np.zeros(1))
        assert found == pytest.approx(np.log(total), abs=0.05)


def test_rows_of_any_layout_take_the_same_compiled_code() -> None:
    rows = np.zeros((10, 3))
    rows[:, 1] = one_contact(np.random.default_rng(1)).curvature
    fixed = np.array(BOTH)
    fixed.flags.writeable = False
    spans = np.full(20, SPAN)[::2]
    first_look(np.zeros(10), BOTH.copy(), LENGTH, np.full(10, SPAN), 0.0, SIGMA, 0.0)
    before = len(_look.signatures)  # type: ignore[attr-defined]
    look = first_look(rows[:, 1], fixed, LENGTH, spans, 0.0, SIGMA, 0.0)
    assert len(_look.signatures) == before  # type: ignore[attr-defined]
    assert look.arc == look_at(rows[:, 1].copy()).arc


def test_a_first_look_that_stands_is_what_all_models_find() -> None:
    stood = 0
    for seed in range(60):
        look = look_at(one_contact(np.random.default_rng([1, seed])).curvature)
        if not stands(look, "auto", AUTO):
            continue
        stood += 1
        readings = look.readings()
        fit, likely = best_model(readings, look.fit(readings), "auto", AUTO)
        (listed,) = contacts_of(readings, fit, AUTO, None)
        assert contact_of(look, AUTO, None) == listed
        assert not likely
        assert fit.setting.name == "plain beam"
    assert stood > 20


def test_a_second_contact_that_matters_is_seen_on_the_grid() -> None:
    matters = 0
    for seed in range(120):
        scene = (one_contact, two_contacts)[seed % 2]
        look = look_at(scene(np.random.default_rng([2, seed])).curvature)
        readings = look.readings()
        two = evidence_of(2, readings, look.fit(readings).setting)
        if two > look.evidence + 0.5 and look.misfit > prior.least_misfit(look.finite):
            matters += 1
            assert look.two > look.evidence + 0.5
    assert matters > 20
