"""The study of the fit to whole sweeps: what it counts of an answer beside its truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from thigmo.field import FieldContact, Swept
from thigmo_bench.studies.drawn import DrawnRoom
from thigmo_bench.studies.field import Judged, _outcome, judged

TRUTH = DrawnRoom([], (20.0, 9.0, 1.0), (25.0, 20.0, 8.0), touched=True, ended=False)
CONTACT = FieldContact(
    length_cm=53.0, arc_cm=25.2, interval_cm=(24.0, 26.0), x_cm=20.3, y_cm=8.4,
    covariance_cm2=0.04 * np.eye(2), normal_rad=1.5, force_per_cm2=1e-3,
    force_interval_per_cm2=(5e-4, 2e-3), track=np.zeros((25, 2)), probability=0.99, places=True,
    doubt="", felt_at_cm=(53.0,), log_odds=50.0, log_evidence=-40.0, misfit=1.0,
    effective=60.0, kind="peg", peg_radius_cm=1.0, friction=0.1, yield_cm=0.0,
    gave_way_at=None,
    arcs=np.array([25.2]), weights=np.ones(1), face=np.zeros((0, 2)), explanations={"peg": 1.0},
)  # fmt: skip


def _judged(room: DrawnRoom, *answers: FieldContact) -> Judged:
    def answer(sweeps: Sequence[Swept]) -> list[FieldContact]:
        return list(answers)

    return judged("as calibrated", 1, 0, room, answer)


def test_an_answer_is_held_against_the_ellipse_and_the_set() -> None:
    near = _judged(TRUTH, replace(CONTACT, covariance_cm2=0.05 * np.eye(2)))
    assert near.judged
    assert near.error_cm == pytest.approx(0.5)
    assert not near.outside  # 0.25 / 0.05 = 5
    assert not near.off_set
    far = _judged(TRUTH, replace(CONTACT, interval_cm=(25.1, 26.0)))
    assert far.outside  # 0.25 / 0.04 = 6.25
    assert far.off_set


def test_a_localized_contact_far_from_its_peg_is_wrong() -> None:
    off = replace(CONTACT, interval_cm=(28.0, 29.0), x_cm=22.0)
    assert _judged(TRUTH, off).wrong
    assert not _judged(TRUTH, replace(off, places=False)).wrong
    assert not _judged(TRUTH, replace(off, interval_cm=(24.0, 35.0))).wrong  # too wide
    assert not _judged(TRUTH, replace(off, x_cm=21.0)).wrong  # nearer than a tube's radius
    best = _judged(TRUTH, replace(off, places=False), CONTACT)
    assert best.localized
    assert best.error_cm == pytest.approx(0.5)
    assert not _judged(TRUTH, replace(CONTACT, probability=0.4)).listed


def test_missed_and_false_contacts_are_counted() -> None:
    empty = replace(TRUTH, peg=None, contact=None, touched=False)
    results = [_judged(TRUTH), _judged(empty), _judged(empty, CONTACT), _judged(TRUTH, CONTACT)]
    rows = _outcome(results).tables["rows"]
    (whole,) = [row for row in rows if row["kind"] == "all kinds"]
    assert (whole["missed"], whole["false"], whole["judged"]) == (1, 1, 1)
    assert whole["outside_percent"] == 100.0
