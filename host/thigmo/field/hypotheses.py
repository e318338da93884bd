"""What may stand beside the body, and what is believed of it before the first sweep.

A place is named by its *touch*: the arc and the bend at which the free body, bent ever further,
first touches it. Touches cover the plane one to one, and sweeps measure just these two, so their
errors are nearly independent. A place that only the flat end can reach has an arc beyond the body:
side, corner and face are one hypothesis. A straight wall is touched by the end's corner, since a
bent body is hollow towards it; it is named by the bend at which the longest body's end touches its
line, the angle that they then make, how far it goes on towards the base, and how far ahead. It may
end short of that touch: then only shorter bodies touch its face, and longer ones its end. Lengths
in cm, bends in 1/cm, positive towards the inflated side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from thigmo.mechanics import Obstacle, Peg, Wall

Floats = npt.NDArray[np.float64]

# Unknowns of a peg and of a wall, and those that all obstacles of a side share.
ARC, BEND, RADIUS = range(3)
WALL_BEND, TILT, REACH, AHEAD = range(4)
PEG_UNKNOWNS, WALL_UNKNOWNS, SHARED_UNKNOWNS = 3, 4, 4
FOLD, FRICTION, YIELD, BASE = -4, -3, -2, -1
UNSIGNED = FRICTION, YIELD, BASE  # not negative

# Friction of fabric and plastic film on what stands in a room is 0 to 0.6, one as likely as the
# other: a bell so wide is nearly even there.
FRICTION_STD, _MOST_FRICTION = 0.6, 0.75
_LEAST_BASE_ERROR = 1e-4  # lengths: a base that was measured exactly
# Tube radii that an obstacle yields, one sigma, under the force that would fold the base from where
# it is first touched: a cushion, a cable, a peg on a foot. Near the base that force is greater.
YIELD_STD = 0.5
# Logarithm of a peg's radius over the tube's: 0.1 to 2.3 of it, two sigma.
RADIUS_MEAN, RADIUS_STD = float(np.log(0.45)), 0.8
_MOST_STD = 4.0  # beyond which no radius is tried
ANOTHER = 0.3  # prior odds that one more obstacle is within a side's reach
# Angle (rad) from a wall's face to the heading of the end that touches it, and the logarithm of the
# way from there to the wall's end at the base's side over the longest body: anything from a flat
# touch to the end's face, a ledge to a whole side of a room.
TILT_MEAN, TILT_STD = 0.7, 0.5
REACH_MEAN, REACH_STD = float(np.log(0.3)), 0.8
# Way from there to its other end, over the longest body: negative where it ends short of the touch.
AHEAD_MEAN, AHEAD_STD = 0.3, 0.4
_LEAST_WALL = 0.02  # length of a wall over the longest body
_WALL_RADIUS = 0.25  # half a wall's thickness over the tube's radius: it shows at the wall's end
_MOST_TILT = 1.7
_WALL_POINTS = 60  # at which a wall's distance is taken
# Area (lengths squared) in which the bodies of one side can touch something: 1500 of 53^2 cm^2.
REACH_AREA = 0.53
LEAST_BEND = 0.02  # turn (rad) of the whole body, before which a touch is one of a straight body
_CLEAR = (
    0.03  # tube radii by which a peg may overlap the straight body: errors of what was measured
)
_MOST_TURN = 1.9  # rad at the touch: a body bent further touches its own base


@dataclass(frozen=True, slots=True)
class Body:
    """What hypotheses need of the robot: lengths in cm."""

    radius: float  # of the tube
    longest: float  # everted length of the longest sweep
    most_bend: float  # 1/cm, beyond which the mechanics were not tabulated
    fold_error: float  # of the moment that folds the base, relative
    # Compliance (cm^3), over the arc of its touch, of an obstacle that yields one tube radius to a
    # force that folds the base from there
    yield_unit: float
    base: float = 0.0  # compliance of the base over `longest`, and its error
    base_error: float = _LEAST_BASE_ERROR


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A number of pegs, or a wall.

    Unknowns q (3 pegs + 4 walls + 4): of each peg the arc and the bend of its touch and the
    logarithm of its radius over the tube's; of each wall `WALL_BEND`, `TILT`, `REACH` and `AHEAD`;
    then, shared, the logarithm of the fold's moment over the stated one; friction; what each
    obstacle yields to a force that folds the base from there, over the tube's radius; compliance of
    the base over `Body.longest`. The last three are not negative.
    """

    pegs: int = 0
    walls: int = 0

    @property
    def obstacles(self) -> int:
        """Number of obstacles."""
        return self.pegs + self.walls

    @property
    def unknowns(self) -> int:
        """Number of unknowns; 0 if nothing stands there."""
        if not self.obstacles:
            return 0
        return PEG_UNKNOWNS * self.pegs + WALL_UNKNOWNS * self.walls + SHARED_UNKNOWNS

    def columns(
        self,
        peg: tuple[float, float, float],
        fold: float,
        friction: float,
        yields: float,
        base: float,
        wall: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    ) -> Floats:
        """(unknowns,) one value for each unknown."""
        if not self.obstacles:
            return np.zeros(0)
        return np.array([*peg * self.pegs, *wall * self.walls, fold, friction, yields, base])

    def unknowns_of(self, obstacle: int) -> slice:
        """Where the unknowns of an obstacle stand in q; pegs come first."""
        walls = max(obstacle - self.pegs, 0)
        start = PEG_UNKNOWNS * (obstacle - walls) + WALL_UNKNOWNS * walls
        return slice(start, start + (PEG_UNKNOWNS if obstacle < self.pegs else WALL_UNKNOWNS))

    def rows(self, q: Floats) -> list[Floats]:
        """The unknowns of each obstacle, pegs first: (3,) of a peg, (4,) of a wall."""
        return [q[self.unknowns_of(n)] for n in range(self.obstacles)]

    def place(self, q: Floats, body: Body) -> list[Obstacle]:
        """The obstacles in the side's plane, pegs first."""
        tube, compliances = body.radius, self.compliances(q, body)
        return [
            touched(row[ARC], row[BEND], float(np.exp(row[RADIUS])) * tube, tube, compliance)
            if n < self.pegs
            else faced(row, body, compliance)
            for n, (row, compliance) in enumerate(zip(self.rows(q), compliances, strict=True))
        ]

    def compliances(self, q: Floats, body: Body) -> list[float]:
        """What each obstacle yields to a force, cm^3."""
        return [abs(float(q[YIELD])) * unit for unit in self.yield_units(q, body)]

    def yield_units(self, q: Floats, body: Body) -> list[float]:
        """Compliance (cm^3) of each obstacle for one of its unknown `YIELD`."""
        return [
            body.yield_unit * (float(row[ARC]) if n < self.pegs else body.longest)
            for n, row in enumerate(self.rows(q))
        ]

    def skin(self, q: Floats, body: Body) -> Floats:
        """(obstacles, 2) the first touched point of each obstacle, cm."""
        points = []
        for n, row in enumerate(self.rows(q)):
            arc, bend = row[:2] if n < self.pegs else (body.longest, row[WALL_BEND])
            turn = arc * bend
            x, y = np.sin(turn) / bend, (1 - np.cos(turn)) / bend
            x, y = x - body.radius * np.sin(turn), y + body.radius * np.cos(turn)
            if n >= self.pegs:  # a wall that ends short of the touch has its end touched
                short, way = body.longest * min(row[AHEAD], 0.0), turn - row[TILT]
                x, y = x + short * np.cos(way), y + short * np.sin(way)
            points.append((x, y))
        return np.array(points)

    def moves(self, q: Floats, body: Body) -> list[Floats]:
        """Derivatives (6, .) of each obstacle by its unknowns.

        Of its x, y, radius, last end and compliance.
        """
        moves = [
            _peg_moves(row, body) if n < self.pegs else _wall_moves(row, body)
            for n, row in enumerate(self.rows(q))
        ]
        for peg in moves[: self.pegs]:
            peg[5, ARC] = abs(float(q[YIELD])) * body.yield_unit
        return moves

    def possible(self, q: Floats, body: Body) -> bool:
        """Whether the straight body has room, and pegs do not overlap."""
        if not np.isfinite(q).all() or (self.obstacles and abs(q[FRICTION]) > _MOST_FRICTION):
            return False
        low = LEAST_BEND / body.longest
        for n, row in enumerate(self.rows(q)):
            if n < self.pegs:
                arc, bend, log_radius = row
                size = abs(log_radius - RADIUS_MEAN) < _MOST_STD * RADIUS_STD
                if not (size and body.radius < arc and low < bend < body.most_bend):
                    return False
                if arc * bend >= _MOST_TURN:
                    return False
            elif not (
                low < row[WALL_BEND] < min(body.most_bend, _MOST_TURN / body.longest)
                and 0.0 < row[TILT] < _MOST_TILT
                and row[REACH] < 0.0
                and row[AHEAD] + np.exp(row[REACH]) > _LEAST_WALL
            ):
                return False
        room = body.radius * (1 - _CLEAR)
        obstacles = self.place(q, body)
        pegs = [obstacle for obstacle in obstacles if isinstance(obstacle, Peg)]
        beside = (np.hypot(p.x - np.clip(p.x, 0.0, body.longest), p.y) > p.radius + room
                  for p in pegs)  # fmt: skip
        apart = (np.hypot(p.x - o.x, p.y - o.y) > p.radius + o.radius
                 for n, p in enumerate(pegs) for o in pegs[:n])  # fmt: skip
        clear = (_clear_of_straight(w, body.longest) > w.radius + room
                 for w in obstacles if isinstance(w, Wall))  # fmt: skip
        return all(beside) and all(apart) and all(clear)

    def bells(self, body: Body) -> tuple[Floats, Floats]:
        """Mean and standard deviation of each unknown; infinite where the plane is even."""
        mean = self.columns(
            (0.0, 0.0, RADIUS_MEAN), 0.0, 0.0, 0.0, body.base,
            (0.0, TILT_MEAN, REACH_MEAN, AHEAD_MEAN),
        )  # fmt: skip
        spread = self.columns(
            (np.inf, np.inf, RADIUS_STD), body.fold_error, FRICTION_STD, YIELD_STD,
            max(body.base_error, _LEAST_BASE_ERROR), (np.inf, TILT_STD, REACH_STD, AHEAD_STD),
        )  # fmt: skip
        return mean, spread

    def log_prior(self, q: Floats, body: Body) -> float:
        """Even over the plane, as a density over touches; bells for the rest; odds of obstacles."""
        mean, spread = self.bells(body)
        known = np.isfinite(spread)
        z = (q - mean) / spread
        total = -0.5 * float(z @ z) - float(np.log(spread[known] * np.sqrt(2 * np.pi)).sum())
        for arc, bend, log_radius in self.rows(q)[: self.pegs]:
            total += log_density(arc, bend, log_radius, body)
        return total + self.walls * float(np.log(ANOTHER / body.most_bend))


