"""The map for planners: no cell inside a peg that was felt is free, and enough others are."""

from __future__ import annotations

from pathlib import Path

import pytest

from thigmo.emulator.scene import Scene
from thigmo_bench.studies.exploration import judge_map
from thigmo_bench.studies.random_rooms import random_pegs
from thigmo_bench.studies.rooms import explored


@pytest.mark.ci
@pytest.mark.parametrize("scene", ["two_pegs", "wall", "room 4"])
def test_no_cell_inside_a_felt_peg_is_free(tmp_path: Path, scene: str) -> None:
    url, seed = f"emulator://{scene}", 1
    if scene.startswith("room"):
        seed = int(scene.split()[1])
        drawn = Scene.load("default").model_copy(update={"pegs": random_pegs(seed)})
        drawn.save(tmp_path / "room.toml")
        url = f"emulator://{tmp_path / 'room.toml'}"
    judged = judge_map(explored(url, tmp_path, seed).document)
    print(judged)
    assert judged.felt > 0
    assert judged.felt_free == 0
    assert judged.free > 0.7 * judged.swept
