"""Whether one peg explains all stages of a side, or several share them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from fits import a_fit

from thigmo.config import RobotConfig
from thigmo.exploration.fitted import FittedMap
from thigmo.field import FieldContact, Readings
from thigmo.record import MapContact
from thigmo.robot import Peak, SweepFrame, SweepResult

CONFIG = RobotConfig()
NEAR, FAR = {"x_cm": 22.0, "y_cm": 6.0}, {"x_cm": 43.0, "y_cm": 12.0}


@dataclass
class ByLengths:
    """Answers of the fit by the lengths of the sweeps that it is given."""

    answers: dict[tuple[float, ...], FieldContact]

    def __call__(self, readings: Readings, *_: Any, expected: Any = None) -> list[FieldContact]:
        lengths = tuple(sorted({stage.length for stage in readings.stages}))
        return [self.answers[lengths]] if lengths in self.answers else []


def _sweep(length_cm: float) -> SweepResult:
    bends = np.linspace(0.0, 0.03, 80)
    frames = [SweepFrame("left", n / 20, 600 * g, g, 0.0) for n, g in enumerate(bends.tolist())]
    curvature = np.repeat(bends[:, None], 10, axis=1)
    peak = Peak("left", 4.0, length_cm, curvature[-1], float(bends[-1]), 18.0, 0x3FF, 10)
    return SweepResult([], [peak], frames, curvature, sensors=0x3FF)


def _mapped(
    monkeypatch: pytest.MonkeyPatch,
    answers: dict[tuple[float, ...], FieldContact],
    *untouched_cm: float,
) -> list[MapContact]:
    monkeypatch.setattr("thigmo.exploration.fitted.contacts", ByLengths(answers))
    fitted = FittedMap(CONFIG)
    touched = {length for lengths in answers for length in lengths}
    for length_cm in sorted({*touched, *untouched_cm}):
        fitted.add(_sweep(length_cm), 2)
    return fitted.contacts("left")


def test_a_peg_that_leaves_a_misfit_is_compared_with_one_for_each_stage(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two pegs: shorter bodies touch one of them, longer ones the other."""
    answers = {
        (30.0, 40.0, 50.0, 53.0): a_fit(44.0, misfit=1.8, log_evidence=-190.0, x_cm=41.0),
        (30.0,): a_fit(24.0, 30.0, log_evidence=-20.0, **NEAR),
        (40.0,): a_fit(23.8, 40.0, log_evidence=-30.0, **NEAR),
        (30.0, 40.0): a_fit(23.7, 40.0, log_evidence=-40.0, felt_at_cm=(30.0, 40.0), **NEAR),
        (50.0,): a_fit(46.0, 50.0, log_evidence=-60.0, **FAR),
        (53.0,): a_fit(45.8, 53.0, misfit=1.4, log_evidence=-50.0, **FAR),
        (50.0, 53.0): a_fit(45.9, 53.0, log_evidence=-120.0, felt_at_cm=(50.0, 53.0), **FAR),
    }
    first, second, third = _mapped(monkeypatch, answers)
    # One peg for two stages where that is likelier than two, and never where it is not.
    assert (first.arc_cm, first.merged, first.status) == (23.7, [30.0], "localized")
    assert [second.everted_length_cm, third.everted_length_cm] == [50.0, 53.0]
    assert third.status == "ambiguous"  # its misfit: something else bore on that body as well
    assert all("one of several" in contact.model for contact in (first, second, third))


@pytest.mark.parametrize(("misfit", "log_evidence"), [(1.8, -90.0), (1.0, -300.0)])
def test_one_peg_stays_one_if_it_explains_its_sweeps_or_is_likelier(
    monkeypatch: pytest.MonkeyPatch, misfit: float, log_evidence: float
) -> None:
    answers = {
        (50.0, 53.0): a_fit(44.0, misfit=misfit, log_evidence=log_evidence),
        (50.0,): a_fit(30.0, 50.0, log_evidence=-60.0, x_cm=28.0, y_cm=9.0),
        (53.0,): a_fit(45.8, 53.0, log_evidence=-50.0),
    }
    (contact,) = _mapped(monkeypatch, answers)
    assert contact.arc_cm == 44.0
    assert "several" not in contact.model


def test_stages_that_felt_nothing_count_against_several(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their readings are part of what one peg for all has explained."""
    answers = {
        (40.0, 50.0, 53.0): a_fit(44.0, misfit=1.8, log_evidence=-120.0),
        (50.0,): a_fit(30.0, 50.0, log_evidence=-60.0, x_cm=28.0, y_cm=9.0),
        (53.0,): a_fit(45.8, 53.0, log_evidence=-50.0),
    }
    seen = []
    for evidence in (-5.0, -15.0):
        monkeypatch.setattr(
            "thigmo.exploration.fitted.untouched_evidence", lambda *_, e=evidence: e
        )
        seen.append(len(_mapped(monkeypatch, answers, 40.0)))
    assert seen == [2, 1]
