"""`thigmo experiment`: repeat the thesis's experiments and compare in three columns."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thigmo.cli.camera import CAMERA_FILE, load_sheet
from thigmo.cli.output import JsonOption, KnownConfigOption, print_json, robot_option
from thigmo.errors import DataError
from thigmo.files import write_whole

if TYPE_CHECKING:
    from collections.abc import Callable

    from thigmo_bench.experiments.session import Place
    from thigmo_bench.studies.engine import Outcome


def experiment(
    name: Annotated[
        str,
        typer.Argument(
            help="single-contact, two-contacts, actuated, predictions, exploration, sensitivity, "
            "all; or fit, which fits the simulated robots' constants again."
        ),
    ],
    robots: Annotated[int, typer.Option(help="Simulated robots, each with its own errors.")] = 20,
    trials: Annotated[
        int, typer.Option(help="Trials of each condition and robot; the thesis has 5.")
    ] = 5,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.", min=0)] = 1,
    jobs: Annotated[
        int, typer.Option(help="Processes on this machine; the results do not depend on it.", min=1)
    ] = 1,
    out: Annotated[Path, typer.Option(help="Folder for trials, tables and figures.")] = Path(
        "experiment-out"
    ),
    robot: Annotated[
        str | None,
        robot_option(
            "Take the trials with this robot: /dev/ttyACM0, COM3, socket://, emulator://SCENE."
        ),
    ] = None,
    config: KnownConfigOption = None,
    camera: Annotated[
        str | None,
        typer.Option(
            help="Camera that measures the dowels: camera:0 or a folder of pictures. Without it "
            "you type their places in."
        ),
    ] = None,
    rehearse: Annotated[
        bool,
        typer.Option(
            "--rehearse", help="On the emulator, ask you for everything that a real robot needs."
        ),
    ] = False,
    recorded: Annotated[
        Path | None, typer.Option(help="Evaluate the trials of this folder again, without a robot.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Repeat the thesis's experiments; compare its results, its method, ours, and the bound.

    Without --robot, readings are computed from the emulator's mechanics and the fitted errors
    (fast: thousands of trials); explorations run on the whole emulator. With --robot, the trials of
    single-contact, two-contacts or actuated are taken one by one and kept in OUT/NAME/trials.jsonl:
    on a bench you are asked for each step, on emulator:// an emulated operator takes it. The same
    command resumes after a stop. Each trial of exploration is then one run with each protocol.
    """
    from thigmo_bench.cli.studies import conduct, report
    from thigmo_bench.experiments import EXPERIMENTS
    from thigmo_bench.experiments.trial import STATIC
    from thigmo_bench.studies.engine import Context

    names = list(EXPERIMENTS) if name == "all" else [name]
    if name not in (*EXPERIMENTS, "all", "fit"):
        raise DataError(
            f"there is no experiment {name!r}", f"choose from {', '.join(EXPERIMENTS)}, all, fit"
        )
    if robots < 1 or trials < 1:
        raise DataError("--robots and --trials must be at least 1", "give larger numbers")
    if robot is None and (rehearse or camera or config):
        raise DataError("--rehearse, --camera and --config need a robot", "give --robot URL")
    if robot is not None and recorded is not None:
        raise DataError("--robot and --recorded are both given", "give one of them")
    if robot is not None or recorded is not None:
        if name not in (*STATIC, "exploration"):
            raise DataError(
                f"{name!r} cannot be done with a robot",
                f"choose from {', '.join(STATIC)}, exploration",
            )
        folder = recorded or out / name
        if robot is not None:
            look = None if camera is None else _look(camera)
            _take(name, robot, folder, trials, seed, config, look, rehearse, as_json)
        result = report(name, _evaluated(name, folder, jobs), folder, as_json)
        if as_json:
            print_json([result])
    elif name == "fit":
        _fit(seed, out)
    else:
        studies = {
            name_of_study: partial(EXPERIMENTS[name_of_study], robots, trials)
            for name_of_study in names
        }
        conduct(studies, Context(seed=seed, jobs=jobs), out, as_json)


def _fit(seed: int, out: Path) -> None:
    from thigmo_bench.cli.studies import study_progress
    from thigmo_bench.experiments.fit import fit

    with study_progress("fit to section 3.2") as tell:
        text = json.dumps(fit(seed, tell), indent=1)
    with DataError.from_os(f"cannot write to {out}", "choose another --out"):
        out.mkdir(parents=True, exist_ok=True)
        write_whole(out / "constants.json", f"{text}\n")
    typer.echo(text)


def _look(camera: str) -> Callable[[float], list[Place]]:
    """A function of the body's diameter (cm) that measures the centres of the dowels beside it."""
    from thigmo.calibrate.overhead import OverheadCamera
    from thigmo.camera import CameraModel, open_source
    from thigmo.config import Body
    from thigmo_bench.experiments import thesis

    located = open_source(camera), CameraModel.load(CAMERA_FILE), load_sheet()

    def look(diameter_cm: float) -> list[Place]:
        detection = (
            OverheadCamera(*located, Body(diameter_cm=diameter_cm), thesis.DOWEL_CM)
            .detection()
            .obstacles
        )
        return sorted((float(o.x_cm), float(o.y_cm)) for o in detection)

    return look


def _take(
    name: str,
    url: str,
    out: Path,
    trials: int,
    seed: int,
    config: Path | None,
    look: Callable[[float], list[Place]] | None,
    rehearse: bool,
    quiet: bool,
) -> None:
    """Take the experiment's trials that are not in `out` yet, until they are or a person stops."""
    from thigmo.cli.console import Console
    from thigmo.config import RobotConfig
    from thigmo.robot import connect
    from thigmo_bench.experiments.explorations import run_explorations
    from thigmo_bench.experiments.recorded import run_trials
    from thigmo_bench.experiments.session import Attendant, Folder

    def say(text: str) -> None:
        if not quiet:
            typer.echo(text)

    console = Console(quiet=quiet)
    stated = RobotConfig.load(config) if config else None
    exploration = name == "exploration"
    with console.interruptible(url):
        with connect(url, seed=seed, operator=console) as machine:
            constants = stated or machine.known_config
            emulated = machine.scenery() is not None
            if constants is None:
                raise DataError("the robot's constants are not known", "give --config robot.toml")
            if rehearse and not emulated:
                raise DataError("--rehearse is for the emulator", "give --robot emulator://default")
            if look and emulated:
                raise DataError("--camera is for a real robot", "the emulator knows its dowels")
            attendant = Attendant(
                None if emulated and not rehearse else console.ask,
                partial(look, constants.body.diameter_cm) if look else None,
                machine if emulated and not exploration else None,
            )
            folder = Folder(out, constants, "explorations" if exploration else "trials")
            if not exploration:
                complete = run_trials(machine, attendant, folder, name, trials, say)
        if exploration:  # opens the robot by itself
            with console.progress() as show:
                complete = run_explorations(
                    url, attendant, folder, trials, seed=seed, operator=console, progress=show,
                    say=say,
                )  # fmt: skip
        if not complete:
            say("stopped; the same command resumes")


def _evaluated(name: str, folder: Path, jobs: int) -> Outcome:
    """What the trials in a folder say."""
    from thigmo_bench.experiments import explorations, recorded
    from thigmo_bench.experiments.evaluate import evaluate
    from thigmo_bench.experiments.session import Folder
    from thigmo_bench.studies.engine import Context

    if name == "exploration":
        return explorations.evaluate(Folder(folder))
    return evaluate(name, recorded.trials(Folder(folder)), Context(jobs=jobs))
