"""Bring-up of the whole emulated robot: what is wired wrong is found, and named with its plug."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from emulated import emulated

from thigmo.bringup import STAGES, BringUp, Finding, jog, press
from thigmo.emulator.scene import FaultTable, Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import ConfigError, RobotFaultError
from thigmo.link import protocol as wire
from thigmo.robot import Robot


def new_robot(change: Callable[[Scene], None] = lambda scene: None) -> Robot:
    """A board as it comes from `thigmo flash`, in a robot that was built by hand."""
    scene = Scene.load("empty")
    change(scene)
    return emulated(scene, seed=0)[0]


def bring_up(change: Callable[[Scene], None] = lambda scene: None) -> list[Finding]:
    robot = new_robot(change)
    return BringUp(robot, robot.operator).run()  # type: ignore[arg-type]


def fault(**keys: object) -> Callable[[Scene], None]:
    return lambda scene: scene.faults.append(FaultTable.model_validate({"at_s": 0.0, **keys}))


def wiring(how: str) -> Callable[[Scene], None]:
    def change(scene: Scene) -> None:
        scene.spool.wiring = how  # type: ignore[assignment]
        scene.start_length_cm = 5.0  # line to spare, also backwards

    return change


def fitted(scene: Scene) -> None:
    scene.enables.fitted = True


def bring_up_braked(failure: str) -> list[Finding]:
    """Of a robot with valves and brake, in which something fails after its motor was checked."""
    scene = Scene.load("empty")
    scene.enables.fitted = scene.robot.spool.brake = True
    robot, transport = emulated(scene, seed=0)
    run = BringUp(robot, robot.operator)  # type: ignore[arg-type]
    assert all(finding.good for finding in run.run(last="motor"))
    robot.configure(transport.config)
    plant = transport.lockstep.plant
    if failure == "stop":
        type(plant).estop = property(lambda self: False, lambda self, on: None)  # type: ignore[assignment]
    elif failure:
        robot.wait(0.5)
        plant.brake_stuck = True
    try:
        return run.run("brake", "brake")
    finally:
        if failure == "stop":
            del type(plant).estop


@pytest.mark.parametrize(
    ("failure", "cure"), [("", ""), ("brake_open", "check the brake"), ("stop", "S1C")]
)
def test_bringup_proves_the_brake_and_the_stops_contact(failure: str, cure: str) -> None:
    *_, last = bring_up_braked(failure)
    assert last.good is not bool(failure)
    assert cure in last.cure


def test_a_valve_that_does_not_empty_its_muscle_is_named() -> None:
    robot = new_robot(fitted)
    plant = robot.operator._plant  # type: ignore[union-attr]
    plant.scene.enables.fitted = False  # its enable does nothing, though a valve is there
    robot.operator.valves_fitted = lambda: True  # type: ignore[union-attr, method-assign]
    findings = BringUp(robot, robot.operator).run(last="enables")  # type: ignore[arg-type]
    assert [(f.subject, f.good) for f in findings if f.stage == "enables"][:2] == [
        ("Y1", False), ("Y2", False),
    ]  # fmt: skip


@pytest.mark.parametrize("change", [lambda scene: None, fitted], ids=["thesis's robot", "enables"])
def test_a_robot_that_is_wired_right_passes(change: Callable[[Scene], None]) -> None:
    findings = bring_up(change)
    assert [f for f in findings if not f.good] == []
    stages = list(dict.fromkeys(finding.stage for finding in findings))
    assert stages == list(STAGES)
    assert len([f for f in findings if f.stage == "flex"]) == 10


@pytest.mark.parametrize("psi", [-1.2, 0.6, 1.2])
def test_a_pressure_sensor_within_its_error_band_is_zeroed_and_passes(psi: float) -> None:
    robot = new_robot(fault(kind="pressure_offset", value=psi))
    findings = BringUp(robot, robot.operator).run()  # type: ignore[arg-type]
    assert [f for f in findings if not f.good] == []
    (left,) = [f for f in findings if f.subject == "pressure left"]
    assert "stored as its zero" in left.observation
    assert robot.read(0.3).pressure_psi[0] == pytest.approx(0.0, abs=0.1)
    assert robot.status().config_generation == 3  # after the defaults; then the direction


WRONG = {
    "supply": (fault(kind="brown_out", value=4000.0), "supply", "5 V", "USB cable"),
    "e-stop wire broken": (fault(kind="estop"), "estop", "emergency stop", "pin 22"),
    "pressure sensor unplugged": (
        fault(kind="pressure_wire_cut", side="right"), "pressure", "pressure right", "J9",
    ),
    "flex sensor unplugged": (
        fault(kind="flex_wire_cut", side="left", sensor=2), "flex", "flex left 2", "J6.4",
    ),
    "flex sensor shorted": (
        fault(kind="flex_short", side="right", sensor=0), "flex", "flex right 0", "J7.2",
    ),
    "dead valve": (
        fault(kind="over_pressure", value=0.0, side="right"), "valves", "valve right", "J11.1",
    ),
    "no air": (fault(kind="air_lost"), "valves", "valve left", "check air"),
    "valve that does not vent": (
        fault(kind="over_pressure", value=3.0, above_pressure_psi=2.0), "valves", "valve left",
        "exhaust",
    ),
    "motor swapped": (wiring("motor_swapped"), "motor", "motor", "swap J4.1 and J4.2"),
    "encoder swapped": (wiring("encoder_swapped"), "motor", "encoder", "swap J5.2 (A) and J5.3"),
    "encoder unplugged": (wiring("encoder_unplugged"), "motor", "encoder", "check J5"),
    "motor unplugged": (fault(kind="spool_stall"), "motor", "motor", "12 V, F2, J4"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_found_and_named(name: str) -> None:
    change, stage, subject, cure = WRONG[name]
    findings = bring_up(change)
    wrong = [finding for finding in findings if not finding.good]
    assert {finding.stage for finding in wrong} == {stage}, findings
    assert subject in [finding.subject for finding in wrong]
    assert cure in wrong[0].cure
    assert findings[-1].stage == stage  # nothing that follows is tried


def test_a_fresh_board_gets_its_defaults_stored() -> None:
    robot = new_robot()
    assert "bad_config" in robot.status().faults
    robot.load_defaults()
    status = robot.status()
    assert "bad_config" not in status.faults
    assert status.config_generation == 1


def ready(change: Callable[[Scene], None] = lambda scene: None) -> Robot:
    robot = new_robot(change)
    robot.load_defaults()
    robot.arm(body_air=False)
    robot.vent()
    return robot


@pytest.mark.parametrize("cm", [2.0, -1.0])
def test_a_jog_goes_as_far_as_asked(cm: float) -> None:
    robot = ready()
    if cm < 0:
        jog(robot, 2.0)
    assert jog(robot, cm) == pytest.approx(cm, abs=0.5)
    assert robot.status().activity == "idle"


def test_a_jog_ends_when_the_encoder_disagrees() -> None:
    with pytest.raises(RobotFaultError, match="other way"):
        jog(ready(wiring("encoder_swapped")), 2.0)
    with pytest.raises(RobotFaultError, match="stands still"):
        jog(ready(wiring("encoder_unplugged")), 2.0)
    with pytest.raises(ConfigError, match="at most 5 cm"):
        jog(ready(), 6.0)


def test_a_jog_ends_with_its_host() -> None:
    robot = ready()
    transport = robot.link.transport
    assert isinstance(transport, EmulatorTransport)
    robot.test_output(wire.Output.MOTOR, 160, 0.4)
    transport.pass_time(0.1)
    assert transport.lockstep.board.motor == 160
    transport.lockstep.faults.host_silent = True
    transport.pass_time(0.4)
    assert transport.lockstep.board.braked
    assert transport.lockstep.plant.line_cm < 4.0


def test_a_press_shows_the_pressure_and_vents() -> None:
    robot = ready()
    pressures: list[float] = []
    assert press(robot, "right", 3.0, 4.0, pressures.append) == pytest.approx(3.0, abs=0.7)
    assert len(pressures) > 10
    robot.wait(3.0)
    assert robot.status().pressure_psi[1] < 0.5
    with pytest.raises(ConfigError, match="at most 5 psi"):
        press(robot, "left", 6.0, 1.0)
    with pytest.raises(ConfigError, match="no muscle port; use left"):
        press(robot, "port", 3.0, 1.0)
