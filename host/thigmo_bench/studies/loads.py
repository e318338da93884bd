"""Answers of `localize` for other loads than one contact in the middle of a known body.

The groups are: no contact, with few sensors or unknown noise; one contact; two, opposed, on one
side or anywhere; three; contacts near the base that one or two sensors see; rods that are held at
their end; folds that are not stated; and bodies with a kink. Truth is the large-deflection rod. The
same rod decides what a frame can show (`misfit_of_one_contact`), so that a promise counts only the
frames that it covers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import chi2

from thigmo.design import arc_bounds
from thigmo.localization import Localizer, priors
from thigmo_bench.studies import contact_scenes
from thigmo_bench.studies.contact_scenes import Draw, Scenes, holds, signs, straight
from thigmo_bench.studies.engine import Claim, Context, Outcome, Record, last, parts, share
from thigmo_bench.studies.rod import Floats, solve
from thigmo_bench.studies.scenes import BOTH, COLUMN, CRITICAL, LENGTH, ROBOT, SIGMA, SPAN

BATCH = 50  # frames of a group in one task
FEW = (2, 3, 5, 10)  # numbers of readings
NEAR_CM = 28.0  # from the base: more than 25 cm from the end
ODDS = (1e-3, 5e-2)  # prior odds of a bad reading
STANDS_OUT = 25.0  # misfit of five standard errors
SEEN_KINK = 9.0  # misfit of three standard errors
LAYOUTS = (1.0, 2.75, 5.0, 7.25)  # centres of the first sensors, cm
PAIRS = ((-0.016, 0.02), (-0.02, 0.03), (-0.03, 0.04))  # moments at the base, 1/cm
TOLD_APART_CM, TOO_CLOSE_CM = 18.5, 13.0
PLACED_CM = 2.5  # bound of the places of two contacts that sensors tell apart
DENSE: Floats = np.linspace(2.75, 50.25, 20)
APART_CM = 8.0  # least distance of contacts that lie anywhere
FOLD_CM = 4.0  # arc of a fold that the first sensors see
NOTHING_SAID: dict[str, Any] = {"held_end": None, "critical_curvature": None}
ROD_CM, ROD_NOISE = 24.0, SIGMA * LENGTH / 24.0  # as noisy as the robot, for its length
BENT, MOST_TURN = np.deg2rad(45.0), np.deg2rad(100.0)


@dataclass(frozen=True)
class Group:
    """Scenes that are counted together."""

    draw: Draw  # a number of scenes
    count: int = 1500  # number of scenes at full scale
    # options of `localize` in addition to those of all groups
    options: dict[str, Any] = field(default_factory=dict)
    # whether `stands_out` is the misfit without a contact less that with one
    against_free: bool = False
    noise: float = SIGMA  # standard deviation of a reading


@dataclass(frozen=True)
class FrameResult:
    """One frame's answer compared with the truth."""

    listed: int  # contacts listed
    likely: int  # of these, with a probability over one half
    # localized, ambiguous: whether this is the status
    localized: bool
    ambiguous: bool
    p_no_contact: float  # probability that nothing touches
    covered: int  # number of listed contacts whose interval contains a true place
    wrong: bool  # whether a contact is localized with an interval that contains no true place
    off_cm: float  # largest distance of a localized contact from the nearest true place
    hinge: bool  # whether the explanation or the message mentions a kink
    p_more: float  # of more contacts than are listed
    stands_out: float  # misfit that decides whether the group's promise covers the frame
    turn: float  # turn of the body by the mean of noise-free readings, rad
    fits: bool  # whether one contact leaves at most the misfit of noise in 99 of 100 frames


def _free(rng: np.random.Generator, count: int, bent: bool) -> Floats:
    size = rng.uniform(0.005, contact_scenes.MOST_FREE, count) if bent else 0.0
    return signs(rng, count) * size


def _push(rng: np.random.Generator, free: Floats, least_share: float) -> Floats:
    """Contacts' moments at the base (1/cm), against the bend, or to either side if it is straight.

    `least` is the smallest moment over the largest.
    """
    bent = bool(free.any())
    largest = np.minimum(CRITICAL, 0.9 * np.abs(free)) if bent else CRITICAL
    moment = rng.uniform(least_share, 1.0, len(free)) * largest
    return (-np.sign(free) if bent else signs(rng, len(free))) * moment


