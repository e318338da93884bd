"""From rendered pictures only: an unknown robot is calibrated and explored, its peg found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import thigmo
from thigmo.calibrate import steps
from thigmo.calibrate.bench import Bench, Plan
from thigmo.calibrate.overhead import OverheadCamera
from thigmo.calibrate.session import Session, blank
from thigmo.camera import Sheet, locate
from thigmo.config import SIDES
from thigmo.emulator.scene import Scene

PLAN = Plan(places=8, straight=2, trials=1, step_psi=4.5, pushes=4, creep_s=20.0)


def unknown_robot(seed: int) -> Scene:
    """The default room with a robot that nobody has measured."""
    scene = Scene.load("default")
    rng = np.random.default_rng(seed)
    for side in SIDES:
        for sensor in scene.robot.column(side):
            sensor.scale_per_ohm = float(rng.uniform(2.6e-5, 4.4e-5))
            sensor.zero_ohm = float(rng.uniform(9e3, 14e3))
        for muscle_map in scene.robot.muscle(side).maps:
            stretch = float(rng.uniform(0.9, 1.1))
            muscle_map.inflate.amplitude *= stretch
            muscle_map.deflate.amplitude *= stretch
    scene.robot.spool.counts_per_cm = 71.0
    scene.robot.body.critical_curvature = 0.0118
    return scene


def save(scene: Scene, path: Path) -> str:
    scene.save(path)
    return f"emulator://{path}"


def test_calibration_begins_without_any_of_the_truth():
    begun = blank(unknown_robot(11).robot)
    assert begun == blank(unknown_robot(12).robot)
    assert begun.body.critical_curvature != 0.0118
    assert begun.spool.counts_per_cm != 71.0


@pytest.mark.ci
def test_from_pixels_to_the_map(tmp_path):
    scene = unknown_robot(11)
    room = save(scene, tmp_path / "room.toml")
    bare = scene.model_copy(deep=True)
    bare.pegs = []
    url = save(bare, tmp_path / "bare.toml")
    truth = scene.robot

    with thigmo.connect(url, seed=4) as robot:
        sheet = Sheet()
        source, height = robot.overhead_pictures(sheet, seed=8)
        sheet.camera_height_cm = height
        camera = locate(source.read(), sheet)
        session = Session(tmp_path / "calibration", blank(truth))
        bench = Bench(robot, OverheadCamera(source, camera, sheet), session, PLAN)
        bench.start()
        for step in ("pressure", "encoder", "actuator", "flex", "buckling"):
            result = steps.run(bench, step)
            assert result.verdict.good, result.verdict
    config = session.config

    pairs = [
        (fitted, true)
        for side in SIDES
        for fitted, true in zip(config.column(side), truth.column(side), strict=True)
    ]
    errors = np.array([fitted.scale_per_ohm / true.scale_per_ohm - 1 for fitted, true in pairs])
    stated = np.array([fitted.scale_se for fitted, _ in pairs])
    assert np.abs(errors).max() < 0.02
    assert np.mean((errors / stated) ** 2) < 3.0
    assert [fitted.bend_sign for fitted, _ in pairs] == [t.bend_sign for _, t in pairs]
    for side in SIDES:
        for fitted, true in zip(config.muscle(side).maps, truth.muscle(side).maps, strict=True):
            full = true.inflate.curvature(18.0)
            for branch in ("inflate", "deflate"):
                curve, right = getattr(fitted, branch), getattr(true, branch)
                gap = [curve.curvature(p) - right.curvature(p) for p in np.arange(0.0, 18.1)]
                assert np.abs(gap).max() < 0.006 * full
    assert config.body.critical_curvature == pytest.approx(0.0118, rel=0.03)
    assert config.spool.counts_per_cm == pytest.approx(71.0, rel=0.01)
    # By half of body pressure times section, against 147 N at full duty.
    pulls = [pressure.pull_duty for pressure in config.body.pressures]
    assert pulls == pytest.approx(
        [17.7 * pressure.pressure_psi for pressure in config.body.pressures], abs=4.0
    )

    (peg,) = scene.pegs
    with thigmo.connect(room, seed=4) as robot:
        source, _ = robot.overhead_pictures(sheet, seed=8)
        # The operator has measured the dowels' thickness, not their places.
        obstacles = OverheadCamera(source, camera, sheet, dowel_radius_cm=0.6).detection().obstacles
    where = obstacles[0]
    assert (where.x_cm, where.y_cm) == pytest.approx((peg.x, peg.y), abs=0.3)

    explored = thigmo.explore(room, config=config, seed=4, out=tmp_path)
    document = explored.document
    assert len(document.contacts) >= 1
    assert document.error_x_cm < 3.0
