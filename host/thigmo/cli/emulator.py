"""`thigmo emulate` and `thigmo scene check`: the emulated room, for any program and any file."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from thigmo.cli.output import JsonOption, show

scene = typer.Typer(help="Work with scene files.", no_args_is_help=True)


def emulate(
    scene: Annotated[str, typer.Argument(help="Scene file, or a built-in scene's name.")],
    link: Annotated[
        Path | None,
        typer.Option(help="Symbolic link to make to the port, so that its name stays the same."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            help="File to write this robot's constants to, as its lab knows them. Default: "
            "SCENE-robot.toml."
        ),
    ] = None,
    prompt: Annotated[
        bool,
        typer.Option(
            "--prompt",
            help="Make this terminal MicroPython's prompt, whose `thigmo_board` is the robot's "
            "controller (in a source checkout).",
        ),
    ] = False,
) -> None:
    """Serve an emulated robot on a pseudo-terminal, in real time, until Ctrl-C or SIGTERM."""
    from thigmo.emulator.serve import attend, serve

    if prompt:
        attend(scene)
        return
    with suppress(KeyboardInterrupt):  # a service: that is how it ends
        written = config or Path(f"{Path(scene).stem}-robot.toml")
        serve(scene, link=link, config=written, announce=typer.echo)


@scene.command()
def check(
    file: Annotated[str, typer.Argument(help="Scene file, or a built-in scene's name.")],
    as_json: JsonOption = False,
) -> None:
    """Check a scene file and list what is in it."""
    from thigmo.emulator.scene import Scene

    scene = Scene.load(file)
    show(
        as_json,
        scene.model_dump(mode="json"),
        f"{file}: good. Pegs: {len(scene.pegs)}; a robot of {scene.robot.body.length_cm:g} cm, "
        f"{scene.start_length_cm:g} cm of it out at the start; faults: {len(scene.faults)}.",
    )
