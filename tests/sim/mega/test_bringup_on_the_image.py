"""Bring-up of a robot with the real image: a motor that is wired the wrong way round is named."""

from __future__ import annotations

from typing import cast

import pytest
from rig import open_rig

from thigmo.bringup import Attendant, BringUp
from thigmo.emulator.scene import Scene


@pytest.mark.ci
def test_a_swapped_motor_is_named() -> None:
    scene = Scene.load("empty")
    scene.start_length_cm = 5.0
    scene.spool.wiring = "motor_swapped"
    rig = open_rig(scene, b"")
    found = BringUp(rig.robot, cast("Attendant", rig.robot.operator)).run()
    wrong = [finding for finding in found if not finding.good]
    assert [(finding.stage, finding.cure) for finding in wrong] == [("motor", "swap J4.1 and J4.2")]
