"""An exploration whose contacts are placed by one fit to all sweeps of a side."""

from __future__ import annotations

import json

import pytest
from emulated import room_file, scene_at

import thigmo
from thigmo.errors import DataError
from thigmo.exploration import replay
from thigmo.exploration.map import true_touches

pytestmark = pytest.mark.ci


def test_a_peg_is_placed_by_all_sweeps_and_a_replay_says_the_same(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    room = room_file(tmp_path_factory.mktemp("room"), scene_at(38.0, "mid_body"))
    result = thigmo.explore(
        room, seed=2, out=tmp_path_factory.mktemp("runs"), name="field", method="field"
    )
    (contact,) = result.contacts
    assert result.document.method == "field"
    assert contact.kind == "peg"
    assert contact.probability > 0.99
    assert result.document.error_cm is not None
    assert result.document.error_cm < 1.75  # a tube's radius
    truth = result.document.truth
    assert truth is not None
    low, high = contact.interval_cm
    arcs = [true.arc_cm for true in true_touches(contact, truth.contacts)]
    assert any(low - 0.1 <= arc <= high + 0.1 for arc in arcs)
    again = replay(result.folder)
    assert again.document.method == "field"
    replayed = json.loads((result.folder / "replay.json").read_text())
    written = json.loads((result.folder / "contacts.json").read_text())
    for old, new in zip(written["contacts"], replayed["contacts"], strict=True):
        assert new["arc_cm"] == pytest.approx(old["arc_cm"], abs=0.05)
        assert new["status"] == old["status"]


def test_a_method_that_there_is_not_names_all_that_there_are() -> None:
    with pytest.raises(DataError, match="nonsense"):
        thigmo.explore(method="nonsense")
