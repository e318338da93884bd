"""Every load but one touch in the middle of a known body: what `localize` answers then.

How many contacts there are (none, read by few sensors or of unknown noise; one; two, opposed or on
one side), touches near the base that one or two sensors see, rods that are held at their end, and
bodies with a kink. Truth is the large-deflection rod. What a frame can tell is decided by that rod
too (`misfit`), so that a promise counts only the frames that it speaks of.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import chi2

from thigmo.localization import arc_bounds, localize
from thigmo.studies import misfit
from thigmo.studies.engine import Claim, Context, Outcome, Table
from thigmo.studies.rod import Floats, solve
from thigmo.studies.scenes import BOTH, COLUMN, CRITICAL, LENGTH, RADIUS, SIGMA, SPAN
from thigmo.studies.touches import MOST_FREE, Scenes, holds, signs

BATCH = 50  # frames of one group that a process takes at a time
FEW = (2, 3, 5, 10)  # readings
NEAR_CM = 28.0  # from the base: more than 25 cm from the end
ODDS = (1e-3, 5e-2)  # of a bad reading
STANDS_OUT = 25.0  # misfit of five standard errors
SEEN_KINK = 9.0  # misfit of three
LAYOUTS = (1.0, 2.75, 5.0, 7.25)  # centres of the first sensors, cm
PAIRS = ((-0.016, 0.02), (-0.02, 0.03), (-0.03, 0.04))  # moments at the base, 1/cm
TOLD_APART_CM, TOO_CLOSE_CM = 18.5, 13.0
PLACED_CM = 2.5  # bound of the places of two contacts that sensors tell apart
ROD_CM, ROD_NOISE = 24.0, SIGMA * LENGTH / 24.0  # as noisy as the robot, for its length
MOST_TURN = np.deg2rad(100.0)


@dataclass(frozen=True)
class Group:
    """Scenes that are counted together.

    Attributes:
        draw: so many scenes.
        count: of scenes, at full scale.
        options: of `localize`, beside those of all groups.
        against_free: whether frames stand out by their misfit without a contact over that with one.
        noise: standard deviation of a reading.
    """

    draw: Callable[[np.random.Generator, int], Scenes]
    count: int = 1500
    options: dict[str, Any] = field(default_factory=dict)
    against_free: bool = False
    noise: float = SIGMA


@dataclass(frozen=True)
class Seen:
    """A frame's answer against its truth.

    Attributes:
        found: contacts listed.
        likely: of these, with a probability over one half.
        localized, ambiguous: the status.
        none: probability that nothing touches.
        held: intervals that hold a true place, of the contacts listed.
        wrong: localized, with an interval that holds no true place.
        off_cm: the farthest that a localized contact is from the true place nearest to it.
        hinge: the explanation has a kink.
        open: the message says that more contacts are not excluded.
        stands_out: misfit of what the group's promise speaks of.
        fits: one contact leaves no more misfit than noise does in 99 of 100 frames.
    """

    found: int
    likely: int
    localized: bool
    ambiguous: bool
    none: float
    held: int
    wrong: bool
    off_cm: float
    hinge: bool
    open: bool
    stands_out: float
    fits: bool


def _free(rng: np.random.Generator, count: int, bent: bool) -> Floats:
    size = rng.uniform(0.005, MOST_FREE, count) if bent else np.zeros(count)
    return signs(rng, count) * size


def _most(free: Floats, bent: bool) -> Floats | float:
    """Largest moment of a contact at the base (1/cm)."""
    return np.minimum(CRITICAL, 0.9 * np.abs(free)) if bent else CRITICAL


def nothing(position: Floats, rng: np.random.Generator, count: int) -> Scenes:
    """Straight bodies that touch nothing."""
    return Scenes(np.zeros((count, position.size)), position, np.zeros(count), np.empty((count, 0)))


def one(rng: np.random.Generator, count: int) -> Scenes:
    """Straight bodies with one clear contact."""
    arcs = rng.uniform(15.0, LENGTH, (count, 1))
    forces = signs(rng, count)[:, None] * rng.uniform(0.003, 0.011, (count, 1)) / arcs
    clean = solve(arcs, forces, length=LENGTH).readings(BOTH, SPAN)
    return Scenes(clean, BOTH, np.zeros(count), arcs)


def near_base(bent: bool, rng: np.random.Generator, count: int) -> Scenes:
    """A contact that only the first sensors see."""
    free, position = _free(rng, count, bent), COLUMN if bent else BOTH
    arcs = rng.uniform(5.0, NEAR_CM, (count, 1))
    moment = rng.uniform(0.2, 1.0, count) * _most(free, bent)
    forces = (-np.sign(free) if bent else signs(rng, count)) * moment
    bodies = solve(arcs, forces[:, None] / arcs, length=LENGTH, free_curvature=free[:, None])
    return Scenes(bodies.readings(position, SPAN), position, free, arcs)


def two(
    opposed: bool, bent: bool, position: Floats, rng: np.random.Generator, count: int
) -> Scenes:
    """Two contacts at least 18.5 cm apart, the distal one near the tip."""
    free = _free(rng, count, bent)
    distal = rng.uniform(45.0, LENGTH, count)
    proximal = rng.uniform(18.0, distal - 18.5)
    # Against the bend. Opposed moments partly cancel at the base, those of one side add up.
    moment = rng.uniform(0.3, 1.0, count) * _most(free, bent)
    sign = -np.sign(free) if bent else signs(rng, count)
    shares = (-1.0, 1.5) if opposed else (0.5, 0.5)
    arcs = np.stack([proximal, distal], axis=1)
    forces = np.array(shares) * (sign * moment)[:, None] / arcs
    bodies = solve(arcs, forces, length=LENGTH, free_curvature=free[:, None])
    return Scenes(bodies.readings(position, SPAN), position, free, arcs)


def pair(
    gap: float, first: float, moments: tuple[float, float], _: np.random.Generator, count: int
) -> Scenes:
    """The same two opposed contacts each time."""
    position = np.tile(first + 10.0 * np.arange(5), 2)
    arcs = np.array([[LENGTH - gap, LENGTH]])
    clean = solve(arcs, np.array([moments]) / arcs, length=LENGTH).readings(position, SPAN)
    return Scenes(
        np.repeat(clean, count, axis=0), position, np.zeros(count), np.repeat(arcs, count, axis=0)
    )


def held_rod(rng: np.random.Generator, count: int) -> Scenes:
    """Rods that something holds at their end, by a force and a couple; NaN: no sensor there.

    Forces of 0.5 to 5 EI/L^2, within 60 degrees of the end's normal, couples of up to 1.5 EI/L,
    turns of at most 100 degrees, 4 to 23 evenly spaced sensors.
    """
    sensors = rng.integers(4, 24, 1)[0]
    position = (np.arange(sensors) + 0.5) * ROD_CM / sensors
    end = np.full((1, 1), ROD_CM)
    clean: list[Floats] = []
    while len(clean) < count:
        force = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 5.0) / ROD_CM**2
        slant, couple = rng.uniform(-np.pi / 3, np.pi / 3), rng.uniform(-1.5, 1.5) / ROD_CM
        loads = {"tangential": force * np.sin(slant), "couple": couple}
        body = solve(end, np.full((1, 1), force * np.cos(slant)), length=ROD_CM, **loads)
        if np.abs(body.base[0]) < MOST_TURN:
            clean.append(body.readings(position)[0])
    return Scenes(np.array(clean), position, np.zeros(count), np.full((count, 1), ROD_CM))


def kinked(touched: bool, bent: bool, rng: np.random.Generator, count: int) -> Scenes:
    """A kink anywhere, and a contact or none."""
    free, position = _free(rng, count, bent), COLUMN if bent else BOTH
    kink = signs(rng, count) * rng.uniform(0.2, 1.0, count)
    places = np.stack([rng.uniform(3.0, 50.0, count), rng.uniform(8.0, LENGTH, count)], axis=1)
    moment = touched * rng.uniform(0.2, 1.0, count) * _most(free, bent)
    sign = -np.sign(free) if bent else signs(rng, count)
    kinks, forces = np.zeros((2, count, 2))
    kinks[:, 0], forces[:, 1] = kink, sign * moment / places[:, 1]
    order = np.argsort(places, axis=1)
    arcs, kinks, forces = (np.take_along_axis(v, order, 1) for v in (places, kinks, forces))
    clean = solve(arcs, forces, length=LENGTH, free_curvature=free[:, None], kink=kinks).readings(
        position, SPAN
    )
    seen = misfit.of_one_contact(clean, position, free)
    return Scenes(
        clean, position, free, places[:, 1:] if touched else np.empty((count, 0)), stands_out=seen
    )


def _groups() -> dict[str, Group]:
    both, column = BOTH, COLUMN
    groups: dict[str, Group] = {}
    for known in (True, False):
        noise = {} if known else {"noise": None}
        label = "known" if known else "unknown"
        for n in FEW:
            where = both if n == 10 else column[:n]
            groups[f"free, {n} readings, noise {label}"] = Group(
                partial(nothing, where), 3000, noise
            )
        groups[f"one contact, noise {label}"] = Group(one, 3000 if known else 1000, noise)
    for bent in (False, True):
        body = "bent" if bent else "straight"
        for odds in ODDS:
            groups[f"near the base, {body}, odds {odds:g}"] = Group(
                partial(near_base, bent), options={"bad_reading_odds": odds}, against_free=True
            )
        for touched in (False, True):
            name = "kink and contact" if touched else "kink"
            groups[f"{name}, {body}"] = Group(partial(kinked, touched, bent))
    for opposed in (True, False):
        kind = "opposed" if opposed else "on one side"
        groups[f"two {kind}, straight"] = Group(partial(two, opposed, False, both))
        for position in (both, column):
            groups[f"two {kind}, bent, {position.size} readings"] = Group(
                partial(two, opposed, True, position)
            )
    for gap in (TOLD_APART_CM, TOO_CLOSE_CM):
        for first in LAYOUTS if gap == TOLD_APART_CM else (5.0,):
            for moments in PAIRS:
                arcs = np.array([LENGTH - gap, LENGTH])
                where = np.tile(first + 10.0 * np.arange(5), 2)
                bound = arc_bounds(arcs, moments / arcs, where, SPAN, SIGMA, LENGTH).max()
                if gap == TOO_CLOSE_CM or bound < PLACED_CM:
                    name = f"{gap:g} cm apart, first sensor at {first:g} cm, {moments[1]:g} 1/cm"
                    groups[name] = Group(partial(pair, gap, first, moments))
    groups["rod held at its end"] = Group(
        held_rod, options={"length": ROD_CM, "span": 0.0, "noise": ROD_NOISE, "tube_radius": None},
        noise=ROD_NOISE,
    )  # fmt: skip
    return groups


GROUPS = _groups()


def see(task: tuple[str, tuple[int, ...], int]) -> list[Seen]:
    """A batch of frames of a group."""
    name, key, size = task
    group, rng = GROUPS[name], np.random.default_rng(key)
    scenes = group.draw(rng, size)
    frames = scenes.curvature + group.noise * rng.standard_normal(scenes.curvature.shape)
    stands_out = np.zeros(size) if scenes.stands_out is None else scenes.stands_out
    least = np.full(size, np.inf)
    if group.against_free or scenes.arcs.shape[1] == 2:
        least = misfit.of_one_contact(frames, scenes.position, scenes.free)
    if group.against_free:
        free = np.square((frames - scenes.free[:, None]) / SIGMA).sum(axis=1)
        stands_out = free - least
    fits = least < chi2.isf(0.01, scenes.position.size - 2)
    told = {"length": LENGTH, "span": SPAN, "noise": SIGMA, "tube_radius": RADIUS, **group.options}
    return [
        _see(frame, scenes.position, {**told, "free_curvature": free}, arcs, float(out), bool(fit))
        for frame, free, arcs, out, fit in zip(
            frames, scenes.free, scenes.arcs, stands_out, fits, strict=True
        )
    ]


def _see(
    frame: Floats, position: Floats, told: dict[str, Any], arcs: Floats, out: float, fits: bool
) -> Seen:
    result = localize(frame, position, **told)

    placed = [contact for contact in result.contacts if contact.status == "localized"]
    return Seen(
        found=len(result.contacts),
        likely=sum(contact.probability > 0.5 for contact in result.contacts),
        localized=bool(placed),
        ambiguous=result.status == "ambiguous",
        none=1.0 / (1.0 + float(np.exp(min(result.log_odds, 500.0)))),
        held=sum(holds(arcs, contact.interval) for contact in result.contacts),
        wrong=any(not holds(arcs, contact.interval) for contact in placed),
        off_cm=max((float(np.abs(arcs - c.arc).min(initial=np.inf)) for c in placed), default=0.0),
        hinge="hinge" in result.hypothesis or "folded" in result.hypothesis,
        open="not excluded" in result.message,
        stands_out=out,
        fits=fits,
    )


def batches(count: int) -> list[int]:
    """Sizes of the batches that make `count` frames."""
    return [min(BATCH, count - start) for start in range(0, count, BATCH)]


def share(flags: Sequence[bool]) -> float:
    """Share of the frames with a property; NaN of none."""
    return float(np.mean(flags)) if flags else float("nan")


def _coverage(frames: Sequence[Seen]) -> float:
    """Share of the contacts listed whose intervals hold a true place."""
    return sum(f.held for f in frames) / max(sum(f.found for f in frames), 1)


def _claims(seen: dict[str, list[Seen]]) -> list[Claim]:
    """What is promised of them; each promise of its worst group."""

    def some(start: str) -> list[list[Seen]]:
        return [frames for name, frames in seen.items() if name.startswith(start)]

    def lone_wrong(start: str) -> list[float]:
        return [share([f.wrong and f.found == 1 for f in frames]) for frames in some(start)]

    claims = []
    for noise in ("known", "unknown"):
        free = [share([f.likely > 0 for f in seen[f"free, {n} readings, noise {noise}"]])
                for n in FEW]  # fmt: skip
        more = share([f.likely > 1 for f in seen[f"one contact, noise {noise}"]])
        claims += [
            Claim(f"noise {noise}: false contacts, 2 to 10 readings, most", max(free), 0.01),
            Claim(f"noise {noise}: false second contacts", more, 0.05),
        ]
    base = [[f for f in frames if f.stands_out >= STANDS_OUT] for frames in some("near the base")]
    usual = [f for name in ("straight", "bent")
             for f in seen[f"near the base, {name}, odds {ODDS[0]:g}"]]  # fmt: skip
    claims += [
        Claim("near the base, 5 standard errors or more: not listed, most",
              max(share([f.found == 0 for f in frames]) for frames in base), 0.0),
        Claim("of these, P(no contact) over 0.05 and not ambiguous, most",
              max(share([f.none > 0.05 and f.localized for f in frames]) for frames in base), 0.0),
        Claim("more than 25 cm from the end: contacts found",
              share([f.likely > 0 for f in usual]), 0.83, at_most=False),
    ]  # fmt: skip
    opposed = seen["two opposed, straight"]
    beside = some("two on one side")
    single = [f for frames in beside for f in frames if f.found == 1 and f.fits]
    claims += [
        Claim("two opposed contacts, straight: both found",
              share([f.likely == 2 for f in opposed]), 0.78, at_most=False),
        Claim("two opposed, one answered: localized where neither is, most",
              max(lone_wrong("two opposed")), 0.05),
        Claim("two on one side that one does not explain: localized where neither is, most",
              max(share([f.wrong and f.found == 1 and not f.fits for f in frames])
                  for frames in beside), 0.05),
        Claim("two on one side that one explains: others said not to be excluded",
              share([f.open for f in single]), 1.0, at_most=False),
        Claim("two opposed, both answered: least coverage of an interval",
              min(_coverage([f for f in frames if f.found == 2]) for frames in some("two opposed")),
              0.93, at_most=False),
        Claim("told apart at 18.5 cm, least share",
              min(share([f.found == 2 for f in frames]) for frames in some("18.5")), 0.9,
              at_most=False),
        Claim("13 cm apart: ambiguous, or localized where they are, least share",
              min(share([not f.wrong for f in frames]) for frames in some("13 cm")), 0.95,
              at_most=False),
    ]  # fmt: skip
    rods = seen["rod held at its end"]
    claims += [
        Claim("rod held at its end: the end in the interval",
              share([f.held > 0 for f in rods]), 0.95, at_most=False),
        Claim("rod held at its end: localized more than 5 % of its length from there",
              share([f.off_cm > 0.05 * ROD_CM for f in rods]), 0.0),
    ]  # fmt: skip
    kinks = [f for frames in some("kink") for f in frames]
    told = [f for f in kinks if f.stands_out >= SEEN_KINK]
    touched = [[f for f in frames if f.stands_out < SEEN_KINK] for frames in some("kink and")]
    claims += [
        Claim("kinks of 3 standard errors or more: not found, and a contact localized",
              share([f.localized and not f.hinge for f in told]), 0.0),
        Claim("of these, localized where nothing is", share([f.wrong for f in told]), 0.03),
        Claim("kinks that hardly show: least coverage",
              min(share([f.held > 0 for f in frames if f.found]) for frames in touched), 0.93,
              at_most=False),
        Claim("kinks that hardly show: localized and wrong, most",
              max(share([f.wrong for f in frames]) for frames in touched), 0.03),
    ]  # fmt: skip
    return claims


def _row(name: str, seen: list[Seen]) -> dict[str, float | int | str]:
    clear = SEEN_KINK if name.startswith("kink") else STANDS_OUT
    return {
        "group": name,
        "count": len(seen),
        "none": share([f.likely == 0 for f in seen]),
        "one": share([f.likely == 1 for f in seen]),
        "two": share([f.likely == 2 for f in seen]),
        "localized": share([f.localized for f in seen]),
        "ambiguous": share([f.ambiguous for f in seen]),
        "covered": _coverage(seen),
        "wrong": share([f.wrong for f in seen]),
        "hinge": share([f.hinge for f in seen]),
        "stand_out": sum(f.stands_out >= clear for f in seen),
        "localized_most_off_cm": max(f.off_cm for f in seen),
    }


def run(context: Context) -> Outcome:
    """All groups, and what is promised of them."""
    tasks = [
        (name, (context.seed, g, b), size)
        for g, (name, group) in enumerate(GROUPS.items())
        for b, size in enumerate(batches(context.count(min(20, group.count), group.count)))
    ]
    seen: dict[str, list[Seen]] = {name: [] for name in GROUPS}
    for (name, *_), found in zip(tasks, context.map(see, tasks, "frames"), strict=True):
        seen[name] += found
    table = Table.of("rows", [_row(name, frames) for name, frames in seen.items()])
    return Outcome([table], claims=_claims(seen), summary=table)
