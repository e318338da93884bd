"""Explorations with a robot that bends less or more than its robot.toml says, as one does whose
regulator is set wrong: its contacts are doubtful, and the operator is told what to check.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from thigmo.cli.console import Console
from thigmo.config import SIDES
from thigmo.emulator.scene import Scene
from thigmo.exploration import ExplorationResult, explore, replay
from thigmo.record import OBSTACLES_FILE, read_obstacles


def _explored(tmp_path: Path, bend: float) -> ExplorationResult:
    scene = Scene.load("default")
    known = scene.believed(1)
    for side in SIDES:
        for zone in scene.robot.actuators.side(side).maps:
            zone.inflate.amplitude *= bend
            zone.deflate.amplitude *= bend
    scene.save(tmp_path / "room.toml")
    return explore(f"emulator://{tmp_path / 'room.toml'}", config=known, seed=1, out=tmp_path)


@pytest.mark.parametrize(("bend", "said"), [(0.7, "less"), (0.8, "less"), (1.2, "more")])
def test_a_robot_off_its_map_is_doubted(
    tmp_path: Path, bend: float, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    result = _explored(tmp_path, bend)
    document = result.document
    assert f"% {said} (+- " in document.doubt
    assert document.contacts
    assert {contact.status for contact in document.contacts} == {"doubtful"}
    known = read_obstacles(result.folder / OBSTACLES_FILE)
    assert {obstacle.status for obstacle in known.obstacles} == {"doubtful"}
    # Only where it stood straight is known to be free.
    assert max(abs(y) for area in known.free for _, y in area.outline) < 2.0
    Console(quiet=False).result(result)
    assert "check the body's regulator" in capsys.readouterr().out
    again = replay(result.folder).document
    assert again.doubt == document.doubt
    assert {contact.status for contact in again.contacts} == {"doubtful"}


def test_a_robot_that_keeps_to_its_map_is_not_doubted(tmp_path: Path) -> None:
    document = _explored(tmp_path, 1.0).document
    assert document.doubt == ""
    assert "doubtful" not in {contact.status for contact in document.contacts}
