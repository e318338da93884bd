"""A growth that tail friction stops in an empty room: tried again at a higher body pressure."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from command import Thigmo
from emulated import room_file

from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatedOperator
from thigmo.errors import DataError
from thigmo.exploration import ExplorationResult, explore, replay

_TOO_LITTLE_PSI = 0.49  # of the last body pressure, for the friction of the longest body


def _room(folder: Path) -> str:
    scene = Scene.load("empty")
    scene.robot.body.growth_psi_per_cm = 0.008
    return room_file(folder, scene)


def _explore(tmp_path: Path) -> ExplorationResult:
    return explore(_room(tmp_path), seed=1, out=tmp_path)


def test_a_tip_that_moves_on_lacked_pressure_and_a_replay_says_so_too(tmp_path: Path) -> None:
    run = _explore(tmp_path)
    stall = run.document.stall
    assert stall is not None
    assert stall.moved_on is True
    assert stall.pressure > 0.9
    assert run.document.outcome == "full length"
    assert run.contacts == []
    again = replay(run.folder).document
    assert again.stall == stall
    assert again.contacts == []


def test_the_terminal_says_a_stall_that_was_overcome(thigmo: Thigmo, tmp_path: Path) -> None:
    ran = thigmo("explore", "--robot", _room(tmp_path), "--seed", "1", "--out", str(tmp_path))
    said = " ".join(ran.out.split())
    assert re.search(r"stalled at 3\d\.\d cm: too little body pressure .* \(9\d %\)", said)


def test_a_stall_that_nobody_can_try_again_stays_ambiguous(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    turned = EmulatedOperator.set_body_pressure
    before: list[float] = []

    def leaves(operator: EmulatedOperator, pressure_psi: float) -> None:
        if before and pressure_psi > before[-1]:  # only a trial raises it
            raise DataError("nobody can answer: the body pressure", "run it in a terminal")
        before.append(pressure_psi)
        turned(operator, pressure_psi)

    monkeypatch.setattr(EmulatedOperator, "set_body_pressure", leaves)
    run = _explore(tmp_path)
    assert before[-1] == _TOO_LITTLE_PSI
    assert run.document.outcome.startswith("growth stalled")
    stall = run.document.stall
    assert stall is not None
    assert stall.moved_on is None
    assert 0.05 < stall.pressure < 0.95
    assert [contact.status for contact in run.contacts] in ([], ["ambiguous"])
    again = replay(run.folder).document
    assert (again.stall, again.contacts) == (stall, run.contacts)
