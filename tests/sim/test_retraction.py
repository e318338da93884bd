"""The end of a retraction: a wrong encoder is a fault, or the tip is within what is stated.

The emulated encoder shows a share of its counts from the moment at which the retraction begins.
"""

from __future__ import annotations

import pytest
from emulated import armed, at_each_step, emulated, scene_at

from thigmo.emulator.scene import FaultTable, Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import RobotFaultError
from thigmo.link import protocol as wire
from thigmo.robot import Retraction, Robot
from thigmo_bench.studies.gallery import gallery_robot

GALLERY = ("thick-7", "thick-10", "mixed", "one-column")
INWARDS_CM = 3.0  # or half a pitch, where that is more


def scene_of(name: str, length_cm: float) -> Scene:
    """A free room with a robot of the gallery, or with the thesis's."""
    scene = scene_at(0.0)
    if name != "thesis":
        scene.robot = gallery_robot(name)
    scene.start_length_cm = length_cm
    return scene


def show_share(transport: EmulatorTransport, share: float) -> None:
    """From now on the encoder shows this share of its counts."""
    fault = FaultTable(kind="encoder_share", at_s=transport.now(), value=share)
    transport.lockstep.faults.inject(fault)


def retract(robot: Robot, to_cm: float) -> Retraction | None:
    """None if the board noticed the encoder: the length is unknown then."""
    try:
        return robot.retract_to(to_cm)
    except RobotFaultError:
        status = robot.status()
        assert status.faults == ("spool_stall",)
        assert status.length_cm is None
        return None


@pytest.mark.parametrize("name", ["thesis", "one-column"])
@pytest.mark.parametrize("share", [0.9, 1.05, 1.2, 1.5, 2.0])
@pytest.mark.parametrize(
    ("start_cm", "to_cm"),
    [(50, 0), (50, 12), (50, 26.5), (44, 0), (44, 26.5), (33, 0), (33, 25), (29, 0), (20, 5)],
)
def test_a_wrong_encoder_is_noticed_or_the_tip_is_where_the_retraction_says(
    name: str, share: float, start_cm: float, to_cm: float
) -> None:
    """At 1.2 the tip ended up to a pitch farther out than was shown, without a word."""
    robot, transport = armed(scene_of(name, start_cm))
    show_share(transport, share)
    end = retract(robot, to_cm)
    if end is None:
        return
    farther_cm = transport.lockstep.plant.length_cm - end.length_cm
    inwards_cm = max(INWARDS_CM, robot.config.body.pitch_cm / 2)
    assert -inwards_cm <= farther_cm <= end.farther_cm
    assert f"may be up to {end.farther_cm:.1f} cm farther out if" in end.words


SNAPS_CM = [(50, 0), (44, 12), (33, 0), (29, 0), (20, 0), (20, 12)]


@pytest.mark.parametrize("name", ["thesis", "thick-7", "thick-10", "one-column"])
@pytest.mark.parametrize(("start_cm", "to_cm"), SNAPS_CM)
@pytest.mark.parametrize("after_s", [0.3, 1.0])
def test_a_line_that_snaps_while_the_spool_winds_in_is_noticed(
    name: str, start_cm: float, to_cm: float, after_s: float
) -> None:
    """The body grew to its full length, and the retraction ended as if it were home."""
    robot, transport = armed(scene_of(name, start_cm))
    fault = FaultTable(kind="line_snapped", at_s=transport.now() + after_s)
    transport.lockstep.faults.inject(fault)
    assert retract(robot, to_cm) is None


def half_blind(start_cm: float, share: float) -> tuple[Robot, EmulatorTransport]:
    """A robot of one column, of whose five sensors the two at the base are dead."""
    scene = scene_of("one-column", start_cm)
    for sensor in scene.robot.column("right")[:2]:
        sensor.healthy = False
    robot, transport = armed(scene)
    show_share(transport, share)
    return robot, transport


def test_the_length_is_in_doubt_from_the_last_sensor_that_works() -> None:
    """Two sensors of five are dead: nothing judges the last 25 cm."""
    robot, transport = half_blind(50.0, 1.2)
    robot.retract_to(28.0)
    end = robot.retract_to(0.0)
    assert end.seen_by == "right 2"
    assert 4.0 < transport.lockstep.plant.length_cm <= end.farther_cm
    assert f"the last sensor that confirmed it was right 2, at {end.seen_cm:.1f} cm" in end.words


def test_a_sensor_that_was_late_is_for_the_operator_to_look_at() -> None:
    """It passed the tip alone, so the board accuses nobody."""
    robot, transport = half_blind(30.0, 1.5)
    end = robot.retract_to(0.0)
    assert end.late
    assert 4.0 < transport.lockstep.plant.length_cm <= end.farther_cm
    assert "That sensor was late: look at the tip." in end.words


@pytest.mark.parametrize("name", ["thesis", *GALLERY])
@pytest.mark.parametrize(("start_cm", "to_cm"), [(50, 0), (50, 12), (44, 24), (29, 0), (20, 17)])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_sound_robot_is_confirmed(name: str, start_cm: float, to_cm: float, seed: int) -> None:
    """As a session's first move, too: what moved a thick body in was taken for a stall."""
    scene = scene_of(name, start_cm)
    robot, transport = armed(scene, seed)
    end = robot.retract_to(to_cm)
    assert not end.late
    assert abs(transport.lockstep.plant.length_cm - to_cm) < 0.2
    assert "look at the tip" not in end.words


def test_a_robot_without_sensors_says_that_the_encoder_is_alone() -> None:
    scene = scene_at(20.0)
    for sensor in scene.robot.board_sensors:
        sensor.healthy = False
    robot, _ = armed(scene)
    end = robot.retract_to(10.0)
    assert not end.late
    assert "no sensor of this robot shows where its tip is" in end.words


@pytest.mark.parametrize("share", [0.5, 0.7, 0.9])
@pytest.mark.parametrize("start_cm", [3.0, 4.0, 20.0])
def test_a_body_that_is_home_early_bears_no_more_than_its_line(
    share: float, start_cm: float
) -> None:
    """The base ends the motion: the spool stalls there, by a duty that line and tail bear."""
    robot, transport = armed(scene_at(start_cm))
    plant = transport.lockstep.plant
    pulls_n: list[float] = []
    at_each_step(transport, lambda: pulls_n.append(plant.line_n))
    show_share(transport, share)
    assert retract(robot, 0.0) is None
    assert max(pulls_n) <= robot.config.spool.line_rating_n
    assert robot.status().faults == ("spool_stall",)


def test_homing_confirms_the_length() -> None:
    robot, _ = emulated(scene_at(6.0))
    robot.configure(scene_at(6.0).robot)
    robot.arm()
    robot.confirm_length(6.0, settled=True)
    robot.home()
    tip = robot.link.request(wire.GetTip())
    assert (tip.sensor, tip.length_um) == (255, 0)
