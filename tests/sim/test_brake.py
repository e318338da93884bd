"""The brake at the spool and the contacts in the motor's supply, and the robot without them."""

from __future__ import annotations

import pytest
from emulated import emulated, scene_at

from thigmo.emulator.scene import FaultTable
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import RobotFaultError
from thigmo.link import protocol as wire
from thigmo.robot import Robot


def robot_with(*, brake: bool = True, failure: str = "") -> tuple[Robot, EmulatorTransport]:
    """Configured, at 20 cm; the failure is there before it is armed."""
    scene = scene_at(20.0)
    scene.robot.spool.brake = brake
    robot, transport = emulated(scene)
    robot.configure(transport.config)
    if failure:
        break_now(transport, kind=failure)
        robot.wait(0.1, despite_faults=True)
    return robot, transport


def break_now(transport: EmulatorTransport, **failure: object) -> None:
    table = {"at_s": transport.now(), **failure}
    transport.lockstep.faults.inject(FaultTable.model_validate(table))


def ready(robot: Robot) -> None:
    robot.arm()
    robot.confirm_length(20.0, settled=True)


def test_the_motor_has_its_supply_only_while_it_moves() -> None:
    robot, transport = robot_with()
    plant = transport.lockstep.plant
    assert not plant.motor_power
    ready(robot)
    robot.wait(0.5)
    assert not plant.motor_power
    robot.supervisor.start(wire.GrowTo(300_000, 0))
    robot.wait(1.0)
    assert plant.motor_power
    robot.supervisor.finish(wire.Activity.GROWING, 20.0)
    robot.wait(0.2)
    assert not plant.motor_power
    robot.retract_to(25.0)
    robot.home()
    assert plant.length_cm == 0.0
    assert robot.status().faults == ()


@pytest.mark.parametrize(
    ("failure", "says"),
    [
        ("brake_open", "brake did not hold"),
        ("contact_welded", "supply although it should be cut"),
        ("motor_shorted", "brake did not hold"),  # it pulls with all that it has
    ],
)
def test_arming_proves_brake_and_contacts(failure: str, says: str) -> None:
    robot, transport = robot_with(failure=failure)
    if failure == "motor_shorted":
        transport.lockstep.plant.scene.brake.holds_n = 30.0
    with pytest.raises(RobotFaultError, match=says):
        robot.arm()
    assert abs(transport.lockstep.plant.length_cm - 20.0) < 1.0


def test_a_brake_that_stays_closed_is_a_stall() -> None:
    robot, transport = robot_with()
    ready(robot)
    break_now(transport, kind="brake_closed")
    with pytest.raises(RobotFaultError, match="spool_stall"):
        robot.grow_to(30.0)
    robot.clear_faults()
    robot.arm()
    with pytest.raises(RobotFaultError, match="spool_stall"):  # a base it is not
        robot.home()


def shorted(robot: Robot, transport: EmulatorTransport, duty: int) -> tuple[float, float]:
    """A driver that is shorted in growth; how far the tip goes, and the highest pull."""
    ready(robot)
    robot.supervisor.start(wire.GrowTo(530_000, 0))
    robot.wait(2.0)
    lockstep, length_cm = transport.lockstep, transport.lockstep.plant.length_cm
    break_now(transport, kind="motor_shorted", value=duty)
    pull_n = 0.0
    for _ in range(300):
        transport.pass_time(0.01)
        pull_n = max(pull_n, lockstep.plant.line_n)
    return abs(lockstep.plant.length_cm - length_cm), pull_n


@pytest.mark.parametrize("duty", [800, -800])
def test_a_driver_that_is_shorted_moves_the_tip_by_2_cm_at_most(duty: int) -> None:
    moved_cm, pull_n = shorted(*robot_with(), duty)
    assert moved_cm < 2.0
    assert pull_n < 100.0
    without_cm, _ = shorted(*robot_with(brake=False), duty)
    assert without_cm > 10.0


def test_the_emergency_stop_takes_the_motors_supply_by_itself() -> None:
    """Driver shorted, winding in, and the enable's contact stuck: the stop's own contact acts."""
    robot, transport = robot_with()
    ready(robot)
    plant = transport.lockstep.plant
    break_now(transport, kind="contact_welded")
    break_now(transport, kind="motor_shorted", value=-800)
    transport.pass_time(0.1)
    break_now(transport, kind="estop")
    transport.pass_time(0.2)
    length_cm = plant.length_cm
    assert not plant.motor_power
    transport.pass_time(3.0)
    assert plant.length_cm == length_cm > 10.0


def test_an_emergency_stop_that_leaves_the_motor_its_supply_is_named() -> None:
    robot, transport = robot_with()
    ready(robot)
    robot.supervisor.start(wire.GrowTo(530_000, 0))
    robot.wait(1.0)
    transport.lockstep.board.set_estop(True)  # seen by the board; its other contact stays closed
    robot.wait(0.5, despite_faults=True)
    assert {"estop", "spool_slip"} <= set(robot.status().faults)
    with pytest.raises(RobotFaultError, match="emergency stop did not cut"):
        raise robot.supervisor.fault_error(["spool_slip"])
    robot.wait(1.0, despite_faults=True)
    assert not transport.lockstep.plant.motor_power  # the enable's contact did
