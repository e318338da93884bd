"""Contacts in space: rods under known loads by an independent solver, read by a fibre.

The groups are one contact; one on a body with weight; two; and a load of force and couple on the
end, without and with a couple about the body's axis, which a fibre cannot see. Errors are compared
with the Cramer-Rao bound of place and force together. The answer must not change if a body is
turned about its axis with its sensors, weight and loads.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np

from thigmo.localization import Localizer, LocalizeResult
from thigmo_bench.studies.engine import Claim, Context, Outcome, Record, last, parts, share
from thigmo_bench.studies.rod import Floats
from thigmo_bench.studies.rod_in_space import RodsInSpace, solve
from thigmo_bench.studies.scaling import KINDS, least_us, one_core
from thigmo_bench.studies.scenes import STATED

GRATINGS, SPAN, SIGMA = 12, 0.04, 0.015  # of a body of length one
POSITION: Floats = np.repeat(np.linspace(0.05, 0.95, GRATINGS), 2)
ANGLE: Floats = np.tile([0.0, np.pi / 2], GRATINGS)
AXIS: Floats = np.column_stack([0.0 * ANGLE, -np.sin(ANGLE), np.cos(ANGLE)])
TWIST = 1.3  # EI / GJ of a round rod
NEAREST, TURNS, MOST_MOMENT = 0.15, (0.2, 1.6), 6.0
END = 0.98  # from here on a place is the end's
STEP = 1e-4
BATCH = 50
GROUPS = ("one", "weight", "two", "end", "twisted end")
ENDS = GROUPS[3:]
READ: dict[str, Any] = {
    "position": POSITION, "angle": ANGLE, "length": 1.0, "span": SPAN, "noise": SIGMA,
    "twist": TWIST, **STATED,
}  # fmt: skip
TURNED = 1.234  # rad
TIMES_PLANE = 3.0  # promised: at most this multiple of the time in a plane


@dataclass(frozen=True)
class Answered:
    """An answer compared with the truth; NaN for a wrong number of contacts."""

    complete: bool  # as many contacts as there are
    error: float  # of the place, the worse of two
    covered: bool  # each true place lies in a set
    localized: bool  # whether a contact is
    wrong: bool  # localized, in a set that holds no true place
    force_square: float  # of the error of the force across the body
    force_bound_square: float
    newtons: bool  # whether the interval of the first force's size contains it
    turned: float  # difference of the places on the turned body


def _rods(group: str, rng: np.random.Generator, count: int) -> tuple[RodsInSpace, Floats, Floats]:
    """Rods, sizes of the first force across each, and of one contact the force's Cramer-Rao bound.

    The bound is the variance (count,) of both components, the place unknown.
    """
    contacts = 2 if group == "two" else 1
    arcs = np.sort(rng.uniform(NEAREST, 1.0, (count, contacts)), axis=1)
    around = rng.uniform(0.0, 2.0 * np.pi, (count, contacts))
    # Forces that turn a straight body by a given angle.
    size = np.minimum(2.0 * rng.uniform(*TURNS, (count, contacts)) / arcs**2, MOST_MOMENT / arcs)
    force = np.stack([0.0 * size, size * np.cos(around), size * np.sin(around)], axis=2)
    weight = rng.standard_normal((count, 3)) if group == "weight" else None
    if group in ENDS:
        axes = [0.0 if group == "end" else 1.0, 1.0, 1.0]
        couple = 0.7 * rng.standard_normal((count, 1, 3)) * axes
        force = rng.standard_normal((count, 1, 3))
        force_across = np.linalg.norm(force[:, 0, 1:], axis=1)
        rods = solve(np.ones((count, 1)), force, couple=couple, twist=TWIST)
        return rods, force_across, np.full(count, np.nan)
    rods = solve(arcs, force, weight=weight, twist=TWIST)
    if group != "one":
        return rods, size[:, 0], np.full(count, np.nan)
    clean, slopes = rods.readings(POSITION, AXIS, SPAN), []
    for arc, normal, binormal in np.eye(3) * STEP:
        force_step = np.array([0.0, normal, binormal])
        moved = solve(arcs - arc, force + force_step, twist=TWIST)
        slopes.append((moved.readings(POSITION, AXIS, SPAN) - clean) / STEP)
    lines = np.stack(slopes, axis=2) / SIGMA
    bound = np.linalg.inv(np.einsum("sni,snj->sij", lines, lines))
    return rods, size[:, 0], bound[:, 1, 1] + bound[:, 2, 2]


def _holds(result: LocalizeResult, arc: float) -> bool:
    return any(low <= arc <= high for c in result.contacts for low, high in c.intervals)


def answers(task: tuple[str, tuple[int, ...], int]) -> list[Answered]:
    """A batch of rods of a group."""
    group, key, count = task
    rng = np.random.default_rng(key)
    rods, force_across, bound = _rods(group, rng, count)
    clean = rods.readings(POSITION, AXIS, SPAN)
    noisy = clean + SIGMA * rng.standard_normal(clean.shape)
    rotation = np.array([
        [1.0, 0.0, 0.0], [0.0, np.cos(TURNED), -np.sin(TURNED)],
        [0.0, np.sin(TURNED), np.cos(TURNED)],
    ])  # fmt: skip
    out = []
    for k, curvature in enumerate(noisy):
        heavy = {"weight": rods.weight[k]} if group == "weight" else {}
        result = Localizer.of(**READ, **heavy, stiffness=(1.0, 0.0)).localize(curvature)
        heavy = {name: rotation @ value for name, value in heavy.items()}
        turned = READ | {"angle": ANGLE + TURNED}
        again = Localizer.of(**turned, **heavy).localize(curvature)
        true = rods.breaks[k, 1:-1]
        placed = [c for c in result.contacts if c.status == "localized"]
        complete = len(result.contacts) == len(true)
        errors = (
            np.subtract([c.arc for c in result.contacts], true) if complete else np.array([np.nan])
        )
        first = result.contacts[0] if result.contacts else None
        vector = (
            np.array(first.vector) if complete and first and first.vector else np.full(3, np.nan)
        )
        low, high = first.newtons.across.interval if first and first.newtons else (np.nan, np.nan)
        same = len(again.contacts) == len(result.contacts)
        pairs = zip(again.contacts, result.contacts, strict=True) if same else ()
        out.append(
            Answered(
                complete,
                float(np.abs(errors).max()),
                all(_holds(result, arc) for arc in true),
                bool(placed),
                any(
                    not any(low <= arc <= high for low, high in c.intervals for arc in true)
                    for c in placed
                )
                if group not in ENDS
                else any(c.interval[1] < END for c in placed),
                float(((vector - rods.forces[k, 0]) ** 2).sum()),
                float(bound[k]),
                bool(low <= force_across[k] <= high),
                max((abs(a.arc - b.arc) for a, b in pairs), default=0.0) if same else np.inf,
            )
        )
    return out


def _times(context: Context) -> list[Claim]:
    """Times of answers in space without options for the end."""
    frames, repeats = context.count(5, 40), context.count(3, 10)
    claims, localizer = [], Localizer.of(**READ)
    for number, (kind, (_, promised)) in enumerate(list(KINDS.items())[1:3], 1):
        rods, *_ = _rods(GROUPS[2 * number - 2], context.rng(9, number), frames)
        clean = rods.readings(POSITION, AXIS, SPAN)
        noisy = clean + SIGMA * context.rng(9, 9).standard_normal(clean.shape)
        times = [least_us(partial(localizer.localize, y), repeats) for y in noisy]
        text = f"{kind}, in space, {POSITION.size} readings"
        claims.append(Claim(text, float(np.median(times)), TIMES_PLANE * promised, unit="us"))
    return claims


def run(context: Context) -> Outcome:
    """Answer each group, and check the promises."""
    count = context.count(20, 200)
    rows: list[Record] = []
    columns: dict[str, dict[str, Floats]] = {}
    for number, group in enumerate(GROUPS):
        tasks = [(group, (context.seed, 24, number, k), size) for k, size in parts(count, BATCH)]
        answered = [answer for part in context.map(answers, tasks, group, last) for answer in part]
        values = {
            f.name: np.array([getattr(a, f.name) for a in answered], float)
            for f in fields(Answered)
        }
        columns[group] = values
        rows.append({
            "group": group, "count": count, "found": share(values["complete"]),
            "place_off": float(np.nanmean(values["error"])), "coverage": share(values["covered"]),
            "localized": share(values["localized"]), "wrong": share(values["wrong"]),
            "wrong_of_localized": share(values["wrong"][values["localized"] == 1.0]),
            "newtons_covered": share(values["newtons"]),
        })  # fmt: skip
    single = [columns[name] for name in ("one", "weight")]
    errors = np.concatenate([values["error"] for values in single])
    covered = np.concatenate([values["covered"] for values in single])
    one_contact = columns["one"]
    over_bound = one_contact["force_square"] / one_contact["force_bound_square"]
    bound = float(np.sqrt(over_bound[one_contact["complete"] == 1.0].mean()))
    turned = max(float(values["turned"].max()) for values in columns.values())
    with one_core():
        times = _times(context)
    percent = 100.0 * float(np.nanmean(errors))
    claims = [
        Claim("one contact, with weight and without: mean place error", percent, 2.0,
              unit="% of the length"),
        Claim("the same: coverage", share(covered), 0.91, at_most=False),
        Claim("force across the body: RMSE over the bound", bound, 1.5),
        Claim("a loaded end, localized elsewhere", share(columns["end"]["wrong"]), 0.0),
        Claim("turned about its axis with everything: largest change of a place", turned, 1e-6,
              unit="of the length"),
        *times,
    ]  # fmt: skip
    return Outcome({"rows": rows}, claims=claims, summary=rows)
