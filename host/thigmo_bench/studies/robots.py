"""Contacts found and localized by other robots than the thesis's, from their descriptions alone.

Every robot is drafted as by `thigmo robot new`. It explores rooms with a peg that some sweep of the
noise-free plant must feel (`emulator.reach`), and empty rooms. Its errors of calibration are those
of the default scene. Promises are pooled over the robots. Of some further robots only runs without
a fault are promised: thick bodies, a catheter, and one with sensors of two kinds. Robots that do
not explore rest in an empty room, are pushed aside at random places, and feel where.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import cos, nan
from pathlib import Path

import numpy as np

from thigmo.config import SIDES, RobotConfig
from thigmo.design.draft import Kind, draft
from thigmo.emulator.board import virtual_board
from thigmo.emulator.reach import room_for
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import ThigmoError
from thigmo.exploration.feeling import feel
from thigmo.exploration.map import best_contact, of_stage
from thigmo.link.client import Client
from thigmo.record import RunDocument, Truth
from thigmo.robot import Robot
from thigmo_bench.studies.engine import Claim, Context, Outcome, Record, share
from thigmo_bench.studies.exploration import LENGTH_CM, Explored
from thigmo_bench.studies.rooms import explored_scene

_ELLIPSE = 5.991  # 95 % of chi-squared of two degrees of freedom

THESIS = "53 cm, 5 a side"


@dataclass(frozen=True)
class _Draft:
    """Arguments of `draft`."""

    length_cm: float
    sensors: int
    muscles: int
    kind: Kind = "flex"
    diameter_cm: float = 3.5


ROBOTS: dict[str, _Draft | None] = {
    THESIS: None,
    "120 cm, 8 a side": _Draft(120.0, 8, 2),
    "30 cm, 1 muscle, 3 sensors": _Draft(30.0, 3, 1),
    "200 cm, 1 muscle, 16 sensors": _Draft(200.0, 16, 1),
    "100 cm, string of 12 IMUs": _Draft(100.0, 12, 2, "heading"),
    "53 cm, fibre of 20 gratings": _Draft(53.0, 20, 2, "fibre"),
}
# Robots whose runs must end soundly; their localization is measured, and nothing is promised.
THICK_7, THICK_10 = "120 cm, 7 cm thick", "120 cm, 10 cm thick"
MIXED = "100 cm, flex at both bases, 10 IMUs"
CATHETER = "catheter"
UNPROMISED: dict[str, _Draft | None] = {
    THICK_7: _Draft(120.0, 8, 2, diameter_cm=7.0),
    THICK_10: _Draft(120.0, 8, 2, diameter_cm=10.0),
    MIXED: _Draft(100.0, 10, 2, "heading"),
    CATHETER: None,
}
GALLERY = Path(__file__).resolve().parents[3] / "docs" / "robots"
# Files of the gallery whose robots are felt at rest.
FELT = ("whisker", "finger", "tendon", "preformed", "three-muscles")
_PUSHED_RAD = (0.15, 0.5)  # turn of the body beyond a push
_BASE_CM = 4.0  # centre of the flex sensors at the base of a string of IMUs


def robot_named(name: str) -> RobotConfig:
    """A robot of the study."""
    if name == CATHETER:
        return RobotConfig.load(GALLERY / f"{name}.toml")
    description = (ROBOTS | UNPROMISED)[name]
    if description is None:
        return Scene.load("default").robot
    config = draft(**asdict(description))
    # Such bodies pull harder than friction holds.
    config.spool.brake = name in (THICK_7, THICK_10)
    if name == MIXED:
        flex = draft(description.length_cm, description.sensors, description.muscles)
        bases = [flex.column(side)[0] for side in SIDES]
        for base in bases:
            base.center_cm = _BASE_CM
        config.sensors = [*bases, *config.sensors]
    return config


@dataclass
class Visited(Explored):
    """A room that one of the robots explored; `kind` is the robot."""

    peg: bool = True
    length_cm: float = nan  # length of the robot
    missed: bool = True  # nothing on the map is at a peg
    # the best contact is localized, and its interval does not hold the true arc
    wrong: bool = False
    plane_cm: float = nan  # error of the best contact in the plane; NaN without one
    # the 95 % ellipse of the best contact does not hold the true point
    outside: bool = False

    def judge_place(self, document: RunDocument) -> None:
        """Compare the run's best contact with the true points of its stage."""
        best, truth = best_contact(document.contacts), document.truth or Truth()
        if best is None:
            return
        stage_contacts = [
            true for true in truth.contacts if of_stage(true, best.everted_length_cm, best.side)
        ]
        low, high = best.interval_cm
        covered = any(low - LENGTH_CM <= true.arc_cm <= high + LENGTH_CM for true in stage_contacts)
        self.missed = len(document.contacts) == len(document.false or [])
        self.wrong = best.status == "localized" and not covered
        offsets = [
            np.array([true.x_cm - best.x_cm, true.y_cm - best.y_cm]) for true in stage_contacts
        ]
        if nearest := sorted(offsets, key=np.linalg.norm)[:1]:
            self.plane_cm = float(np.linalg.norm(nearest[0]))
            squared = nearest[0] @ np.linalg.solve(np.asarray(best.covariance_cm2), nearest[0])
            self.outside = bool(squared > _ELLIPSE)


