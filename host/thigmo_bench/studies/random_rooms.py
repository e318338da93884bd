"""Random rooms of the default robot: several pegs, walls, pairs on a side, and pegs slipped past.

What the body touches is asked of the emulator's own mechanics, without noise.
"""

from __future__ import annotations

from math import hypot

import numpy as np
import numpy.typing as npt

from thigmo.config import SIGN, RobotConfig, Side
from thigmo.emulator.reach import TRIGGER, first_felt, random_peg, stages
from thigmo.emulator.scene import PegTable, Scene
from thigmo.mechanics import Peg, Rod, Tube, critical_moment

Floats = npt.NDArray[np.float64]

RADII_CM = (0.25, 2.5)
_MOST_PEGS = 3
_MOST_DOWELS = 64  # of a scene
_BETWEEN_CM = 0.5  # pegs stand at least so far apart
_PAIR_RADII_CM, _PAIR_BETWEEN_CM = (0.4, 1.0), 2.0
_CELL_CM = 2.0
_BENDS = 40  # of a sweep
_LEAST_TOUCHED = 3  # bends at which a touch counts
_LEAST_FORCE = 1e-5  # over EI, 1/cm^2
_LEAST_SLIPPED_CM = 20.0  # along the body's straight line: nearer to the base nothing slips


def random_pegs(seed: int) -> list[PegTable]:
    """One to three pegs; each alone would be felt."""
    robot, rng = Scene.load("default").robot, np.random.default_rng([seed, 0x3A9])
    pegs: list[PegTable] = []
    for _ in range(rng.integers(1, _MOST_PEGS + 1)):
        peg, _ = random_peg(robot, rng, radius=RADII_CM)
        gaps = (hypot(peg.x - o.x, peg.y - o.y) - peg.radius - o.radius for o in pegs)
        if all(gap > _BETWEEN_CM for gap in gaps):
            pegs.append(PegTable(x=peg.x, y=peg.y, radius=peg.radius))
    return pegs


def random_wall(seed: int) -> list[PegTable]:
    """A wall, a corner, a wall with a gap, or one on each side, beside the path of growth.

    Of dowels apart, or side by side as a smooth wall.
    """
    robot, rng = Scene.load("default").robot, np.random.default_rng([seed, 0x3A11])
    while True:
        kind, smooth = rng.choice(["wall", "corner", "gap", "two"]), rng.random() < 0.5
        radius = 0.4 if smooth else float(rng.uniform(0.5, 1.0))
        spacing = 0.5 if smooth else float(rng.uniform(2.0, 3.0))
        side = float(rng.choice([-1.0, 1.0]))

        def row(x: float, y: float, angle: float, length: float) -> list[tuple[float, float]]:
            along = spacing * np.arange(max(round(length / spacing), 1) + 1)  # noqa: B023
            return list(zip(x + along * np.cos(angle), y + along * np.sin(angle), strict=True))

        def beside(way: float) -> list[tuple[float, float]]:
            x, y = rng.uniform(10.0, 35.0), way * rng.uniform(4.0, 20.0)
            return row(x, y, rng.uniform(-0.6, 0.6), rng.uniform(10.0, 30.0))

        places = beside(side)
        if kind == "corner":
            (x0, y0), (x1, y1) = places[0], places[-1]
            turn = float(np.arctan2(y1 - y0, x1 - x0)) + float(rng.choice([-1.0, 1.0])) * np.pi / 2
            places += row(x1, y1, turn, rng.uniform(6.0, 15.0))[1:]
        elif kind == "gap":
            middle, gap = rng.uniform(0.3, 0.7) * len(places), rng.uniform(5.0, 10.0) / spacing
            places = [p for n, p in enumerate(places) if abs(n - middle) > gap / 2]
        elif kind == "two":
            places += beside(-side)
        clear = robot.body.radius_cm + radius + 0.3
        pegs = [PegTable(x=x, y=y, radius=radius) for x, y in places if abs(y) > clear and x > 3.0]
        countable = 3 <= len(pegs) <= _MOST_DOWELS
        if countable and first_felt(robot, [Peg(p.x, p.y, p.radius) for p in pegs]) is not None:
            return pegs


def random_pair(seed: int, friction: float) -> list[PegTable]:
    """Two pegs that the longest sweep of one side touches at once when its trigger ends it."""
    robot, rng = Scene.load("default").robot, np.random.default_rng([seed, 0x2A1D])
    full = robot.body.length_cm
    while True:
        side = robot.sides[int(rng.integers(len(robot.sides)))]
        first, second = (_beside(robot, rng, side, _PAIR_RADII_CM) for _ in range(2))
        gap = hypot(first.x - second.x, first.y - second.y) - first.radius - second.radius
        if gap < _PAIR_BETWEEN_CM:
            continue
        force, excess = _swept(robot, [first, second], full, side, friction)
        ended = np.flatnonzero(excess >= TRIGGER)
        end = int(ended[0]) if ended.size else _BENDS - 1
        both = np.min(force, axis=1)[: end + 1] > _LEAST_FORCE
        if both[end] and both.sum() >= _LEAST_TOUCHED:
            return [PegTable(x=peg.x, y=peg.y, radius=peg.radius) for peg in (first, second)]


def random_slipped(seed: int, friction: float) -> PegTable:
    """A peg that the body touches and slips past, in a full sweep at some length."""
    robot, rng = Scene.load("default").robot, np.random.default_rng([seed, 0x511D])
    while True:
        side = robot.sides[int(rng.integers(len(robot.sides)))]
        peg = _beside(robot, rng, side, RADII_CM, _LEAST_SLIPPED_CM)
        for length in stages(robot):
            force, _ = _swept(robot, [peg], length, side, friction)
            touched = force[:, 0] > _LEAST_FORCE
            if touched.sum() >= _LEAST_TOUCHED and not touched[-1]:
                return PegTable(x=peg.x, y=peg.y, radius=peg.radius)


def _beside(
    robot: RobotConfig, rng: np.random.Generator, side: Side, radii: tuple[float, float],
    least_x: float = 5.0,
) -> Peg:  # fmt: skip
    """A peg on the side to which a muscle bends the body, beside the path of growth."""
    full, radius = robot.body.length_cm, float(rng.uniform(*radii))
    clear = robot.body.radius_cm + radius + 0.3
    y = SIGN[side] * float(rng.uniform(clear, 0.8 * full))
    return Peg(float(rng.uniform(least_x, full)), y, radius)


def _swept(
    robot: RobotConfig, pegs: list[Peg], length_cm: float, side: Side, friction: float
) -> tuple[Floats, Floats]:
    """Forces (bends, pegs) of a full sweep, over EI, and |base contact curvature| (bends,)."""
    body, muscle = robot.body, robot.muscle(side)
    number = body.pressure_number(length_cm)
    moment = critical_moment(
        body.critical_curvature, body.critical_pressure_psi, body.pressures[number].pressure_psi
    )
    rod = Rod(Tube(body.diameter_cm, moment), pegs, friction=friction, cell_cm=_CELL_CM)
    curve = muscle.maps[number].inflate
    free = SIGN[side] * np.array(
        [curve.curvature(psi) for psi in np.linspace(0.0, muscle.max_pressure_psi, _BENDS)]
    )
    base = robot.sensors_for(side)[0]
    sweep = rod.sweep(free, length_cm, np.array([base.center_cm]), np.array([base.span_cm]))
    return np.nan_to_num(sweep.contacts[..., 3]), np.abs(sweep.readings[:, 0] - free)