def _read(
    arcs: Floats, forces: Floats, position: Floats, free: Floats, kink: Floats | float = 0.0
) -> Scenes:
    bodies = solve(arcs, forces, length=LENGTH, free_curvature=free[:, None], kink=kink)
    return Scenes(bodies.readings(position, SPAN), position, free, arcs)


def one_contact(position: Floats, rng: np.random.Generator, count: int) -> Scenes:
    """Straight bodies with one clear contact."""
    arcs = rng.uniform(15.0, LENGTH, (count, 1))
    forces = signs(rng, count)[:, None] * rng.uniform(0.003, 0.011, (count, 1)) / arcs
    return _read(arcs, forces, position, np.zeros(count))


def near_base(bent: bool, rng: np.random.Generator, count: int) -> Scenes:
    """A contact that only the first sensors see."""
    free = _free(rng, count, bent)
    arcs = rng.uniform(5.0, NEAR_CM, (count, 1))
    forces = _push(rng, free, 0.2)[:, None] / arcs
    return _read(arcs, forces, COLUMN if bent else BOTH, free)


def two(
    opposed: bool, bent: bool, position: Floats, rng: np.random.Generator, count: int
) -> Scenes:
    """Two contacts at least 18.5 cm apart, the distal one near the tip."""
    free = _free(rng, count, bent)
    distal = rng.uniform(45.0, LENGTH, count)
    arcs = np.stack([rng.uniform(18.0, distal - 18.5), distal], axis=1)
    # Opposed moments partly cancel at the base, those of one side add up.
    shares = np.array((-1.0, 1.5) if opposed else (0.5, 0.5))
    return _read(arcs, shares * _push(rng, free, 0.3)[:, None] / arcs, position, free)


def pair(
    gap: float, first: float, moments: tuple[float, float], _: np.random.Generator, count: int
) -> Scenes:
    """The same two opposed contacts in all scenes."""
    arcs = np.tile([LENGTH - gap, LENGTH], (count, 1))
    return _read(arcs, np.array(moments) / arcs, _layout(first), np.zeros(count))


def _layout(first: float) -> Floats:
    """Ten sensors, the first of a column at `first`."""
    return np.tile(first + 10.0 * np.arange(5), 2)


def anywhere(
    number: int, bent: bool, position: Floats, rng: np.random.Generator, count: int
) -> Scenes:
    """Contacts anywhere, with independent moments to either side."""
    free = signs(rng, count) * rng.uniform(0.002, 0.04, count) if bent else np.zeros(count)
    room = LENGTH - 12.0 - APART_CM * (number - 1)
    arcs = 12.0 + np.sort(rng.uniform(0.0, room, (count, number)), axis=1)
    arcs += APART_CM * np.arange(number)
    side = rng.choice([-1.0, 1.0], (count, number))
    moments = side * rng.uniform(0.3, 1.0, (count, number)) * CRITICAL
    return _read(arcs, moments / arcs, position, free)


def folded(bent: bool, rng: np.random.Generator, count: int) -> Scenes:
    """One contact that has folded the base, where the first sensors see it."""
    free = signs(rng, count) * rng.uniform(0.02, contact_scenes.MOST_FREE, count) * bent
    side = -np.sign(free) if bent else signs(rng, count)
    arcs = np.stack([np.full(count, FOLD_CM), rng.uniform(15.0, LENGTH, count)], axis=1)
    forces, kinks = np.zeros((2, count, 2))
    forces[:, 1] = side * CRITICAL / arcs[:, 1]
    kinks[:, 0] = side * rng.uniform(0.1, 0.8, count)
    scenes = _read(arcs, forces, COLUMN if bent else BOTH, free, kinks)
    return replace(scenes, arcs=arcs[:, 1:])


