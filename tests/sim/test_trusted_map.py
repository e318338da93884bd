"""The map for planners: no cell inside a peg that was felt is free, and enough others are."""

from __future__ import annotations

from pathlib import Path

import pytest

from thigmo.studies.maps import judge, room
from thigmo.studies.rooms import explored


@pytest.mark.ci
@pytest.mark.parametrize("scene", ["two_pegs", "wall", "room 4"])
def test_no_cell_inside_a_felt_peg_is_free(tmp_path: Path, scene: str) -> None:
    url, seed = f"emulator://{scene}", 1
    if scene.startswith("room"):
        seed = int(scene.split()[1])
        room(seed).save(tmp_path / "room.toml")
        url = f"emulator://{tmp_path / 'room.toml'}"
    document = explored(url, tmp_path, seed).document
    judged, bold = judge(document), judge(document, sigmas=0.0)
    print(judged)
    assert judged.felt_cells > 0
    assert judged.felt_free == 0
    assert judged.free_cm2 > 0.7 * bold.free_cm2
