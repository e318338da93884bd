"""Robots of the gallery, docs/robots: calibrated and explored, or felt, beside what check says.

Nobody has measured a robot that explores: the scales of its sensors and its maps are drawn. The
steps of `calibrate all` measure it to their end, and it explores rooms with that robot.toml: pegs
that some sweep of the noise-free plant must feel (`emulator.reach`), and empty rooms. In every
second room the sensors' gains differ from what was measured. A check that is not "bad" promises
that the robot finds these pegs: one that misses them shows that `thigmo robot check` is wrong.

Robots that do not explore rest in an empty room, are pushed aside at random places, and feel where.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, nan
from pathlib import Path
from typing import NamedTuple

import numpy as np

from thigmo.calibrate.bench import Bench, Plan
from thigmo.calibrate.overhead import painted_camera
from thigmo.calibrate.session import Session, blank
from thigmo.calibrate.steps import run_all, steps_of
from thigmo.camera import Sheet
from thigmo.config import RobotConfig
from thigmo.design import judge
from thigmo.emulator.board import virtual_board
from thigmo.emulator.reach import room_for
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import ThigmoError
from thigmo.exploration.feeling import feel
from thigmo.link.client import Client
from thigmo.robot import Robot, connect
from thigmo_bench.studies.engine import Claim, Context, Outcome, Record, share
from thigmo_bench.studies.exploration import LENGTH_CM
from thigmo_bench.studies.robots import Visited, explored_row

GALLERY = Path(__file__).resolve().parents[3] / "docs" / "robots"
EXPLORED = ("one-column", "mixed", "thick-7", "thick-10", "catheter", "finger")
FELT = ("whisker", "finger", "tendon", "preformed", "three-muscles")

_ROOMS = 8  # of a robot
_EMPTY = (2, 5, 7)  # of every eight rooms
_LOADS = 20  # pushes of a robot
_GAIN_CHANGE = 0.05  # relative standard deviation, after the calibration
# What nobody has measured before the calibration: ranges of what differs from the gallery's file.
_SCALES, _MAPS = (0.75, 1.25), (0.93, 1.07)
# Fewer set points than the command's defaults: the emulator's noise does not need more.
_PLAN = Plan(trials=1, step_psi=3.0, places=6)
_PUSHED_RAD = (0.15, 0.5)  # turn of the body beyond a push


def gallery_robot(name: str) -> RobotConfig:
    """A robot of the gallery, by the name of its file."""
    return RobotConfig.load(GALLERY / f"{name}.toml")


def unmeasured(name: str, seed: int) -> RobotConfig:
    """A robot of the gallery whose scales and maps differ from its file."""
    robot, rng = gallery_robot(name), np.random.default_rng([seed, 0xCA1])
    for sensor in robot.sensors:
        sensor.rescale(float(rng.uniform(*_SCALES)))
    for muscle in robot.muscles:
        for muscle_map in muscle.maps:
            stretch = float(rng.uniform(*_MAPS))
            for curve in (muscle_map.inflate, muscle_map.deflate):
                curve.amplitude *= stretch
    return robot


@dataclass
class Calibrated:
    """A robot that `calibrate all` has measured."""

    robot: str
    seed: int
    # steps that are not good, or were not run, with the reason
    faulty_steps: tuple[str, ...] = ()
    config: RobotConfig | None = None  # the robot.toml of the last step; None if it did not run


def calibrate(robot_and_seed: tuple[str, int]) -> Calibrated:
    """Measure a robot with all steps of `calibrate all`."""
    name, seed = robot_and_seed
    truth = unmeasured(name, seed)
    calibrated = Calibrated(name, seed)
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "empty.toml"
        room_for(truth, seed, peg=False).save(scene)
        try:
            with connect(f"emulator://{scene}", seed=seed) as robot:
                session = Session(Path(folder) / "calibration", blank(truth))
                body = truth.body
                camera = painted_camera(robot, Sheet.of_length(body.length_cm), body, seed)
                assert camera is not None  # the robot is emulated
                results = run_all(Bench(robot, camera, session, _PLAN))
        except ThigmoError as error:
            calibrated.faulty_steps = (f"aborted: {error.problem}",)
            return calibrated
        # Steps that no other step needs, such as that for the stiffness, may be bad.
        calibrated.faulty_steps = tuple(
            f"{step}: {results[step].verdict.reason}" if step in results else f"{step}: not run"
            for step in steps_of(truth)
            if step not in results or not results[step].verdict.good
        )
        if len(results) == len(steps_of(truth)):
            calibrated.config = session.config
    return calibrated


class Room(NamedTuple):
    """A room of a calibrated robot."""

    robot: Calibrated
    seed: int
    peg: bool
    gains_changed: bool  # since the calibration


def has_peg(number: int) -> bool:
    """Whether a peg stands in a robot's room of that number."""
    return number % 8 not in _EMPTY


