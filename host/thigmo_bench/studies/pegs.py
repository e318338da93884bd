"""Pegs in a room that an inflating body bends into: truth for one frame and for whole sweeps.

A round frictionless peg touches the body's outline on its side, at a corner of its end, or on the
face of the end. The place and the force follow from the peg's position. Lengths are in cm, forces
over EI; bodies bend towards +y. The accuracy study and tests use these pegs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from thigmo_bench.studies import scenes
from thigmo_bench.studies.rod import Bodies, Floats, solve
from thigmo_bench.studies.scenes import COLUMN, CRITICAL, LENGTH, NEAREST, RADIUS, SPAN

Part = Literal["side", "corner", "anywhere"]

STEP = 0.004  # of the free curvature, from one equilibrium to the next (1/cm)
NEWTON_STEPS = 6
RESOLVED = 1e-6  # distance (cm) to which a peg is met
FORCE = 1e-3  # order of the forces over EI (1/cm^2)


def outline(u: Floats, peg_radius: Floats, length: float) -> tuple[Floats, Floats, Floats, Floats]:
    """The contact of a peg at `u` (S,) along the outline, and the position of the peg.

    `u` follows the peg's centre: along the side towards +y (as arc), round its corner, across the
    face and round the other corner.

    Returns:
        Arc (S,); offset of the contact towards +y in the section (S,); direction to the peg (2, S)
        and the peg's centre (2, S) in the section's frame.
    """
    past_end = u - length
    quarter = 0.5 * math.pi * peg_radius
    round_end = np.maximum(past_end - 2.0 * RADIUS, np.minimum(past_end, quarter)) / peg_radius
    angle = np.where(u <= length, 0.0, round_end)
    offset = RADIUS - np.clip(past_end - quarter, 0.0, 2.0 * RADIUS)
    away = np.stack([np.sin(angle), np.cos(angle)])
    return np.minimum(u, length), offset, away, np.stack([0.0 * u, offset]) + peg_radius * away


def press(
    u: Floats, push: Floats, free: Floats, peg_radius: Floats, length: float
) -> tuple[Bodies, Floats]:
    """Bodies (S,) pushed at `u` on their outlines, and the pegs' places (2, S) in the room."""
    arc, offset, away, centre = outline(u, peg_radius, length)
    tangential, normal = -push * away
    loads = {"tangential": tangential[:, None], "couple": (-offset * tangential)[:, None]}
    bodies = solve(
        arc[:, None], normal[:, None], length=length, free_curvature=free[:, None], **loads
    )
    turn, x, y = bodies.base
    cosine, sine = np.cos(turn), np.sin(turn)
    dx, dy = centre[0] - x, centre[1] - y
    return bodies, np.stack([cosine * dx + sine * dy, cosine * dy - sine * dx])


@dataclass(frozen=True)
class Rooms:
    """S rooms with a peg each, through an inflation of T frames; NaN before the touch."""

    free: Floats  # (T, S) free curvature of the frames, rising
    u: Floats  # (T, S) place on the outline
    push: Floats  # (T, S) size of the force
    peg: Floats  # (2, S)
    peg_radius: Floats  # (S,)
    length: float  # everted length

    @property
    def arc(self) -> Floats:
        """(T, S) places of contact along the body."""
        return np.minimum(self.u, self.length)

    def bodies(self, frame: int) -> Bodies:
        """The bodies of one frame; without contact, free ones."""
        touches = np.isfinite(self.u[frame])
        u = np.where(touches, self.u[frame], 0.5 * self.length)
        push = np.where(touches, self.push[frame], 0.0)
        return press(u, push, self.free[frame], self.peg_radius, self.length)[0]


def inflate(
    u: Floats, touch: Floats, free: Floats, peg_radius: Floats, length: float
) -> tuple[Floats, Floats]:
    """Contacts during inflations to free curvatures (T, S).

    The bodies first touch their pegs at `u` (S,) on the outline, at the free curvature `touch`
    (S,).

    Returns:
        Place on the outline and size of the force, (T, S) each; NaN before the touch, and after the
        body has slipped past the peg.
    """
    _, peg = press(u, np.zeros_like(u), touch, peg_radius, length)
    place, reached = np.stack([u, np.zeros_like(u)]), touch
    contacts = np.full((2, *free.shape), np.nan)
    for t, goal in enumerate(free):
        steps = math.ceil(np.max(goal - reached, initial=0.0) / STEP)
        for free_now in np.linspace(reached, np.maximum(goal, reached), steps + 1)[1:]:
            contact = _meet(place, free_now, peg, peg_radius, length)
            place = np.where(free_now > touch, contact, place)
        reached = np.maximum(goal, reached)
        contacts[:, t] = np.where(goal > touch, place, np.nan)
    return contacts[0], contacts[1]


