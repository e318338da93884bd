"""What may stand beside the body, and what is believed of it before the first sweep.

A place is named by its *touch*: the arc and the bend at which the free body, bent ever further,
first touches it. Touches cover the plane one to one, and sweeps measure just these two, so their
errors are nearly independent. A place that only the flat end can reach has an arc beyond the body:
side, corner and face are one hypothesis. Lengths in cm, bends in 1/cm, positive towards the
inflated side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from thigmo.mechanics import Peg

Floats = npt.NDArray[np.float64]

# Unknowns of a peg, and those that all obstacles of a side share.
ARC, BEND, RADIUS = range(3)
PEG_UNKNOWNS, SHARED_UNKNOWNS = 3, 3
FOLD, FRICTION, YIELD = -3, -2, -1

# Friction of fabric and plastic film on what stands in a room is 0 to 0.6: two sigma.
FRICTION_STD = 0.3
_MOST_FRICTION = 4 * FRICTION_STD
# Tube radii that an obstacle yields, one sigma, under a force at seven tenths of the longest body
# that would fold its base: a cushion, a cable, a peg on a foot.
YIELD_STD = 0.5
# Logarithm of a peg's radius over the tube's: 0.1 to 2.3 of it, two sigma.
RADIUS_MEAN, RADIUS_STD = float(np.log(0.45)), 0.8
ANOTHER = 0.3  # prior odds that one more obstacle is within a side's reach
# Area (lengths squared) in which the bodies of one side can touch something: 1500 of 53^2 cm^2.
REACH = 0.53
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
    yield_unit: float  # compliance (cm^3) of an obstacle that yields one tube radius, as above


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A number of pegs.

    Unknowns q (3 pegs + 3): arc, bend and logarithm of the radius over the tube's of each peg;
    logarithm of the fold's moment over the stated one; friction; what obstacles yield, over
    `Body.yield_unit`. The signs of the last two mean nothing.
    """

    pegs: int = 0

    @property
    def unknowns(self) -> int:
        """Number of unknowns; 0 if nothing stands there."""
        return PEG_UNKNOWNS * self.pegs + SHARED_UNKNOWNS if self.pegs else 0

    def columns(
        self, peg: tuple[float, float, float], fold: float, friction: float, yields: float
    ) -> Floats:
        """(unknowns,) one value for each unknown."""
        return np.array([*peg * self.pegs, fold, friction, yields]) if self.pegs else np.zeros(0)

    def place(self, q: Floats, body: Body) -> list[Peg]:
        """The pegs in the side's plane."""
        rows = np.reshape(q[: PEG_UNKNOWNS * self.pegs], (-1, PEG_UNKNOWNS))
        compliance = abs(float(q[YIELD])) * body.yield_unit if self.pegs else 0.0
        tube = body.radius
        return [touched(a, b, float(np.exp(r)) * tube, tube, compliance) for a, b, r in rows]

    def possible(self, q: Floats, body: Body) -> bool:
        """Whether the straight body has room, and pegs do not overlap."""
        if not np.isfinite(q).all() or (self.pegs and abs(q[FRICTION]) > _MOST_FRICTION):
            return False
        for p in range(self.pegs):
            arc, bend = q[PEG_UNKNOWNS * p + ARC], q[PEG_UNKNOWNS * p + BEND]
            low = LEAST_BEND / body.longest
            if not (body.radius < arc and low < bend < min(body.most_bend, _MOST_TURN / arc)):
                return False
        pegs, room = self.place(q, body), body.radius * (1 - _CLEAR)
        beside = (np.hypot(p.x - np.clip(p.x, 0.0, body.longest), p.y) > p.radius + room
                  for p in pegs)  # fmt: skip
        apart = (np.hypot(p.x - o.x, p.y - o.y) > p.radius + o.radius
                 for n, p in enumerate(pegs) for o in pegs[:n])  # fmt: skip
        return all(beside) and all(apart)

    def bells(self, body: Body) -> tuple[Floats, Floats]:
        """Mean and standard deviation of each unknown; infinite where the plane is even."""
        mean = self.columns((0.0, 0.0, RADIUS_MEAN), 0.0, 0.0, 0.0)
        spread = self.columns(
            (np.inf, np.inf, RADIUS_STD), body.fold_error, FRICTION_STD, YIELD_STD
        )
        return mean, spread

    def log_prior(self, q: Floats, body: Body) -> float:
        """Even over the plane, as a density over touches; bells for the rest; odds of obstacles."""
        mean, spread = self.bells(body)
        known = np.isfinite(spread)
        z = (q - mean) / spread
        total = -0.5 * float(z @ z) - float(np.log(spread[known] * np.sqrt(2 * np.pi)).sum())
        for p in range(self.pegs):
            arc, bend, log_radius = q[PEG_UNKNOWNS * p : PEG_UNKNOWNS * (p + 1)]
            # The area that a step of arc and one of bend sweep, on the peg's centre.
            across = max(1 - body.radius * (1 + np.exp(log_radius)) * bend, 0.05)
            area = across * (1 - np.cos(min(arc * bend, np.pi))) / bend**2
            total += float(np.log(ANOTHER * area / (REACH * body.longest**2)))
        return total


NOTHING, PEG, PEGS = Hypothesis(), Hypothesis(1), Hypothesis(2)


def touched(
    arc: float, bend: float, peg_radius: float, tube_radius: float, compliance: float = 0.0
) -> Peg:
    """The peg that the free body touches at an arc when it is bent so far."""
    turn = arc * bend
    across = tube_radius + peg_radius
    x, y = np.sin(turn) / bend, (1 - np.cos(turn)) / bend
    x, y = x - across * np.sin(turn), y + across * np.cos(turn)
    return Peg(float(x), float(y), peg_radius, compliance)


def untouched(peg: Peg, length: float, tube_radius: float, bends: Floats) -> int:
    """Number of ascending bends up to which a free body surely does not touch a peg.

    Its end counts as round, which touches sooner than a flat one.
    """
    rho = 1 / np.maximum(bends, 1e-9)
    nearest = np.clip(np.arctan2(peg.x, rho - peg.y) * rho, 0.0, length)
    turn = np.array([nearest, np.full(bends.size, length)]) / rho
    away = np.hypot(rho * np.sin(turn) - peg.x, rho * (1 - np.cos(turn)) - peg.y).min(axis=0)
    touches = np.flatnonzero(away < tube_radius + peg.radius)
    return max(int(touches[0]) - 1, 0) if touches.size else bends.size
