"""The thesis's fit as a method of `localize`: its numbers, and that nobody takes them for sure."""

from __future__ import annotations

import math

import numpy as np
import pytest

import thigmo
from thigmo.errors import DataError
from thigmo.localization import thesis

X = np.tile([5.0, 15.0, 25.0, 35.0, 45.0], 2)


def pressed(arc: float, moment: float = 0.009) -> np.ndarray:
    return np.asarray(moment / arc * np.clip(arc - X, 0.0, None))


@pytest.mark.parametrize("arc", [39.75, 45.0])
def test_it_finds_a_clean_contact_and_claims_nothing(arc: float) -> None:
    answer = thigmo.localize(pressed(arc), X, length=53, span=5.5, method="thesis")
    (contact,) = answer.contacts
    assert contact.arc == pytest.approx(arc, abs=1.5)
    assert contact.force == pytest.approx(0.009 / arc, rel=0.1)
    assert answer.status == contact.status == "point estimate"
    assert contact.interval == (0.0, 53.0)
    assert math.isnan(contact.probability)
    assert "no interval" in repr(answer)
    assert "no interval" in answer._repr_html_()
    assert answer.bend[0, 1] == pytest.approx(contact.force * contact.arc)
    answer.plot()


def test_several_contacts_are_those_of_the_solver() -> None:
    y = pressed(53.0, 0.012) - pressed(20.0, 0.008)
    answer = thigmo.localize(y, X, length=53, span=5.5, contacts=2, method="thesis")
    arcs, forces = thesis.alternating(thesis.ThesisProblem(y, X, np.full(10, 5.5), 53.0, 2))
    assert [contact.arc for contact in answer.contacts] == arcs.tolist()
    assert [contact.force for contact in answer.contacts] == forces.tolist()


def test_a_folded_base_is_coupled_where_the_critical_curvature_is_given() -> None:
    y = pressed(30.0, 0.01108) + 0.02 * (X < 6)  # the fold lies under the base sensors
    plain = thigmo.localize(y, X, length=53, method="thesis").contacts[0]
    coupled = thigmo.localize(
        y, X, length=53, method="thesis", critical_curvature=0.01108
    ).contacts[0]
    assert abs(coupled.arc - 30.0) < 0.5 * abs(plain.arc - 30.0)
    assert coupled.force * coupled.arc == pytest.approx(0.01108)


def test_missing_readings_are_left_out() -> None:
    y = pressed(39.75)
    y[3] = math.nan
    rest = np.isfinite(y)
    answer = thigmo.localize(y, X, length=53, span=5.5, method="thesis")
    without = thigmo.localize(y[rest], X[rest], length=53, span=5.5, method="thesis")
    assert answer.contacts[0].arc == without.contacts[0].arc


def test_what_it_cannot_do_is_said() -> None:
    with pytest.raises(DataError, match="0 contacts"):
        thigmo.localize(pressed(30.0), X, length=53, contacts=0, method="thesis")
    with pytest.raises(DataError, match="thesis takes no rows"):
        thigmo.localize_batch(pressed(30.0)[None], X, length=53, method="thesis")  # type: ignore[arg-type]
    with pytest.raises(DataError, match="a reading is infinite"):
        thigmo.localize(np.full(10, np.inf), X, length=53, method="thesis")
    with pytest.raises(DataError, match="unknown method 'l1'") as gone:
        thigmo.localize(pressed(30.0), X, length=53, method="l1")
    assert "posterior" in gone.value.next_step