def _meet(place: Floats, free: Floats, peg: Floats, peg_radius: Floats, length: float) -> Floats:
    """Place on the outline and push (2, S) at the pegs, by Newton's method from `place`."""

    def peg_error(u: Floats, push: Floats) -> Floats:
        return press(u, push, free, peg_radius, length)[1] - peg

    slipped = ~np.isfinite(place[0])
    u, push = np.where(slipped, length, place[0]), np.where(slipped, 0.0, place[1])
    miss = peg_error(u, push)
    for _ in range(NEWTON_STEPS):
        if np.all(slipped | (np.hypot(*miss) < RESOLVED)):
            break
        by_u = (peg_error(u + 1e-4, push) - miss) / 1e-4
        by_push = (peg_error(u, push + 1e-4 * FORCE) - miss) / (1e-4 * FORCE)
        area = by_u[0] * by_push[1] - by_u[1] * by_push[0]
        area = np.where(np.abs(area) > 1e-9 / FORCE, area, np.inf)
        u = u - np.clip((miss[0] * by_push[1] - miss[1] * by_push[0]) / area, -5.0, 5.0)
        push = push - (by_u[0] * miss[1] - by_u[1] * miss[0]) / area
        miss = peg_error(u, push)
    touching = ~slipped & (np.hypot(*miss) < RESOLVED) & (push > 0.0)
    return np.where(touching, np.stack([u, push]), np.nan)


def rooms(
    rng: np.random.Generator,
    count: int,
    *,
    length: float,
    largest_free: float,
    frames: int = 1,
    radius: tuple[float, float] = (0.25, 2.5),
    moment: tuple[float, float] = (0.05, 1.0),
    part: Part = "anywhere",
) -> Rooms:
    """Pegs spread evenly over the room, each touched at the end of an inflation.

    The free curvature rises to a random value up to `most`, in `frames` even steps. `radius` is the
    range of peg radii, `moment` the range of the contact's final moment at the base over the
    critical one, and `part` the part of the outline that is touched then.
    """
    batches: list[Floats] = []
    while sum(accepted.shape[1] for accepted in batches) < count:
        tries = 8 * count + 100
        peg_radius = rng.uniform(*radius, tries)
        top = length + math.pi * peg_radius + 2.0 * RADIUS
        u = rng.uniform(NEAREST if part != "corner" else 0.9 * length, top)
        last = rng.uniform(0.1 * largest_free, largest_free, tries)
        touch = rng.uniform(0.0, last) + 1e-6
        corners = (
            press(u + du, np.zeros(tries), touch + dg, peg_radius, length)[1]
            for du, dg in ((0.0, 0.0), (1e-4, 0.0), (0.0, 1e-6))
        )
        peg, shifted_along, shifted_free = corners
        by_u, by_free = (shifted_along - peg) / 1e-4, (shifted_free - peg) / 1e-6
        area = by_u[0] * by_free[1] - by_u[1] * by_free[0]
        # As likely as the area that a step of both sweeps; beside the straight body.
        accepted = rng.uniform(0.0, length**2, tries) < area
        accepted &= peg[1] > RADIUS + peg_radius
        u, touch, last, peg_radius, peg = (
            values[..., accepted] for values in (u, touch, last, peg_radius, peg)
        )
        free = last * np.linspace(1.0 / frames, 1.0, frames)[:, None]
        place, push = inflate(u, touch, free, peg_radius, length)
        end = np.nan_to_num(place[-1], nan=length)
        bodies, _ = press(end, np.nan_to_num(push[-1]), last, peg_radius, length)
        share = np.abs(bodies.base_moment) / CRITICAL
        touched = np.isfinite(place[-1]) & (share > moment[0]) & (share < moment[1])
        round_corner = (end > length) & (end < length + 0.5 * math.pi * peg_radius)
        if part != "anywhere":
            touched &= (end <= length) if part == "side" else round_corner
        batches.append(np.concatenate([free, place, push, peg, peg_radius[None]])[:, touched])
    all_rows = np.concatenate(batches, axis=1)[:, :count]
    free, place, push, peg, peg_radius = np.split(
        all_rows, np.cumsum([frames, frames, frames, 2]).tolist()
    )
    return Rooms(free, place, push, peg, peg_radius[0], length)


def any_peg(rng: np.random.Generator) -> scenes.Case:
    """One contact of the bent robot with a peg anywhere in the room, read as `scenes.actuated`."""
    room = rooms(rng, 1, length=LENGTH, largest_free=scenes.FULL_CURVATURE, moment=(0.3, 1.0))
    (clean,) = room.bodies(0).readings(COLUMN, SPAN)
    noisy = clean + scenes.SIGMA * rng.standard_normal(COLUMN.size)
    return scenes.Case(noisy, COLUMN, float(room.free[0, 0]), (float(room.arc[0, 0]),))