def room_scene(room: Room) -> Scene:
    """The true robot in its room."""
    truth = unmeasured(room.robot.robot, room.robot.seed)
    scene = room_for(truth, room.seed, peg=room.peg)
    rng = np.random.default_rng([room.seed, 0x6A1])
    for sensor in truth.sensors if room.gains_changed else ():
        sensor.rescale(1.0 / (1.0 + _GAIN_CHANGE * rng.standard_normal()))
    return scene


def visit(room: Room) -> Visited:
    """Explore a room with what the calibration measured."""
    scene = room_scene(room)
    visited = Visited(
        room.robot.robot, room.seed, peg=room.peg, length_cm=scene.robot.body.length_cm
    )
    if room.robot.config is None:
        visited.status = f"aborted: not calibrated, {room.robot.faulty_steps[0]}"
        return visited
    visited.explore(scene, config=room.robot.config)
    return visited


@dataclass
class Pushed:
    """A push at a resting robot, and what was felt of it."""

    robot: str
    seed: int
    arc_cm: float
    status: str = ""
    felt: bool = False  # there was a contact
    wrong: bool = False  # it is localized, and its interval does not hold the push
    error_cm: float = nan


def push(load: tuple[str, int]) -> Pushed:
    """Push a robot of the gallery aside at a random place of its outer four fifths."""
    name, seed = load
    robot = gallery_robot(name)
    length_cm = robot.body.length_cm
    scene = room_for(robot, seed, peg=False)
    scene.start_length_cm = length_cm
    transport = EmulatorTransport(scene, virtual_board(robot, seed), seed=seed)
    driven = Robot(Client(transport))
    driven.configure(transport.config)
    driven.confirm_length(length_cm, settled=True)
    driven.pressurize(len(robot.body.pressures) - 1)
    driven.arm()
    driven.wait(2.0)
    driven.zero()
    rng = np.random.default_rng([seed, 0x9F5])
    arc_cm = float(rng.uniform(0.2, 1.0) * length_cm)
    turn = float(rng.choice([-1.0, 1.0]) * rng.uniform(*_PUSHED_RAD))
    # A force at an arc turns what lies beyond by half of moment times arc.
    plant = transport.lockstep.plant
    _, y_cm, heading = plant.body.pose(arc_cm)
    plant.hold([(arc_cm, y_cm + 2 / 3 * turn * arc_cm * cos(heading))], 0.5)
    driven.wait(3.0)
    pushed = Pushed(name, seed, arc_cm)
    try:
        result = feel(driven).result
    except ThigmoError as error:
        pushed.status = f"aborted: {error.problem}"
        return pushed
    finally:
        driven.close()
    pushed.status = result.status
    if result.contacts:
        best = min(result.contacts, key=lambda contact: abs(contact.arc - arc_cm))
        low, high = best.interval
        pushed.felt, pushed.error_cm = True, abs(best.arc - arc_cm)
        pushed.wrong = result.status == "localized" and not (
            low - LENGTH_CM <= arc_cm <= high + LENGTH_CM
        )
    return pushed


def verdict(robot: RobotConfig) -> str:
    """The worst mark of `thigmo robot check`: "good", "warning" or "bad"."""
    marks = {finding.mark for finding in judge(robot)}
    return next((mark for mark in ("bad", "warning") if mark in marks), "good")


