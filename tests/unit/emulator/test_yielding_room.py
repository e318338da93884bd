"""Scenes with what yields, straight walls, a base that turns and a round tip."""

from __future__ import annotations

from math import hypot
from pathlib import Path

import pytest

from thigmo.emulator.plant import Plant
from thigmo.emulator.scene import PegTable, Scene, WallTable
from thigmo.errors import ConfigError
from thigmo.mechanics import Rod

BEND = 0.02  # 1/cm


def bent(scene: Scene) -> Plant:
    """The whole robot, bent to the left without a muscle's lags."""
    scene.start_length_cm = scene.robot.body.length_cm
    plant = Plant(scene)
    while plant.free_curvature < BEND:
        plant.step((800, 0), (True, True), 0, True)
        if plant.t_s > 20.0:
            raise AssertionError("the muscle does not bend the body so far")
    return plant


def room(**changes: object) -> Scene:
    scene = Scene.load("empty")
    for name, value in changes.items():
        setattr(scene.body, name, value)
    return scene


def excess(plant: Plant) -> float:
    """What the contacts take off the base sensor's curvature, 1/cm."""
    out = plant.free_curvature - plant.sensor_curvature[5]
    return float(out)


def test_a_peg_that_yields_holds_less() -> None:
    stiff, soft = room(), room()
    stiff.pegs = [PegTable(x=34.0, y=10.0, radius=0.6)]
    soft.pegs = [PegTable(x=34.0, y=10.0, radius=0.6, compliance_cm3=10000.0)]
    assert 0.0 < excess(bent(soft)) < 0.8 * excess(bent(stiff))


def test_a_peg_gives_way_for_good_and_stays_in_the_truth() -> None:
    scene = room()
    scene.pegs = [
        PegTable(x=34.0, y=10.0, radius=0.6, gives_way=1e-4),
        PegTable(x=40.0, y=-10.0, radius=0.6),
    ]
    plant = bent(scene)
    assert excess(plant) == pytest.approx(0.0, abs=1e-4)
    truth = plant.truth()
    assert len(truth.pegs) == 2
    assert truth.gave_way == {0}
    assert truth.contacts == ()
    for _ in range(300):
        plant.step((0, 0), (True, True), 0, True)
    assert plant.free_curvature < 1e-3
    while plant.free_curvature < BEND:
        plant.step((800, 0), (True, True), 0, True)
    assert plant.truth().contacts == ()


def test_a_wall_is_touched_and_shown_as_pegs_side_by_side() -> None:
    scene = room()
    scene.walls = [WallTable(x=25.0, y=12.0, end_x=60.0, end_y=14.0, radius=0.3)]
    plant = bent(scene)
    truth = plant.truth()
    assert excess(plant) > 1e-3
    assert len(truth.contacts) >= 1
    for contact in truth.contacts:
        peg = truth.pegs[contact.peg]
        assert hypot(contact.x - peg.x, contact.y - peg.y) == pytest.approx(0.3, abs=0.05)


def test_base_and_tip_are_those_of_the_scene() -> None:
    tube = bent(room(base_compliance_cm=3.0, tip_rounding_cm=1.0)).body.tube
    assert isinstance(bent(room()).body, Rod)
    assert (tube.base_compliance_cm, tube.tip_rounding_cm) == (3.0, 1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[walls]]\nx=-5.0\ny=1.0\nend_x=20.0\nend_y=1.0", "overlaps the robot's base"),
        ("[[walls]]\nx=30.0\ny=9.0\nend_x=30.1\nend_y=9.0", "longer than its radius"),
        ("[body]\ntip_rounding_cm = 2.0", "tip_rounding_cm exceeds"),
        ("[[pegs]]\nx=30.0\ny=9.0\nradius=0.5\ngives_way=0.0", "gives_way"),
    ],
)
def test_impossible_rooms_are_refused(text: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "room.toml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=said):
        Scene.load(file)
