"""A dowel that stops the tip or bends it aside: the run notices, and does not grow on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emulated import room_file, scene_at

from thigmo.emulator.scene import PegTable, Scene
from thigmo.exploration import explore, replay, run_knowledge
from thigmo.exploration.stall import HeldBent
from thigmo.record import OBSTACLES_FILE, RunFolder, read_obstacles
from thigmo_bench.studies.rooms import explored

STALLS = PegTable(x=44.0, y=0.3, radius=0.8)


def room(folder: Path, peg: PegTable) -> str:
    """The default robot before this peg; explored from 38 cm on if the peg is beyond."""
    scene = Scene.load("default")
    scene.start_length_cm = 38.0 if peg.x > 40.0 else scene.start_length_cm
    scene.pegs = [peg]
    return room_file(folder, scene)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.ci)])
def test_a_peg_that_stalls_the_growth_is_reported_and_backed_off_from(
    tmp_path: Path, seed: int
) -> None:
    result = explored(room(tmp_path, STALLS), tmp_path, seed)
    document = result.document
    assert document.outcome == "peg ahead" or document.outcome.startswith("growth stalled at ")
    assert document.stall is not None
    assert document.stall.pressure < 0.05  # it was tried again at a higher one
    (contact,) = document.contacts
    assert contact.x_cm == pytest.approx(44.0 - 0.8, abs=1.0)
    assert abs(contact.y_cm) < 1.75
    assert document.missed == document.false == []
    assert result.length_cm == pytest.approx(40.0, abs=0.1)  # the slack is wound in again
    (obstacle,) = read_obstacles(result.folder / OBSTACLES_FILE).obstacles
    assert obstacle.kind == "peg"


@pytest.mark.parametrize(("x", "y", "seed"), [(34.0, 0.3, 1), (18.4, 1.3, 2), (27.3, -1.6, 3)])
def test_a_peg_that_bends_the_tip_aside_is_placed_and_backed_off_from(
    tmp_path: Path, x: float, y: float, seed: int
) -> None:
    result = explored(room(tmp_path, PegTable(x=x, y=y, radius=0.7)), tmp_path, seed)
    document = result.document
    assert document.outcome == "peg ahead"
    (contact,) = document.contacts
    (true,) = document.truth.contacts if document.truth else []
    assert document.error_cm is not None
    assert document.error_cm < 1.5
    assert contact.interval_cm[0] <= true.arc_cm <= contact.interval_cm[1]
    assert document.missed == document.false == []
    assert result.length_cm == pytest.approx(x // 10 * 10, abs=0.1)  # the stage before the peg
    (obstacle,) = read_obstacles(result.folder / OBSTACLES_FILE).obstacles
    assert obstacle.body_side == ("left" if y > 0 else "right")


@pytest.mark.parametrize(
    "peg", [pytest.param(STALLS, marks=pytest.mark.ci), PegTable(x=18.4, y=1.3, radius=0.7)]
)
def test_a_replay_tells_the_same_peg(tmp_path: Path, peg: PegTable) -> None:
    result = explore(room(tmp_path, peg), seed=2, out=tmp_path)
    again = replay(result.folder).document
    assert again.contacts == result.document.contacts
    assert again.error_x_cm == result.document.error_x_cm


@pytest.mark.ci
def test_zeros_that_moved_by_themselves_end_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def moved(*grown: Any) -> HeldBent | None:
        """What zeros that move in proportion to their levers look like, when 40 cm are out."""
        if round(max(grown[0].length_cm, default=30.0)) != 40:
            return None
        lever = np.maximum(34.0 - grown[-1].center_cm, 0.0)
        bend = np.where(grown[-1].bend_sign >= 0, 2e-4 * lever, np.nan)
        return HeldBent(40.0, 34.0, (33.0, 35.5), 3, 2e-4, 3e-4, False, bend)

    monkeypatch.setattr(run_knowledge, "detect_held_bent", moved)
    result = explore(room_file(tmp_path, scene_at(30.0)), seed=1, out=tmp_path)
    steps = [note.facts.get("step") for note in RunFolder(result.folder).read_log().notes]
    assert steps.count("held_bent") == steps.count("zeros_moved") == 1  # refuted once for all
    assert result.document.outcome == "full length"
    assert result.document.contacts == []
    swept = [round(stage.everted_length_cm) for stage in result.document.stages]
    assert swept == sorted(set(swept)), "each stage once"
    assert replay(result.folder).document.contacts == []
