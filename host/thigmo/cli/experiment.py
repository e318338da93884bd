"""`thigmo experiment`: repeat the thesis's experiments and compare in three columns."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thigmo.cli.output import JsonOption, print_json

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from thigmo.cli.console import Console, TerminalOperator
    from thigmo.config import RobotConfig
    from thigmo.robot import Robot
    from thigmo.studies.experiments import Results
    from thigmo.studies.experiments.attendant import Attendant, Place


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(experiment)


def experiment(
    name: Annotated[
        str,
        typer.Argument(
            help="single-contact, two-contacts, actuated, predictions, exploration, sensitivity, "
            "all; or fit, which fits the simulated robots' constants again."
        ),
    ],
    robots: Annotated[int, typer.Option(help="Simulated robots, each built anew.")] = 20,
    trials: Annotated[int, typer.Option(help="Trials a condition and robot; the thesis: 5.")] = 5,
    seed: Annotated[int, typer.Option(help="Every random number comes from it.", min=0)] = 1,
    jobs: Annotated[
        int, typer.Option(help="Processes on this machine; the results do not depend on it.", min=1)
    ] = 1,
    out: Annotated[Path, typer.Option(help="Folder for trials, tables and figures.")] = Path(
        "experiment-out"
    ),
    robot: Annotated[
        str | None,
        typer.Option(
            help="Take the trials with this robot: /dev/ttyACM0, COM3, socket://, emulator://SCENE."
        ),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="robot.toml; the emulator's robot is known without.")
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            help="Measures the dowels: camera:0, a folder of pictures. Else they are typed in."
        ),
    ] = None,
    sheet_file: Annotated[Path, typer.Option("--sheet", help="Sheet file.")] = Path("sheet.toml"),
    camera_file: Annotated[
        Path, typer.Option("--camera-file", help="Camera file of `thigmo camera locate`.")
    ] = Path("camera.json"),
    rehearse: Annotated[
        bool, typer.Option("--rehearse", help="On the emulator: ask as on a real robot.")
    ] = False,
    recorded: Annotated[
        Path | None, typer.Option(help="Evaluate the trials of this folder again; no robot.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Repeat the thesis's experiments: the thesis, its method here, ours, and the bound.

    Without --robot, readings are computed from the emulator's mechanics and the fitted errors
    (fast: thousands of trials); explorations run on the whole emulator. With --robot the trials of
    single-contact, two-contacts or actuated are taken one by one, on a bench with prompts, on
    emulator:// by its own operator, and kept in OUT/NAME/trials.csv; the same command goes on
    after a stop. With --robot, exploration makes one run by each protocol a trial.
    """
    from thigmo.errors import DataError
    from thigmo.studies.experiments import EXPERIMENTS, run

    names = list(EXPERIMENTS) if name == "all" else [name]
    if name not in (*EXPERIMENTS, "all", "fit"):
        raise DataError(
            f"there is no experiment {name!r}", f"choose from {', '.join(EXPERIMENTS)}, all, fit"
        )
    if robots < 1 or trials < 1:
        raise DataError("--robots and --trials must be at least 1", "give larger numbers")
    if robot is None and (rehearse or camera or config):
        raise DataError("--rehearse, --camera and --config need a robot", "give --robot URL")
    if robot is not None or recorded is not None:
        if robot is not None and recorded is not None:
            raise DataError("--robot and --recorded are both given", "give one of them")
        asked = _Asked(
            robot, recorded, trials, seed, out, config, camera, sheet_file, camera_file, rehearse,
            as_json, jobs,
        )  # fmt: skip
        found = _explored(asked) if name == "exploration" else _with_robot(name, asked)
        _tell([found], out, as_json)
        return
    if name == "fit":
        _fit(seed, out, as_json)
        return
    results = []
    for one in names:
        if not as_json:
            typer.echo(f"{one}: {robots} robots, {trials} trials a condition ..")
        results.append(run(one, out, robots=robots, trials=trials, seed=seed, jobs=jobs))
    _tell(results, out, as_json)


@dataclass(frozen=True)
class _Asked:
    """The options of trials with a robot, or of those recorded before."""

    robot: str | None
    recorded: Path | None
    trials: int
    seed: int
    out: Path
    config: Path | None
    camera: str | None
    sheet_file: Path
    camera_file: Path
    rehearse: bool
    quiet: bool
    jobs: int

    def say(self, text: str) -> None:
        """To the operator, not into JSON."""
        if not self.quiet:
            typer.echo(text)

    @contextmanager
    def connected(self, person: TerminalOperator) -> Iterator[tuple[Robot, RobotConfig]]:
        """The robot and its constants, robot.toml's before those it is known by."""
        from thigmo.config import RobotConfig
        from thigmo.errors import DataError
        from thigmo.robot import connect

        assert self.robot is not None
        given = RobotConfig.load(self.config) if self.config else None
        with connect(self.robot, seed=self.seed, operator=person) as machine:
            known = given or machine.known_config
            if known is None:
                raise DataError("the robot's constants are not known", "give --config robot.toml")
            if self.rehearse and machine.scenery() is None:
                raise DataError("--rehearse is for the emulator", "give --robot emulator://default")
            yield machine, known


