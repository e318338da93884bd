"""How many contacts there are: false ones in empty scenes, and two that are told apart or not.

False contacts are counted in empty scenes and in scenes with one contact, with few and many
readings, of known and unknown noise; two opposed contacts over separations, forces and sensor
layouts. Truth is the large-deflection rod. How many scenes each number has is chosen for the
standard error that its claim needs, and the tables state it. Coverage and accuracy of the places
are a study of their own (`accuracy.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thigmo.localization import localize
from thigmo.studies.engine import Claim, Context, Outcome, Table
from thigmo.studies.information import arc_deviations
from thigmo.studies.rod import readings
from thigmo.studies.scenes import BOTH, COLUMN, LENGTH, SIGMA, SPAN

Floats = NDArray[np.float64]
Loads = tuple[tuple[float, ...], tuple[float, ...]]
"""Arcs (cm) and base moments (1/cm) of the contacts."""

LAYOUTS = (1.0, 2.75, 5.0, 7.25)
GAPS = (39.0, 34.0, 29.0, 23.5, 18.5, 13.0)
PAIRS = ((-0.016, 0.02), (-0.02, 0.03), (-0.03, 0.04))

BATCH = 25  # scenes of one group that a process takes at a time
# Pairs that a claim rests on (its share to 2 %), and those that are on the map only (6 %).
CLAIMED_PAIR, MAPPED_PAIR = 200, 60


def none(_: np.random.Generator) -> Loads:
    """Nothing touches."""
    return (), ()


def single(rng: np.random.Generator) -> Loads:
    """One clear contact."""
    arc = float(rng.uniform(15.0, LENGTH))
    return (arc,), (float(rng.choice([-1.0, 1.0]) * rng.uniform(0.003, 0.011)),)


def given(loads: Loads, _: np.random.Generator) -> Loads:
    """The same loads each time."""
    return loads


@dataclass(frozen=True)
class Group:
    """Scenes that are counted together."""

    draw: Callable[[np.random.Generator], Loads]
    count: int
    position: tuple[float, ...] = tuple(BOTH.tolist())
    known: bool = True


@dataclass(frozen=True)
class Seen:
    """A scene's answer against its truth.

    `held`: as many contacts as there are were found, and each interval holds its own. `square`:
    mean squared error of the arcs in order (cm^2), NaN where another number was found.
    """

    found: int
    localized: bool
    ambiguous: bool
    held: bool
    square: float


@lru_cache(maxsize=64)
def _clean(arcs: tuple[float, ...], moments: tuple[float, ...], where: tuple[float, ...]) -> Floats:
    forces = np.array(moments) / np.maximum(arcs, 1e-9)
    return readings(np.array(arcs), forces, np.array(where), length=LENGTH, span=SPAN)


def see(task: tuple[Group, tuple[int, ...], int]) -> list[Seen]:
    """A batch of scenes of a group."""
    group, key, size = task
    rng = np.random.default_rng(key)
    return [_see(group, rng) for _ in range(size)]


def _see(group: Group, rng: np.random.Generator) -> Seen:
    arcs, moments = group.draw(rng)
    clean = _clean(arcs, moments, group.position)
    result = localize(
        clean + SIGMA * rng.standard_normal(clean.size),
        group.position,
        length=LENGTH,
        span=SPAN,
        noise=SIGMA if group.known else None,
    )
    found = result.contacts
    same = len(found) == len(arcs)
    pairs = list(zip(found, arcs, strict=True)) if same else []
    return Seen(
        len(found),
        result.status == "localized",
        result.status == "ambiguous",
        same and all(c.interval[0] - 1e-6 <= a <= c.interval[1] + 1e-6 for c, a in pairs),
        float(np.mean([(c.arc - a) ** 2 for c, a in pairs])) if pairs else float("nan"),
    )


def batches(count: int) -> list[int]:
    """Sizes of the batches that make `count` scenes."""
    return [min(BATCH, count - start) for start in range(0, count, BATCH)]


def see_all(context: Context, groups: Sequence[Group], part: str) -> list[list[Seen]]:
    """All scenes of each group."""
    tasks = [
        (group, (context.seed, len(part), g, b), size)
        for g, group in enumerate(groups)
        for b, size in enumerate(batches(group.count))
    ]
    found: list[list[Seen]] = [[] for _ in groups]
    for (_, key, _), seen in zip(tasks, context.map(see, tasks, part), strict=True):
        found[key[2]] += seen
    return found


def share(seen: Sequence[Seen], what: str) -> float:
    """Share of the scenes with a property."""
    return float(np.mean([bool(getattr(one, what)) for one in seen]))


def share_error(share: float, count: int) -> float:
    """Standard error of a share; not zero where none or all of the scenes had it (Agresti)."""
    shrunk = (share * count + 2.0) / (count + 4.0)
    return float(np.sqrt(shrunk * (1.0 - shrunk) / (count + 4.0)))


def root_mean(squares: Floats) -> tuple[float, float]:
    """Root of the mean, and its standard error, of what is not NaN; NaN without any."""
    squares = squares[~np.isnan(squares)]
    if squares.size == 0:
        return float("nan"), float("nan")
    root = float(np.sqrt(np.mean(squares)))
    spread = float(np.std(squares)) / np.sqrt(squares.size)
    return root, float(spread / (2.0 * root)) if root > 0.0 else 0.0


def false_alarms(context: Context) -> tuple[Table, list[Claim]]:
    """False contacts in empty scenes, false second ones in scenes with one."""
    count = context.count(300, 3000)
    groups = {}
    for known in (True, False):
        label = "known" if known else "unknown"
        for n in (2, 3, 5, 10):
            where = tuple((BOTH if n == 10 else COLUMN[:n]).tolist())
            groups["empty", label, n] = Group(none, count, where, known=known)
        # At the promised 5 % a thousand scenes tell the rate to 0.7 %.
        many = context.count(100, 3000 if known else 1000)
        groups["one contact", label, 10] = Group(single, many, known=known)
    seen = see_all(context, list(groups.values()), "false contacts")
    rows, claims = [], []
    for (scene, label, n), some in zip(groups, seen, strict=True):
        empty = scene == "empty"
        rate = float(np.mean([one.found > (0 if empty else 1) for one in some]))
        rows.append((scene, label, n, len(some), rate, share_error(rate, len(some))))
        text = f"false contacts, {n} readings" if empty else "false second contacts"
        claims.append(Claim(f"{text}, {label} noise", rate, 0.01 if empty else 0.05))
    columns = ("scene", "noise", "readings", "count", "false_rate", "standard_error")
    return Table("false-alarms", columns, rows), claims


def separation(context: Context) -> tuple[Table, list[Claim]]:
    """Two opposed contacts over gap, force and layout."""
    groups: dict[tuple[float, float, tuple[float, float]], Group] = {}
    bounds = {}
    for base in LAYOUTS:
        position = np.tile(base + 10.0 * np.arange(5), 2)
        for gap in GAPS:
            for moments in PAIRS:
                arcs = LENGTH - gap, LENGTH
                forces = np.array(moments) / arcs
                bound = float(
                    arc_deviations(np.array(arcs), forces, position, SPAN, SIGMA, LENGTH).max()
                )
                claimed = (gap == 18.5 and bound < 2.5) or (gap == 13.0 and base == 5.0)
                count = context.count(10, CLAIMED_PAIR if claimed else MAPPED_PAIR)
                where = tuple(position.tolist())
                groups[base, gap, moments] = Group(partial(given, (arcs, moments)), count, where)
                bounds[base, gap, moments] = bound
    rows: list[dict[str, Any]] = []
    seen = see_all(context, list(groups.values()), "separation")
    for (base, gap, moments), some in zip(groups, seen, strict=True):
        rmse, error = root_mean(np.array([one.square for one in some]))
        shares = {
            "two_found": float(np.mean([one.found == 2 for one in some])),
            "localized": share(some, "localized"),
            "ambiguous": share(some, "ambiguous"),
            "confidently_wrong": float(np.mean([one.localized and not one.held for one in some])),
        }
        rows.append({
            "first_centre_cm": base, "gap_cm": gap, "proximal_moment": moments[0],
            "distal_moment": moments[1], "count": len(some), "bound_cm": bounds[base, gap, moments],
            **shares,
            "share_standard_error_most": max(share_error(s, len(some)) for s in shares.values()),
            "rmse_cm": rmse, "rmse_standard_error_cm": error,
        })  # fmt: skip
    apart = [row["two_found"] for row in rows if row["gap_cm"] == 18.5 and row["bound_cm"] < 2.5]
    close = [r["ambiguous"] for r in rows if r["gap_cm"] == 13.0 and r["first_centre_cm"] == 5.0]
    return Table.of("separation", rows), [
        Claim("told apart at 18.5 cm, least share", min(apart), 0.9, at_most=False),
        Claim("13 cm answered ambiguous, least share", min(close), 0.95, at_most=False),
    ]


def run(context: Context) -> Outcome:
    """Both, as `thigmo bench` runs them; each part is written when it is done."""
    outcome = Outcome()
    for part in (false_alarms, separation):
        table, claims = part(context)
        outcome.tables.append(table)
        outcome.claims += claims
        context.save(outcome)
    return outcome
