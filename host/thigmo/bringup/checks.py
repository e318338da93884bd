"""The checklist of the first power-up: questions, measurements and cures.

Stages run in the order in which they are safe: nothing is energised before the emergency stop has
been seen to work, no air before the sensors that watch it, no motion before its direction is known.
A stage in which something is wrong is the last. Names of plugs are those of docs/hardware.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, Protocol

from thigmo.bringup.push import duty_of, push
from thigmo.config import SIDES
from thigmo.errors import RobotFaultError, ThigmoError
from thigmo.link.protocol import Output
from thigmo.robot import WITHOUT_BRAKE, Robot

_ESTOP_S = 1.0
_EMPTY_PSI = 1.5  # a sensor's error before its zero is calibrated
_ZERO_PSI = 0.1  # less is for `thigmo calibrate pressure`
_BROKEN_PSI = -4.0  # an input at 0 V reads 0 - 10 % of 75 psi
_FLAT_OHM = (5e3, 6e4)  # 10 or 25 kOhm +- 30 %, bent or not
_TEST_MA = 4.2  # just above the live zero: 2.7 psi of a 2..60 psi transducer
_TEST_S = 1.5
_RISE_PSI = (0.8, 5.0)
_NO_RISE_PSI = 0.4
_VENT_S = 4.0
_BODY_S = 15.0  # to fill it through its throttle
_LIMP_S = 3.0
_STOP_S = 8.0
_TURN_DUTIES = (100, 150, 200)  # of 800
_TURN_S = 0.3
_TURN_CM = 0.03

# Subject, observation and cure ("" = good) of each thing that a check looks at.
CheckOutcomes = Iterator[tuple[str, str, str]]
SpoolTurn = Literal["out", "in", "not"]


class Attendant(Protocol):
    """The person beside the robot, who does by hand what a check asks for, and reports on it."""

    def ready(self, request: str) -> None:
        """Show a request; return when the person has carried it out."""

    def press_emergency_stop(self, pressed: bool) -> None:
        """Press the emergency stop, or release it; return when it is done."""

    def press_emergency_stop_soon(self) -> None:
        """Press the emergency stop two seconds after this returns."""

    def valves_fitted(self) -> bool:
        """Say whether valves Y1 to Y3 are there."""

    def body_is_limp(self) -> bool:
        """Say whether the body has lost its air."""

    def spool_turned(self) -> SpoolTurn:
        """Say how the spool turned since the last question: it paid out, wound in, or neither."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What a check found."""

    stage: str  # one of `STAGES`
    subject: str  # the part that was checked
    good: bool  # nothing is wrong with it
    observation: str  # what was measured, or what is wrong
    cure: str = ""  # what to do about it; empty if good


def _board(robot: Robot, _: Attendant) -> CheckOutcomes:
    firmware = "{firmware} on {board}, reset cause {reset_cause}".format_map(robot.identity)
    yield "firmware", firmware, ""
    observation = "valid"
    if "bad_config" in robot.status().faults:
        robot.load_defaults()
        observation = "there was none: defaults loaded and stored"
    yield "configuration", observation, ""


def _supply(robot: Robot, _: Attendant) -> CheckOutcomes:
    status = robot.status()
    observation, cure = f"{status.supply_v:.2f} V, by the board", ""
    if "supply_good" not in status.conditions:
        observation = f"{status.supply_v:.2f} V by the board, below supply_min_mv"
        cure = ("measure 5 V at the Mega; if it is good, correct reference_mv, else use a better "
                "USB cable or port")  # fmt: skip
    yield "5 V", observation, cure


def _estop(robot: Robot, attendant: Attendant) -> CheckOutcomes:
    observation = "reads pressed while it is released"
    if _estop_reads(robot, False):
        attendant.press_emergency_stop(True)
        pressed_seen = _estop_reads(robot, True)
        attendant.press_emergency_stop(False)
        observation = "pressed, and not seen"
        if pressed_seen:
            observation = "released, and still read as pressed"
            if _estop_reads(robot, False):
                robot.clear_faults("estop")
                yield "emergency stop", "seen pressed and released", ""
                return
    yield "emergency stop", observation, "check S1's contact at J15.1-2, R41 and the wire to pin 22"


