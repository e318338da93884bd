"""Motor leads or encoder channels that are swapped: the first millimetres tell.

Both together look right to the board; which way the spool turns, somebody must have seen once.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from command import Thigmo
from emulated import Serve, armed, at_each_step, scene_at

from thigmo.bringup import BringUp
from thigmo.errors import RobotFaultError
from thigmo.robot import Robot

START_CM = 20.0
MOVES = {
    "grow": lambda robot: robot.grow_to(40.0),
    "retract": lambda robot: robot.retract_to(0.0),
    "home": Robot.home,
}


@pytest.mark.parametrize("psi", [0.49, 1.47])
@pytest.mark.parametrize("move", MOVES)
@pytest.mark.parametrize("wiring", ["motor_swapped", "encoder_swapped"])
def test_a_swapped_plug_moves_the_tip_by_millimetres_and_is_named(
    wiring: str, move: str, psi: float
) -> None:
    scene = scene_at(START_CM)
    scene.spool.wiring = wiring  # type: ignore[assignment]
    robot, transport = armed(scene)
    plant = transport.lockstep.plant
    plant.set_body_pressure(psi)
    lengths = [plant.length_cm]
    at_each_step(transport, lambda: lengths.append(plant.length_cm))
    with pytest.raises(RobotFaultError, match=r"went the wrong way.*J4.1 and J4.2.*J5.2 and J5.3"):
        MOVES[move](robot)
    robot.wait(0.5, despite_faults=True)
    assert max(abs(length - START_CM) for length in lengths) < 0.2
    assert robot.status().length_cm is None  # it is asked for again


def test_each_armed_session_proves_its_direction() -> None:
    robot, transport = armed(scene_at(START_CM))
    robot.grow_to(25.0)
    robot.disarm()
    transport.lockstep.plant.scene.spool.wiring = "motor_swapped"  # somebody works on the plug
    robot.arm()
    with pytest.raises(RobotFaultError, match="went the wrong way"):
        robot.grow_to(30.0)


def test_both_swapped_look_right_to_the_board_and_are_seen_at_bringup() -> None:
    scene = scene_at(5.0)  # line to spare, also backwards
    robot, transport = armed(scene)
    robot.make_safe()
    attendant = robot.operator
    good = BringUp(robot, attendant).run("motor", "motor")  # type: ignore[arg-type]
    assert [finding.good for finding in good] == [True]
    assert robot.parameter("direction_seen") == [1]
    transport.lockstep.plant.scene.spool.wiring = "both_swapped"
    robot.wait(0.1, despite_faults=True)  # its count has jumped
    robot.clear_faults()
    (jog,) = BringUp(robot, attendant).run("motor", "motor")  # type: ignore[arg-type]
    assert "J4.1 and J4.2, and J5.2 and J5.3" in jog.cure
    assert robot.parameter("direction_seen") == [0]


@pytest.mark.realtime
def test_a_robot_whose_direction_nobody_has_seen_does_not_move(
    thigmo: Thigmo, serve: Serve, tmp_path: Path
) -> None:
    scene = scene_at(START_CM)
    port, config = serve(scene).port, tmp_path / "robot.toml"
    scene.robot.save(config)
    retract = ("retract", "--robot", port, "--config", config, "--length", START_CM, "--to", 19.0)
    assert thigmo("params", "--robot", port, "direction_seen", 0, "--save").code == 0
    refused = thigmo(*retract)
    assert refused.code == 1
    assert refused.err.count("\n") == 1
    assert f"thigmo bringup --robot {port} --from motor" in refused.err
    assert thigmo("params", "--robot", port, "direction_seen", 1, "--save").code == 0
    moved = thigmo(*retract)
    assert moved.code == 0
    assert "19.0 cm" in moved.out
    assert moved.err == (
        "Warning: no brake is fitted: the emergency stop leaves the motor its supply; "
        "keep hands away and shut V1\n"
    )
