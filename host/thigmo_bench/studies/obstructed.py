"""Independent truth for whole sweeps: bodies that bend into pegs and walls, slip, fold and yield.

Bodies of one everted length are clamped at (0, 0), straight along x, and bend towards +y ever
further. Obstacles beside them are touched with the side, a corner of the end or its face. Skin and
obstacle stick until the tangential force reaches friction times the normal one, and then slide.
The base folds at its critical moment and turns a little before that; obstacles yield; stiffness and
free curvature may be uneven along the body, the end flat or round.

Equilibria follow from `rod.solve`, which shares nothing with `thigmo.mechanics`: Newton's method
finds places and sizes of forces and the fold, many rooms side by side. A body that slips off an
obstacle is followed where it then lies free; where Newton fails otherwise, the room ends and says
so.

Lengths in cm, moments in 1/cm and forces in 1/cm^2 over EI.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from thigmo.mechanics import traced
from thigmo_bench.studies.rod import Bodies, Floats, solve

Flags = npt.NDArray[np.bool_]

STEP_TURN = 0.02  # rad of the whole body from one equilibrium to the next
NEWTON_STEPS = 12
MET = 1e-8  # cm to which obstacles are met
OVERLAP = 1e-3  # cm of overlap at which a touch begins: above the polyline's error
FORCE = 1e-3  # order of a force over EI, 1/cm^2
LEVER = 10.0  # cm by which a wrong direction of the skin counts, for each rad
POINTS = 240  # of the polyline that looks for touches
SWITCHES = 14  # of contacts, friction and fold at one bend
RELEASES = 2  # of contacts at one bend, where Newton failed
SLIPS_OFF = 0.8  # of the length: contacts farther out may slip off the end
_WAVES = 1.5  # of uneven stiffness and curvature along the body


@dataclass(frozen=True)
class Mechanics:
    """S bodies; every array has shape (S,)."""

    length: float  # everted
    # of the whole body, along which it is uneven: that stays where it is as the body grows
    whole: float
    radius: float  # of the tube
    critical: Floats  # moment at which the base folds
    friction: Floats  # coefficient between skin and obstacles
    base_compliance: Floats  # rad by which the base turns for each 1/cm of moment
    rounding: Floats  # radius of the end's corners, at most the tube's
    taper: Floats  # share of the stiffness that the tip lacks, falling evenly from the base
    stiffness_wave: Floats  # relative amplitude of a wave in the stiffness
    bend_wave: Floats  # and of one in the free curvature
    phase: Floats  # of both waves, rad

    @classmethod
    def ideal(cls, count: int, *, length: float, radius: float, critical: float) -> Mechanics:
        """`count` bodies alike, wholly everted, without any of what is not ideal."""
        nothing = np.zeros(count)
        return cls(length, length, radius, np.full(count, critical), *[nothing] * 7)

    def take(self, rooms: npt.NDArray[np.intp]) -> Mechanics:
        """Some of the bodies, or the same ones several times."""
        return Mechanics(
            self.length, self.whole, self.radius,
            *(
                value[rooms]
                for value in (
                    self.critical, self.friction, self.base_compliance, self.rounding, self.taper,
                    self.stiffness_wave, self.bend_wave, self.phase,
                )
            ),
        )  # fmt: skip

    def stiffness(self, arc: Floats) -> Floats:
        """(S,) at arcs (S,), over EI at the base of an even body."""
        wave = np.sin(2.0 * math.pi * _WAVES * arc / self.whole + self.phase)
        stiffness: Floats = (1.0 - self.taper * arc / self.whole) * (
            1.0 + self.stiffness_wave * wave
        )
        return stiffness

    def evenness(self, arc: Floats) -> Floats:
        """(S,) free curvature at arcs (S,) over its mean along the whole body."""
        turn = 2.0 * math.pi * _WAVES
        wave = np.sin(turn * arc / self.whole + self.phase)
        mean = (np.cos(self.phase) - np.cos(turn + self.phase)) / turn
        evenness: Floats = 1.0 + self.bend_wave * (wave - mean)
        return evenness


@dataclass(frozen=True)
class Obstacles:
    """P obstacles in each of S rooms, (S, P) each; a missing one has NaN as its place."""

    x: Floats  # of a peg's centre, or of a point on a wall's middle line
    y: Floats
    radius: Floats  # of the peg, or half the wall's thickness
    angle: Floats  # of a wall's line, rad; NaN for a peg
    compliance: Floats  # cm by which it yields for each 1/cm^2 of force

    def take(self, rooms: npt.NDArray[np.intp]) -> Obstacles:
        """Some of the rooms, or the same ones several times."""
        return Obstacles(**{name: value[rooms] for name, value in vars(self).items()})

    @classmethod
    def pegs(cls, x: Floats, y: Floats, radius: Floats, compliance: float = 0.0) -> Obstacles:
        """One peg in each room, from arrays (S,)."""
        x, y, radius = (np.asarray(value, dtype=np.float64)[:, None] for value in (x, y, radius))
        return cls(x, y, radius, np.full_like(x, np.nan), np.full_like(x, compliance))


@dataclass
class State:
    """Equilibria of S bodies: what obstacles and base do to them."""

    place: Floats  # (S, P) along the outline: see `_outline`
    push: Floats  # (S, P) normal force
    drag: Floats  # (S, P) tangential force, positive towards larger places
    fold: Floats  # (S,) angle of the base's fold, rad
    touching: Flags  # (S, P)
    sliding: Floats  # (S, P) 0 while it sticks, else the sign of `drag`
    folding: Floats  # (S,) sign of the moment at which the base folds, 0 while it does not
    failed: Flags  # (S,) rooms in which no equilibrium was found any more
    moved: Floats  # (S, P) the skin's way over the obstacle when it last rested; NaN before

    @classmethod
    def free(cls, rooms: int, obstacles: int) -> State:
        """Bodies that touch nothing."""
        zeros, untouched = np.zeros((rooms, obstacles)), np.zeros((rooms, obstacles), dtype=bool)
        return cls(
            place=zeros.copy(), push=zeros.copy(), drag=zeros.copy(), fold=np.zeros(rooms),
            touching=untouched, sliding=zeros.copy(), folding=np.zeros(rooms),
            failed=np.zeros(rooms, dtype=bool), moved=np.full_like(zeros, np.nan),
        )  # fmt: skip

    def copy(self) -> State:
        """Another one that later steps do not change."""
        return State(**{name: value.copy() for name, value in vars(self).items()})


@dataclass(frozen=True)
class Swept:
    """S sweeps through T bends."""

    readings: Floats  # (T, S, N) mean curvature over the sensors; NaN after a room's end
    contacts: Floats  # (T, S, P, 3) arc, x and y of the touched skin; NaN without contact
    push: Floats  # (T, S, P) normal force; 0 without contact
    drag: Floats  # (T, S, P) tangential force, positive towards larger places along the skin
    base_moment: Floats  # (T, S)
    fold: Floats  # (T, S) rad
    base_turn: Floats  # (T, S) rad
    ended: Flags  # (S,) rooms in which no equilibrium was found any more


@dataclass(frozen=True)
class _Laid:
    """Bodies under their loads, laid into the room."""

    bodies: Bodies
    missed: Floats  # (S, P, 2) by which they miss the obstacles' equations, cm
    moved: Floats  # (S, P) way of the skin over the obstacle, cm
    skin: Floats  # (S, P, 2) touched points of the skin
    arc: Floats  # (S, P) of them
    moment: Floats  # (S,) at the base


class Sweeper:
    """S bodies, each in a room of its own."""

    def __init__(self, mechanics: Mechanics, obstacles: Obstacles) -> None:
        self.mechanics, self.obstacles = mechanics, obstacles
        self.rooms, self.count = obstacles.x.shape
        self._all = np.arange(self.rooms)

    def sweep(self, bends: Floats, position: Floats, span: float) -> Swept:
        """Readings at sensors (N,) of a span, while the free curvature rises through bends (T, S).

        Bends start near 0 and rise; a room may stop rising. A sensor beyond the body reads 0.
        """
        out = position - 0.5 * span < self.mechanics.length - 1e-6
        state = State.free(self.rooms, self.count)
        reached, rows = np.zeros(self.rooms), []
        step = STEP_TURN / self.mechanics.length
        for goal in bends:
            steps = max(1, math.ceil(float(np.max(goal - reached)) / step))
            for now in np.linspace(reached, goal, steps + 1)[1:]:
                laid = self._settle(state, now)
            reached = goal
            touching = state.touching & ~state.failed[:, None]
            place = np.concatenate([laid.arc[..., None], laid.skin], axis=2)
            readings = np.zeros((self.rooms, position.size))
            readings[:, out] = laid.bodies.readings(position[out], span)
            rows.append((
                np.where(state.failed[:, None], np.nan, readings),
                np.where(touching[..., None], place, np.nan),
                np.where(touching, state.push, 0.0), np.where(touching, state.drag, 0.0),
                laid.moment, state.fold.copy(), self.mechanics.base_compliance * laid.moment,
            ))  # fmt: skip
        readings, contacts, push, drag, moment, fold, turned = (
            np.array(column) for column in zip(*rows, strict=True)
        )
        return Swept(readings, contacts, push, drag, moment, fold, turned, state.failed)

    def _settle(self, state: State, free: Floats) -> _Laid:
        """Follow all bodies to free curvatures (S,): Newton inside, what touches and slips outside.

        Changes `state` to the new equilibrium.
        """
        previous = state.copy()
        stuck_again = np.zeros((self.rooms, self.count), dtype=int)
        released = np.zeros(self.rooms, dtype=int)
        for _ in range(SWITCHES):
            laid, met = self._newton(state, free)
            switched = self._lets_go(state, previous, met, released)
            switched |= self._switches_fold(state, laid, ~switched)
            switched |= self._switches_friction(state, laid, ~switched, stuck_again)
            switched |= self._touches(state, laid, ~switched)
            if not switched.any():
                break
        else:
            state.failed |= switched
        state.moved = np.where(state.touching, laid.moved, np.nan)
        return laid

    def _lets_go(
        self, state: State, previous: State, met: Flags, released: npt.NDArray[np.intp]
    ) -> Flags:
        """Release what pulls. Where Newton failed, the end has jumped: release that contact too.

        If the body overlaps the obstacle without it, it will touch again, at another place.
        """
        alive = ~state.failed
        pulls = state.touching & (state.push < 0.0) & (alive & met)[:, None]
        state.touching &= ~pulls
        for values in (state.push, state.drag, state.sliding):
            values[pulls] = 0.0
        switched: Flags = np.asarray(pulls.any(axis=1))
        for room in np.flatnonzero(alive & ~met):
            touched = np.where(state.touching[room], state.place[room], -1.0)
            touched = np.where(previous.touching[room], previous.place[room], touched)
            outermost = int(np.argmax(np.where(state.touching[room], touched, -1.0)))
            released[room] += 1
            near = touched[outermost] < SLIPS_OFF * self.mechanics.length
            if near or released[room] > RELEASES:
                state.failed[room] = True
                continue
            for name in ("place", "push", "drag", "sliding", "fold", "folding"):
                getattr(state, name)[room] = getattr(previous, name)[room]
            state.touching[room, outermost] = False
            state.push[room, outermost] = state.drag[room, outermost] = 0.0
            switched[room] = True
        return switched

    def _switches_fold(self, state: State, laid: _Laid, settled: Flags) -> Flags:
        """Fold a base whose moment is too large; unfold one whose fold would open the other way."""
        settled = settled & ~state.failed
        opens = settled & (state.fold * state.folding < 0.0)
        state.folding[opens] = state.fold[opens] = 0.0
        folds = settled & ~opens & (state.folding == 0.0)
        folds &= np.abs(laid.moment) > self.mechanics.critical * (1.0 + 1e-9)
        state.folding[folds] = np.sign(laid.moment[folds])
        return np.asarray(opens | folds)

    def _switches_friction(
        self, state: State, laid: _Laid, settled: Flags, stuck_again: npt.NDArray[np.intp]
    ) -> Flags:
        """Let slide what sticks too hard, and stick what would slide against its friction."""
        friction = self.mechanics.friction[:, None]
        old = state.touching & np.isfinite(state.moved) & (friction > 0.0)
        old &= (settled & ~state.failed)[:, None]
        slips = (
            old
            & (state.sliding == 0.0)
            & (np.abs(state.drag) > friction * state.push * (1.0 + 1e-9))
        )
        state.sliding[slips] = np.sign(state.drag[slips])
        way = laid.moved - state.moved
        sticks = old & ~slips & (way * state.sliding < -1e-9) & (stuck_again < 3)
        stuck_again += sticks
        state.sliding[sticks] = 0.0
        return np.asarray((slips | sticks).any(axis=1))

    def _touches(self, state: State, laid: _Laid, settled: Flags) -> Flags:
        """Touch the obstacle that a body overlaps the deepest."""
        gap, place = self._gaps(laid)
        open_ = ~state.touching & (settled & ~state.failed)[:, None]
        gap = np.where(open_, gap, np.inf)
        switched = np.zeros(self.rooms, dtype=bool)
        for room in np.flatnonzero(gap.min(axis=1) < -OVERLAP):
            obstacle = int(np.argmin(gap[room]))
            if gap[room, obstacle] < -self.mechanics.radius:
                state.failed[room] = True  # it would have to be pushed through
                continue
            state.touching[room, obstacle] = switched[room] = True
            state.place[room, obstacle] = place[room, obstacle]
            state.push[room, obstacle] = 1e-2 * FORCE
            state.drag[room, obstacle] = state.sliding[room, obstacle] = 0.0
            state.moved[room, obstacle] = np.nan
        return switched

    def _newton(self, state: State, free: Floats) -> tuple[_Laid, Flags]:
        """Meet all that is touched, from the present state, which changes; and which rooms are met.

        The unknowns are (S, 3 P + 1): places, pushes and drags over `FORCE`, and the fold.
        """
        p, n = self.count, 3 * self.count + 1
        tiny = np.concatenate([np.full(3 * p, 1e-5), [1e-6]])
        most = np.concatenate([np.full(p, 2.0), np.full(2 * p, np.inf), [0.5]])
        z = np.column_stack([state.place, state.push / FORCE, state.drag / FORCE, state.fold])
        rooms = np.tile(self._all, n + 1)
        for step in range(NEWTON_STEPS + 1):
            moved = z + np.concatenate([np.zeros((1, n)), np.diag(tiny)])[:, None, :]
            value = self._equations(moved.reshape(-1, n), z, state, free, rooms)
            value = value.reshape(n + 1, self.rooms, n)
            met = np.asarray(np.abs(value[0]).max(axis=1) < MET) | state.failed
            if met.all() or step == NEWTON_STEPS:
                break
            slopes = np.moveaxis((value[1:] - value[0]) / tiny[:, None, None], 0, 2)
            slopes = np.where(np.isfinite(slopes), slopes, 0.0)
            held = met | (np.abs(np.linalg.det(slopes)) < 1e-14)
            slopes[held] = np.eye(n)
            change = -np.linalg.solve(slopes, value[0][..., None])[..., 0]
            change[held] = 0.0
            shrink = (most / np.maximum(np.abs(change), 1e-300)).min(axis=1)
            z = z + np.minimum(shrink, 1.0)[:, None] * change
        state.place, state.push = z[:, :p], FORCE * z[:, p : 2 * p]
        state.drag = FORCE * z[:, 2 * p : -1]
        state.fold = z[:, -1].copy()
        return self._lay(z, state, free, self._all), met

    def _equations(
        self, z: Floats, start: Floats, state: State, free: Floats, rooms: npt.NDArray[np.intp]
    ) -> Floats:
        """(B, 3 P + 1) what vanishes in equilibrium, of unknowns (B, 3 P + 1) in rooms (B,)."""
        p = self.count
        laid = self._lay(z, state, free[rooms], rooms)
        touching, push, drag = state.touching[rooms], z[:, p : 2 * p], z[:, 2 * p : -1]
        along = np.where(touching, laid.missed[..., 0], z[:, :p] - start[rooms, :p])
        across = np.where(touching, laid.missed[..., 1], push)
        sticks = touching & (state.sliding == 0.0)[rooms] & np.isfinite(state.moved[rooms])
        sticks &= (self.mechanics.friction > 0.0)[rooms, None]
        slides = (state.sliding * self.mechanics.friction[:, None])[rooms]
        friction = np.where(sticks, laid.moved - state.moved[rooms], drag - slides * push)
        folding = state.folding[rooms]
        excess = folding * laid.moment - self.mechanics.critical[rooms]
        fold = np.where(folding != 0.0, self.mechanics.length**2 * excess, z[:, -1])
        return np.column_stack([along, across, friction, fold])

    def _lay(self, z: Floats, state: State, free: Floats, rooms: npt.NDArray[np.intp]) -> _Laid:
        """Bodies (B,) under the unknowns z (B, 3 P + 1), in rooms (B,)."""
        p = self.count
        body, pegs = self.mechanics.take(rooms), self.obstacles.take(rooms)
        touching = state.touching[rooms]
        radius = np.where(touching, pegs.radius, 1.0)
        place = np.where(touching, z[:, :p], 0.5 * body.length)
        push = np.where(touching, FORCE * z[:, p : 2 * p], 0.0)
        drag = np.where(touching, FORCE * z[:, 2 * p : 3 * p], 0.0)
        arc, corner, angle = _outline(place, radius, body)
        away = np.stack([np.sin(angle), np.cos(angle)])  # from the skin, along and across
        onward = np.stack([np.cos(angle), -np.sin(angle)])  # towards larger places
        along, across = drag * onward - push * away
        rounding = body.rounding[:, None]
        ahead, offset = rounding * away[0], corner + rounding * away[1]
        couple = ahead * across - offset * along
        # The fold is spread over one diameter: a load of nothing ends it.
        width = 2.0 * body.radius
        arcs = np.column_stack([np.full(len(z), width), arc])
        loads = [np.column_stack([np.zeros(len(z)), load]) for load in (across, along, couple)]
        order = np.argsort(arcs, axis=1, kind="stable")
        arcs, *loads = (np.take_along_axis(load, order, 1) for load in (arcs, *loads))
        pieces = np.concatenate([np.zeros((len(z), 1)), arcs], axis=1)
        folded = np.where(pieces < width - 1e-9, z[:, -1:] / width, 0.0)
        bodies = solve(
            arcs, loads[0], length=body.length, free_curvature=free[:, None], added=folded,
            tangential=loads[1], couple=loads[2], stiffness=body.stiffness, evenness=body.evenness,
        )  # fmt: skip
        back = np.argsort(order, axis=1, kind="stable")[:, 1:]
        heading, x, y = (np.take_along_axis(value, back, 1) for value in bodies.at_loads)
        _, base_x, base_y = bodies.base[:, :, None]
        moment = bodies.base_moment
        turn = (body.base_compliance * moment - bodies.base[0])[:, None]

        def in_room(dx: Floats, dy: Floats) -> tuple[Floats, Floats]:
            return np.cos(turn) * dx - np.sin(turn) * dy, np.sin(turn) * dx + np.cos(turn) * dy

        def turned(along: Floats, across: Floats) -> tuple[Floats, Floats]:
            cosine, sine = np.cos(heading + turn), np.sin(heading + turn)
            return cosine * along - sine * across, sine * along + cosine * across

        x, y = in_room(x - base_x, y - base_y)
        bump = rounding + radius
        to_centre = turned(bump * away[0], corner + bump * away[1])
        force = turned(along, across)
        centre = [
            where + out + pegs.compliance * pushed
            for where, out, pushed in zip((x, y), to_centre, force, strict=True)
        ]
        out, go = turned(*away), turned(*onward)
        is_wall = np.isfinite(pegs.angle)
        line = np.where(is_wall, pegs.angle, 0.0)
        wall = np.cos(line), np.sin(line)
        dx, dy = pegs.x - centre[0], pegs.y - centre[1]
        missed = np.stack(
            [
                np.where(is_wall, dy * wall[0] - dx * wall[1], dx),
                np.where(is_wall, LEVER * (out[0] * wall[0] + out[1] * wall[1]), dy),
            ],
            axis=2,
        )
        # The way of the skin over the obstacle: along the outline, less along the obstacle.
        sign = np.sign(go[0] * wall[0] + go[1] * wall[1])
        over_wall = place - radius * angle - sign * (centre[0] * wall[0] + centre[1] * wall[1])
        moved = np.where(is_wall, over_wall, place - radius * (heading + turn))
        skin_x, skin_y = turned(ahead, offset)
        skin = np.stack([x + skin_x, y + skin_y], axis=2)
        return _Laid(bodies, missed, moved, skin, arc + ahead, moment)

    def _gaps(self, laid: _Laid) -> tuple[Floats, Floats]:
        """(S, P) distances of obstacles from the skin and the closest places; by a polyline."""
        body, pegs = self.mechanics, self.obstacles
        side = (body.length - body.rounding)[:, None]
        arcs = side * np.linspace(0.0, 1.0, POINTS + 1)
        heading = laid.bodies.turn(arcs)
        heading = heading - heading[:, :1] + (body.base_compliance * laid.moment)[:, None]
        step = np.diff(arcs, axis=1)
        middle = 0.5 * (heading[:, 1:] + heading[:, :-1])
        x, y = traced(heading, step)
        flat = (body.radius - body.rounding)[:, None]
        bump = pegs.radius + body.rounding[:, None]
        quarter = 0.5 * math.pi * bump
        cosine, sine = np.cos(heading[:, -1:]), np.sin(heading[:, -1:])
        # Pegs: the nearest point of the line's segments, then the end.
        px, py = pegs.x[:, :, None] - x[:, None, :-1], pegs.y[:, :, None] - y[:, None, :-1]
        c, s = np.cos(middle)[:, None], np.sin(middle)[:, None]
        t = np.clip(px * c + py * s, 0.0, step[:, None])
        away = np.hypot(px - t * c, py - t * s)
        left = py * c - px * s
        away = np.where(left > 0.0, away, np.inf)  # on the side towards which bodies bend
        nearest = np.argmin(away, axis=2)[..., None]
        gap = np.take_along_axis(away, nearest, 2)[..., 0] - body.radius - pegs.radius
        place = np.take_along_axis(arcs[:, None, :-1] + t, nearest, 2)[..., 0]
        dx, dy = pegs.x - x[:, -1:], pegs.y - y[:, -1:]
        ahead, left_of = dx * cosine + dy * sine, dy * cosine - dx * sine
        outside = np.maximum(np.abs(left_of) - flat, 0.0)
        end = np.hypot(ahead, outside) - bump
        angle = np.arctan2(ahead, np.maximum(np.abs(left_of) - flat, 1e-12))
        face = quarter + flat - np.clip(left_of, -flat, flat)
        round_left = np.where(left_of > flat, bump * angle, face)
        round_end = np.where(left_of < -flat, 2.0 * flat + bump * (math.pi - angle), round_left)
        ends = (ahead > 0.0) & (end < np.where(np.isfinite(gap), gap, np.inf))
        gap, place = np.where(ends, end, gap), np.where(ends, side + round_end, place)
        # Walls: across their line, on the side where the base lies.
        line = np.where(np.isfinite(pegs.angle), pegs.angle, 0.0)
        hand = np.sign(np.sin(line) * -pegs.x + np.cos(line) * pegs.y)
        nx, ny = -hand * np.sin(line), hand * np.cos(line)
        off = (
            (pegs.x[..., None] - x[:, None]) * nx[..., None]
            + (pegs.y[..., None] - y[:, None]) * ny[..., None]
        )  # fmt: skip
        nearest = np.argmin(off, axis=2)[..., None]
        # Where the last section is the nearest one, the end's corners touch.
        clearance = np.take_along_axis(off, nearest, 2)[..., 0] - body.radius - pegs.radius
        clearance = np.where(nearest[..., 0] == POINTS, np.inf, clearance)
        where = np.take_along_axis(np.broadcast_to(arcs[:, None], off.shape), nearest, 2)[..., 0]
        out_along, out_across = nx * cosine + ny * sine, ny * cosine - nx * sine
        corner_off = off[..., -1] - np.abs(out_across) * flat - bump
        turn = np.arctan2(out_along, out_across)
        corners = (out_along > 0.0) & (corner_off < clearance)
        far = np.where(out_across < 0.0, 2.0 * flat, 0.0)
        wall_gap = np.where(corners, corner_off, clearance)
        wall_place = np.where(corners, side + far + bump * turn, where)
        is_wall = np.isfinite(pegs.angle)
        gap, place = np.where(is_wall, wall_gap, gap), np.where(is_wall, wall_place, place)
        return np.where(np.isfinite(pegs.x), gap, np.inf), place


def _outline(place: Floats, radius: Floats, body: Mechanics) -> tuple[Floats, Floats, Floats]:
    """Where a place (B, P) on the outline is, for obstacles of a radius (B, P).

    The place follows the obstacle's centre: along the side towards +y (as arc), round its corner,
    across the face and round the other corner.

    Returns:
        Arc of the section that carries it; offset of the corner's centre towards +y in the section;
        angle of the outward normal from the section's +y, clockwise; each (B, P).
    """
    rounding = body.rounding[:, None]
    side, flat = body.length - rounding, body.radius - rounding
    beyond, quarter = place - side, 0.5 * math.pi * (radius + rounding)
    round_end = np.maximum(beyond - 2.0 * flat, np.minimum(beyond, quarter))
    angle = np.where(beyond <= 0.0, 0.0, round_end / (radius + rounding))
    corner = flat - np.clip(beyond - quarter, 0.0, 2.0 * flat)
    return np.clip(place, 1e-6, side), corner, angle
