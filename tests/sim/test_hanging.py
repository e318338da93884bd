"""A body that hangs on a peg from behind, since a sweep slipped past it."""

from __future__ import annotations

from pathlib import Path

import pytest
from emulated import room_file

from thigmo.emulator.scene import PegTable, Scene
from thigmo.exploration import explore, replay
from thigmo.record import RunFolder


@pytest.mark.parametrize("seed", [1, pytest.param(3, marks=pytest.mark.ci)])
def test_it_winds_in_until_it_is_free_and_grows_there_once_more(tmp_path: Path, seed: int) -> None:
    scene = Scene.load("default")
    scene.start_length_cm = 38.0
    scene.pegs = [PegTable(x=48.2, y=-12.0, radius=1.17)]
    scene.body.friction = 0.4
    result = explore(room_file(tmp_path, scene), seed=seed, out=tmp_path)
    steps = [note.facts.get("step") for note in RunFolder(result.folder).read_log().notes]
    assert steps.count("held_bent") == steps.count("let_go") == 1
    document = result.document
    assert document.outcome == "full length"
    swept = [round(stage.everted_length_cm) for stage in document.stages]
    assert swept == [40, 50, 53]
    (contact,) = document.contacts
    assert contact.side == "right"
    assert contact.status == "localized"
    assert document.error_cm is not None
    assert document.error_cm < 1.0
    assert document.missed == document.false == []
    assert replay(result.folder).document.contacts == document.contacts
