"""Other robots than the thesis's, each from its description alone: do they feel, and localize?

Every robot is drafted as `thigmo robot new` does, and explores rooms with a peg that the noise-free
plant says some sweep must feel (`emulator.reach`), and empty ones. Its lab knows it to within the
default scene's errors of calibration. What is promised is pooled over the robots.
"""

from __future__ import annotations

import tempfile
from dataclasses import asdict, dataclass
from math import nan
from pathlib import Path

import numpy as np

from thigmo.config import RobotConfig
from thigmo.design import draft
from thigmo.emulator.reach import room_for
from thigmo.emulator.scene import Scene
from thigmo.errors import ThigmoError
from thigmo.studies.engine import Claim, Context, Outcome, Record, share
from thigmo.studies.exploration import Explored
from thigmo.studies.rooms import explored

THESIS = "53 cm, 5 a side"


@dataclass(frozen=True)
class _Draft:
    """Arguments of `draft`."""

    length_cm: float
    sensors: int
    muscles: int


ROBOTS: dict[str, _Draft | None] = {
    THESIS: None,
    "120 cm, 5 a side": _Draft(120.0, 5, 2),
    "30 cm, 1 muscle, 3 sensors": _Draft(30.0, 3, 1),
    "200 cm, 1 muscle, 9 sensors": _Draft(200.0, 9, 1),
}


def robot_named(name: str) -> RobotConfig:
    """A robot of the study."""
    made = ROBOTS[name]
    return Scene.load("default").robot if made is None else draft(**asdict(made))


@dataclass
class Visited(Explored):
    """A room that one of the robots explored; `kind` is the robot."""

    peg: bool = True
    length_cm: float = nan  # of the robot


def visit(room: tuple[str, int, bool]) -> Visited:
    """Explore a room with or without a peg."""
    name, seed, peg = room
    scene = room_for(robot_named(name), seed, peg=peg)
    found = Visited(name, seed, peg=peg, length_cm=scene.robot.body.length_cm)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "room.toml"
        scene.save(file)
        try:
            found.judge(explored(f"emulator://{file}", folder, seed).document)
        except ThigmoError as error:
            found.status = f"aborted: {error.what}"
    return found


def run(context: Context) -> Outcome:
    """Rooms of every robot, and what is promised of all."""
    pegs, empty = context.count(2, 20), context.count(1, 10)
    seeds = context.rng(0x26).integers(0, 2**31, pegs + empty).tolist()
    found: list[Visited] = []
    outcome = Outcome()
    for name in ROBOTS:
        rooms = [(name, seed, number < pegs) for number, seed in enumerate(seeds)]
        found += context.map(visit, rooms, name)
        outcome = _outcome(found)
        context.save(outcome)
    return outcome


def _outcome(found: list[Visited]) -> Outcome:
    names = dict.fromkeys(one.kind for one in found)
    rows = [_row(name, [one for one in found if one.kind == name]) for name in names]
    whole = _row("all robots", found)
    claims = [
        Claim(f"{text}, all robots", float(whole[column]), limit, unit=unit)
        for text, column, limit, unit in (
            ("pegs missed", "missed_percent", 10.0, "%"),
            ("localized, and wrong", "wrong_percent", 5.0, "%"),
            ("empty rooms with a localized contact", "empty_localized", 0.0, "rooms"),
            ("median |x error|", "error_percent", 3.0, "% of the length"),
        )
    ]
    rows.append(whole)
    return Outcome({"runs": [vars(one) for one in found], "rows": rows}, {}, claims, [], rows)


def _row(name: str, found: list[Visited]) -> Record:
    there, empty = ([one for one in found if one.peg is peg] for peg in (True, False))
    localized = [one for one in there if one.status == "localized"]
    errors = [abs(one.error_x_cm) / one.length_cm for one in there]
    known = [error for error in errors if np.isfinite(error)]
    return {
        "robot": name,
        "rooms": len(there),
        "missed_percent": 100 * share([one.missed for one in there]),
        "localized": len(localized),
        "wrong_percent": 100 * share([one.wrong for one in there]),
        "error_percent": 100 * float(np.median(known)) if known else nan,
        "empty_rooms": len(empty),
        "empty_localized": sum(one.status == "localized" for one in empty),
        "aborted": sum(one.status.startswith("aborted") for one in found),
    }
