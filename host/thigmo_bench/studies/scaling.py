"""Time of `localize`: its promises, and how it grows with sensors and rows.

The whole call is timed as a user makes it: from Python, without the number of contacts, on one
core. Each time is the least of many repeats, because other work of the machine only adds to it.
Frames differ in the explanations that must be weighed, so the median over frames is reported.
Limits are printed as claims, never asserted in a test.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from time import process_time

import numpy as np
from numpy.typing import NDArray

from thigmo.localization import Localizer
from thigmo_bench.studies import scenes
from thigmo_bench.studies.engine import Claim, Context, Outcome, Record
from thigmo_bench.studies.scenes import (
    BOTH,
    LENGTH,
    SIGMA,
    SPAN,
    STATED,
    Case,
    one_contact,
    three_contacts,
)

SENSORS = (5, 10, 20, 50, 100, 200, 500, 1000)
ROWS = 10_000
BATCHES = (1, 10, 100, 1000, ROWS)
BATCH = 100  # rows of a batch; the promise is the time of one row
# Kind of case, and promised time (microseconds); three times that if the noise is unknown.
KINDS: dict[str, tuple[Callable[[np.random.Generator], Case], float]] = {
    "one contact, straight": (one_contact, 100.0),
    "one contact, bent": (partial(scenes.actuated, position=BOTH), 200.0),
    "two contacts": (scenes.two_contacts, 1000.0),
    "three contacts": (three_contacts, 20_000.0),
}
GRATINGS, GRATINGS_MS = SENSORS[-1], 50.0
ROW_US = 40.0


@contextmanager
def one_core() -> Iterator[None]:
    """Restrict this process and its children to one core, if the system supports it."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def time_us(call: Callable[[], object]) -> float:
    """Time of the processor for a call (microseconds)."""
    start = process_time()
    call()
    return (process_time() - start) * 1e6


def least_us(call: Callable[[], object], repeats: int) -> float:
    """Least processor time of a call (microseconds), after a first call that fills the caches.

    This approximates the time on an idle core.
    """
    call()
    return min(time_us(call) for _ in range(repeats))


def answer_us(
    cases: Iterable[Case], repeats: int, *, noise: float | None = SIGMA, span: float = SPAN
) -> float:
    """Time of `Localizer.localize`, median over frames."""
    answers = (
        partial(
            Localizer.of(
                position=case.position, length=LENGTH, span=span, noise=noise, **STATED
            ).localize,
            case.curvature,
            free_curvature=case.free,
        )
        for case in cases
    )
    return float(np.median([least_us(answer, repeats) for answer in answers]))


def row_us(rows: NDArray[np.float64], size: int, repeats: int) -> float:
    """Mean time (microseconds) of a row of `localize_batch`, in batches of `size` rows.

    Each batch counts with its least time. The batches take turns, so that a slow period of the
    computer affects one repeat of each, not every repeat of some.
    """
    localizer = Localizer.of(position=BOTH, length=LENGTH, span=SPAN, noise=SIGMA, **STATED)
    batches = [
        partial(localizer.localize_batch, rows[start : start + size])
        for start in range(0, len(rows), size)
    ]
    times = [[time_us(batch) for batch in batches] for _ in range(repeats)]
    return float(np.min(times, axis=0).sum() / len(rows))


@one_core()
def run(context: Context) -> Outcome:
    """The promises, time over the number of sensors, and time of a row over the batch."""
    frames, repeats = context.count(5, 60), context.count(3, 20)
    claims: list[Claim] = []
    for kind, (draw, promised_us) in KINDS.items():
        cases = [draw(context.rng(1, i)) for i in range(frames)]
        ways = (("", SIGMA, 1), (", noise unknown", None, 3))
        for label, noise, slower in ways if kind.startswith("one") else ways[:1]:
            time = answer_us(cases, repeats, noise=noise)
            text = f"{kind}{label}, 10 readings"
            claims.append(Claim(text, time, slower * promised_us, unit="us"))
        context.progress("promises", len(claims), len(KINDS) + 2)
    sensors: list[Record] = []
    for name, draw_contacts in (("one contact", one_contact), ("three contacts", three_contacts)):
        for number, count in enumerate(SENSORS, 1):
            where = np.linspace(0.5, LENGTH - 0.5, count)
            cases = [draw_contacts(context.rng(2, i), where, 0.0) for i in range(3)]
            time = answer_us(cases, max(repeats // 5, 2), span=0.0)
            sensors.append({"contacts": name, "sensors": count, "time_us": time})
            context.progress(f"sensors, {name}", number, len(SENSORS))
    # The last time is of three contacts on all gratings.
    claims.append(Claim(f"three contacts, {GRATINGS} gratings", time / 1e3, GRATINGS_MS, unit="ms"))
    rows = np.array([one_contact(context.rng(3, i)).curvature for i in range(ROWS)])
    times = {}
    for number, size in enumerate(BATCHES, 1):
        times[size] = row_us(rows, size, repeats)
        context.progress("rows", number, len(BATCHES))
    text = f"localize_batch, a row, {BATCH} at a time"
    claims.append(Claim(text, times[BATCH], ROW_US, unit="us"))
    batch: list[Record] = [{"rows": size, "row_us": time} for size, time in times.items()]
    return Outcome({"sensors": sensors, "batch": batch}, claims=claims)
