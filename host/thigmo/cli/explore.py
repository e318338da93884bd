"""`thigmo explore`: the robot's main job, and how it is shown."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from thigmo.cli import ending
from thigmo.cli.output import (
    AnyRobotOption,
    JsonOption,
    KnownConfigOption,
    MethodOption,
    print_json,
)


def explore(
    robot: AnyRobotOption = None,
    scene: Annotated[
        str | None, typer.Option(help="Scene file, or the name of a built-in scene, to emulate.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Of the emulator's noise; same seed, same run.", min=0)
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for run folders.")] = Path("runs"),
    config: KnownConfigOption = None,
    name: Annotated[str | None, typer.Option(help="Name of the run.")] = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Let the emulator run at the clock's pace.")
    ] = False,
    protocol: Annotated[
        Literal["measure", "thesis"] | None,
        typer.Option(
            help="How a contact is measured: by a second sweep to the pressure at which it is felt "
            "best (measure, the default; that of the run for one that is resumed), or at the full "
            "sweep's peak, as in the thesis."
        ),
    ] = None,
    effort: Annotated[
        Literal["quick", "default", "careful"] | None,
        typer.Option(
            help="How much robot time to spend on the map. The run says at its start and end "
            "what it omits."
        ),
    ] = None,
    time_s: Annotated[
        float | None,
        typer.Option(
            "--time", min=0, help="Instead of --effort: a budget of robot time, in seconds."
        ),
    ] = None,
    method: MethodOption = None,
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
            help="Run folder of an exploration that was cut short: goes on from what it had "
            "learnt, swept and felt, on the same robot, whose everted length is measured again."
        ),
    ] = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="Open the page on which the run is seen and stopped.")
    ] = False,
    asks_viewers: Annotated[
        bool, typer.Option("--asks-viewers", hidden=True)  # for the page, which starts runs
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Grow, sweep, feel, localize and map, stage by stage to the full length."""
    from thigmo.cli.console import Console
    from thigmo.config import RobotConfig
    from thigmo.errors import ConfigError
    from thigmo.exploration import explore as run

    if robot is not None and scene is not None:
        raise ConfigError("--robot and --scene are both given", "give one of them")
    url = f"emulator://{scene}" if scene else robot
    if resume is not None and method is not None:
        raise ConfigError("a run that is resumed keeps its method", "leave --method out")
    if resume is None:
        url = url or "emulator://default"
    if watch:
        from thigmo.cli.watch import open_page
        from thigmo.exploration import open_run

        where = url or open_run(resume or "").document.url
        open_page(where, out, config)
    ending.outlive_terminal()
    console = Console(quiet=as_json, asks_viewers=asks_viewers)
    with console.progress() as show, console.interruptible():
        result = run(
            url,
            config=RobotConfig.load(config) if config else None,
            seed=seed,
            out=out,
            name=name,
            realtime=realtime,
            protocol=protocol,
            effort=effort,
            time_s=time_s,
            method=method or "posterior",
            prior=prior,
            resume=resume,
            operator=console,
            progress=show,
        )
    if as_json:
        print_json(result.as_json())
    else:
        console.result(result)
