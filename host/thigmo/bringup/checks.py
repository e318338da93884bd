"""The checklist of the first power-up: what is asked, what is measured, what it means.

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
from thigmo.errors import ThigmoError
from thigmo.link.protocol import Output
from thigmo.robot import SENSORS, Robot

STAGES = ("board", "supply", "estop", "pressure", "flex", "valves", "motor", "home")

_A_SIDE = SENSORS // 2
_ESTOP_S = 1.0
_EMPTY_PSI = 1.5  # a sensor's error before its zero is calibrated
_ZERO_PSI = 0.1  # less is left to `thigmo calibrate pressure`
_BROKEN_PSI = -4.0  # an input at 0 V reads 0 - 10 % of 75 psi
_FLAT_OHM = (5e3, 6e4)  # 10 or 25 kOhm +- 30 %, bent or not
_TEST_MA = 4.2  # just above the live zero: 2.7 psi of a 2..60 psi transducer
_TEST_S = 1.5
_RISE_PSI = (0.8, 5.0)
_NO_RISE_PSI = 0.4
_VENT_S = 4.0
_TURN_DUTIES = (100, 150, 200)  # of 800
_TURN_S = 0.3
_TURN_CM = 0.03


Found = Iterator[tuple[str, str, str]]  # subject, what was found, and the cure ("" = good)
Turned = Literal["out", "in", "not"]


class Attendant(Protocol):
    """Stands beside the robot, does with his hands what a check needs, and says what he sees."""

    def ready(self, request: str) -> None:
        """Do something; return when it is done."""

    def press_emergency_stop(self, pressed: bool) -> None:
        """Press the emergency stop, or release it; return when it is done."""

    def spool_turned(self) -> Turned:
        """Say how the spool turned since the last question: it paid out, wound in, or neither."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What a check found."""

    stage: str  # one of `STAGES`
    subject: str  # what was looked at
    good: bool  # nothing is wrong with it
    what: str  # was measured, or is wrong
    cure: str = ""  # what to do about it; empty if good