def visit(room: tuple[str, int, bool]) -> Visited:
    """Explore a room with or without a peg."""
    name, seed, peg = room
    scene = room_for(robot_named(name), seed, peg=peg)
    visited = Visited(name, seed, peg=peg, length_cm=scene.robot.body.length_cm)
    try:
        document = explored_scene(scene, seed)
    except ThigmoError as error:
        visited.status = f"aborted: {error.problem}"
        return visited
    visited.judge(document)
    visited.judge_place(document)
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
    robot = RobotConfig.load(GALLERY / f"{name}.toml")
    length_cm = robot.body.length_cm
    scene = room_for(robot, seed, peg=False)
    scene.start_length_cm = length_cm
    transport = EmulatorTransport(scene, virtual_board(robot, seed), seed=seed)
    driven = Robot(Client(transport))
    driven.configure(transport.config)
    driven.confirm_length(length_cm, settled=True)
    driven.pressurize(len(robot.body.zones) - 1)
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


def run(context: Context) -> Outcome:
    """Explore rooms with every robot, and check the promises."""
    pegs, empty = context.count(2, 20), context.count(1, 10)
    seeds = context.rng(0x26).integers(0, 2**31, pegs + empty).tolist()
    visits: list[Visited] = []
    outcome = Outcome()
    sound = context.rng(0x45).integers(0, 2**31, context.count(2, 40)).tolist()
    for name in UNPROMISED | ROBOTS:
        if name in ROBOTS:
            rooms = [(name, seed, number < pegs) for number, seed in enumerate(seeds)]
        else:  # every fourth is empty
            rooms = [(name, seed, number % 4 != 3) for number, seed in enumerate(sound)]
        visits += context.map(visit, rooms, name)
        outcome = _outcome(visits, [])
        context.save(outcome)
    loads = context.rng(0x51).integers(0, 2**31, context.count(2, 20)).tolist()
    pushed = context.map(push, [(name, load) for name in FELT for load in loads], "pushes")
    return _outcome(visits, pushed)


def _outcome(visits: list[Visited], pushed: list[Pushed]) -> Outcome:
    names = dict.fromkeys(visited.kind for visited in visits)
    rows = [_row(name, [visited for visited in visits if visited.kind == name]) for name in names]
    all_robots = _row("all robots", [visited for visited in visits if visited.kind in ROBOTS])
    claims = [
        Claim(f"{text}, all robots", float(all_robots[column]), limit, unit=unit)
        for text, column, limit, unit in (
            ("pegs missed", "missed_percent", 10.0, "%"),
            ("localized, and wrong", "wrong_percent", 5.0, "%"),
            ("empty rooms with a localized contact", "empty_localized", 0.0, "rooms"),
            ("median error in the plane", "error_percent", 3.0, "% of the length"),
            ("true points outside of the 95 % ellipse", "outside_percent", 10.0, "%"),
        )
    ]
    aborted = sum(visited.status.startswith("aborted") for visited in visits)
    claims.append(Claim("runs aborted, of all robots", float(aborted), 0.0, unit="runs"))
    rows.append(all_robots)
    if pushed:
        rows += [_felt_row(name, [load for load in pushed if load.robot == name]) for name in FELT]
        wrong = 100 * share([load.wrong for load in pushed])
        failed = sum(load.status.startswith("aborted") for load in pushed)
        claims += [
            Claim("pushes localized, and wrong", wrong, 2.5, unit="%"),
            Claim("pushes aborted", float(failed), 0.0, unit="pushes"),
        ]
    data: dict[str, Sequence[Record]] = {
        "runs": [vars(visited) for visited in visits],
        "pushes": [vars(load) for load in pushed],
        "rows": rows,
    }
    return Outcome(data, {}, claims, [], rows)


def _row(name: str, visits: list[Visited]) -> Record:
    with_peg, empty = (
        [visited for visited in visits if visited.peg is peg] for peg in (True, False)
    )
    localized = [visited for visited in with_peg if visited.status == "localized"]
    placed = [visited for visited in with_peg if np.isfinite(visited.plane_cm)]
    errors = [visited.plane_cm / visited.length_cm for visited in placed]
    return {
        "robot": name,
        "rooms": len(with_peg),
        "missed_percent": 100 * share([visited.missed for visited in with_peg]),
        "localized": len(localized),
        "wrong_percent": 100 * share([visited.wrong for visited in with_peg]),
        "error_percent": 100 * float(np.median(errors)) if errors else nan,
        "worst_percent": 100 * max(errors, default=nan),
        "outside_percent": 100 * share([visited.outside for visited in placed]),
        "empty_rooms": len(empty),
        "empty_localized": sum(visited.status == "localized" for visited in empty),
        "aborted": sum(visited.status.startswith("aborted") for visited in visits),
    }


def _felt_row(name: str, pushed: list[Pushed]) -> Record:
    """The row of a robot that rests: its rooms are pushes."""
    length_cm = RobotConfig.load(GALLERY / f"{name}.toml").body.length_cm
    errors = [load.error_cm / length_cm for load in pushed if load.felt]
    return {
        "robot": f"{name}, pushed at rest",
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