NOTHING, PEG, PEGS, WALL = Hypothesis(), Hypothesis(1), Hypothesis(2), Hypothesis(walls=1)


def log_density(arc: float, bend: float, log_radius: float, body: Body) -> float:
    """Of one more peg, even over the plane, by the arc (cm) and bend (1/cm) of its touch."""
    # The area that a step of arc and one of bend sweep, on the peg's centre.
    across = max(1 - body.radius * (1 + np.exp(log_radius)) * bend, 0.05)
    area = across * (1 - np.cos(min(arc * bend, np.pi))) / bend**2
    return float(np.log(ANOTHER * area / (REACH_AREA * body.longest**2)))


def touched(
    arc: float, bend: float, peg_radius: float, tube_radius: float, compliance: float = 0.0
) -> Peg:
    """The peg that the free body touches at an arc when it is bent so far."""
    turn = arc * bend
    across = tube_radius + peg_radius
    x, y = np.sin(turn) / bend, (1 - np.cos(turn)) / bend
    x, y = x - across * np.sin(turn), y + across * np.cos(turn)
    return Peg(float(x), float(y), peg_radius, compliance)


def _peg_moves(row: Floats, body: Body) -> Floats:
    arc, bend, log_radius = row.tolist()
    radius, turn = float(np.exp(log_radius)) * body.radius, arc * bend
    across = 1 / bend - body.radius - radius
    sine, cosine = float(np.sin(turn)), float(np.cos(turn))
    moves = np.zeros((6, PEG_UNKNOWNS))
    moves[:2, ARC] = bend * across * cosine, bend * across * sine
    moves[:2, BEND] = (
        arc * across * cosine - sine / bend**2,
        arc * across * sine - (1 - cosine) / bend**2,
    )
    moves[:3, RADIUS] = -radius * sine, radius * cosine, radius
    return moves


