"""`thigmo experiment`: repeat the thesis's experiments and compare in three columns."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thigmo.cli.camera import CAMERA_FILE, SHEET_FILE, CameraFileOption, SheetOption
from thigmo.cli.output import JsonOption, KnownConfigOption, print_json, robot_option

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from thigmo.cli.console import Console, TerminalOperator
    from thigmo.config import RobotConfig
    from thigmo.robot import Robot
    from thigmo.studies.engine import Outcome
    from thigmo.studies.experiments.attendant import Attendant, Place


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
        robot_option(
            "Take the trials with this robot: /dev/ttyACM0, COM3, socket://, emulator://SCENE."
        ),
    ] = None,
    config: KnownConfigOption = None,
    camera: Annotated[
        str | None,
        typer.Option(
            help="Measures the dowels: camera:0, a folder of pictures. Else they are typed in."
        ),
    ] = None,
    sheet_file: SheetOption = SHEET_FILE,
    camera_file: CameraFileOption = CAMERA_FILE,
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
    from thigmo.cli.studies import conduct, report
    from thigmo.errors import DataError
    from thigmo.studies.engine import Context
    from thigmo.studies.experiments import EXPERIMENTS

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
        look = None if camera is None else _look(camera, sheet_file, camera_file)
        desk = _Desk(robot, recorded, out / name, trials, seed, config, look, rehearse, as_json)
        outcome, folder = desk.explorations() if name == "exploration" else desk.static(name, jobs)
        found = report(name, outcome, folder, as_json)
        if as_json:
            print_json([found])
    elif name == "fit":
        _fit(seed, out)
    else:
        studies = {one: partial(EXPERIMENTS[one], robots, trials) for one in names}
        conduct(studies, Context(seed=seed, jobs=jobs), out, as_json)


def _fit(seed: int, out: Path) -> None:
    from thigmo.cli.studies import study_progress
    from thigmo.studies.experiments.fit import as_json, fit

    with study_progress("fit to section 3.2") as tell:
        found = as_json(fit(seed=seed, progress=tell))
    out.mkdir(parents=True, exist_ok=True)
    (out / "constants.json").write_text(f"{found}\n")
    typer.echo(found)


def _look(camera: str, sheet_file: Path, camera_file: Path) -> Callable[[float], list[Place]]:
    """What measures the centres of the dowels beside a body of so many cm across."""
    from thigmo.calibrate.eyes import Eyes
    from thigmo.camera import CameraModel, open_source
    from thigmo.cli.camera import load_sheet
    from thigmo.studies.experiments import thesis

    located = open_source(camera), CameraModel.load(camera_file), load_sheet(sheet_file)

    def look(diameter_cm: float) -> list[Place]:
        found = Eyes(*located, diameter_cm, thesis.DOWEL_CM).everything().obstacles
        return sorted((float(o.x_cm), float(o.y_cm)) for o in found)

    return look


@dataclass(frozen=True)
class _Desk:
    """Where trials are taken with a robot, or those taken before are read."""

    robot: str | None
    recorded: Path | None
    out: Path
    trials: int
    seed: int
    config: Path | None
    look: Callable[[float], list[Place]] | None
    rehearse: bool
    quiet: bool

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
            emulated = machine.scenery() is not None
            if self.rehearse and not emulated:
                raise DataError("--rehearse is for the emulator", "give --robot emulator://default")
            if self.look and emulated:
                raise DataError("--camera is for a real robot", "the emulator knows its dowels")
            yield machine, known

    def camera(self, known: RobotConfig) -> Callable[[], list[Place]] | None:
        """What measures the dowels beside this robot; None: they are typed in."""
        return partial(self.look, known.body.diameter_cm) if self.look else None

    def static(self, name: str, jobs: int) -> tuple[Outcome, Path]:
        """Take the trials, or read them, and evaluate what there is."""
        from thigmo.cli.console import Console, TerminalOperator
        from thigmo.errors import DataError
        from thigmo.studies.engine import Context
        from thigmo.studies.experiments.evaluate import evaluate
        from thigmo.studies.experiments.plan import STATIC
        from thigmo.studies.experiments.recorded import TrialFolder, run_trials

        if name not in STATIC:
            raise DataError(
                f"{name!r} is not taken with a robot, as {', '.join(STATIC)} and exploration are",
                "name one of these",
            )
        if self.recorded is not None:
            folder = TrialFolder(self.recorded)
        else:
            console = Console(quiet=self.quiet)
            person = TerminalOperator(console)
            with console.interruptible(), self.connected(person) as (machine, known):
                folder = TrialFolder(self.out, known)
                attendant = self._attendant(console, machine, known)
                if not run_trials(machine, attendant, folder, name, self.trials, self.say):
                    self.say("stopped; the same command goes on")
        return evaluate(name, folder.trials(), Context(jobs=jobs)), folder.path

    def _attendant(self, console: Console, machine: Robot, known: RobotConfig) -> Attendant:
        from thigmo.cli.experiment_prompts import TerminalAttendant
        from thigmo.studies.experiments.attendant import EmulatedAttendant

        if machine.scenery() is None:
            return TerminalAttendant(console, self.camera(known))
        behind = EmulatedAttendant(machine)
        return TerminalAttendant(console, behind=behind) if self.rehearse else behind

    def explorations(self) -> tuple[Outcome, Path]:
        """Explore trial by trial, or read the runs, and evaluate what there is."""
        from thigmo.cli.console import Console, TerminalOperator
        from thigmo.cli.experiment_prompts import TerminalBystander
        from thigmo.studies.experiments.explorations import (
            EmulatedBystander,
            ExplorationFolder,
            evaluate,
            run_explorations,
        )

        if self.robot is None:
            assert self.recorded is not None
            folder = ExplorationFolder(self.recorded)
            return evaluate(folder), folder.path
        console = Console(quiet=self.quiet)
        person = TerminalOperator(console)
        with console.interruptible():
            with self.connected(person) as (machine, known):
                emulated = machine.scenery() is not None and not self.rehearse
            folder = ExplorationFolder(self.out, known)
            bystander = (
                EmulatedBystander() if emulated else TerminalBystander(console, self.camera(known))
            )
            with console.progress() as show:
                done = run_explorations(
                    self.robot, bystander, folder, self.trials, seed=self.seed, operator=person,
                    progress=show, say=self.say,
                )  # fmt: skip
            if not done:
                self.say("stopped; the same command goes on")
        return evaluate(folder), folder.path
