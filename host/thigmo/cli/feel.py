"""`thigmo feel`: contacts now, by a fibre that is read live."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thigmo.cli.console import Console
from thigmo.cli.output import JsonOption, KnownConfigOption, RobotOption, print_json
from thigmo.errors import CommandRefusedError, ConfigError, DataError

if TYPE_CHECKING:
    from thigmo.config import RobotConfig
    from thigmo.localization import LocalizeResult
    from thigmo.robot import FibreReading, Robot

_STEADY_S = 3.0  # from a set point to a bend at rest
_RAMP_PSI_S = 1.0
_TRIES = 3  # of zeroing a body that still drifts


def feel(
    robot: RobotOption,
    press: Annotated[
        str | None,
        typer.Option(
            help="Muscle to hold under pressure meanwhile, with the pressure in psi: left=6."
        ),
    ] = None,
    count: Annotated[int, typer.Option(help="Number of answers, one every 0.5 s.", min=1)] = 10,
    config: KnownConfigOption = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the emulator's noise.", min=0)] = None,
    as_json: JsonOption = False,
) -> None:
    """Say where the body is touched now, by the fibre that robot.toml's `interrogator` reads.

    First the sensors are zeroed: the robot must be straight and vented, and touch nothing. It is
    stopped safely (valves at 0 mA, motor braked) if the interrogator falls silent or loses a
    grating.
    """
    from thigmo.config import RobotConfig
    from thigmo.robot import connect

    known = None if config is None else RobotConfig.load(config)
    console, answers = Console(quiet=as_json), []
    with console.interruptible(robot), connect(robot, seed=seed, operator=console) as machine:
        if (used := known or machine.known_config) is None:
            raise ConfigError(f"the constants of {robot} are not known", "give --config robot.toml")
        name, psi = _pressed(press, used)
        machine.configure(used)
        _ready(machine, used)
        if name is not None:
            machine.press(name, psi, ramp_psi_s=_RAMP_PSI_S)
            machine.wait(psi / _RAMP_PSI_S + _STEADY_S)
        opened_s = machine.now() - machine.elapsed_s
        for _ in range(count):
            reading = machine.read_fibre()
            result = _localized(used, reading)
            truth, t_s = machine.truth(), reading.t_s - opened_s
            answers.append(
                {"t_s": t_s, "length_cm": reading.length_cm, "lines": reading.lines,
                 "zero_age_s": reading.zero_age_s, "free_curvature": reading.free_curvature,
                 "curvature": reading.curvature.tolist(), **result.to_dict(),
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


def _pressed(text: str | None, config: RobotConfig) -> tuple[str | None, float]:
    """`left=6` as a muscle's name and its pressure."""
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
    return name, psi


def _ready(machine: Robot, config: RobotConfig) -> None:
    """Arm the robot, with the body pressure of its length, and zero it at rest."""
    length_cm = machine.known_length_cm()
    zone = config.body.zone_at(length_cm)
    machine.pressurize(zone)
    machine.arm()
    machine.vent()
    machine.wait_settled()
    for tries in range(_TRIES):
        try:
            machine.zero()
        except CommandRefusedError as error:
            if error.reason != "drifting" or tries + 1 == _TRIES:
                raise
            machine.wait(_STEADY_S)
        else:
            return


def _localized(config: RobotConfig, reading: FibreReading) -> LocalizeResult:
    """Contacts by the strains that have a zero; temperature's error grows with the zero's age."""
    import numpy as np

    import thigmo
    from thigmo.reading_errors import errors_of

    used = np.flatnonzero(np.isfinite(reading.curvature))
    if not used.size:
        raise DataError("no healthy grating of the fibre has everted", "grow the robot first")
    used = used[np.argsort([config.gratings[n].center_cm for n in used], kind="stable")]
    sensors: list[Any] = []
    for number in used:
        grating = config.gratings[number]
        warmer = max(1.0, reading.zero_age_s / grating.warm_s)
        sensors.append(
            grating.model_copy(update={"temperature_se": warmer * grating.temperature_se})
        )
    zone = config.body.zone_at(reading.length_cm)
    return thigmo.localize(
        reading.curvature[used],
        [sensor.center_cm for sensor in sensors],
        length=reading.length_cm,
        span=[sensor.span_cm for sensor in sensors],
        free_curvature=reading.free_curvature,
        **errors_of(config, reading.side, zone, sensors).arguments(),
    )