def faced(row: Floats, body: Body, compliance: float = 0.0) -> Wall:
    """The wall of four unknowns.

    They are the bend at which the longest body's end touches its line; the angle from its face to
    the end's heading, rad; the logarithm of its way from the touch towards the base, over
    `Body.longest`; and its way beyond the touch, over the same.
    """
    bend, tilt, reach, ahead = row.tolist()
    length, radius = body.longest, _WALL_RADIUS * body.radius
    turn = length * bend
    way = turn - tilt
    # The end's corner, and from there the wall's middle line.
    x = np.sin(turn) / bend - body.radius * np.sin(turn) - radius * np.sin(way)
    y = (1 - np.cos(turn)) / bend + body.radius * np.cos(turn) + radius * np.cos(way)
    back, ahead = length * np.exp(reach), length * ahead
    c, d = np.cos(way), np.sin(way)
    return Wall(
        float(x - back * c), float(y - back * d), float(x + ahead * c), float(y + ahead * d),
        radius, compliance,
    )  # fmt: skip


def _wall_moves(row: Floats, body: Body) -> Floats:
    moves = np.zeros((6, WALL_UNKNOWNS))
    for n, step in enumerate((1e-5 / body.longest, 1e-5, 1e-5, 1e-5)):
        low, high = (
            np.array([wall.x, wall.y, wall.radius, wall.end_x, wall.end_y])
            for wall in (
                faced(row + way * step * np.eye(WALL_UNKNOWNS)[n], body) for way in (-1.0, 1.0)
            )
        )
        moves[:5, n] = (high - low) / (2 * step)
    return moves


