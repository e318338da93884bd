"""`thigmo explore`: the robot's main job, and how it is shown."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from thigmo.cli import signals
from thigmo.cli.output import (
    AnyRobotOption,
    JsonOption,
    KnownConfigOption,
    method_option,
    print_json,
)


def explore(
    robot: AnyRobotOption = None,
    scene: Annotated[
        str | None, typer.Option(help="Scene file, or the name of a built-in scene, to emulate.")
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(help="Seed of the emulator's noise. The same seed gives the same run.", min=0),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder in which each run gets a folder.")] = Path(
        "runs"
    ),
    config: KnownConfigOption = None,
    name: Annotated[str | None, typer.Option(help="Name of the run.")] = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Run the emulator at the speed of the wall clock.")
    ] = False,
    protocol: Annotated[
        Literal["measure", "thesis"] | None,
        typer.Option(
            help="How a contact is measured. measure: by a second, slower sweep, up to the "
            "pressure at which the sensors show it most clearly. thesis: at the peak of the full "
            "sweep. Default: measure, or the "
            "protocol of the run that is resumed."
        ),
    ] = None,
    effort: Annotated[
        Literal["quick", "default", "careful"] | None,
        typer.Option(
            help="How much robot time the map may cost. The run says at its start and end what "
            "it omits."
        ),
    ] = None,
    time_s: Annotated[
        float | None,
        typer.Option("--time", min=0, help="Budget of robot time, in seconds; replaces --effort."),
    ] = None,
    method: Annotated[str | None, method_option("Default: field.", explores=True)] = None,
    prior: Annotated[
        Path | None,
        typer.Option(
            "--map",
            help="A map of the room: an earlier run's folder or obstacles.json, or a ROS map's "
            "YAML file. Readings can overrule it.",
        ),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            help="Run folder of an exploration that was cut short. The new run continues from what "
            "that one had learnt, swept and felt, on the same robot. You measure the everted "
            "length again."
        ),
    ] = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="Open the page that shows the run and can stop it.")
    ] = False,
    asks_viewers: Annotated[
        bool, typer.Option("--asks-viewers", hidden=True)  # for the page, which starts runs
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Explore: grow in stages to the full length; at each, sweep, feel, localize and map."""
    from thigmo.cli.console import Console
    from thigmo.config import RobotConfig
    from thigmo.errors import ConfigError
    from thigmo.exploration import explore as run
    from thigmo.exploration import open_run

    if robot is not None and scene is not None:
        raise ConfigError("--robot and --scene are both given", "give one of them")
    url = f"emulator://{scene}" if scene else robot
    if resume is not None and method is not None:
        raise ConfigError("a resumed run keeps its method", "leave --method out")
    where = url or (open_run(resume).document.url if resume else "emulator://default")
    if watch:
        from thigmo.live.opening import open_page

        open_page(where, out, config)
    signals.outlive_terminal()
    console = Console(quiet=as_json, asks_viewers=asks_viewers)
    with console.progress() as show, console.interruptible(where):
        result = run(
            where,
            config=RobotConfig.load(config) if config else None,
            seed=seed,
            out=out,
            name=name,
            realtime=realtime,
            protocol=protocol,
            effort=effort,
            time_s=time_s,
            method=method or "field",
            prior=prior,
            resume=resume,
            operator=console,
            progress=show,
        )
    if as_json:
        print_json(result.to_dict())
    else:
        console.result(result)
