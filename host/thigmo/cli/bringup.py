"""`thigmo bringup`, `thigmo jog`, `thigmo press`: the first power-up, and small careful moves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thigmo.cli.console import Console
from thigmo.cli.dead_man_switch import ByPageOption, dead_man_switch
from thigmo.cli.output import JsonOption, RobotOption, SentConfigOption, filled, show
from thigmo.errors import ConfigError

if TYPE_CHECKING:
    from thigmo.bringup import Finding, SpoolTurn
    from thigmo.robot import Robot


class _TerminalAttendant:
    """Asks the person beside the robot."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._asked = False

    def ready(self, request: str) -> None:
        self._console.confirm(f"{request}.")

    def press_emergency_stop(self, pressed: bool) -> None:
        self.ready(f"{'Press' if pressed else 'Release'} the emergency stop")

    def press_emergency_stop_soon(self) -> None:
        self.ready("Have the emergency stop in your hand. Press it two seconds after Enter")

    def valves_fitted(self) -> bool:
        return self._yes("Are the valves Y1, Y2 and Y3 fitted")

    def body_is_limp(self) -> bool:
        return self._yes("Is the body limp now")

    def _yes(self, question: str) -> bool:
        answer = ""
        while answer not in ("y", "n"):
            answer = self._console.ask(f"{question}? (y/n)").strip().lower()[:1]
        return answer == "y"

    def spool_turned(self) -> SpoolTurn:
        """Ask how the spool turned; before it has been driven, only for attention."""
        if not self._asked:
            self._asked = True
            self.ready("Watch the spool: it is to pay out a little line")
            return "not"
        answers: dict[str, SpoolTurn] = {"o": "out", "i": "in", "n": "not"}
        answer = ""
        while answer not in answers:
            answer = self._console.ask("Did it pay line (o)ut, wind it (i)n, or (n)ot turn?")
            answer = answer.strip().lower()[:1]
        return answers[answer]


def bringup(
    robot: RobotOption,
    first: Annotated[
        str, typer.Option("--from", help="Stage to begin with, if those before it were good.")
    ] = "board",
    last: Annotated[
        str, typer.Option("--to", help="Stage to end with, for a robot that is not complete yet.")
    ] = "home",
    config: SentConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check a newly wired robot, from its supply to homing, and name the plug of what is wrong.

    Stages: board, supply, estop, pressure, flex, valves, enables, motor, brake, home. It asks
    you for one thing after the other, and stops after the first stage in which something is wrong.
    `--from STAGE` continues there, and `--to STAGE` ends with that stage. A board without a
    configuration gets the defaults.

    Read "Before the first power" in docs/hardware/electronics.md first.
    """
    from thigmo.bringup import STAGES, BringUp
    from thigmo.calibrate.commands import commands_of
    from thigmo.config import RobotConfig
    from thigmo.robot import connect

    for stage in (first, last):
        if stage not in STAGES:
            raise ConfigError(f"there is no stage {stage!r}", f"name one of {', '.join(STAGES)}")
    if STAGES.index(last) < STAGES.index(first):
        raise ConfigError(f"stage {last} comes before {first}", f"the order is {', '.join(STAGES)}")
    console = Console(quiet=as_json)

    def tell(finding: Finding) -> None:
        mark, cure = ("good ", "") if finding.good else ("WRONG", f"; {finding.cure}")
        if not as_json:
            same = finding.subject.startswith(finding.stage)
            subject = finding.subject if same else f"{finding.stage}: {finding.subject}"
            typer.echo(filled(f"{mark} {subject}: {finding.observation}{cure}", indent=6))

    with console.interruptible(robot), connect(robot, operator=console) as machine:
        if config is not None:
            machine.configure(RobotConfig.load(config))
        if first != STAGES[0]:
            _cured(machine)
        # The emulated robot has an attendant of its own.
        emulated: Any = machine.operator if machine.virtual else None
        # Its requests make faults, such as the emergency stop's.
        console.meanwhile = partial(machine.wait, despite_faults=True)
        attendant = emulated if hasattr(emulated, "spool_turned") else _TerminalAttendant(console)
        findings = BringUp(machine, attendant, tell).run(first, last)
        calibrations = commands_of(machine.config, robot)
    good = all(finding.good for finding in findings)
    stage = findings[-1].stage
    if not good:
        advice = f"Correct it, then: thigmo bringup --robot {robot} --from {stage}"
    elif stage == STAGES[-1]:
        advice = f"All is as it should be. Next: {', then '.join(calibrations)}"
    else:
        following = STAGES[STAGES.index(stage) + 1]
        advice = f"So far all is well. Next: thigmo bringup --robot {robot} --from {following}"
    show(as_json, {"good": good, "findings": [asdict(finding) for finding in findings]}, advice)
    if not good:
        raise typer.Exit(1)


def jog(
    robot: RobotOption,
    out: Annotated[
        float, typer.Option("--out", help="Centimetres of tip to pay out, at most 5.")
    ] = 0,
    wind: Annotated[
        float, typer.Option("--in", help="Centimetres of tip to wind in, at most 5.")
    ] = 0,
    by_page: ByPageOption = False,
    as_json: JsonOption = False,
) -> None:
    """Turn the spool a little, slowly; the length need not be known. Muscles must be empty.

    The board ends each push within half a second, so the spool stops when this program does.
    """
    from thigmo.bringup import jog as move

    if (out > 0) == (wind > 0) or min(out, wind) < 0:
        raise ConfigError("a jog needs one direction", "give --out CM or --in CM")
    with _robot(robot, Console(quiet=as_json)) as machine, dead_man_switch(machine, "jog", by_page):
        machine.arm(body_air=False)
        machine.vent()
        moved = move(machine, out or -wind)
    show(as_json, {"moved_cm": moved}, f"The encoder went {moved:+.2f} cm.")


def press(
    robot: RobotOption,
    muscle: Annotated[str, typer.Argument(help="Name of the muscle in robot.toml, such as left.")],
    psi: Annotated[float, typer.Argument(help="Pressure, at most 5 psi.")],
    seconds: Annotated[float, typer.Option(help="Duration, at most 60 s.")] = 5.0,
    as_json: JsonOption = False,
) -> None:
    """Give a muscle's transducer the current of a low pressure, show the pressure, then vent.

    This checks valve, tube and sensor. It needs neither length nor zeros, and does not control the
    pressure. The board ends each push within half a second, so the muscle empties when this program
    stops.
    """
    from thigmo.bringup import press as hold

    console = Console(quiet=as_json)
    with _robot(robot, console) as machine, console.progress() as tell:
        machine.config.muscle_number(muscle)  # that there is one, before anything is armed
        machine.arm(body_air=False)
        began = machine.now()
        reached = hold(
            machine, muscle, psi, seconds,
            lambda now: tell(f"{muscle} {now:.2f} psi", (machine.now() - began) / seconds),
        )  # fmt: skip
    text = f"The {muscle} muscle reached {reached:.2f} psi."
    show(as_json, {"muscle": muscle, "pressure_psi": reached}, text)


@contextmanager
def _robot(robot: str, console: Console) -> Iterator[Robot]:
    """A robot whose configuration is known."""
    from thigmo.robot import connect

    with console.interruptible(robot), connect(robot) as machine:
        _cured(machine)
        yield machine


def _cured(robot: Robot) -> None:
    """An emulated board is new at each connection: give it what its lab would have stored."""
    if robot.virtual and robot.known_config is not None:
        robot.configure(robot.known_config)