def _clear_of_straight(wall: Wall, length: float) -> float:
    """Distance of a wall's middle line from the straight body's."""
    share = np.linspace(0.0, 1.0, _WALL_POINTS)
    x, y = wall.x + share * (wall.end_x - wall.x), wall.y + share * (wall.end_y - wall.y)
    return float(np.hypot(x - np.clip(x, 0.0, length), y).min())


def untouched(obstacle: Obstacle, length: float, tube_radius: float, bends: Floats) -> int:
    """Number of ascending bends up to which a free body surely does not touch an obstacle.

    Its end counts as round, which touches sooner than a flat one.
    """
    rho = 1 / np.maximum(bends, 1e-9)
    if isinstance(obstacle, Wall):
        step = length / _WALL_POINTS
        turn = step * np.arange(_WALL_POINTS + 1)[:, None] / rho
        x, y = rho * np.sin(turn), rho * (1 - np.cos(turn))
        away = (from_wall(obstacle, x, y) - 0.5 * step).min(axis=0)
    else:
        nearest = np.clip(np.arctan2(obstacle.x, rho - obstacle.y) * rho, 0.0, length)
        turn = np.array([nearest, np.full(bends.size, length)]) / rho
        dx, dy = rho * np.sin(turn) - obstacle.x, rho * (1 - np.cos(turn)) - obstacle.y
        away = np.hypot(dx, dy).min(axis=0)
    touches = np.flatnonzero(away < tube_radius + obstacle.radius)
    return max(int(touches[0]) - 1, 0) if touches.size else bends.size


def nearest_on(obstacle: Obstacle, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """The point of a peg's centre, or of a wall's middle line, that is nearest to points."""
    if isinstance(obstacle, Peg):
        return np.full_like(x, obstacle.x), np.full_like(y, obstacle.y)
    dx, dy = obstacle.end_x - obstacle.x, obstacle.end_y - obstacle.y
    along = ((x - obstacle.x) * dx + (y - obstacle.y) * dy) / (dx**2 + dy**2)
    share = np.clip(along, 0.0, 1.0)
    return obstacle.x + share * dx, obstacle.y + share * dy


def way_into(obstacle: Obstacle, x: float, y: float) -> float:
    """Direction from a touched point of the skin to what it touches, rad."""
    near_x, near_y = nearest_on(obstacle, np.asarray(x), np.asarray(y))
    return float(np.arctan2(near_y - y, near_x - x))


def from_wall(wall: Wall, x: Floats, y: Floats) -> Floats:
    """Distances of points from a wall's middle line."""
    near_x, near_y = nearest_on(wall, x, y)
    distance: Floats = np.hypot(x - near_x, y - near_y)
    return distance