def _estop_reads(robot: Robot, pressed: bool) -> bool:
    """Whether the emergency stop reads so within a second."""
    end = robot.now() + _ESTOP_S
    while ("estop" in robot.status().conditions) is not pressed:
        if robot.now() > end:
            return False
        robot.wait(0.05, despite_faults=True)
    return True


def _muscles(robot: Robot) -> list[str]:
    return [muscle.name for muscle in robot.config.muscles]


def _psi(robot: Robot, seconds: float = 0.1) -> tuple[float, ...]:
    return robot.read(seconds, despite_faults=True).pressure_psi


def _pressure(robot: Robot, attendant: Attendant) -> CheckOutcomes:
    attendant.ready("Shut the air off (V1): muscles and body are empty")
    robot.clear_faults()
    pressures = _psi(robot, 0.3)
    zero, span = robot.parameter("pressure_zero"), robot.parameter("pressure_span")
    full_psi = robot.parameter("pressure_full_cpsi")[0] / 100
    zeros_changed = False
    for index, (name, psi) in enumerate(zip(_muscles(robot), pressures, strict=True)):
        plug = f"J{8 + index}"
        observation, cure = f"{psi:+.2f} psi, empty", ""
        if psi < _BROKEN_PSI:
            observation, cure = "no signal", f"plug it in, check {plug}.1 (5 V), {plug}.2"
        elif abs(psi) > _EMPTY_PSI:
            observation = f"{psi:.1f} psi with the air off"
            cure = f"empty the muscle; else check {plug}, or the sensor is none of 0..60 psi"
        elif abs(psi) > _ZERO_PSI:
            # A sensor's error may be more than a muscle that counts as empty may hold.
            zero[index] += round(psi / full_psi * span[index])
            zeros_changed = True
            observation += ": stored as its zero"
        yield f"pressure {name}", observation, cure
    if zeros_changed:
        robot.set_parameter("pressure_zero", zero)
        robot.save()
        robot.clear_faults()


