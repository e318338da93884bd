"""`thigmo feel`: contacts now, by the board's sensors or a fibre that is read live."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from thigmo.cli.console import Console
from thigmo.cli.output import JsonOption, KnownConfigOption, RobotOption, print_json
from thigmo.errors import ConfigError, DataError

if TYPE_CHECKING:
    from thigmo.config import Muscle, RobotConfig

_RAMP_PSI_S = 1.0


def feel(
    robot: RobotOption,
    press: Annotated[
        str | None,
        typer.Option(
            help="Muscle to hold under pressure meanwhile, with the pressure in psi: left=6."
        ),
    ] = None,
    grow: Annotated[
        float | None,
        typer.Option("--grow-to", help="Grow to this length (cm) first, if it is shorter."),
    ] = None,
    count: Annotated[int, typer.Option(help="Number of answers, one every 0.5 s.", min=1)] = 10,
    config: KnownConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say where the body is touched now, by the board's sensors, or a fibre if robot.toml has one.

    First the sensors are zeroed: the robot must be vented, as it lies at rest, and touch nothing.
    It needs no muscles; without them it feels while it grows: every sensor is zeroed where the
    growth pauses first after the sensor has come out, and the growth ends at the pause in which
    something bends the body. With sensors around the body the contact is localized in space. The
    robot is stopped safely (valves at 0 mA, motor braked) if a fibre's interrogator falls silent
    or loses a grating.
    """
    from thigmo.calibrate.bench import grow_to
    from thigmo.config import RobotConfig
    from thigmo.exploration.feeling import STEADY_S, grow_until_touched, prepare
    from thigmo.exploration.feeling import feel as felt_now
    from thigmo.robot import connect

    known = None if config is None else RobotConfig.load(config)
    console, answers = Console(quiet=as_json), []
    with console.interruptible(robot), connect(robot, operator=console) as machine:
        if (used := known or machine.known_config) is None:
            raise ConfigError(f"the constants of {robot} are not known", "give --config robot.toml")
        muscle, psi = _pressed(press, used)
        machine.configure(used)
        if grow is not None:
            machine.known_length_cm()
            machine.arm()
        if grow is not None and not used.muscles and not used.gratings:
            if grow_until_touched(machine, grow, _say):
                _say("something bends the body: the growth ends here")
        else:
            if grow is not None:
                grow_to(machine, used, grow, _say)
            prepare(machine)
        if muscle is not None:
            machine.press(muscle.name, psi, ramp_psi_s=_RAMP_PSI_S)
            machine.wait(psi / _RAMP_PSI_S + STEADY_S)
        opened_s = machine.now() - machine.elapsed_s
        for _ in range(count):
            now = felt_now(machine, muscle)
            result = now.result
            truth, t_s = machine.truth(), now.t_s - opened_s
            answers.append(
                {"t_s": t_s, "length_cm": now.length_cm, "lines": now.lines,
                 "zero_age_s": now.zero_age_s, "free_curvature": now.free_curvature.tolist(),
                 "curvature": now.curvature.tolist(), **result.to_dict(),
                 "truth": None if truth is None else [asdict(c) for c in truth.contacts]}
            )  # fmt: skip
            if not as_json:
                touched = ", ".join(
                    f"{c.arc:.1f} cm ({c.interval_text}; {c.status})" for c in result.contacts
                )
                typer.echo(f"{t_s:8.1f} s  {result.status}  {touched}")
        machine.vent()
    if as_json:
        print_json(answers)


def _say(text: str) -> None:
    typer.echo(text, err=True)


def _pressed(text: str | None, config: RobotConfig) -> tuple[Muscle | None, float]:
    """`left=6` as a muscle and its pressure."""
    if text is None:
        return None, 0.0
    name, _, number = text.partition("=")
    muscle = config.muscles[config.muscle_number(name)]
    try:
        psi = float(number)
    except ValueError:
        psi = -1.0
    if not 0.0 < psi <= muscle.max_pressure_psi:
        raise DataError(
            f"--press is {text!r}", f"give NAME=PSI, of 0 to {muscle.max_pressure_psi:g} psi"
        )
    return muscle, psi
