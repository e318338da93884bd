"""Explorations with a robot that bends less or more than its robot.toml says, as one does whose
regulator is set wrong: the frames before the touch say so, and no place is confidently wrong.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from emulated import room_file

from thigmo.config import SIDES
from thigmo.emulator.scene import Scene
from thigmo_bench.studies.rooms import explored


@pytest.mark.parametrize("bend", [0.9, 1.1])
def test_a_robot_off_its_map_places_its_contact_within_the_interval(
    tmp_path: Path, bend: float
) -> None:
    scene = Scene.load("default")
    known = scene.believed(1)
    for side in SIDES:
        for muscle_map in scene.robot.muscle(side).maps:
            muscle_map.inflate.amplitude *= bend
            muscle_map.deflate.amplitude *= bend
    result = explored(room_file(tmp_path, scene), tmp_path, 1, config=known)
    truth = result.document.truth
    assert truth is not None
    assert result.document.contacts
    for contact in result.document.contacts:
        low, high = contact.interval_cm
        print(
            f"{bend}: {contact.status}, {low:.1f}..{high:.1f} cm, error {result.document.error_cm}"
        )
        assert any(low - 1.0 <= true.arc_cm <= high + 1.0 for true in truth.contacts)
