"""How time grows: with sensors (5..1000), contacts (1..3) and batch size.

Times are the least of many repeats on one core: what lies above it is the machine's other work. The
promised limits hold for two ordinary cores; they are printed as claims, never asserted in a test.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from thigmo.localization import localize, localize_batch
from thigmo.localization.exact import one_contact as exact_one
from thigmo.localization.exact import one_contact_batch, several_contacts
from thigmo.studies.engine import Claim, Context, Outcome, Table
from thigmo.studies.rod import readings
from thigmo.studies.scenes import (
    CRITICAL,
    LENGTH,
    SIGMA,
    SPAN,
    Case,
    one_contact,
    two_contacts,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SENSORS = (5, 10, 20, 50, 100, 200, 500, 1000)
BATCHES = (1, 10, 100, 1000, 10_000)


def _least_us(call: Callable[[], object], repeats: int) -> float:
    call()  # compiles, and warms the caches
    times = []
    for _ in range(repeats):
        start = perf_counter()
        call()
        times.append(perf_counter() - start)
    return min(times) * 1e6


def _dense(rng: np.random.Generator, sensors: int, contacts: int) -> tuple[np.ndarray, np.ndarray]:
    """Readings of point sensors (gratings) evenly along the body, and their places."""
    where = np.linspace(0.5, LENGTH - 0.5, sensors)
    arcs = np.array([50.0, 35.0, 20.0][:contacts])[::-1].copy()
    forces = np.array([1.0, -1.6, 2.4][:contacts])[::-1] * 0.6 * CRITICAL / LENGTH
    clean = readings(arcs, forces, where, length=LENGTH)
    return clean + SIGMA * rng.standard_normal(sensors), where


def _figure(
    by_sensors: list[tuple[int, int, float]], by_batch: list[tuple[int, str, float]]
) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for contacts in sorted({c for c, _, _ in by_sensors}):
        points = [(n, t) for c, n, t in by_sensors if c == contacts]
        left.plot(*zip(*points, strict=True), marker="o", label=f"{contacts} contact(s)")
    left.set(xscale="log", yscale="log", xlabel="number of sensors", ylabel="time of one fit (us)")
    for name in dict.fromkeys(label for _, label, _ in by_batch):
        points = [(b, t) for b, label, t in by_batch if label == name]
        right.plot(*zip(*points, strict=True), marker="o", label=name)
    right.set(
        xscale="log", yscale="log", xlabel="readings in a batch", ylabel="time a reading (us)"
    )
    for axis in (left, right):
        axis.grid(which="both", alpha=0.2)
        axis.legend(fontsize=8)
    figure.suptitle("Scaling of the exact solvers, one core")
    return figure


def _answer_us(cases: list[Case], repeats: int) -> float:
    """Time of `localize` (microseconds), median over cases, number of contacts not given."""

    def answer(case: Case) -> object:
        return localize(case.curvature, case.position, length=LENGTH, span=SPAN, noise=SIGMA)

    return float(np.median([_least_us(partial(answer, case), repeats) for case in cases]))


def run(context: Context) -> Outcome:
    """The study: sensors, contacts, batch sizes; and the promised speeds."""
    rng = context.rng(0)
    repeats = context.count(5, 30)
    by_sensors: list[tuple[int, int, float]] = []
    for contacts in (1, 2, 3):
        for sensors in SENSORS:
            curvature, where = _dense(rng, sensors, contacts)

            def fit(y: np.ndarray = curvature, x: np.ndarray = where, c: int = contacts) -> object:
                if c == 1:
                    return exact_one(y, x, LENGTH)
                return several_contacts(y, x, LENGTH, contacts=c)

            by_sensors.append((contacts, sensors, _least_us(fit, repeats)))
            context.progress("fits", len(by_sensors), 3 * len(SENSORS))

    by_batch: list[tuple[int, str, float]] = []
    cases = [one_contact(np.random.default_rng([context.seed, i])) for i in range(BATCHES[-1])]
    rows = np.array([case.curvature for case in cases])
    where = cases[0].position
    for size in BATCHES:
        some = rows[:size]
        times = max(2, repeats // 5)
        fit_only = _least_us(partial(one_contact_batch, some, where, LENGTH, span=SPAN), times)
        whole = _least_us(
            partial(localize_batch, some, where, length=LENGTH, span=SPAN, noise=SIGMA), times
        )
        by_batch += [(size, "exact L1 fit", fit_only / size), (size, "localize", whole / size)]
        context.progress("batches", len(by_batch) // 2, len(BATCHES))

    ten = cases[0]
    pair = two_contacts(context.rng(1))
    single = _least_us(
        lambda: exact_one(ten.curvature, ten.position, LENGTH, span=SPAN), 10 * repeats
    )
    # Noise decides whether a second contact is looked for, so each call meets another frame.
    frames = [one_contact(np.random.default_rng([context.seed, 1, i])) for i in range(repeats)]
    pairs = [two_contacts(np.random.default_rng([context.seed, 2, i])) for i in range(repeats)]
    full = _answer_us(frames, repeats)
    full_two = _answer_us(pairs, repeats)
    two = _least_us(
        lambda: several_contacts(pair.curvature, pair.position, LENGTH, contacts=2, span=SPAN),
        repeats,
    )
    at = {(c, n): t for c, n, t in by_sensors}
    batch = next(t for b, name, t in by_batch if b == BATCHES[-1] and name == "exact L1 fit")
    claims = [
        Claim("one contact, 10 readings, exact fit in a batch", batch, 5.0, unit="us"),
        Claim("one contact, 10 readings, exact fit from Python", single, 40.0, unit="us"),
        Claim("one contact, 10 readings, all that localize answers", full, 40.0, unit="us"),
        Claim("two contacts, 10 readings, exact fit", two, 500.0, unit="us"),
        Claim("two contacts, 10 readings, all that localize answers", full_two, 500.0, unit="us"),
        Claim("one contact, 200 gratings", at[1, 200], 300.0, unit="us"),
        Claim("three contacts, 1000 gratings", at[3, 1000] / 1e3, 100.0, unit="ms"),
    ]
    return Outcome(
        [
            Table("sensors", ("contacts", "sensors", "time_us"), list(by_sensors)),
            Table("batch", ("batch", "what", "time_us"), list(by_batch)),
        ],
        {"scaling": _figure(by_sensors, by_batch)},
        claims,
    )