def run(context: Context) -> Outcome:
    """Calibrate and explore with the robots that do, push the others, and check the promises."""
    seed = int(context.rng(0x47).integers(0, 2**31))
    calibrated = context.map(calibrate, [(name, seed) for name in EXPLORED], "calibrations")
    seeds = context.rng(0x45).integers(0, 2**31, context.count(3, _ROOMS)).tolist()
    visits: list[Visited] = []
    outcome = Outcome()
    for robot in calibrated:
        rooms = [
            Room(robot, room_seed, peg=has_peg(number), gains_changed=number % 2 == 1)
            for number, room_seed in enumerate(seeds)
        ]
        visits += context.map(visit, rooms, robot.robot)
        outcome = outcome_of(calibrated, visits, [])
        context.save(outcome)
    loads = context.rng(0x51).integers(0, 2**31, context.count(2, _LOADS)).tolist()
    pushed = context.map(push, [(name, load) for name in FELT for load in loads], "pushes")
    return outcome_of(calibrated, visits, pushed)


def outcome_of(
    calibrated: list[Calibrated], visits: list[Visited], pushed: list[Pushed]
) -> Outcome:
    """Tables and promises of what was calibrated, explored and felt."""
    explored_rows: list[Record] = []
    for name in dict.fromkeys(visited.kind for visited in visits):
        rooms = [visited for visited in visits if visited.kind == name]
        check = verdict(gallery_robot(name))
        explored_rows.append({**explored_row(name, rooms), "check": check})
    felt_rows = [
        _felt_row(name, [load for load in pushed if load.robot == name])
        for name in dict.fromkeys(load.robot for load in pushed)
    ]
    rows = [*explored_rows, *felt_rows]
    missed_by_robot = [
        [visited.missed for visited in visits if visited.peg and visited.kind == row["robot"]]
        for row in explored_rows
        if row["check"] != "bad"
    ]
    promised = [missed for pegs in missed_by_robot for missed in pegs]
    worst = max(missed_by_robot, key=share, default=promised)
    aborted = sum(visited.status.startswith("aborted") for visited in visits)
    claims = [
        Claim(
            "calibrations that did not come to their end",
            float(sum(robot.config is None for robot in calibrated)),
            0.0,
            unit="robots",
        ),
        Claim("runs aborted", float(aborted), 0.0, unit="runs"),
        Claim(
            "rooms with a localized contact that is wrong",
            100 * share([visited.contacts_wrong > 0 for visited in visits]),
            2.5,
            unit="%",
        ),
        Claim("pegs missed that `robot check` promised", 100 * share(promised), 10.0, unit="%"),
        Claim(
            "pegs missed that `robot check` promised, of the robot that misses most",
            100 * share(worst),
            10.0,
            unit="%",
            standard_error=100 * float(np.std(worst)) / max(len(worst), 1) ** 0.5,
        ),
    ]
    if pushed:
        wrong = 100 * share([load.wrong for load in pushed])
        failed = sum(load.status.startswith("aborted") for load in pushed)
        claims += [
            Claim("pushes localized, and wrong", wrong, 2.5, unit="%"),
            Claim("pushes aborted", float(failed), 0.0, unit="pushes"),
        ]
    notes = [f"{robot.robot}: {problem}" for robot in calibrated for problem in robot.faulty_steps]
    data: dict[str, Sequence[Record]] = {
        "runs": [vars(visited) for visited in visits],
        "pushes": [vars(load) for load in pushed],
        "rows": rows,
    }
    return Outcome({name: table for name, table in data.items() if table}, {}, claims, notes, rows)


def _felt_row(name: str, pushed: list[Pushed]) -> Record:
    """The row of a robot that rests: its rooms are pushes."""
    length_cm = gallery_robot(name).body.length_cm
    errors = [load.error_cm / length_cm for load in pushed if load.felt]
    return {
        "robot": f"{name}, pushed at rest",
        "check": verdict(gallery_robot(name)),
        "rooms": len(pushed),
        "missed_percent": 100 * share([not load.felt for load in pushed]),
        "localized": sum(load.status == "localized" for load in pushed),
        "wrong_percent": 100 * share([load.wrong for load in pushed]),
        "error_percent": 100 * float(np.median(errors)) if errors else nan,
        "worst_percent": 100 * max(errors, default=nan),
        "outside_percent": nan,
        "empty_rooms": 0,
        "empty_localized": 0,
        "aborted": sum(load.status.startswith("aborted") for load in pushed),
    }
