"""One frame against all frames of an inflation: `localize` of the last, and `ContactFilter`.

Truth is the independent rod bent into a peg at rest (`pegs`), of a size that is not stated. Errors
stay the same through an inflation: those of gains, map and zeros are stated; a bad sensor is not. A
localized contact whose 95 % interval does not hold the place is wrong; shares are of all rooms.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from thigmo.localization import Localizer, LocalizeResult, localize
from thigmo.studies.engine import Claim, Context, Outcome, last, parts, share
from thigmo.studies.pegs import Rooms, rooms
from thigmo.studies.rod import Floats
from thigmo.studies.scenes import COLUMN, LENGTH, RADIUS, ROBOT, SIGMA, SPAN

MOST = 0.05  # free curvature (1/cm) that an inflation can reach
FRAMES = 8
BATCH = 20  # rooms that a process takes at a time
GAIN, MAP, ZERO = 0.05, 0.05, 1e-3  # standard errors that are stated
BODY: dict[str, Any] = {"length": LENGTH, "span": SPAN, "noise": SIGMA, "tube_radius": RADIUS}


Stated = dict[str, Any]
Spoil = Callable[[np.random.Generator, Floats, Floats], tuple[Floats, Floats]]
"""What an error does to readings (T, N) of one body and to free curvatures (T,) as believed."""


def _gains(rng: np.random.Generator, curvature: Floats, free: Floats) -> tuple[Floats, Floats]:
    return curvature * (1.0 + GAIN * rng.standard_normal(COLUMN.size)), free


def _map(rng: np.random.Generator, curvature: Floats, free: Floats) -> tuple[Floats, Floats]:
    return curvature, free * (1.0 + MAP * rng.standard_normal())


def _zeros(rng: np.random.Generator, curvature: Floats, free: Floats) -> tuple[Floats, Floats]:
    return curvature + ZERO * rng.standard_normal(COLUMN.size), free


def _bad(offset: float | None) -> Spoil:
    """One sensor is off by `offset`, or says nothing but zero."""

    def spoil(rng: np.random.Generator, curvature: Floats, free: Floats) -> tuple[Floats, Floats]:
        sensor = np.arange(COLUMN.size) == rng.integers(COLUMN.size)
        if offset is None:
            return np.where(sensor, 0.0, curvature), free
        return curvature + sensor * offset * rng.choice([-1.0, 1.0]), free

    return spoil


def _more(rng: np.random.Generator, curvature: Floats, free: Floats) -> tuple[Floats, Floats]:
    return curvature + np.sqrt(3.0) * SIGMA * rng.standard_normal(curvature.shape), free


OTHER_NOISE = "twice the noise, not stated"
ERRORS: dict[str, tuple[Spoil, Stated]] = {
    "none": (lambda rng, curvature, free: (curvature, free), {}),
    "gains 5 % off": (_gains, {"gain_error": GAIN}),
    "map 5 % off": (_map, {"map_error": MAP}),
    "zeros 1e-3 1/cm off": (_zeros, {"zero_error": ZERO}),
    "a sensor off by 2e-3 1/cm": (_bad(2e-3), {}),
    "a sensor off by 8e-3 1/cm": (_bad(8e-3), {}),
    "a sensor stuck at zero": (_bad(None), {}),
    OTHER_NOISE: (_more, {}),
}
STATED, BAD = tuple(ERRORS)[:4], tuple(ERRORS)[4:7]


@cache
def _rooms(seed: int, number: int, size: int) -> tuple[Rooms, Floats]:
    """Pegs, and (S, T, N) what the sensors read without noise: the same for every error."""
    rng = np.random.default_rng([seed, 0x5E, number])
    there = rooms(rng, size, length=LENGTH, most=MOST, frames=FRAMES)
    read = [there.bodies(frame).readings(COLUMN, SPAN) for frame in range(FRAMES)]
    return there, np.stack(read, axis=1)


def _last(curvature: Floats, free: Floats, stated: Stated) -> LocalizeResult:
    return localize(curvature[-1], COLUMN, free_curvature=free[-1], **BODY | ROBOT, **stated)


def _all(curvature: Floats, free: Floats, stated: Stated) -> LocalizeResult:
    felt = Localizer.of(position=COLUMN, **BODY, **stated).filter(1.25 * MOST)
    felt.update(curvature, free)
    return felt.result()


METHODS = {"last frame": _last, "all frames": _all}


def judge(task: tuple[str, int, int, int]) -> dict[str, Floats]:
    """Answer a batch of rooms under one error: its name, the seed, the batch's number and size.

    Returns:
        (size, 5) of each method: listed, covered, localized, absolute error, width of interval.
    """
    error, seed, number, size = task
    there, clean = _rooms(seed, number, size)
    rng = np.random.default_rng([seed, 0x5F, list(ERRORS).index(error), number])
    spoil, stated = ERRORS[error]
    rows = {name: np.full((size, 5), np.nan) for name in METHODS}
    for room, arc in enumerate(there.arc[-1]):
        noise = SIGMA * rng.standard_normal(clean[room].shape)
        curvature, free = spoil(rng, clean[room], there.free[:, room])
        for name, method in METHODS.items():
            result = method(curvature + noise, free, stated)
            rows[name][room, [0, 2]] = bool(result.contacts), False
            if result.contacts:
                best = min(result.contacts, key=lambda contact: abs(contact.arc - arc))
                low, high = best.interval
                rows[name][room] = (
                    True, low - 1e-6 <= arc <= high + 1e-6, result.status == "localized",
                    abs(best.arc - arc), high - low,
                )  # fmt: skip
    return rows


def score(error: str, method: str, rows: Floats) -> dict[str, Any]:
    """One method under one error, of the rows of `judge`.

    Shares are of all rooms, `covered` of those listed.
    """
    listed, covered, localized, off, width = rows.T
    return {
        "error": error, "method": method, "rooms": len(rows), "listed": share(listed),
        "covered": float(np.nanmean(covered)), "localized": share(localized),
        "wrong": float(np.nansum(localized * (1.0 - covered)) / len(rows)),
        "mean_error_cm": float(np.nanmean(off)), "median_width_cm": float(np.nanmedian(width)),
    }  # fmt: skip


def run(context: Context) -> Outcome:
    """The study: every error, by the last frame and by all."""
    batches = parts(context.count(BATCH, 160), BATCH)
    scores = {}
    for error in ERRORS:
        got = context.map(judge, [(error, context.seed, *part) for part in batches], error, last)
        for method in METHODS:
            judged = np.concatenate([some[method] for some in got])
            scores[error, method] = score(error, method, judged)
    whole = {error: scores[error, "all frames"] for error in ERRORS}
    stated = [whole[error] for error in STATED]
    claims = [
        Claim("errors stated: least coverage", min(row["covered"] for row in stated), 0.93, False),
        Claim("errors stated: localized and wrong, most", max(r["wrong"] for r in stated), 0.03),
        Claim("a bad sensor: localized and wrong, most", max(whole[e]["wrong"] for e in BAD), 0.03),
        Claim("twice the noise: coverage", whole[OTHER_NOISE]["covered"], 0.9, at_most=False),
        Claim("twice the noise: localized and wrong", whole[OTHER_NOISE]["wrong"], 0.05),
        Claim(
            "mean error, over that of the last frame",
            whole["none"]["mean_error_cm"] / scores["none", "last frame"]["mean_error_cm"], 1.0,
        ),
    ]  # fmt: skip
    rows = list(scores.values())
    return Outcome({"rows": rows}, claims=claims, summary=rows)
