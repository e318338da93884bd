"""The fit to whole sweeps (`thigmo.field`) against sweeps of an independent rod, by kind of error.

The robot states the same robot.toml in every kind; each kind adds an error that it does not state
(`studies.drawn`). Whoever answers gets the sweeps of one side in their order. Truth is the contact
point on the skin at the last sweep's peak.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from math import nan
from time import process_time

import numpy as np

from thigmo.config import RobotConfig
from thigmo.contact_status import LIKELY
from thigmo.emulator.scene import Scene
from thigmo.exploration.fitted import is_localized
from thigmo.field import Atlas, FieldContact, Swept, contacts, read
from thigmo.wiring import Wiring
from thigmo_bench.studies.drawn import KINDS, DrawnRoom, rooms
from thigmo_bench.studies.engine import Claim, Context, Outcome, Record, last, parts, share

LENGTHS_CM = (40.0, 50.0, 53.0)  # everted, of the sweeps
ELLIPSE = 5.99  # 95 % of chi-square with two degrees of freedom
_BATCH = 4  # rooms that the rod solves side by side
_BEND_MARGIN = 1.3  # bends of the atlas over the map's highest
_LEAST_SAMPLES = 50.0
RADIUS_CM = 1.75  # of the tube
_ROOMS = 60  # of a kind, for which mistakes are promised

_CALIBRATED = "as calibrated"

Answer = Callable[[Sequence[Swept]], list[FieldContact]]
"""What the sweeps of the left side touched, best first."""


@dataclass(frozen=True)
class Judged:
    """An answer beside the truth of its room."""

    kind: str
    seed: int
    room: int
    touched: bool  # at any bend of any stop
    listed: bool
    judged: bool = False  # the last sweep touched the peg to its end, and a contact is listed
    error_cm: float = nan
    outside: bool = False  # of the 95 % ellipse
    off_set: bool = False  # the arc is not in the 95 % set along the body
    localized: bool = False
    wrong: bool = False  # localized, the arc not in its set, and over a tube's radius away
    samples: float = nan  # effective
    misfit: float = nan
    time_s: float = nan  # processor time


def judged(kind: str, seed: int, number: int, room: DrawnRoom, answer: Answer) -> Judged:
    """Ask for an answer, and hold its likely contacts against the room's truth."""
    begun = process_time()
    answered = answer([Swept(sweep, body_pressure) for sweep, body_pressure in room.sweeps])
    listed = [contact for contact in answered if contact.probability > LIKELY]
    time_s = process_time() - begun
    if not listed or room.contact is None or room.ended:
        return Judged(kind, seed, number, room.touched, bool(listed), time_s=time_s)
    best = min(listed, key=lambda contact: (not _is_localized(contact), _width(contact)))
    arc, x, y = room.contact
    off = np.array([best.x_cm - x, best.y_cm - y])
    low, high = best.interval_cm
    error_cm = float(np.linalg.norm(off))
    off_set, localized = not low <= arc <= high, _is_localized(best)
    return Judged(
        kind, seed, number, room.touched, listed=True, judged=True,
        error_cm=error_cm,
        outside=bool(off @ np.linalg.solve(best.covariance_cm2, off) > ELLIPSE),
        off_set=off_set,
        localized=localized, wrong=localized and off_set and error_cm > RADIUS_CM,
        samples=best.effective, misfit=best.misfit, time_s=time_s,
    )  # fmt: skip


def _width(contact: FieldContact) -> float:
    return contact.interval_cm[1] - contact.interval_cm[0]


def _is_localized(contact: FieldContact) -> bool:
    return is_localized(contact, LENGTHS_CM[-1])


@cache
def _robot() -> tuple[RobotConfig, Answer]:
    """The thesis's robot as its lab calibrated it, and its answers."""
    config = Scene.load("default").believed(3)
    wiring = Wiring.laid_out(config)
    muscle = config.muscle("left")
    most = muscle.most_bend
    atlas = Atlas(config.body.length_cm, _BEND_MARGIN * most)

    def answer(sweeps: Sequence[Swept]) -> list[FieldContact]:
        prepared = read(sweeps, "left", wiring)
        return [] if prepared is None else contacts(*prepared, atlas)

    return config, answer


def _batch(item: tuple[str, int, int]) -> list[Judged]:
    kind, seed, count = item
    config, answer = _robot()
    drawn = rooms(KINDS[kind], config, LENGTHS_CM, count, seed)
    return [judged(kind, seed, number, room, answer) for number, room in enumerate(drawn)]


def run(context: Context) -> Outcome:
    """Answer rooms of every kind, and check that ellipses hold the truth."""
    count = context.count(4, 60)
    results: list[Judged] = []
    outcome = Outcome()
    for number, kind in enumerate(KINDS):
        seeds = context.rng(0x47, number).integers(0, 2**31, count)
        batches = [
            (kind, int(seed), size)
            for seed, (_, size) in zip(seeds, parts(count, _BATCH), strict=False)
        ]
        for batch in context.map(_batch, batches, kind, last):
            results += batch
        outcome = _outcome(results)
        context.save(outcome)
    return outcome


def _outcome(results: list[Judged]) -> Outcome:
    rows = [_row(kind, [result for result in results if result.kind == kind]) for kind in KINDS]
    rows = [row for row in rows if row["rooms"]]
    whole = _row("all kinds", results)
    worst = max((float(row["outside_percent"]) for row in rows if row["judged"]), default=nan)
    false = sum(result.listed and not result.touched for result in results)

    def per_kind(column: str, *, calibrated: bool) -> float:
        """The most of a kind, in 60 rooms."""
        kinds = [row for row in rows if (row["kind"] == _CALIBRATED) == calibrated]
        shares = (float(row[column]) / float(row["rooms"]) for row in kinds)
        return _ROOMS * max(shares, default=nan)

    claims = [
        Claim("truth outside of the 95 % ellipse, all kinds", float(whole["outside_percent"]), 8.0,
              unit="%"),
        Claim("truth outside of the 95 % ellipse, worst kind", worst, 15.0, unit="%"),
        Claim("localized wrong, as calibrated", per_kind("wrong", calibrated=True), 0.0,
              unit="of 60"),
        Claim("localized wrong, worst other kind", per_kind("wrong", calibrated=False), 1.0,
              unit="of 60"),
        Claim("truth outside of the 95 % set along the body, worst kind",
              max(per_kind("off_set", calibrated=calibrated) for calibrated in (True, False)),
              5.0, unit="of 60"),
        Claim("sides with a contact that touched nothing", float(false), 0.0, unit="sides"),
    ]  # fmt: skip
    rows.append(whole)
    return Outcome(
        {"runs": [vars(result) for result in results], "rows": rows},
        {}, claims, [], rows,
    )  # fmt: skip


def _row(kind: str, results: list[Judged]) -> Record:
    right = [result for result in results if result.judged]
    return {
        "kind": kind,
        "rooms": len(results),
        "judged": len(right),
        "error_cm": float(np.mean([result.error_cm for result in right])) if right else nan,
        "outside_percent": 100 * share([result.outside for result in right]),
        "off_set": sum(result.off_set for result in right),
        "localized": sum(result.localized for result in right),
        "wrong": sum(result.wrong for result in right),
        "few_samples": sum(result.samples < _LEAST_SAMPLES for result in right),
        "missed": sum(result.touched and not result.listed for result in results),
        "false": sum(result.listed and not result.touched for result in results),
        "time_s": float(np.mean([result.time_s for result in results])) if results else nan,
    }
