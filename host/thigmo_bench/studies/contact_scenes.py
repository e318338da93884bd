"""Groups of bodies with and without contact, and noise-free readings of their sensors.

Truth is the independent rod (`rod`, `pegs`). Each contact has the Cramer-Rao bound of its place for
an estimator that knows all but place and force. `misfit_of_one_contact` decides with the same rod
whether one contact explains readings. The studies of accuracy and of loads use these scenes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from thigmo_bench.studies.pegs import Part, outline, rooms
from thigmo_bench.studies.rod import Floats, Profile, solve
from thigmo_bench.studies.scenes import BOTH, COLUMN, CRITICAL, LENGTH, RADIUS, SIGMA, SPAN

MOST_FREE = 0.05  # 1/cm, largest free curvature of bent bodies
FRICTION = (0.3, 0.6)  # coefficients, of either sign
WAVES = np.arange(1.0, 5.0)[:, None] * np.pi / LENGTH  # wave numbers of the stiffness, 1/cm
SOFTNESS = 0.2 / np.sqrt(len(WAVES))  # amplitude of each wave: EI varies by 0.2 (relative s.d.)


@dataclass(frozen=True)
class Scenes:
    """S bodies and the noise-free readings of their sensors."""

    curvature: Floats  # (S, N)
    position: Floats  # (N,)
    free: Floats  # (S,) free curvature
    arcs: Floats  # (S, C) contacts; C is 0 for free bodies
    # (S,) Cramer-Rao standard deviation (cm) of a contact's place; infinite without one
    bound: Floats | float = np.inf
    # (S,) misfit that decides whether a promise covers a body, if it does not depend on noise
    stands_out: Floats | None = None


Draw = Callable[[np.random.Generator, int], Scenes]


def holds(arcs: Floats, interval: tuple[float, float]) -> bool:
    """Whether an interval contains one of the true places."""
    low, high = interval
    return bool(((arcs >= low - 1e-6) & (arcs <= high + 1e-6)).any())


def signs(rng: np.random.Generator, count: int) -> Floats:
    """(count,) 1.0 or -1.0 at random."""
    return rng.choice([-1.0, 1.0], count)


def rubbing(force: Floats, friction: Floats | float) -> dict[str, Any]:
    """Options of `rod.solve` for friction, which acts on the skin where the body is pushed."""
    tangential = friction * np.abs(force)
    return {"tangential": tangential, "couple": np.sign(force) * RADIUS * tangential}


def one_contact(
    arc: Floats,
    force: Floats,
    free: Floats,
    position: Floats,
    friction: Floats | float = 0.0,
    stiffness: Profile | None = None,
) -> Scenes:
    """One contact on the side of each body, with the bound of its place for unknown force."""

    def read(arc: Floats, force: Floats) -> Floats:
        load = rubbing(force[:, None], np.reshape(friction, (-1, 1)))
        load |= {"free_curvature": free[:, None], "stiffness": stiffness}
        return solve(arc[:, None], force[:, None], length=LENGTH, **load).readings(position, SPAN)

    clean = read(arc, force)
    by_arc = (clean - read(arc - 1e-3, force)) / 1e-3
    by_force = (read(arc, force * (1.0 + 1e-4)) - clean) / (1e-4 * force)[:, None]
    alike = (by_arc * by_force).sum(axis=1) ** 2 / (by_force**2).sum(axis=1)
    information = np.maximum((by_arc**2).sum(axis=1) - alike, 1e-30)
    return Scenes(clean, position, free, arc[:, None], SIGMA / np.sqrt(information))


def pressed(rng: np.random.Generator, count: int) -> Scenes:
    """A straight body pressed from either side; all ten sensors read."""
    arc = rng.uniform(5.0, LENGTH, count)
    force = signs(rng, count) * rng.uniform(0.1, 1.0, count) * CRITICAL / arc
    return one_contact(arc, force, np.zeros(count), BOTH)


def bent(rng: np.random.Generator, count: int, **options: Any) -> Scenes:
    """A bent body with a contact on its side; the five sensors of the inactive side read."""
    free = signs(rng, count) * rng.uniform(0.005, MOST_FREE, count)
    arc = rng.uniform(8.0, LENGTH, count)
    moment = rng.uniform(0.2, 1.0, count) * np.minimum(CRITICAL, 0.9 * np.abs(free))
    return one_contact(arc, -np.sign(free) * moment / arc, free, COLUMN, **options)


def rubbed(rng: np.random.Generator, count: int) -> Scenes:
    """As `bent`, with friction at the contact."""
    return bent(rng, count, friction=signs(rng, count) * rng.uniform(*FRICTION, count))


def uneven(rng: np.random.Generator, count: int) -> Scenes:
    """As `bent`, with stiffness that varies smoothly along the body."""
    size = SOFTNESS * rng.standard_normal((2, len(WAVES), count))

    def stiffness(arc: Floats) -> Floats:
        phase = WAVES * arc
        softness: Floats = np.exp((size[0] * np.cos(phase) + size[1] * np.sin(phase)).sum(axis=0))
        return softness

    return bent(rng, count, stiffness=stiffness)


def pegs(part: Part, rng: np.random.Generator, count: int) -> Scenes:
    """A bent body against a peg in the room, on that part of it."""
    room = rooms(rng, count, length=LENGTH, largest_free=MOST_FREE, part=part)
    side, free = signs(rng, count), room.free[-1]
    # The bound is that of a contact on the side with the same normal force.
    _, _, away, _ = outline(room.u[-1], room.peg_radius, LENGTH)
    normal = -np.maximum(room.push[-1] * away[1], 1e-9)
    bound = one_contact(room.arc[-1], normal, free, COLUMN).bound
    clean = side[:, None] * room.bodies(-1).readings(COLUMN, SPAN)
    return Scenes(clean, COLUMN, side * free, room.arc[-1][:, None], bound)


def straight(position: Floats, rng: np.random.Generator, count: int) -> Scenes:
    """Straight bodies that touch nothing."""
    return Scenes(np.zeros((count, position.size)), position, np.zeros(count), np.empty((count, 0)))


def untouched_bent(rng: np.random.Generator, count: int) -> Scenes:
    """A bent body that touches nothing."""
    free = signs(rng, count) * rng.uniform(0.0, MOST_FREE, count)
    return Scenes(np.tile(free[:, None], 5), COLUMN, free, np.empty((count, 0)))


GROUPS: dict[str, Draw] = {
    "pressed": pressed,
    "bent": bent,
    "peg": partial(pegs, "side"),
    "corner": partial(pegs, "corner"),
    "free": partial(straight, BOTH),
    "free, bent": untouched_bent,
    "friction": rubbed,
    "uneven": uneven,
}
TOUCHED = ("pressed", "bent", "peg", "corner")
BENT = ("bent", "peg", "corner")


def misfit_of_one_contact(curvature: Floats, position: Floats, free: Floats) -> Floats:
    """(F,) least misfit of one contact on the side to the readings (F, N) of each frame.

    Misfits are sums of squares over the noise's variance. All frames have the same sensors, at
    `position` (N,), on bodies of free curvature (F,).
    """
    places = np.linspace(1.0, LENGTH, 53)
    arcs = np.tile(places, len(curvature))[:, None]
    bend = np.repeat(free, len(places))[:, None]
    readings = np.repeat(curvature, len(places), axis=0)

    def excess(force: Floats) -> Floats:
        bodies = solve(arcs, force, length=LENGTH, free_curvature=bend)
        return readings - bodies.readings(position, SPAN)

    force, step = np.zeros_like(arcs), 1e-6  # 1/cm^2
    for _ in range(2):  # Gauss-Newton: the body is almost linear in the force
        residual = excess(force)
        slope = (residual - excess(force + step)) / step
        power = np.maximum((slope**2).sum(axis=1), 1e-12)
        force = force + ((slope * residual).sum(axis=1) / power)[:, None]
    misfits = np.square(excess(force) / SIGMA).sum(axis=1).reshape(len(curvature), -1)
    smallest: Floats = misfits.min(axis=1)
    return smallest
