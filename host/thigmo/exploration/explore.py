"""`thigmo.explore`: one call from a URL to a run folder with a map."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType

from thigmo.config import RobotConfig
from thigmo.errors import ConfigError, DataError, RunFolderError, StoppedByViewerError, ThigmoError
from thigmo.exploration.effort import EFFORTS, Planner, chosen_effort, within
from thigmo.exploration.methods import FIELD, check_exploration_method
from thigmo.exploration.prior import read_prior, within_reach
from thigmo.exploration.result import ExplorationResult
from thigmo.exploration.resume import interrupted
from thigmo.exploration.run import Exploration, Progress, Protocol
from thigmo.exploration.run_control import Questions, RunControl
from thigmo.operator_prompts import Reachable
from thigmo.record import (
    PRIOR_FILE,
    NamedMuscle,
    ObstacleMap,
    RunDocument,
    RunFolder,
    write_obstacles,
)
from thigmo.report import draw_map
from thigmo.robot import Operator, connect
from thigmo.stream import Event, recording
from thigmo.version import VERSION
from thigmo.wiring import Wiring

_ENDINGS: dict[type[BaseException], str] = {
    KeyboardInterrupt: "interrupted by the operator",
    SystemExit: "terminated",  # by SIGTERM
}


def explore(
    url: str | None = None,
    *,
    config: RobotConfig | None = None,
    seed: int | None = None,
    out: str | os.PathLike[str] = "runs",
    name: str | None = None,
    realtime: bool = False,
    protocol: Protocol | None = None,
    effort: str | None = None,
    time_s: float | None = None,
    method: str = FIELD,
    prior: str | os.PathLike[str] | None = None,
    resume: str | os.PathLike[str] | None = None,
    operator: Operator | None = None,
    progress: Progress | None = None,
) -> ExplorationResult:
    """Explore with a robot: grow, sweep, feel, localize and map, to the full length.

    Returns the contacts in the room and the run folder.

    Args:
        url: address of the robot, as for `thigmo.connect`. None: that of the run to be resumed, or
            else `emulator://default`.
        config: robot.toml. It may be omitted for an emulated robot, whose scene supplies it.
        seed: of the emulator's noise.
        out: folder in which the run folder is made.
        name: of the run.
        realtime: run the emulator at the speed of the wall clock.
        protocol: how contacts are measured. "measure", the default, does not wait until sensors
            have settled, looks for contacts while the pressure rises, and then sweeps a side with a
            contact again, to the pressure at which the contact is felt best. "thesis" waits, and
            takes the readings at the full sweep's peak. A resumed run keeps its own.
        effort: "quick", "default" or "careful": how much robot time the map may cost
            (docs/figures.md charts it). The protocol "thesis" has no such choice.
        time_s: in place of `effort`, a budget of robot time in seconds, within which the run does
            as much as it can. Time spent waiting for a person counts.
        method: "field" places contacts by one fit to every frame of all sweeps of a side
            (`thigmo.field`). "thesis" takes each sweep's peak by the thesis's solver. It gives no
            intervals, so every stage's place is a contact of its own: nothing shows whether two are
            the same.
        prior: a map of the room: an earlier run's folder or obstacles.json, or a ROS map's YAML
            file. Readings can overrule it.
        resume: folder of a run that was cut short. The new run continues with what that one had
            learnt, swept and found, and with its constants, map, protocol and method. An emulated
            robot starts again at its scene's length.
        operator: answers what the board cannot know; the emulator has its own.
        progress: called with what the robot is doing, as text for people.

    Raises:
        ThigmoError: the run could not go on; the message has the operator's next step. The robot is
            vented and braked, and the run folder says how far the run came.
    """
    reached = 0.0

    def tell(doing: str, fraction: float) -> None:
        nonlocal reached
        reached = fraction
        if progress is not None:
            progress(doing, fraction)

    past = None if resume is None else interrupted(resume, config)
    if past is not None:
        if prior is not None:
            raise DataError("a run that is resumed keeps the map it was given", "leave --map out")
        url, name, config = url or past.document.url, name or past.document.name, past.config
        swept: Protocol = "thesis" if past.protocol == "thesis" else "measure"
        if protocol not in (None, swept):
            raise DataError(
                f"a run that is resumed keeps its protocol, {swept}", "leave --protocol out"
            )
        protocol = swept
        seed, method = past.document.seed if seed is None else seed, past.document.method
        if time_s is None and past.document.effort in EFFORTS:
            effort = effort or past.document.effort
    protocol = protocol or "measure"
    url = url or "emulator://default"
    given = past.prior if past else [] if prior is None else read_prior(prior)
    started = datetime.now(UTC)
    label = name or Path(url.partition("://")[2].partition("?")[0] or url).stem or "run"
    begun = started.isoformat(timespec="seconds")
    check_exploration_method(method)
    chosen = chosen_effort(protocol, effort, time_s)
    document = RunDocument(
        thigmo=VERSION, name=label, url=url, started=begun, seed=seed, method=method
    )
    if past is not None:
        document = replace(
            past.knowledge.interpreter.judged(document),
            stages=list(past.knowledge.stages),
            truth=past.document.truth,
            resumes=str(past.folder.path),
        )
    with (
        ExitStack() as afterwards,
        _sigterm_raises(),
        connect(url, seed=seed, operator=operator, realtime=realtime) as robot,
    ):
        used = config or robot.known_config
        if used is None:
            calibrated = Path("calibration") / "robot.toml"
            raise ConfigError(
                f"the constants of the robot at {url} are not known",
                f"give them: --config {calibrated}"
                if calibrated.with_name("actuator.json").exists()
                else f"give its robot.toml with --config; `thigmo calibrate all --robot {url}` "
                "makes one",
            )
        wiring = Wiring.laid_out(used)
        if beyond := wiring.unexplorable:
            raise ConfigError(
                f"an exploration is in the plane, by sensors on the board: {beyond.problem}",
                beyond.cure,
            )
        if time_s is not None:
            chosen = within(time_s, wiring)
        planner = Planner(wiring, chosen)
        document = replace(
            document,
            effort=chosen.name,
            skips=planner.skips(),
            muscles=NamedMuscle.all_of(used),
        )
        folder = RunFolder.create(out, label, started.astimezone())
        afterwards.enter_context(folder.hold())
        used.save(folder.path / "robot.toml")
        if past is not None:
            folder.keep_records_of(past.folder)
        given = within_reach(given, used.body)
        if given:
            kept = ObstacleMap("prior", "", "given", used.body.radius_cm, given)
            write_obstacles(kept, folder.path / PRIOR_FILE)

        def draw(kind: object, error: BaseException | None, trace: object) -> None:
            tell("drawing the map", 1.0 if error is None else reached)
            try:
                known, radius_cm = folder.read_document(), used.body.radius_cm
                draw_map(known, folder.map_path, radius_cm=radius_cm, prior=given)
            except (ThigmoError, OSError) as failure:
                if error is None:
                    raise
                error.add_note(f"no map: {failure}")

        folder.write_document(document)
        afterwards.push(draw)  # of what is known, also when the run is cut short
        facts = {
            "thigmo": VERSION,
            "url": url,
            "seed": "" if seed is None else str(seed),
            "started": begun,
            "protocol": protocol,
            "effort": chosen.name,
            **robot.identity,
        }
        control = RunControl()
        robot.while_waiting(control.obey_stop)
        if isinstance(operator, Reachable):
            operator.viewers = Questions(robot, control)
        with (
            robot.serve(label, str(folder.path.resolve()), control.command),
            folder.open_log(facts, robot.epoch_s) as log,
            recording(robot.hub, log),
        ):
            robot.record_frames(log.frame)
            robot.record_fibre(log.fibre)
            robot.while_waiting(log.check)
            run = Exploration(
                robot, wiring, folder, log, document, tell, planner, protocol, given, control,
                past.knowledge if past else None,
            )  # fmt: skip
            _walk(run)
    return ExplorationResult(run.document, folder.path)


def _walk(run: Exploration) -> None:
    """Walk the table while the record listens; whatever happens, the folder ends up whole."""
    start = time.monotonic()
    interrupted = False
    failed: BaseException | None = None
    try:
        run.run()
    except BaseException as error:
        failed = error
        interrupted = isinstance(error, KeyboardInterrupt | SystemExit | StoppedByViewerError)
        if isinstance(error, ThigmoError):
            why, words = str(error), (error.problem, error.next_step)
        else:
            why = _ENDINGS.get(type(error), f"{type(error).__name__}: {error}")
            words = (why, "")
        run.document = replace(run.document, outcome=f"aborted: {why}")
        run.live.tell(Event, "aborted", "fault", *words)
        error.add_note(f"run folder: {run.folder.path}")
        raise
    finally:
        # Safe outputs first, while the record still listens.
        safe = run.robot.make_safe(interrupted=interrupted)
        if safe:
            with suppress(ThigmoError):
                run.restore()
        run.document = replace(
            run.document,
            length_cm=run.length_cm,
            robot_time_s=round(run.robot.elapsed_s, 3),
            wall_time_s=round(time.monotonic() - start, 3),
        )
        try:
            run.keep()
        except RunFolderError as failure:  # a full disk: what was kept last stays
            if failed is None:
                raise
            failed.add_note(failure.problem)
        run.tell()
        if safe:
            with suppress(ThigmoError):
                run.robot.watch_emptying()


@contextmanager
def _sigterm_raises() -> Iterator[None]:
    """Let SIGTERM unwind like Ctrl-C does, so that the robot is vented on the way out."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def terminate(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, previous)  # a second one does not wait for the robot
        raise SystemExit(128 + signal.SIGTERM)

    previous = signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)
