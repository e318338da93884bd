"""How long `localize` takes: what is promised of it, and how time grows with sensors and rows.

Everything that a call answers counts, as a user calls it: from Python, the number of contacts not
given, on one core. Each time is the least of many repeats, for what lies above it is the machine's
other work; frames differ in what has to be weighed, so the median over frames is taken. Limits are
printed as claims, never asserted in a test.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from time import process_time
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from thigmo.localization import localize, localize_batch
from thigmo.studies import charts
from thigmo.studies.engine import Claim, Context, Outcome
from thigmo.studies.scenes import (
    BOTH,
    LENGTH,
    SIGMA,
    SPAN,
    Case,
    actuated,
    one_contact,
    three_contacts,
    two_contacts,
)

SENSORS = (5, 10, 20, 50, 100, 200, 500, 1000)
BATCHES = (1, 10, 100, 1000, 10_000)
# What is drawn, and what is promised (microseconds); with the noise unknown three times that.
KINDS: dict[str, tuple[Callable[[np.random.Generator], Case], float]] = {
    "one contact, straight": (one_contact, 40.0),
    "one contact, bent": (partial(actuated, position=BOTH), 150.0),
    "two contacts": (two_contacts, 600.0),
    "three contacts": (three_contacts, 20_000.0),
}
GRATINGS, GRATINGS_MS = 1000, 50.0
ROW_US = 20.0


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process, and those that it starts, to one core, where the system can."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def least_us(call: Callable[[], object], repeats: int) -> float:
    """Least time of the processor for a call (microseconds), after a first one that warms.

    That is the time on a core of its own, whatever else the computer does.
    """
    call()
    times = []
    for _ in range(repeats):
        start = process_time()
        call()
        times.append(process_time() - start)
    return min(times) * 1e6


def answer_us(
    cases: Iterable[Case], repeats: int, *, noise: float | None = SIGMA, span: float = SPAN
) -> float:
    """Time of `localize`, median over frames."""

    def answer(case: Case) -> object:
        return localize(
            case.curvature,
            case.position,
            length=LENGTH,
            span=span,
            free_curvature=case.free,
            noise=noise,
        )

    return float(np.median([least_us(partial(answer, case), repeats) for case in cases]))


@one_core()
def run(context: Context) -> Outcome:
    """The promises, time over the number of sensors, and time of a row over the batch."""
    frames, repeats = context.count(5, 60), context.count(3, 20)
    outcome = Outcome()
    times: dict[str, float] = {}
    for kind, (draw, promised_us) in KINDS.items():
        cases = [draw(context.rng(1, i)) for i in range(frames)]
        ways = (("", SIGMA, 1), (", noise unknown", None, 3))
        for way, noise, share in ways if kind.startswith("one") else ways[:1]:
            name = f"{kind}{way}"
            times[name] = answer_us(cases, repeats, noise=noise)
            text = f"{name}, 10 readings"
            outcome.claims.append(Claim(text, times[name], share * promised_us, unit="us"))
        context.progress("promises", len(times), len(KINDS) + 2)
    by_sensors: dict[str, list[tuple[float, float]]] = {}
    for name, draw in (("one contact", one_contact), ("three contacts", three_contacts)):
        by_sensors[name] = []
        for done, sensors in enumerate(SENSORS, 1):
            where = np.linspace(0.5, LENGTH - 0.5, sensors)
            some = [draw(context.rng(2, i), where, 0.0) for i in range(3)]
            time = answer_us(some, max(repeats // 5, 2), span=0.0)
            by_sensors[name].append((sensors, time))
            context.progress(f"sensors, {name}", done, len(SENSORS))
    most = by_sensors["three contacts"][SENSORS.index(GRATINGS)][1]
    outcome.claims.append(
        Claim(f"three contacts, {GRATINGS} gratings", most / 1e3, GRATINGS_MS, unit="ms")
    )
    rows = np.array([one_contact(context.rng(3, i)).curvature for i in range(BATCHES[-1])])
    by_batch = [(size, _row_us(rows[:size], max(repeats // 10, 1))) for size in BATCHES]
    outcome.claims.append(Claim("localize_batch, a row", by_batch[-1][1], ROW_US, unit="us"))
    outcome.tables = {
        "promises": [{"what": what, "time_us": time} for what, time in times.items()],
        "sensors": [
            {"contacts": name, "sensors": sensors, "time_us": time}
            for name, points in by_sensors.items()
            for sensors, time in points
        ],
        "batch": [{"rows": size, "row_us": time} for size, time in by_batch],
    }
    outcome.figures["scaling"] = _figure(by_sensors, by_batch)
    return outcome


def _row_us(rows: np.ndarray, repeats: int) -> float:
    call = partial(localize_batch, rows, BOTH, length=LENGTH, span=SPAN, noise=SIGMA)
    return least_us(call, repeats) / len(rows)


def _figure(
    by_sensors: dict[str, list[tuple[float, float]]], by_batch: list[tuple[int, float]]
) -> Figure:
    figure, (left, right) = charts.panels(1, 2, title="Time of all that is answered, one core")
    both: dict[str, Any] = {"xscale": "log", "yscale": "log"}
    charts.curves(left, by_sensors, xlabel="number of sensors", ylabel="localize (us)", **both)
    charts.curves(
        right, {"localize_batch": by_batch}, xlabel="rows", ylabel="time of a row (us)", **both
    )
    return figure