class BringUp:
    """The checks, on a robot that may be wired wrong.

    Args:
        robot: connected, disarmed.
        attendant: whoever stands beside it.
        tell: shown each finding as it comes.
    """

    def __init__(
        self,
        robot: Robot,
        attendant: Attendant,
        tell: Callable[[Finding], None] = lambda finding: None,
    ) -> None:
        self._robot = robot
        self._attendant = attendant
        self._tell = tell

    def run(self, first: str = STAGES[0], last: str = STAGES[-1]) -> list[Finding]:
        """Check stage after stage, up to the first in which something is wrong.

        Args:
            first: stage to begin with; those before it were good at another time.
            last: stage to end with, `first` or one after it; what the others need is not built yet.
        """
        found: list[Finding] = []
        for stage in STAGES[STAGES.index(first) : STAGES.index(last) + 1]:
            for finding in self._stage(stage):
                self._tell(finding)
                found.append(finding)
            if not all(finding.good for finding in found):
                break
        self._robot.make_safe()
        return found

    def _stage(self, stage: str) -> Iterator[Finding]:
        """One stage; an error that it does not expect is a finding, too."""
        try:
            for subject, what, cure in getattr(self, f"_{stage}")():
                yield Finding(stage, subject, not cure, what, cure)
        except ThigmoError as error:
            yield Finding(stage, "robot", False, error.what, error.next_step)

    def _board(self) -> Found:
        robot = self._robot
        told = "{firmware} on {board}, reset cause {reset_cause}".format_map(robot.identity)
        yield "firmware", told, ""
        if "bad_config" in robot.status().faults:
            robot.load_defaults()
            yield "configuration", "there was none: defaults loaded and stored", ""
        else:
            yield "configuration", "valid", ""

    def _supply(self) -> Found:
        status = self._robot.status()
        if "supply_good" in status.conditions:
            yield "5 V", f"{status.supply_v:.2f} V, by the board", ""
        else:
            yield (
                "5 V", f"{status.supply_v:.2f} V by the board, below supply_min_mv",
                "measure 5 V at the Mega; if it is good, correct reference_mv, else use a better "
                "USB cable or port",
            )  # fmt: skip

    def _estop(self) -> Found:
        robot, loose = self._robot, "check S1's contact at J15.1-2, R41 and the wire to pin 22"
        if self._waits_for("estop", False) is False:
            yield "emergency stop", "reads pressed while it is released", loose
            return
        self._attendant.press_emergency_stop(True)
        seen = self._waits_for("estop", True)
        self._attendant.press_emergency_stop(False)
        if not seen:
            yield "emergency stop", "pressed, and not seen", loose
            return
        if not self._waits_for("estop", False):
            yield "emergency stop", "released, and still read as pressed", loose
            return
        robot.clear_faults("estop")
        yield "emergency stop", "seen pressed and released", ""

    def _waits_for(self, condition: str, there: bool) -> bool:
        """Whether a condition comes (or goes) within a second."""
        robot = self._robot
        end = robot.now() + _ESTOP_S
        while (condition in robot.status().conditions) is not there:
            if robot.now() > end:
                return False
            robot.wait(0.05, despite_faults=True)
        return True

    def _pressure(self) -> Found:
        self._attendant.ready("Shut the air off (V1): muscles and body are empty")
        self._robot.clear_faults()
        robot = self._robot
        reading = robot.read(0.3, despite_faults=True)
        zero, span = robot.parameter("pressure_zero"), robot.parameter("pressure_span")
        full_psi = robot.parameter("pressure_full_cpsi")[0] / 100
        off = False
        for index, psi in enumerate((reading.left_psi, reading.right_psi)):
            side = SIDES[index]
            plug = "J8" if side == "left" else "J9"
            if psi < _BROKEN_PSI:
                yield f"pressure {side}", "no signal", f"plug it in, check {plug}.1 (5 V), {plug}.2"
            elif abs(psi) > _EMPTY_PSI:
                yield (
                    f"pressure {side}", f"{psi:.1f} psi with the air off",
                    f"empty the muscle; else check {plug}, or the sensor is none of 0..60 psi",
                )  # fmt: skip
            elif abs(psi) > _ZERO_PSI:
                # A sensor's error may be more than a muscle that counts as empty may hold.
                zero[index] += round(psi / full_psi * span[index])
                off = True
                yield f"pressure {side}", f"{psi:+.2f} psi, empty: stored as its zero", ""
            else:
                yield f"pressure {side}", f"{psi:+.2f} psi, empty", ""
        if off:
            robot.set_parameter("pressure_zero", zero)
            robot.save()
            robot.clear_faults()

    def _flex(self) -> Found:
        robot = self._robot
        enabled = robot.parameter("flex_enabled")
        robot.clear_faults()
        ohms = robot.read(0.3, despite_faults=True).resistance
        for sensor in range(SENSORS):
            side, index = divmod(sensor, _A_SIDE)
            name, pin = f"flex {SIDES[side]} {index}", f"J{6 + side}.{index + 2}"
            is_open, is_short = robot.flex_circuit(sensor)
            what, cure = f"{ohms[sensor] / 1e3:.1f} kOhm", ""
            if not enabled[sensor]:
                what = "not in use (flex_enabled)"
            elif is_open:
                what = "open"
                cure = f"plug it in, check {pin} and its 5 V; a dead one: flex_enabled 0"
            elif is_short:
                what, cure = "shorted", f"check {pin} for a short to 5 V"
            elif not _FLAT_OHM[0] < ohms[sensor] < _FLAT_OHM[1]:
                cure = f"check its divider at {pin}"
            yield name, what, cure

    def _valves(self) -> Found:
        self._attendant.ready(
            "Turn the 24 V on, then the air: FR1 at 25 psi. Hands away from the muscles"
        )
        robot = self._robot
        robot.arm(body_air=False)
        robot.vent()
        for side, output in enumerate((Output.LEFT_TRANSDUCER, Output.RIGHT_TRANSDUCER)):
            name, plug = f"valve {SIDES[side]}", f"J{10 + side}"
            before = self._psi()
            push(robot, output, duty_of(_TEST_MA), _TEST_S)
            during = self._psi()
            rise = [b - a for a, b in zip(before, during, strict=True)]
            robot.vent(wait=False)  # ends the push
            robot.wait(_VENT_S, despite_faults=True)
            left = self._psi()[side]
            own, other = rise[side], rise[1 - side]
            at = f"{_TEST_MA} mA moves its pressure by {own:.1f} psi"
            if own < _NO_RISE_PSI and other > _RISE_PSI[0]:
                yield (
                    name, f"{_TEST_MA} mA moves the other side's pressure",
                    f"swap the tubes of Y1 and Y2, or {plug} with its neighbour, or J8 and J9",
                )  # fmt: skip
            elif own < _NO_RISE_PSI:
                yield (
                    name, f"dead: {at}",
                    f"check air, 24 V at {plug}.1, {0.1 * _TEST_MA:.2f} V at TP{10 * side + 1}, "
                    f"Y{side + 1} (enable, pin 24) and its tube",
                )  # fmt: skip
            elif not _RISE_PSI[0] <= own <= _RISE_PSI[1]:
                yield name, at, "check the transducer's range: 4..20 mA to 2..60 psi is expected"
            elif left - before[side] > _NO_RISE_PSI:
                yield (
                    name, f"at 0 mA it keeps {left:.1f} psi",
                    f"check its exhaust, and that TP{10 * side + 1} is at 0 V",
                )  # fmt: skip
                return  # the board may have latched it: it drives no other now
            else:
                yield name, f"{at}; 0 mA vents", ""

    def _psi(self) -> tuple[float, float]:
        reading = self._robot.read(0.1, despite_faults=True)
        return reading.left_psi, reading.right_psi

    def _motor(self) -> Found:
        self._attendant.ready(
            "Body air off. Turn the 12 V on; the tail is free, or has 5 cm of line to spare"
        )
        robot = self._robot
        robot.arm(body_air=False)
        robot.vent()
        self._attendant.spool_turned()
        moved = 0.0
        for duty in _TURN_DUTIES:
            before = robot.read(0.1).length_cm
            push(robot, Output.MOTOR, duty, _TURN_S)
            robot.vent(wait=False)
            robot.wait(0.5)
            moved = robot.read(0.1).length_cm - before
            if abs(moved) >= _TURN_CM:
                break
        turned = self._attendant.spool_turned()
        went = f"driven to pay out, the encoder goes {moved:+.2f} cm"
        if abs(moved) < _TURN_CM and turned == "not":
            yield "motor", "does not turn", "free the tail; check 12 V, F2, J4, pin 6"
        elif abs(moved) < _TURN_CM:
            yield "encoder", "the spool turns, the encoder stands still", "check J5: 5 V, A, B"
        elif turned == "not":
            yield "encoder", f"{went}, the spool does not turn", "check J5 and its coupling"
        elif turned == "in" and moved < 0:
            yield "motor", f"winds in when driven to pay out ({went})", "swap J4.1 and J4.2"
        elif turned == "in":
            yield (
                "motor", "winds in when driven to pay out, and the encoder counts backwards",
                "swap J4.1 and J4.2, and J5.2 and J5.3",
            )  # fmt: skip
        elif moved < 0:
            yield "encoder", f"counts backwards: {went}", "swap J5.2 (A) and J5.3 (B)"
        else:
            yield "motor", went, ""

    def _home(self) -> Found:
        self._attendant.ready("The tail is tied on and lies in the base. Homing winds it in slowly")
        robot = self._robot
        robot.arm(body_air=False)
        robot.home()
        length_cm = robot.status().length_cm
        yield "home", f"the spool stalls twice at one place; length {length_cm:.1f} cm", ""
