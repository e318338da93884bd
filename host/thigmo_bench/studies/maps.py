"""What a map of the room does to an exploration: a true one, a stale one, and none.

Rooms of one peg, as the study of explorations draws them, are explored three times with the same
seeds: without a map, with a ROS map of the peg where it stands, and with one that shows it 6 cm
away from there. Errors are those of the best contact in the plane, and are compared room by room.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import asdict
from math import cos, sin, tau
from pathlib import Path

import numpy as np

from thigmo.emulator.reach import random_peg
from thigmo.emulator.scene import PegTable, Scene
from thigmo.errors import ThigmoError
from thigmo.exploration.prior import read_prior, within_reach
from thigmo.record import Obstacle, OccupancyGrid, write_ros_map
from thigmo.record.occupancy import FREE, OCCUPIED
from thigmo_bench.studies.engine import Claim, Context, Outcome, Record
from thigmo_bench.studies.exploration import Explored
from thigmo_bench.studies.rooms import explored_scene

_ROOMS = 20
_MOVED_CM = 6.0  # from where a stale map shows the peg
_CELL_CM = 0.5
_RADII_CM = (0.25, 2.5)
_AROUND_CM = (-20.0, 80.0, -60.0, 60.0)  # x, y that the map shows
_SHARE_OF_TIME = 0.85  # promised, of the robot time without a map
NONE, TRUE, STALE = "none", "true", "stale"
Visit = dict[str, Explored]  # by the map that was given


def given_map(peg: PegTable, moved: tuple[float, float] = (0.0, 0.0)) -> list[Obstacle]:
    """The obstacles of a ROS map that shows a peg, moved by x and y (cm)."""
    low_x, high_x, low_y, high_y = _AROUND_CM
    x, y = np.meshgrid(
        np.arange(low_x, high_x, _CELL_CM) + _CELL_CM / 2,
        np.arange(low_y, high_y, _CELL_CM) + _CELL_CM / 2,
    )
    away = np.hypot(x - peg.x - moved[0], y - peg.y - moved[1])
    # A peg narrower than a cell fills the one that it stands in.
    inside = away <= max(peg.radius, away.min())
    cells = np.where(inside, OCCUPIED, FREE).astype(np.int8)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "room.yaml"
        write_ros_map(OccupancyGrid(cells, _CELL_CM, (low_x, low_y, 0.0)), file)
        return read_prior(file)


def visit(seed: int) -> Visit:
    """Explore the room of a seed without a map, with a true one and with a stale one."""
    scene, rng = Scene.load("default"), np.random.default_rng([seed, 0x9E6])
    known = scene.believed(seed)
    drawn, _ = random_peg(scene.robot, rng, radius=_RADII_CM)
    peg = PegTable(x=drawn.x, y=drawn.y, radius=drawn.radius)
    scene.pegs = [peg]
    angle = float(rng.uniform(0.0, tau))
    moved = _MOVED_CM * cos(angle), _MOVED_CM * sin(angle)
    maps: Mapping[str, list[Obstacle]] = {
        NONE: [], TRUE: given_map(peg), STALE: given_map(peg, moved)
    }  # fmt: skip
    runs = {}
    for name, obstacles in maps.items():
        explored = Explored(f"map: {name}", seed, x_cm=peg.x, y_cm=peg.y, radius_cm=peg.radius)
        try:
            prior = within_reach(obstacles, known.body)
            explored.judge(explored_scene(scene, seed, config=known, prior=prior))
        except ThigmoError as error:
            explored.status = f"aborted: {error.problem}"
        runs[name] = explored
    return runs


def run(context: Context) -> Outcome:
    """Explore the rooms, and compare each map with none."""
    seeds = context.rng(0x3A9).integers(0, 2**31, context.count(2, _ROOMS)).tolist()
    visits = context.map(visit, seeds, "rooms")
    return judged(visits)


def judged(visits: list[Visit]) -> Outcome:
    """A row for each map, and the promises."""
    rows: list[Record] = []
    for name in (NONE, TRUE, STALE):
        runs = [explored[name] for explored in visits]
        more_cm, more_se_cm = _more_cm(visits, name)
        rows.append({
            "map": name,
            "rooms": len(runs),
            "aborted": sum(run.status.startswith("aborted") for run in runs),
            "touched": sum(run.touched for run in runs),
            "touched_missed": sum(run.touched_missed for run in runs),
            "lost": _lost(visits, name),
            "false": sum(run.far for run in runs),
            "localized": sum(run.contacts_localized for run in runs),
            "wrong": sum(run.contacts_wrong for run in runs),
            "error_cm": float(np.nanmean([run.best_cm for run in runs])),
            "more_cm": more_cm,
            "more_se_cm": more_se_cm,
            "time_s": float(np.nanmean([run.time_s for run in runs])),
            "time_share": _time_share(visits, name)[0],
        })  # fmt: skip
    more_cm, se_cm = _more_cm(visits, TRUE)
    time_share, time_se = _time_share(visits, TRUE)
    claims = [
        Claim("true map: mean error of the best contact, less that without a map",
              more_cm, 0.0, unit="cm", standard_error=se_cm),
        Claim("true map: robot time over that without a map",
              time_share, _SHARE_OF_TIME, standard_error=time_se),
        Claim(f"map stale by {_MOVED_CM:g} cm: contacts that are found without it and not with it",
              _lost(visits, STALE), 0),
    ]  # fmt: skip
    every = [asdict(explored) for maps in visits for explored in maps.values()]
    return Outcome({"rows": rows, "runs": every}, claims=claims, summary=rows)


def _more_cm(visits: list[Visit], name: str) -> tuple[float, float]:
    """Mean error with a map less that without, room by room, and its standard error (cm)."""
    more = np.array([maps[name].best_cm - maps[NONE].best_cm for maps in visits])
    more = more[np.isfinite(more)]
    se = more.std(ddof=1) / np.sqrt(more.size) if more.size > 1 else np.nan
    return float(more.mean()) if more.size else float("nan"), float(se)


def _time_share(visits: list[Visit], name: str) -> tuple[float, float]:
    """Robot time of all rooms with a map over that without, and its standard error."""
    times = np.array([(maps[name].time_s, maps[NONE].time_s) for maps in visits])
    with_map, without = times[np.isfinite(times).all(axis=1)].T
    ratio = with_map.sum() / without.sum()
    left = with_map - ratio * without
    se = left.std(ddof=1) / np.sqrt(left.size) / without.mean() if left.size > 1 else np.nan
    return float(ratio), float(se)


def _lost(visits: list[Visit], name: str) -> int:
    """Rooms whose peg is found without a map and not with it."""
    return sum(
        maps[NONE].near > 0 and maps[NONE].touched_missed == 0 and maps[name].near == 0
        for maps in visits
    )