def _with_robot(name: str, asked: _Asked) -> Results:
    """Take the trials, or read them, and evaluate what there is."""
    from thigmo.cli.console import Console, TerminalOperator
    from thigmo.errors import DataError
    from thigmo.studies.engine import Context
    from thigmo.studies.experiments.evaluate import evaluate, save
    from thigmo.studies.experiments.procedure import STATIC
    from thigmo.studies.experiments.recorded import TrialFolder, run_trials

    if name not in STATIC:
        raise DataError(
            f"{name!r} is not taken with a robot, as {', '.join(STATIC)} and exploration are",
            "name one of these",
        )
    if asked.recorded is not None:
        folder = TrialFolder(asked.recorded)
    else:
        console = Console(quiet=asked.quiet)
        with (
            console.interruptible(),
            asked.connected(TerminalOperator(console)) as (machine, known),
        ):
            folder = TrialFolder(asked.out / name, known)
            attendant = _attendant(console, machine, asked)
            if not run_trials(machine, attendant, folder, name, asked.trials, asked.say):
                asked.say("stopped; the same command goes on")
    results = evaluate(name, folder.trials(), Context(jobs=asked.jobs))
    save(results, name, folder.path)
    return results


def _explored(asked: _Asked) -> Results:
    """Explore trial by trial, or read the runs, and evaluate what there is."""
    from thigmo.cli.console import Console, TerminalOperator
    from thigmo.cli.experiment_prompts import TerminalBystander
    from thigmo.studies.experiments.evaluate import save
    from thigmo.studies.experiments.explorations import (
        EmulatedBystander,
        ExplorationFolder,
        evaluate,
        run_explorations,
    )

    if asked.robot is None:
        assert asked.recorded is not None
        folder = ExplorationFolder(asked.recorded)
    else:
        console = Console(quiet=asked.quiet)
        person = TerminalOperator(console)
        with console.interruptible():
            with asked.connected(person) as (machine, known):
                emulated = machine.scenery() is not None
            folder = ExplorationFolder(asked.out / "exploration", known)
            look = _look(asked, known.body.diameter_cm)
            bystander = (
                EmulatedBystander() if emulated and not asked.rehearse
                else TerminalBystander(console, look)
            )  # fmt: skip
            with console.progress() as show:
                done = run_explorations(
                    asked.robot, bystander, folder, asked.trials, seed=asked.seed,
                    operator=person, progress=show, say=asked.say,
                )  # fmt: skip
            if not done:
                asked.say("stopped; the same command goes on")
    results = evaluate(folder)
    save(results, "exploration", folder.path)
    return results


def _attendant(console: Console, machine: Robot, asked: _Asked) -> Attendant:
    from thigmo.cli.experiment_prompts import TerminalAttendant
    from thigmo.errors import DataError
    from thigmo.studies.experiments.attendant import EmulatedAttendant

    if machine.scenery() is not None:
        if asked.camera is not None:
            raise DataError("--camera is for a real robot", "the emulator knows its dowels")
        behind = EmulatedAttendant(machine)
        return TerminalAttendant(console, behind=behind) if asked.rehearse else behind
    return TerminalAttendant(console, _look(asked, machine.config.body.diameter_cm))


def _look(asked: _Asked, diameter_cm: float) -> Callable[[], list[Place]] | None:
    """What measures the dowels' centres; None without a camera."""
    if asked.camera is None:
        return None
    from thigmo.calibrate.eyes import Eyes
    from thigmo.camera import CameraModel, open_source
    from thigmo.cli.camera import load_sheet
    from thigmo.studies.experiments import thesis

    eyes = Eyes(
        open_source(asked.camera), CameraModel.load(asked.camera_file),
        load_sheet(asked.sheet_file), diameter_cm, thesis.DOWEL_CM,
    )  # fmt: skip

    def look() -> list[Place]:
        found = eyes.everything().obstacles
        return sorted((float(o.x_cm), float(o.y_cm)) for o in found)

    return look


def _tell(results: list[Results], out: Path, as_json: bool) -> None:
    if as_json:
        print_json([_plain(result) for result in results])
        return
    _show([row for result in results for row in result.rows])
    for result in results:
        for claim in result.claims:
            typer.echo(f"  {claim}")
        for note in result.notes:
            typer.echo(f"  {note}")
    typer.echo(f"tables and figures are in {out}/")


def _plain(result: Results) -> dict[str, Any]:
    return {
        "rows": [row.record() for row in result.rows],
        "claims": [claim.record() for claim in result.claims],
        "notes": result.notes,
    }


def _fit(seed: int, out: Path, as_json: bool) -> None:
    from rich.progress import Progress

    from thigmo.studies.experiments.fit import as_json as fit_json
    from thigmo.studies.experiments.fit import fit

    with Progress(disable=as_json) as bar:
        task = bar.add_task("fitting the constants to section 3.2", total=None)
        found = fit(
            seed=seed, progress=lambda done, total: bar.update(task, completed=done, total=total)
        )
    out.mkdir(parents=True, exist_ok=True)
    (out / "constants.json").write_text(fit_json(found) + "\n")
    typer.echo(fit_json(found))


def _show(rows: list[Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    if not rows:
        return
    table = Table(
        "",
        "trials",
        "thesis",
        "its method, here",
        "ours",
        "perfect arc",
        "at the bound",
        "workspace: its",
        "ours",
        "bound",
        title="mean +- standard deviation of |a - x of the obstacle|; mean workspace x error; cm",
    )
    for row in rows:
        table.add_row(
            f"{row.experiment}, {row.condition}",
            str(row.trials),
            f"{row.thesis_mean:.2f} +- {row.thesis_std:.2f}",
            f"{row.here.mean:.2f} +- {row.here.std:.2f}",
            f"{row.ours.mean:.2f} +- {row.ours.std:.2f}",
            f"{row.perfect:.2f}",
            f"{row.measured:.2f}",
            f"{row.here.workspace:.2f}",
            f"{row.ours.workspace:.2f}",
            f"{row.bound:.2f}",
        )
    Console(width=150).print(table)
