"""`thigmo calibrate STEP`: guided, resumable calibration; also on a CSV that a lab already has."""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from thigmo.cli.camera import CAMERA_FILE, load_sheet
from thigmo.cli.console import Console
from thigmo.cli.output import AnyRobotOption, JsonOption, print_json, show, visible
from thigmo.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from thigmo.calibrate.overhead import OverheadCamera
    from thigmo.calibrate.session import Session
    from thigmo.calibrate.verdict import StepResult
    from thigmo.robot import Robot


def _steps(begun: str) -> list[str]:
    """Steps for the shell to complete."""
    from thigmo.calibrate.steps import STEPS

    return [step for step in ("all", "status", *STEPS) if step.startswith(begun)]


def calibrate(
    step: Annotated[
        str,
        typer.Argument(help="all, status, or one of the steps above.", autocompletion=_steps),
    ],
    robot: AnyRobotOption = None,
    folder: Annotated[Path, typer.Option(help="Calibration folder.")] = Path("calibration"),
    csv: Annotated[
        Path | None, typer.Option(help="Fit this file of readings instead; no robot is used.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="robot.toml to start from: geometry and body pressures.")
    ] = None,
    camera: Annotated[
        str,
        typer.Option(help="camera:0, a video or a folder of pictures; not on the emulator."),
    ] = "camera:0",
    trials: Annotated[int, typer.Option(help="Trials of the free bends.", min=1)] = 3,
    step_psi: Annotated[float, typer.Option(help="Pressure step of free bends.", min=0.5)] = 2.0,
    places: Annotated[int, typer.Option(help="Tip places of the flex step.", min=4)] = 10,
    pictures: Annotated[
        int,
        typer.Option(help="Pictures in the stiffness step, beside those of the tip places.", min=2),
    ] = 12,
    body_pressure: Annotated[
        list[int] | None,
        typer.Option(help="Only this body pressure, from 0; may be given more than once."),
    ] = None,
    method: Annotated[
        Literal["thesis"] | None,
        typer.Option(
            help="For flex and buckling: fit as the thesis did, without stating errors.",
            show_default=False,
        ),
    ] = None,
    from_fold: Annotated[
        bool,
        typer.Option(
            "--from-fold", help="For stiffness: state EI from the fold's moment; no robot is used."
        ),
    ] = False,
    again: Annotated[bool, typer.Option("--again", help="Take the readings again.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Measure the robot's constants, with an overhead camera; good ones go into FOLDER/robot.toml.

    First the camera: see `thigmo camera --help`. Then, with the robot straight on the table:

    `thigmo calibrate all --robot /dev/ttyACM0 --config robot.toml`

    or step by step; each step needs those before it:

    pressure: zeros of the pressure sensors, vented.

    encoder: the robot grows; counts by the length that the camera sees, and the motor's duty.

    actuator: free bends of every muscle at every body pressure; maps, and the lag. Bends out of
    the plane are measured by the sensors that read them.

    base: the tip is pushed aside by hand, by two amounts to either side; the angle by which the
    base turns under load. With `--csv` of pushes whose moment or force is known: by that turn
    (`turn_deg`), or the tip's place (`tip_y_cm`).

    flex: the tip is pushed aside by hand to ten places; every sensor's scale, zero and noise.

    heading: for IMUs: the turn from each to the next at the free bends; scale, zero and drift.

    fibre: for a fibre: strains at the free bends; scales, zeros, twist, and the common drift.

    hysteresis: how each sensor creeps after it was everted (from the encoder's stops).

    buckling: hard pushes at the tip, until the base folds.

    stiffness: whether sensors stiffen the body, to 0.1 with twelve more pictures of the pushed tip
    (a check; no other step uses it). With `--csv` of readings under known forces, such as a hung
    weight, or with `--from-fold`: the bending stiffness, which makes newtons of forces.

    noise: readings of the robot at rest.

    check: whether the robot is still as robot.toml says.

    Each step draws its fit (FOLDER/STEP.png) and says whether it is good, and why. Only good
    results are kept; the file before them becomes robot.toml.1.bak and so on. A step that was
    stopped resumes after its last reading; `status` lists what is done.

    `--csv FILE` fits readings that a lab already has; if a column is missing, the message lists
    all of them. Try it without a robot: `--robot emulator://empty`.
    """
    from thigmo.extras import require

    require("camera", "calibration")
    from thigmo.calibrate.bending import from_fold as state_stiffness
    from thigmo.calibrate.session import Session, blank
    from thigmo.calibrate.step_figures import draw
    from thigmo.calibrate.steps import STEPS, fit_csv, run, run_all
    from thigmo.config import RobotConfig

    if step not in (*STEPS, "all", "status"):
        raise DataError(f"there is no step {step!r}", f"use all, status, {', '.join(STEPS)}")
    if method and step not in ("all", "status") and STEPS[step].thesis is None:
        raise DataError(f"{step} has only one method", "give --method only with flex or buckling")
    start = RobotConfig.load(config) if config else None
    if from_fold and (step != "stiffness" or csv is not None):
        raise DataError("--from-fold is for stiffness only", "run `thigmo calibrate stiffness`")
    if csv is not None or from_fold:
        held = folder / "robot.toml"
        base = RobotConfig.load(held) if held.exists() else start or RobotConfig()
        # Before a folder is made: a bad file leaves none.
        result = fit_csv(step, csv, base, method) if csv else state_stiffness(base)
        session = Session(folder, start)
        draw(result, session.figure(step))
        show(as_json, result.as_data(), *session.keep(step, result))
        if not result.verdict.good:
            raise typer.Exit(2)
        return
    if step == "status":
        if not (folder / "robot.toml").exists():
            raise DataError(
                f"{folder} is not a calibration folder",
                "name one with --folder, or begin: `thigmo calibrate all --robot URL`",
            )
        _show_steps(Session(folder, start), as_json=as_json)
        return
    if robot is None:
        raise DataError("no robot is named", "give --robot URL, or --csv FILE")
    from thigmo.calibrate.bench import Bench, Plan
    from thigmo.robot import connect

    def say(text: str) -> None:
        if not as_json:
            typer.echo(text)

    console = Console(quiet=as_json)
    with console.interruptible(robot), connect(robot, operator=console) as machine:
        known = machine.known_config
        session = Session(folder, start or (blank(known) if known else None))
        plan = Plan(trials=trials, step_psi=step_psi, places=places,
                    pictures=pictures,
                    body_pressures=tuple(body_pressure) if body_pressure else None)  # fmt: skip
        overhead = _overhead_camera(machine, session, camera)
        bench = Bench(machine, overhead, session, plan, say)
        if step == "all":
            results = run_all(bench, again=again, method=method)
        else:
            results = {step: run(bench, step, again=again, method=method)}
    if as_json:
        print_json({name: result.as_data() for name, result in results.items()})
    bad = [name for name, result in results.items() if not result.verdict.good]
    if step == "all" and not as_json:
        _show_steps(session, results, as_json=False)
    if bad:
        if step == "all":
            say(f"next: correct what is BAD, and run `thigmo calibrate {bad[0]} --robot {robot}`")
        raise typer.Exit(2)
    if step == "all":
        command = "feel" if bench.wiring.unexplorable else "explore"
        say(f"next: `thigmo {command} --robot {robot} --config {session.robot_file}`")
    else:
        say(f"constants so far: {session.robot_file}")


def _show_steps(
    session: Session, results: Mapping[str, StepResult] = MappingProxyType({}), *, as_json: bool
) -> None:
    """A line for what each step has learnt: by these results, or by those that the folder keeps."""
    from thigmo.calibrate.steps import STEPS, steps_of

    facts: dict[str, dict[str, object]] = {}
    lines = []
    for name in steps_of(session.config):
        readings = sum(len(session.rows(procedure)) for procedure in STEPS[name].rows)
        stored = session.good_result(name)
        reason = stored["verdict"]["reason"] if stored else ""
        state = "good" if stored else "not run"
        if name in results:
            verdict = results[name].verdict
            state, reason = "good" if verdict.good else "BAD", verdict.reason
        facts[name] = {"done": state == "good", "readings": readings, "reason": reason}
        lines.append(f"{name:12s} {state:8s} {readings:5d} readings  {visible(reason)}".rstrip())
    show(as_json, facts, *lines)


def _overhead_camera(machine: Robot, session: Session, camera: str) -> OverheadCamera:
    """The camera: painted over an emulated robot, opened and located on a real one."""
    from thigmo.calibrate.overhead import OverheadCamera, painted_camera
    from thigmo.camera import CameraModel, open_source

    body = session.config.body
    sheet = load_sheet(body.length_cm)
    if (painted := painted_camera(machine, sheet, body, seed=0)) is not None:
        painted.model.save(session.folder / "camera.json")
        return painted
    return OverheadCamera(open_source(camera), CameraModel.load(CAMERA_FILE), sheet, body)
