"""A run localized by the thesis's fit: places without intervals, from the readings to the map."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import thigmo
from thigmo.exploration import replay
from thigmo.exploration.prior import read_prior


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs")
    return thigmo.explore(seed=1, out=out, name="thesis", method="thesis").folder


def test_every_contact_is_a_point_estimate_and_its_replay_says_the_same(run: Path) -> None:
    written = json.loads((run / "contacts.json").read_text())
    assert written["method"] == "thesis"
    assert written["contacts"]
    for contact in written["contacts"]:
        assert contact["status"] == "point estimate"
        assert contact["interval_cm"] == [0.0, contact["everted_length_cm"]]
        assert not contact["merged"]
        assert contact["probability"] is None
    again = replay(run)
    assert again.document.method == "thesis"
    replayed = json.loads((run / "replay.json").read_text())
    assert replayed["contacts"] == written["contacts"]


def test_a_replay_by_another_method_has_intervals_again(run: Path) -> None:
    document = replay(run, method="field").document
    assert document.method == "field"
    assert {contact.status for contact in document.contacts} <= {"localized", "ambiguous"}


def test_a_place_of_unknown_error_is_no_prior_knowledge(run: Path) -> None:
    assert read_prior(run) == []
