"""An obstacle that gives way for good: on the map with its place, neither free nor occupied."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from thigmo.design import draft
from thigmo.emulator.reach import room_for
from thigmo.exploration import explore
from thigmo.exploration.prior import read_prior
from thigmo.record import read_ros_map
from thigmo.record.occupancy import UNKNOWN


def test_an_exploration_says_what_gave_way_and_where(tmp_path: Path) -> None:
    scene = room_for(draft(53, 5, 2, kind="flex"), 6)
    (peg,) = scene.pegs
    peg.gives_way = 3e-4
    scene.save(tmp_path / "room.toml")
    run = explore(f"emulator://{tmp_path / 'room.toml'}", seed=1, out=tmp_path)
    (contact,) = run.document.contacts
    assert contact.gave_way_per_cm is not None
    assert "gave way" in contact.model
    away = np.hypot(contact.x_cm - peg.x, contact.y_cm - peg.y)
    assert away < peg.radius + 2.45 * np.sqrt(np.linalg.eigvalsh(contact.covariance_cm2)[-1])
    grid = read_ros_map(run.folder / "map.yaml")
    x, y = grid.centers()
    near = np.hypot(x - contact.x_cm, y - contact.y_cm) < 0.5
    assert (grid.cells[near] == UNKNOWN).all()
    assert read_prior(run.folder) == []  # nothing stands there to be expected
