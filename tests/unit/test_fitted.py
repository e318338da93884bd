"""What the fit of a side says on the map."""

from __future__ import annotations

from math import nan
from typing import Any

import numpy as np
import pytest
from fits import a_fit

from thigmo.config import RobotConfig
from thigmo.exploration.fitted import FittedMap
from thigmo.field import FieldContact
from thigmo.record import MapContact
from thigmo.robot import Peak, SweepFrame, SweepResult

CONFIG = RobotConfig()


def _sweep(length_cm: float) -> SweepResult:
    bends = np.linspace(0.0, 0.03, 80)
    frames = [SweepFrame("left", n / 20, 600 * g, g, 0.0) for n, g in enumerate(bends.tolist())]
    curvature = np.repeat(bends[:, None], 10, axis=1)
    peak = Peak("left", 4.0, length_cm, curvature[-1], float(bends[-1]), 18.0, 0x3FF, 10)
    return SweepResult([], [peak], frames, curvature, sensors=0x3FF)


def _mapped(monkeypatch: pytest.MonkeyPatch, *answer: FieldContact) -> list[MapContact]:
    def contacts(*_: Any, **__: Any) -> list[FieldContact]:
        return list(answer)

    monkeypatch.setattr("thigmo.exploration.fitted.contacts", contacts)
    fitted = FittedMap(CONFIG)
    for length_cm in (40.0, 53.0):
        fitted.add(_sweep(length_cm), 2)
    return fitted.contacts("left")


def test_a_peg_that_explains_its_sweeps_is_localized(monkeypatch: pytest.MonkeyPatch) -> None:
    (contact,) = _mapped(monkeypatch, a_fit(44.0, felt_at_cm=(40.0, 53.0)))
    assert (contact.status, contact.merged) == ("localized", [40.0])
    assert contact.model == "peg, by 2 sweeps"
    assert contact.fit_radius_cm == 1.0


def test_two_pegs_of_a_side_are_two_contacts(monkeypatch: pytest.MonkeyPatch) -> None:
    near, far = _mapped(monkeypatch, a_fit(24.0, 40.0, x_cm=22.0, y_cm=6.0), a_fit(46.0))
    assert [near.status, far.status] == ["localized", "localized"]
    assert near.model == "peg, by 2 sweeps; one of 2 on this side"
    assert [near.everted_length_cm, far.everted_length_cm] == [40.0, 53.0]


def test_a_doubted_contact_is_not_localized_and_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    (contact,) = _mapped(monkeypatch, a_fit(44.0, doubt="the model does not explain these sweeps"))
    assert contact.status == "ambiguous"
    assert contact.model == "peg, by 2 sweeps; the model does not explain these sweeps"


def test_a_wall_has_no_radius(monkeypatch: pytest.MonkeyPatch) -> None:
    (contact,) = _mapped(monkeypatch, a_fit(53.0, kind="wall", peg_radius_cm=nan))
    assert contact.fit_radius_cm is None
    assert contact.model.startswith("wall")
