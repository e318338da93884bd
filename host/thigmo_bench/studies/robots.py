"""Contacts found and localized by other robots than the thesis's, from their descriptions alone.

Every robot is drafted as by `thigmo robot new`. It explores rooms with a peg that some sweep of the
noise-free plant must feel (`emulator.reach`), and empty rooms. Its errors of calibration are those
of the default scene. Promises are pooled over the robots. Of some further robots only runs without
a fault are promised: thick bodies, and one with sensors of two kinds. The study `gallery` has
robots whose calibration is emulated too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import nan

import numpy as np

from thigmo.config import SIDES, RobotConfig
from thigmo.design import draft
from thigmo.emulator.reach import room_for
from thigmo.emulator.scene import Scene
from thigmo.errors import ThigmoError
from thigmo.exploration.map import best_contact, true_touches
from thigmo.record import RunDocument, Truth
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
    kind: str = "flex"
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
UNPROMISED: dict[str, _Draft | None] = {
    THICK_7: _Draft(120.0, 8, 2, diameter_cm=7.0),
    THICK_10: _Draft(120.0, 8, 2, diameter_cm=10.0),
    MIXED: _Draft(100.0, 10, 2, "heading"),
}
_BASE_CM = 4.0  # centre of the flex sensors at the base of a string of IMUs


def robot_named(name: str) -> RobotConfig:
    """A robot of the study."""
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

    def explore(self, scene: Scene, *, config: RobotConfig | None = None) -> None:
        """Explore the scene with a robot.toml, by default with what its lab would know; judge it.

        A run that was aborted has its problem as its status.
        """
        try:
            document = explored_scene(scene, self.seed, config=config)
        except ThigmoError as error:
            self.status = f"aborted: {error.problem}"
            return
        self.judge(document)
        self.judge_place(document)

    def judge_place(self, document: RunDocument) -> None:
        """Compare the run's best contact with the true points that it may be."""
        best, truth = best_contact(document.contacts), document.truth or Truth()
        if best is None:
            return
        true_contacts = true_touches(best, truth.contacts)
        low, high = best.interval_cm
        covered = any(low - LENGTH_CM <= true.arc_cm <= high + LENGTH_CM for true in true_contacts)
        self.missed = len(document.contacts) == len(document.false or [])
        self.wrong = best.status == "localized" and not covered
        offsets = [
            np.array([true.x_cm - best.x_cm, true.y_cm - best.y_cm]) for true in true_contacts
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
    visited.explore(scene)
    return visited


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
        outcome = _outcome(visits)
        context.save(outcome)
    return outcome


def _outcome(visits: list[Visited]) -> Outcome:
    visits_by_name = {
        name: [visited for visited in visits if visited.kind == name]
        for name in dict.fromkeys(visited.kind for visited in visits)
    }
    rows = [explored_row(name, rooms) for name, rooms in visits_by_name.items()]
    promised = [visited for visited in visits if visited.kind in ROBOTS]
    all_robots = explored_row("all robots", promised)
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
    data: dict[str, Sequence[Record]] = {
        "runs": [vars(visited) for visited in visits],
        "rows": rows,
    }
    return Outcome(data, {}, claims, [], rows)


def explored_row(name: str, visits: list[Visited]) -> Record:
    """The row of a robot that explores."""
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
