"""`thigmo robot new | check`: a robot's description, before there is a robot."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from thigmo.cli.output import JsonOption, filled, show

robot = typer.Typer(help="Draft a robot, or check it.", no_args_is_help=True)

_FileArgument = Annotated[Path, typer.Argument(help="robot.toml.")]


def _kinds(begun: str) -> list[str]:
    """Kinds of sensors for the shell to complete."""
    from thigmo.design.draft import LAYOUTS

    return [kind for kind in LAYOUTS if kind.startswith(begun)]


@robot.command()
def new(
    length: Annotated[float, typer.Option(help="Length of the body, cm (30 to 300).")] = 53.0,
    sensors: Annotated[
        int | None,
        typer.Option(help="Sensors in each column: 5 if not given, or 4 with four muscles."),
    ] = None,
    muscles: Annotated[
        int,
        typer.Option(
            help="0, 1 or 2 in the plane, or 3 or 4 around the body, each with a column opposite."
        ),
    ] = 2,
    kind: Annotated[
        str,
        typer.Option(
            help="Kind of the sensors, such as flex, heading (one string of IMUs) or fibre.",
            autocompletion=_kinds,
        ),
    ] = "flex",
    diameter: Annotated[float, typer.Option(help="Diameter of the tube, cm.")] = 3.5,
    out: Annotated[Path, typer.Option(help="Folder for robot.toml and scene.toml.")] = Path(
        "robot"
    ),
    seed: Annotated[int, typer.Option(help="Seed of the peg's place in the scene.", min=0)] = 0,
    as_json: JsonOption = False,
) -> None:
    """Draft a robot: its robot.toml, a scene with a peg that it feels, and an empty one.

    It explores on the first and is calibrated on the other, where nothing stops its free bends. A
    robot of 3 or 4 muscles bends out of the plane, and one without muscles cannot sweep: they do
    not explore, and get the empty one.
    """
    from thigmo.calibrate.commands import commands_of
    from thigmo.design import draft
    from thigmo.emulator.reach import pressed, room_for
    from thigmo.errors import ConfigError
    from thigmo.wiring import Wiring, beyond_board

    config = draft(length, sensors, muscles, diameter, kind=kind)
    with ConfigError.from_os(f"cannot make {out}", "choose another folder"):
        out.mkdir(parents=True, exist_ok=True)
    config.save(out / "robot.toml")
    for older in ("scene.toml", "empty.toml", "grown.toml"):  # of the robot that was there before
        (out / older).unlink(missing_ok=True)
    written, lines = [str(out / "robot.toml")], []
    if beyond := beyond_board(config):
        lines = [filled(f"no scene: {problem}; {cure}") for problem, cure in beyond]
    elif refused := Wiring.laid_out(config).unexplorable:
        lines = [filled(f"explore does not work with it: {refused.problem}; {refused.cure}")]
    else:
        room = room_for(config, seed)
        room.save(out / "scene.toml")
        written.append(str(out / "scene.toml"))
        lines = [f"explore it: thigmo explore --scene {out / 'scene.toml'}"]
        if config.gratings:
            room.start_length_cm = config.body.length_cm
            room.save(out / "grown.toml")
            written.append(str(out / "grown.toml"))
            press = pressed(config, room.peg_list())
            url = f"emulator://{out / 'grown.toml'}"
            lines.append(f"feel its peg, grown: thigmo feel --robot {url} --press {press}")
    if not beyond:
        room_for(config, seed, peg=False).save(out / "empty.toml")
        written.append(str(out / "empty.toml"))
        commands = commands_of(config, f"emulator://{out / 'empty.toml'}")
        lines.append(f"calibrate it: {', then '.join(commands)}")
    lines = [f"wrote {', '.join(written)}", f"check it: thigmo robot check {written[0]}", *lines]
    show(as_json, {"files": written, "notes": lines[1:]}, *lines)


@robot.command()
def check(file: _FileArgument, as_json: JsonOption = False) -> None:
    """Predict from mechanics where a described robot grows, slips, folds and feels.

    The command ends with status 1 if something must be changed.
    """
    from thigmo.config import RobotConfig
    from thigmo.design import judge

    findings = judge(RobotConfig.load(file))
    lines = [
        filled(f"{finding.mark:8}{finding.part}: {finding.text}", indent=8) for finding in findings
    ]
    show(as_json, {"findings": [asdict(finding) for finding in findings]}, *lines)
    if any(finding.mark == "bad" for finding in findings):
        raise typer.Exit(1)
