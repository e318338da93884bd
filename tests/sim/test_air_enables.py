"""Valves that empty muscles and body: what the whole robot does with them fitted."""

from __future__ import annotations

import pytest
from emulated import armed, scene_at

from thigmo.emulator.scene import FaultTable
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import LinkError, RobotFaultError
from thigmo.robot import Robot


def breathing() -> tuple[Robot, EmulatorTransport]:
    """A robot with the valves, armed, its body filled, 10 cm out."""
    scene = scene_at(10.0)
    scene.enables.fitted = True
    robot, transport = armed(scene)
    robot.select_body_pressure(0)
    robot.wait(15.0)
    return robot, transport


def test_body_and_muscle_empty_at_the_emergency_stop() -> None:
    robot, transport = breathing()
    plant = transport.lockstep.plant
    assert plant.body_psi == pytest.approx(1.47, abs=0.05)
    robot.zero()
    robot.press("left", 10.0)
    robot.wait(3.0)
    assert plant.muscle_psi[0] == pytest.approx(10.0, abs=0.5)
    transport.lockstep.board.set_estop(True)
    with pytest.raises(RobotFaultError, match="estop"):
        robot.wait(3.0)
    transport.pass_time(3.0)
    assert plant.muscle_psi[0] < 0.5
    assert plant.body_psi < 0.1
    transport.lockstep.board.set_estop(False)
    transport.pass_time(5.0)
    assert not robot.clear_faults()
    assert plant.body_psi < 0.1  # released is not armed
    robot.arm()
    robot.wait(15.0)
    assert plant.body_psi == pytest.approx(1.47, abs=0.05)


def test_a_shorted_current_stage_is_emptied_by_the_enable() -> None:
    robot, transport = breathing()
    lockstep = transport.lockstep
    robot.zero()
    lockstep.faults.inject(FaultTable(kind="over_pressure", at_s=robot.now(), value=25.0))
    with pytest.raises(RobotFaultError, match=r"over_pressure|pressure_stuck"):
        robot.wait(5.0)
    transport.pass_time(2.0)
    assert lockstep.plant.muscle_psi[0] < 0.5
    assert "over_pressure" in lockstep.faults.active  # the stage is still shorted


def test_growth_ends_when_the_program_hangs() -> None:
    robot, transport = breathing()
    plant = transport.lockstep.plant
    transport.lockstep.faults.inject(
        FaultTable(kind="hang", at_s=robot.now() + 3.0, while_motor_runs=True)
    )
    with pytest.raises(LinkError, match="restarted"):
        robot.grow_to(40.0)
    reached = plant.length_cm
    transport.pass_time(10.0)
    assert plant.body_psi < 0.1
    assert plant.length_cm - reached < 0.1