def _flex(robot: Robot, _: Attendant) -> CheckOutcomes:
    enabled = robot.parameter("flex_enabled")
    robot.clear_faults()
    ohms = robot.read(0.3, despite_faults=True).resistance
    for sensor in range(len(ohms)):
        side, index = divmod(sensor, len(ohms) // 2)
        pin = f"J{6 + side}.{index + 2}"
        is_open, is_short = robot.flex_circuit(sensor)
        observation, cure = f"{ohms[sensor] / 1e3:.1f} kOhm", ""
        if not enabled[sensor]:
            observation = "not in use (flex_enabled)"
        elif is_open:
            observation = "open"
            cure = f"plug it in, check {pin} and its 5 V; a dead one: flex_enabled 0"
        elif is_short:
            observation, cure = "shorted", f"check {pin} for a short to 5 V"
        elif not _FLAT_OHM[0] < ohms[sensor] < _FLAT_OHM[1]:
            cure = f"check its divider at {pin}"
        yield f"flex {SIDES[side]} {index}", observation, cure


def _valves(robot: Robot, attendant: Attendant) -> CheckOutcomes:
    attendant.ready("Turn the 24 V on, then the air: FR1 at 25 psi. Hands away from the muscles")
    robot.arm(body_air=False)
    robot.vent()
    for side, name in enumerate(_muscles(robot)):
        plug, point = f"J{10 + side}", f"TP{10 * side + 1}"
        previous_psi = _psi(robot)
        push(robot, Output.TRANSDUCER, duty_of(_TEST_MA), _TEST_S, side)
        rises = [b - a for a, b in zip(previous_psi, _psi(robot), strict=True)]
        robot.vent(wait=False)  # ends the push
        robot.wait(_VENT_S, despite_faults=True)
        remaining_psi = _psi(robot)[side]
        rise_psi, other_rise_psi = rises[side], max([0.0, *rises[:side], *rises[side + 1 :]])
        effect = f"{_TEST_MA} mA moves its pressure by {rise_psi:.1f} psi"
        stuck = False
        if rise_psi < _NO_RISE_PSI and other_rise_psi > _RISE_PSI[0]:
            observation = f"{_TEST_MA} mA moves another muscle's pressure"
            cure = f"swap the tubes of Y1 and Y2, or {plug} with its neighbour, or J8 and J9"
        elif rise_psi < _NO_RISE_PSI:
            observation = f"dead: {effect}"
            cure = (f"check air, 24 V at {plug}.1, {0.1 * _TEST_MA:.2f} V at {point}, "
                    f"Y{side + 1} (enable, pin 24) and its tube")  # fmt: skip
        elif not _RISE_PSI[0] <= rise_psi <= _RISE_PSI[1]:
            observation, cure = (
                effect,
                "check the transducer's range: 4..20 mA to 2..60 psi is expected",
            )
        elif stuck := remaining_psi - previous_psi[side] > _NO_RISE_PSI:
            observation = f"at 0 mA it keeps {remaining_psi:.1f} psi"
            cure = f"check its exhaust, and that {point} is at 0 V"
        else:
            observation, cure = f"{effect}; 0 mA vents", ""
        yield f"valve {name}", observation, cure
        if stuck:
            return  # the board may have latched it: it drives no other now


def _enables(robot: Robot, attendant: Attendant) -> CheckOutcomes:
    """Each valve must empty its muscle or body while the transducer's current still flows."""
    if not attendant.valves_fitted():
        yield "valves Y1 to Y3", "none: 0 mA alone empties the muscles, V1 the body", ""
        return
    robot.arm(body_air=False)
    robot.vent()
    current = duty_of(_TEST_MA)
    for side in range(len(_muscles(robot))):
        empty = _psi(robot)[side]
        push(robot, Output.TRANSDUCER, current, _TEST_S, side)
        full = _psi(robot)[side]
        robot.vent(wait=False)
        push(robot, Output.VENT, current, _TEST_S, side)
        remaining_psi = _psi(robot)[side]
        robot.vent(wait=False)
        robot.wait(_VENT_S)
        observation, cure = (
            f"{full:.1f} psi; without its enable {remaining_psi:.1f} psi at {_TEST_MA} mA",
            "",
        )
        if full - empty < _NO_RISE_PSI:
            observation, cure = "no pressure to empty", "go on from stage valves"
        elif remaining_psi - empty > _NO_RISE_PSI:
            cure = f"Y{side + 1} sticks or is bridged, or Q21 is shorted: check J{12 + side}"
        yield f"Y{side + 1}", observation, cure
    if not _grows(robot):
        return  # its body holds no air
    attendant.ready("Set PR1 to 0.5 psi: the body fills and must stand firm")
    robot.body_air(True)
    robot.wait(_BODY_S)
    firm = not attendant.body_is_limp()
    robot.body_air(False)
    robot.wait(_LIMP_S)
    limp = attendant.body_is_limp()
    observation, cure = "fills the body, and empties it without its enable", ""
    if not firm:
        observation, cure = "the body does not fill", "check PR1, NV1, Y3 (J14) and pin 26"
    elif not limp:
        observation, cure = "the body keeps its air without the enable", "check Y3, Q31 and J14"
    yield "Y3", observation, cure


def _grows(robot: Robot) -> bool:
    return bool(robot.parameter("grows")[0])


def _brake(robot: Robot, attendant: Attendant) -> CheckOutcomes:
    """Arming has proved that the brake holds; the motor's turn, that it opens."""
    if not robot.parameter("brake_fitted")[0]:
        yield "brake", f"none (brake = false in robot.toml): {WITHOUT_BRAKE}", ""
        return
    robot.make_safe()
    robot.arm(body_air=False)  # a brake that slips and a contact that sticks are its faults
    robot.wait(0.5)
    yield "brake", "holds 20 N against the motor; K2 cuts its supply", ""
    attendant.press_emergency_stop_soon()
    faults: tuple[str, ...] = ()
    try:
        push(robot, Output.MOTOR, 1, _STOP_S)  # gives the motor its supply, and moves nothing
        robot.vent(wait=False)
    except RobotFaultError as error:
        faults = error.faults
    robot.wait(0.5, despite_faults=True)
    faults = (*faults, *robot.status().faults)
    attendant.press_emergency_stop(False)
    observation, cure = "its own contact cuts the motor's supply", ""
    if "estop" not in faults:
        observation, cure = "was not pressed, or not seen", "try again: `--from brake`"
    elif "spool_slip" in faults:
        observation = "leaves the motor its supply"
        cure = "check S1C at J15.5-6, and K1: its contact sticks, or it is bridged"
    else:
        robot.wait(0.2, despite_faults=True)
        robot.clear_faults()
    yield "emergency stop", observation, cure


def _motor(robot: Robot, attendant: Attendant) -> CheckOutcomes:
    attendant.ready(
        "Body air off. Turn the 12 V on; the tail is free, or has 5 cm of line to spare"
    )
    robot.arm(body_air=False)
    robot.vent()
    attendant.spool_turned()
    for duty in _TURN_DUTIES:
        previous_cm = robot.read(0.1).length_cm
        push(robot, Output.MOTOR, duty, _TURN_S)
        robot.vent(wait=False)
        robot.wait(0.5)
        moved = robot.read(0.1).length_cm - previous_cm
        if abs(moved) >= _TURN_CM:
            break
    turned = attendant.spool_turned()
    movement = f"driven to pay out, the encoder goes {moved:+.2f} cm"
    counted = 0 if abs(moved) < _TURN_CM else 1 if moved > 0 else -1
    subject, observation, cure = "motor", movement, ""
    if counted == 0 and turned == "not":
        observation, cure = "does not turn", "free the tail; check 12 V, F2, J4, pin 6"
    elif counted == 0:
        subject, observation = "encoder", "the spool turns, the encoder stands still"
        cure = "check J5: 5 V, A, B"
    elif turned == "not":
        subject, observation = "encoder", f"{movement}, the spool does not turn"
        cure = "check J5 and its coupling"
    elif turned == "in" and counted < 0:
        observation, cure = f"winds in when driven to pay out ({movement})", "swap J4.1 and J4.2"
    elif turned == "in":
        observation = "winds in when driven to pay out, and the encoder counts backwards"
        cure = "swap J4.1 and J4.2, and J5.2 and J5.3"
    elif counted < 0:
        subject, observation = "encoder", f"counts backwards: {movement}"
        cure = "swap J5.2 (A) and J5.3 (B)"
    if robot.parameter("direction_seen") != [int(not cure)]:
        robot.set_parameter("direction_seen", [int(not cure)])
        robot.save()
    yield subject, observation, cure


def _home(robot: Robot, attendant: Attendant) -> CheckOutcomes:
    attendant.ready("The tail is tied on and lies in the base. Homing winds it in slowly")
    robot.arm(body_air=False)
    robot.home()
    length_cm = robot.status().length_cm
    yield "home", f"the spool stalls twice at one place; length {length_cm:.1f} cm", ""


_CHECKS: dict[str, Callable[[Robot, Attendant], CheckOutcomes]] = {
    "board": _board, "supply": _supply, "estop": _estop, "pressure": _pressure, "flex": _flex,
    "valves": _valves, "enables": _enables, "motor": _motor, "brake": _brake, "home": _home,
}  # fmt: skip
STAGES = tuple(_CHECKS)
_OF_THE_SPOOL = ("motor", "brake", "home")


@dataclass
class BringUp:
    """The checks, on a robot that may be wired wrong."""

    robot: Robot  # connected, disarmed
    attendant: Attendant  # the person beside it
    tell: Callable[[Finding], None] = lambda finding: None  # shown each finding as it comes

    def _outcomes(self, stage: str) -> CheckOutcomes:
        if stage in _OF_THE_SPOOL and not _grows(self.robot):
            return iter([(stage, "none (grows = false in robot.toml)", "")])
        return _CHECKS[stage](self.robot, self.attendant)

    def run(self, first: str = STAGES[0], last: str = STAGES[-1]) -> list[Finding]:
        """Check stage after stage, up to the first in which something is wrong.

        Those before `first` were good at another time; what those after `last` need is not built.
        """
        findings: list[Finding] = []
        for stage in STAGES[STAGES.index(first) : STAGES.index(last) + 1]:
            try:
                for subject, observation, cure in self._outcomes(stage):
                    findings.append(Finding(stage, subject, not cure, observation, cure))
                    self.tell(findings[-1])
            except ThigmoError as error:  # one that the check does not expect is a finding, too
                findings.append(Finding(stage, "robot", False, error.problem, error.next_step))
                self.tell(findings[-1])
            if not all(finding.good for finding in findings):
                break
        self.robot.make_safe()
        return findings
