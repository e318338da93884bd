"""The study of loads: its scenes are what they say, and its counts count what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from thigmo_bench.studies import loads
from thigmo_bench.studies.contact_scenes import misfit_of_one_contact
from thigmo_bench.studies.loads import FEW, GROUPS, SEEN_KINK, STANDS_OUT, FrameResult
from thigmo_bench.studies.scenes import BOTH, SIGMA

PLAIN = FrameResult(
    listed=1, likely=1, localized=True, ambiguous=False, p_no_contact=0.0, covered=1, wrong=False,
    off_cm=0.5, hinge=False, p_more=0.3, stands_out=0.0, fits=True, turn=1.0,
)  # fmt: skip


def test_one_contact_explains_its_own_readings_and_noise_only() -> None:
    rng = np.random.default_rng(1)
    scenes = loads.one_contact(BOTH, rng, 200)
    clean = misfit_of_one_contact(scenes.curvature, BOTH, scenes.free)
    assert clean.max() < 1.0  # places a centimetre apart
    frames = scenes.curvature + SIGMA * rng.standard_normal(scenes.curvature.shape)
    left = misfit_of_one_contact(frames, BOTH, scenes.free)
    assert left.mean() == pytest.approx(8.0, abs=1.0)  # ten readings less place and force
    opposed = GROUPS["two opposed, straight"].draw(rng, 50)
    assert np.median(misfit_of_one_contact(opposed.curvature, BOTH, opposed.free)) > chi2.isf(
        0.01, 8
    )


def test_each_promise_fails_by_the_frames_that_it_speaks_of() -> None:
    bad = {
        "noise unknown, one contact: localized": (
            "one contact, 5 readings, noise unknown",
            {"wrong": True},
        ),
        "noise known: false contacts": ("free, 2 readings, noise known", {}),
        "near the base, 5": ("near the base, bent, odds 0.05", {"listed": 0, "stands_out": 99.0}),
        "of these, P(no": (
            "near the base, straight, odds 0.001",
            {"p_no_contact": 0.2, "stands_out": 30},
        ),
        "two on one side that one does": (
            "two on one side, straight",
            {"wrong": True, "fits": False},
        ),
        "two on one side that one explains": (
            "two on one side, straight",
            {"p_more": 0.01},
        ),
        "rod held at its end: localized": ("rod held at its end", {"off_cm": 3.0, "turn": 0.2}),
        "kinks of 3": ("kink, bent", {"stands_out": SEEN_KINK}),
    }
    free = replace(PLAIN, listed=0, likely=0, localized=False, covered=0)
    good = {name: [free if name.startswith("free") else PLAIN] * 50 for name in GROUPS}
    for name in GROUPS:
        if name.startswith("near"):
            good[name] = [replace(PLAIN, stands_out=STANDS_OUT)] * 50
        if name.startswith(("two opposed", "18.5", "13 cm")):
            good[name] = [replace(PLAIN, listed=2, likely=2, covered=2)] * 50
        if name.startswith("kink"):
            good[name] = [replace(PLAIN, hinge=True, stands_out=v) for v in (0.0, 99.0)] * 25
    assert [c.text for c in loads._claims(good) if not c.holds] == []
    far = good | {"rod held at its end": [replace(PLAIN, off_cm=3.0)] * 50}
    assert sum("from there" in c.text for c in loads._claims(far) if not c.holds) == 2
    for start, (group, change) in bad.items():
        spoilt = {**good, group: [*good[group][:40], *[replace(PLAIN, **change)] * 10]}
        missed = [c.text for c in loads._claims(spoilt) if not c.holds]
        assert len(missed) == 1, start
        assert missed[0].startswith(start)


def test_a_group_is_answered_frame_by_frame() -> None:
    name = f"free, {FEW[0]} readings, noise known"
    results = loads.answer_frames((name, (0, 1), 5))
    assert [f.listed for f in results] == [0] * 5
    (contact, *_) = loads.answer_frames(("one contact, noise known", (0, 2), 3))
    assert (contact.likely, contact.wrong, contact.covered) == (1, False, 1)