def held_rod(rng: np.random.Generator, count: int) -> Scenes:
    """Rods whose end is held, by a force and a couple; NaN stands for no sensor.

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
    """A kink anywhere, with or without a contact."""
    free = _free(rng, count, bent)
    kink = signs(rng, count) * rng.uniform(0.2, 1.0, count)
    places = np.stack([rng.uniform(3.0, 50.0, count), rng.uniform(8.0, LENGTH, count)], axis=1)
    kinks, forces = np.zeros((2, count, 2))
    kinks[:, 0], forces[:, 1] = kink, touched * _push(rng, free, 0.2) / places[:, 1]
    order = np.argsort(places, axis=1)
    arcs, kinks, forces = (np.take_along_axis(v, order, 1) for v in (places, kinks, forces))
    scenes = _read(arcs, forces, COLUMN if bent else BOTH, free, kinks)
    misfit = contact_scenes.misfit_of_one_contact(scenes.curvature, scenes.position, free)
    return replace(scenes, arcs=places[:, 1 : 1 + touched], stands_out=misfit)


def _groups() -> dict[str, Group]:
    groups: dict[str, Group] = {}
    for label, noise, count in (("known", {}, 3000), ("unknown", {"noise": None}, 1000)):
        for n in FEW:
            where = BOTH if n == 10 else COLUMN[:n]
            name = f"free, {n} readings, noise {label}"
            groups[name] = Group(partial(straight, where), 3000, noise)
        groups[f"one contact, noise {label}"] = Group(partial(one_contact, BOTH), count, noise)
    groups["one contact, 5 readings, noise unknown"] = Group(
        partial(one_contact, COLUMN), options={"noise": None}
    )
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
        groups[f"two {kind}, straight"] = Group(partial(two, opposed, False, BOTH))
        for position in (BOTH, COLUMN):
            groups[f"two {kind}, bent, {position.size} readings"] = Group(
                partial(two, opposed, True, position)
            )
    for gap in (TOLD_APART_CM, TOO_CLOSE_CM):
        for first in LAYOUTS if gap == TOLD_APART_CM else (5.0,):
            for moments in PAIRS:
                arcs = np.array([LENGTH - gap, LENGTH])
                bound = arc_bounds(arcs, moments / arcs, _layout(first), SPAN, SIGMA, LENGTH).max()
                if gap == TOO_CLOSE_CM or bound < PLACED_CM:
                    name = f"{gap:g} cm apart, first sensor at {first:g} cm, {moments[1]:g} 1/cm"
                    groups[name] = Group(partial(pair, gap, first, moments))
    rod = {"length": ROD_CM, "span": 0.0, "noise": ROD_NOISE, "held_end": None}
    for radius, name in ((None, "rod held at its end"), (0.8, "rod held, radius stated")):
        groups[name] = Group(held_rod, options=rod | {"tube_radius": radius}, noise=ROD_NOISE)
    for level in (0.0, 0.9):
        for position in (DENSE, COLUMN):
            name = f"two anywhere, bent, {position.size} readings, number {level:g}"
            groups[name] = Group(
                partial(anywhere, 2, True, position), options={"number_level": level}
            )
    groups["three anywhere, straight, 20 readings"] = Group(partial(anywhere, 3, False, DENSE))
    for bent in (False, True):
        body = "bent" if bent else "straight"
        groups[f"folded, {body}, nothing said"] = Group(partial(folded, bent), options=NOTHING_SAID)
    for name, draw in (("pressed", contact_scenes.pressed), ("bent", contact_scenes.bent)):
        for statement, options in (("all said", {}), ("nothing said", NOTHING_SAID)):
            groups[f"{name}, {statement}"] = Group(draw, options=options)
    return groups


GROUPS = _groups()


def answer_frames(task: tuple[str, tuple[int, ...], int]) -> list[FrameResult]:
    """A batch of frames of a group."""
    name, key, size = task
    group, rng = GROUPS[name], np.random.default_rng(key)
    scenes = group.draw(rng, size)
    frames = scenes.curvature + group.noise * rng.standard_normal(scenes.curvature.shape)
    stands_out = np.zeros(size) if scenes.stands_out is None else scenes.stands_out
    misfit = np.full(size, np.inf)
    if group.against_free or scenes.arcs.shape[1] == 2:
        misfit = contact_scenes.misfit_of_one_contact(frames, scenes.position, scenes.free)
    if group.against_free:
        free = np.square((frames - scenes.free[:, None]) / SIGMA).sum(axis=1)
        stands_out = free - misfit
    fits = misfit < chi2.isf(0.01, scenes.position.size - 2)
    stated = {"length": LENGTH, "span": SPAN, "noise": SIGMA, **ROBOT, **group.options}
    localizer = Localizer.of(position=scenes.position, **stated)
    results = []
    turns = np.abs(scenes.curvature.mean(axis=1)) * stated["length"]
    for frame, free, arcs, excess, fit, turn in zip(
        frames, scenes.free, scenes.arcs, stands_out, fits, turns, strict=True
    ):
        result = localizer.localize(frame, free_curvature=free)
        localized = [contact for contact in result.contacts if contact.status == "localized"]
        distances = (float(np.abs(arcs - c.arc).min(initial=np.inf)) for c in localized)
        results.append(
            FrameResult(
                listed=len(result.contacts),
                likely=sum(contact.probability > 0.5 for contact in result.contacts),
                localized=bool(localized),
                ambiguous=result.status == "ambiguous",
                p_no_contact=1.0 / (1.0 + float(np.exp(min(result.log_odds, 500.0)))),
                covered=sum(holds(arcs, contact.interval) for contact in result.contacts),
                wrong=any(not holds(arcs, contact.interval) for contact in localized),
                off_cm=max(distances, default=0.0),
                hinge=any(
                    word in f"{result.hypothesis} {result.message}"
                    for word in ("hinge", "folded", "kinked")
                ),
                p_more=sum(result.number[len(result.contacts) + 1 :]),
                stands_out=float(excess),
                turn=float(turn),
                fits=bool(fit),
            )
        )
    return results


def _coverage(frames: Sequence[FrameResult]) -> float:
    """Share of listed contacts whose intervals contain a true place."""
    return sum(f.covered for f in frames) / max(sum(f.listed for f in frames), 1)


def _claims(results: dict[str, list[FrameResult]]) -> list[Claim]:
    """The promises; each is checked on its worst group."""

    def named(start: str) -> list[list[FrameResult]]:
        return [frames for name, frames in results.items() if name.startswith(start)]

    def worst(groups: Iterable[list[FrameResult]], holds: Callable[[FrameResult], bool]) -> float:
        return max(share([holds(f) for f in frames]) for frames in groups)

    def at_least(text: str, value: float, limit: float) -> Claim:
        return Claim(text, value, limit, at_most=False)

    claims = []
    for noise in ("known", "unknown"):
        free = [results[f"free, {n} readings, noise {noise}"] for n in FEW]
        single = [results[f"one contact, noise {noise}"]]
        claims += [
            Claim(f"noise {noise}: false contacts, 2 to 10 readings, most",
                  worst(free, lambda f: f.likely > 0), 0.01),
            Claim(f"noise {noise}: false second contacts",
                  worst(single, lambda f: f.likely > 1), 0.05),
        ]  # fmt: skip
    doubted = [results[f"one contact, {n}noise unknown"] for n in ("", "5 readings, ")]
    claims += [
        at_least("noise unknown, one contact: least coverage", min(map(_coverage, doubted)), 0.93),
        Claim("noise unknown, one contact: localized and wrong, most",
              worst(doubted, lambda f: f.wrong), 0.04),
    ]  # fmt: skip
    base = [[f for f in frames if f.stands_out >= STANDS_OUT] for frames in named("near the base")]
    usual = [f for body in ("straight", "bent")
             for f in results[f"near the base, {body}, odds {ODDS[0]:g}"]]  # fmt: skip
    opposed, aligned = named("two opposed"), named("two on one side")
    explained = [f for frames in aligned for f in frames if f.listed == 1 and f.fits]
    two_answered = [[f for f in frames if f.listed == 2] for frames in opposed]
    rods = results["rod held at its end"]
    clear = [f for frames in named("kink") for f in frames if f.stands_out >= SEEN_KINK]
    hidden = [[f for f in frames if f.stands_out < SEEN_KINK] for frames in named("kink and")]
    return [
        *claims,
        Claim("near the base, 5 standard errors or more: not listed, most",
              worst(base, lambda f: f.listed == 0), 0.0),
        Claim("of these, P(no contact) over 0.05 and not ambiguous, most",
              worst(base, lambda f: f.p_no_contact > 0.05 and f.localized), 0.0),
        at_least("more than 25 cm from the end: contacts found",
                 share([f.likely > 0 for f in usual]), 0.83),
        at_least("two opposed contacts, straight: both found",
                 share([f.likely == 2 for f in results["two opposed, straight"]]), 0.78),
        Claim("two opposed, one answered: localized where neither is, most",
              worst(opposed, lambda f: f.wrong and f.listed == 1), 0.05),
        Claim("two on one side that one does not explain: localized where neither is, most",
              worst(aligned, lambda f: f.wrong and f.listed == 1 and not f.fits), 0.05),
        at_least("two opposed, both answered: least coverage of an interval",
                 min(map(_coverage, two_answered)), 0.93),
        at_least("two on one side that one explains: two or more not excluded",
                 share([f.p_more > priors.EXCLUDED for f in explained]), 1.0),
        at_least("separated at 18.5 cm, least share",
                 min(share([f.listed == 2 for f in frames]) for frames in named("18.5")), 0.9),
        at_least("13 cm apart: ambiguous, or localized where they are, least share",
                 min(share([not f.wrong for f in frames]) for frames in named("13 cm")), 0.95),
        at_least("rod held at its end: the end in the interval",
                 share([f.covered > 0 for f in rods]), 0.95),
        Claim("rod held at its end: localized more than 5 % of its length from there",
              share([f.off_cm > 0.05 * ROD_CM for f in rods]), 0.0),
        Claim("of the rods that turn by 45 degrees or more: localized so far from there",
              share([f.off_cm > 0.05 * ROD_CM for f in rods if f.turn >= BENT]), 0.0),
        Claim("rod held, radius stated: localized more than 5 % of its length from there",
              share([f.off_cm > 0.05 * ROD_CM for f in results["rod held, radius stated"]]), 0.0),
        Claim("two anywhere, bent, 20 readings: localized and wrong",
              share([f.wrong for f in results["two anywhere, bent, 20 readings, number 0"]]), 0.13),
        at_least("of these, frames with a localized contact",
                 share([f.localized for f in results["two anywhere, bent, 20 readings, number 0"]]),
                 0.5),
        Claim("two anywhere, bent, 5 readings: localized and wrong",
              share([f.wrong for f in results["two anywhere, bent, 5 readings, number 0"]]), 0.08),
        Claim("two anywhere, the number held to 90 %: localized and wrong, most",
              max(share([f.wrong for f in frames]) for name, frames in results.items()
                  if name.endswith("number 0.9")), 0.075),
        Claim("three anywhere, straight, 20 readings: localized and wrong",
              share([f.wrong for f in results["three anywhere, straight, 20 readings"]]), 0.15),
        Claim("folds that nobody states: localized and wrong, most",
              worst(named("folded"), lambda f: f.wrong), 0.05),
        at_least("nothing said: least share of the localized contacts that are with all said",
                 min(share([f.localized for f in results[f"{name}, nothing said"]])
                     / max(share([f.localized for f in results[f"{name}, all said"]]), 1e-9)
                     for name in ("pressed", "bent")), 2.0 / 3.0),
        at_least("nothing said: least coverage",
                 min(_coverage(results[f"{name}, nothing said"]) for name in ("pressed", "bent")),
                 0.93),
        Claim("kinks of 3 standard errors or more: not reported, and a contact localized",
              share([f.localized and not f.hinge for f in clear]), 0.0),
        Claim("of these, localized where nothing is", share([f.wrong for f in clear]), 0.03),
        at_least("kinks that hardly show: least coverage",
                 min(share([f.covered > 0 for f in frames if f.listed]) for frames in hidden),
                 0.93),
        Claim("kinks that hardly show: localized and wrong, most",
              worst(hidden, lambda f: f.wrong), 0.03),
    ]  # fmt: skip


def _row(name: str, results: list[FrameResult]) -> Record:
    clear = SEEN_KINK if name.startswith("kink") else STANDS_OUT
    return {
        "group": name,
        "count": len(results),
        **{count: share([f.likely == n for f in results])
           for n, count in enumerate(("none", "one", "two"))},
        "localized": share([f.localized for f in results]),
        "ambiguous": share([f.ambiguous for f in results]),
        "covered": _coverage(results),
        "wrong": share([f.wrong for f in results]),
        "hinge": share([f.hinge for f in results]),
        "wrong_of_localized": share([f.wrong for f in results if f.localized]),
        "stand_out": sum(f.stands_out >= clear for f in results),
        "localized_most_off_cm": max(f.off_cm for f in results),
    }  # fmt: skip


def run(context: Context) -> Outcome:
    """Answer all groups, and check the promises."""
    tasks = [
        (name, (context.seed, g, b), size)
        for g, (name, group) in enumerate(GROUPS.items())
        for b, size in parts(context.count(min(20, group.count), group.count), BATCH)
    ]
    results: dict[str, list[FrameResult]] = {name: [] for name in GROUPS}
    for (name, *_), batch in zip(
        tasks, context.map(answer_frames, tasks, "frames", last), strict=True
    ):
        results[name] += batch
    rows = [_row(name, frames) for name, frames in results.items()]
    return Outcome({"rows": rows}, claims=_claims(results), summary=rows)
