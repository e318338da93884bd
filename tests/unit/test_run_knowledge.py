"""What a run knows is built up again from the steps in its record."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from thigmo.config import RobotConfig
from thigmo.exploration.recorded import RecordedRun
from thigmo.exploration.run_knowledge import RunKnowledge
from thigmo.exploration.stall import Obstruction
from thigmo.link import protocol as wire
from thigmo.record import Log, Note, RunFolder
from thigmo.wiring import Wiring


def replayed(folder: Path, *steps: dict[str, Any]) -> RunKnowledge:
    """What a record of these notes tells."""
    notes = [Note(float(n), {"topic": "step", **step}) for n, step in enumerate(steps)]
    log = Log(list(notes), {"schema_hash": f"{wire.SCHEMA_HASH:08x}"}, False, 0)
    return RecordedRun(RunFolder(folder), [log], RobotConfig()).knowledge


def test_a_replay_takes_the_steps_that_the_run_has_noted(tmp_path: Path) -> None:
    noted: list[dict[str, Any]] = []
    live = RunKnowledge(Wiring.laid_out(RobotConfig()))
    live.journal = lambda step, numbers: noted.append({"step": step, "numbers": dict(numbers)})
    live.growth_begins()
    live.tries_more_pressure(body_pressure=2)
    live.ended(t_s=1.5, length_cm=30.0)
    assert [note["step"] for note in noted] == ["growth_begins", "tries_more_pressure", "ended"]
    again = replayed(tmp_path, *noted)
    assert again.raised == live.raised == 2
    assert again.stages == live.stages == []  # nothing was swept


@pytest.mark.parametrize(
    "damaged",
    [
        {},
        {"step": "tries_more_pressure"},
        {"step": "tries_more_pressure", "numbers": {}},
        {"step": "tries_more_pressure", "numbers": {"body_pressure": 1, "t_s": 0.0}},
        {"step": "__init__", "numbers": {}},
        {"step": "has_looked", "numbers": {"body_pressure": 0}},  # its sweep is lost
    ],
)
def test_a_damaged_note_is_left_out(damaged: dict[str, Any], tmp_path: Path) -> None:
    higher = {"step": "tries_more_pressure", "numbers": {"body_pressure": 2}}
    assert replayed(tmp_path, damaged, higher, damaged).raised == 2


def test_zeros_that_moved_by_themselves_are_not_asked_about_again_up_to_that_length() -> None:
    knowledge = RunKnowledge(Wiring.laid_out(RobotConfig()))
    knowledge.obstruction = Obstruction(40.0, 34.0, (33.0, 35.5), 3, 2e-4)
    knowledge.zeros_moved()
    assert (knowledge.obstruction, knowledge.straight_cm) == (None, 40.0)
