"""`thigmo emulate` and `thigmo scene check`: the emulated room, for any program and any file."""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from thigmo.cli.output import JsonOption, print_json

# The emulator is reached by name, as the URL that opens it does: no layer above depends on it.
_SERVE = "thigmo.emulator.serve"
_SCENE = "thigmo.emulator.scene"


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(emulate)
    scene = typer.Typer(help="Work with scene files.", no_args_is_help=True)
    scene.command("check")(check)
    app.add_typer(scene, name="scene")


def emulate(
    scene: Annotated[str, typer.Argument(help="Scene file, or a built-in scene's name.")],
    seed: Annotated[int | None, typer.Option(help="Of the noise.", min=0)] = None,
    link: Annotated[
        Path | None, typer.Option(help="Make this symbolic link to the port, for a stable name.")
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            help="Write this robot's constants, as its lab knows them, here; else SCENE-robot.toml."
        ),
    ] = None,
) -> None:
    """Serve an emulated robot on a pseudo-terminal, in real time, until Ctrl-C or SIGTERM."""
    serve: Any = import_module(_SERVE)
    with suppress(KeyboardInterrupt):  # a service: that is how it ends
        written = config or Path(f"{Path(scene).stem}-robot.toml")
        serve.serve(scene, seed=seed, link=link, config=written, announce=typer.echo)


def check(
    file: Annotated[str, typer.Argument(help="Scene file, or a built-in scene's name.")],
    as_json: JsonOption = False,
) -> None:
    """Check a scene file and say what it holds."""
    scenes: Any = import_module(_SCENE)
    scene = scenes.Scene.load(file)
    if as_json:
        print_json(scene.model_dump(mode="json"))
        return
    typer.echo(
        f"{file}: good. Pegs: {len(scene.pegs)}; a robot of {scene.robot.body.length_cm:g} cm, "
        f"{scene.start_length_cm:g} cm of it out at the start; faults: {len(scene.faults)}."
    )
