"""Swapped motor leads and encoder channels, by the real image: tests/sim has every move."""

from __future__ import annotations

import pytest
from rig import open_rig

from thigmo.emulator.scene import Scene
from thigmo.errors import RobotFaultError

START_CM = 20.0


@pytest.mark.parametrize("move", ["grow", "retract"])
@pytest.mark.parametrize("wiring", ["motor_swapped", "encoder_swapped"])
def test_a_swapped_plug_moves_the_tip_by_millimetres_and_is_named(
    wiring: str, move: str, stored_config: bytes
) -> None:
    scene = Scene.load("empty")
    scene.start_length_cm = START_CM
    scene.spool.wiring = wiring  # type: ignore[assignment]
    rig = open_rig(scene, stored_config)
    robot, lockstep = rig.robot, rig.transport.lockstep
    lengths = []
    advance = lockstep.advance

    def watch() -> None:
        advance()
        lengths.append(lockstep.plant.length_cm)

    lockstep.advance = watch  # type: ignore[method-assign]
    robot.wait(0.3)
    robot.confirm_length(START_CM, settled=True)
    robot.select_zone(0)
    robot.arm()
    with pytest.raises(RobotFaultError, match=r"against its command.*J4.1 and J4.2.*J5.2 and J5.3"):
        (robot.grow_to if move == "grow" else robot.retract_to)(30.0 if move == "grow" else 5.0)
    robot.wait(0.5, despite_faults=True)
    assert 0 < max(abs(length - START_CM) for length in lengths) < 0.2
    assert rig.off
    assert robot.status().length_cm is None
