"""Where methods fail: mean error and failure rate as one thing after another gets harder.

Maps over two conditions (force x place, noise x number of sensors, separation x force, starting
point x place) and curves over one (sensor layout, outliers, wrong free curvature, wrong
calibration, lost sensors, quantisation). Every method sees the same readings; the map over starting
points has the same readings in every row, and the methods that need a starting point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from thigmo.studies.attempt import FAILURE_CM, attempt, mean_and_failures
from thigmo.studies.engine import Context, Outcome, Table
from thigmo.studies.scenes import CRITICAL, LENGTH, SIGMA, SPAN, Case, one_contact, read

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Condition = float
Draw = Callable[[np.random.Generator, Condition, Condition], tuple[Case, float]]
"""Case and the noise that the method is told, for a row and a column condition."""

# Methods quick enough to map; the rest stand in the speed-accuracy chart.
MAPPED = ("exact", "l1", "l2", "alternating", "coordinate", "grid", "slsqp", "pwlf")
# Methods that start somewhere, beside two that do not.
STARTED = (
    "exact",
    "l1",
    "alternating",
    "clamped",
    "coupled",
    "slsqp",
    "trust-constr",
    "nelder-mead",
)
FOLD_CM = 3.5  # the fold at the base is spread over one body diameter


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _force_place(rng: np.random.Generator, moment: float, arc: float) -> tuple[Case, float]:
    return read(rng, (arc,), (_sign(rng) * moment * CRITICAL / arc,)), SIGMA


def _noise_sensors(rng: np.random.Generator, sigma: float, sensors: float) -> tuple[Case, float]:
    arc = float(rng.uniform(20.0, LENGTH))
    where = np.linspace(5.0, 45.0, int(sensors)) if sensors > 1 else np.array([25.0])
    case = read(rng, (arc,), (_sign(rng) * 0.7 * CRITICAL / arc,), position=where, sigma=sigma)
    return case, sigma


def _separation_force(rng: np.random.Generator, gap: float, moment: float) -> tuple[Case, float]:
    proximal = LENGTH - gap
    force = _sign(rng) * moment * CRITICAL / LENGTH
    return read(rng, (proximal, LENGTH), (-force * LENGTH / proximal, 1.5 * force)), SIGMA


def _layout(rng: np.random.Generator, first: float, _: float) -> tuple[Case, float]:
    arc = float(rng.uniform(20.0, LENGTH))
    where = np.tile(first + 10.0 * np.arange(5), 2)
    return read(rng, (arc,), (_sign(rng) * 0.7 * CRITICAL / arc,), position=where), SIGMA


def _outliers(rng: np.random.Generator, share: float, _: float) -> tuple[Case, float]:
    case = one_contact(rng)
    hit = rng.random(case.curvature.size) < share
    size = rng.uniform(6.0, 20.0, hit.size) * rng.choice([-1.0, 1.0], hit.size) * SIGMA
    return replace(case, curvature=case.curvature + hit * size), SIGMA


def _wrong_free(rng: np.random.Generator, error: float, _: float) -> tuple[Case, float]:
    case = one_contact(rng)
    return replace(case, curvature=case.curvature + _sign(rng) * error), SIGMA


def _wrong_gain(rng: np.random.Generator, spread: float, _: float) -> tuple[Case, float]:
    case = one_contact(rng)
    gains = 1.0 + spread * rng.standard_normal(case.curvature.size)
    return replace(case, curvature=case.curvature * gains), SIGMA


def _lost(rng: np.random.Generator, lost: float, _: float) -> tuple[Case, float]:
    case = one_contact(rng)
    readings = case.curvature.copy()
    readings[rng.permutation(readings.size)[: int(lost)]] = np.nan
    return replace(case, curvature=readings), SIGMA


def _quantised(rng: np.random.Generator, step: float, _: float) -> tuple[Case, float]:
    case = one_contact(rng)
    if step <= 0:
        return case, SIGMA
    return replace(case, curvature=np.round(case.curvature / step) * step), SIGMA


def _start_place(rng: np.random.Generator, _start: float, arc: float) -> tuple[Case, float]:
    """Half of the cases are folded at the base, which is what `clamped` and `coupled` are for."""
    folded = rng.random() < 0.5
    sign = _sign(rng)
    case = read(rng, (arc,), (sign * (1.0 if folded else 0.7) * CRITICAL / arc,))
    if folded:
        near = np.clip(case.position - SPAN / 2, 0.0, FOLD_CM)
        far = np.clip(case.position + SPAN / 2, 0.0, FOLD_CM)
        fold = sign * rng.uniform(0.1, 0.4) / FOLD_CM * (far - near) / SPAN
        case = replace(case, curvature=case.curvature + fold)
    return case, SIGMA


@dataclass(frozen=True)
class Stress:
    """One way of making it hard: a draw over one or two conditions with their labels.

    With `starts` the rows are arcs (cm) at which the methods start, on the same cases.
    """

    name: str
    draw: Draw
    row_label: str
    rows: tuple[float, ...]
    column_label: str = ""
    columns: tuple[float, ...] = (0.0,)
    methods: tuple[str, ...] = MAPPED
    starts: bool = False


STRESSES: tuple[Stress, ...] = (
    Stress(
        "force-place",
        _force_place,
        "base moment / critical",
        (0.1, 0.2, 0.4, 0.7, 1.0),
        "arc of the contact (cm)",
        (15.0, 20.0, 26.5, 33.0, 39.75, 46.0, 53.0),
    ),
    Stress(
        "noise-sensors",
        _noise_sensors,
        "noise (1/cm)",
        (0.0, 1e-4, 3e-4, 6e-4, 1.2e-3, 2.4e-3),
        "number of sensors",
        (2.0, 3.0, 4.0, 5.0, 7.0, 10.0),
    ),
    Stress(
        "separation-force",
        _separation_force,
        "separation of two contacts (cm)",
        (13.0, 18.5, 23.5, 29.0, 34.0, 39.0),
        "distal base moment / critical",
        (0.3, 0.6, 1.0, 1.5),
    ),
    Stress(
        "starting-point",
        _start_place,
        "starting point (cm)",
        (5.0, 15.0, 26.5, 40.0, 53.0),
        "arc of the contact (cm)",
        (15.0, 20.0, 26.5, 33.0, 39.75, 46.0, 53.0),
        STARTED,
        starts=True,
    ),
    Stress("layout", _layout, "centre of the first sensor (cm)", (1.0, 2.75, 5.0, 7.25)),
    Stress("outliers", _outliers, "share of outliers (6..20 sigma)", (0.0, 0.05, 0.1, 0.2, 0.3)),
    Stress(
        "free-curvature",
        _wrong_free,
        "error of the free curvature (1/cm)",
        (0.0, 2e-4, 5e-4, 1e-3, 2e-3),
    ),
    Stress("calibration", _wrong_gain, "spread of the gains", (0.0, 0.02, 0.05, 0.1, 0.2)),
    Stress("sensor-loss", _lost, "lost sensors of 10", (0.0, 1.0, 3.0, 5.0, 7.0)),
    Stress(
        "quantisation",
        _quantised,
        "step of the readings (1/cm)",
        (0.0, 2e-4, 4e-4, 8e-4, 1.6e-3, 3.2e-3),
    ),
)


def _cell(task: tuple[int, int, float, float, int, int, tuple[str, ...]]) -> np.ndarray:
    """Errors of all methods over one cell's cases: (cases, methods)."""
    which, cases, row, column, seed, key, methods = task
    rng = np.random.default_rng([seed, which, key])
    errors = np.empty((cases, len(methods)))
    for index in range(cases):
        case, noise = STRESSES[which].draw(rng, row, column)
        for m, method in enumerate(methods):
            start = row if STRESSES[which].starts else None
            errors[index, m] = attempt(case, method, noise=max(noise, 1e-6), start=start)[0]
    return errors


def _figure(
    stress: Stress, methods: tuple[str, ...], means: np.ndarray, fails: np.ndarray
) -> Figure:
    from matplotlib.figure import Figure

    if len(stress.columns) == 1:
        figure = Figure(figsize=(10, 4), layout="constrained")
        left, right = figure.subplots(1, 2)
        for m, method in enumerate(methods):
            style = {"linewidth": 2.4} if method == "exact" else {"linewidth": 1.0, "alpha": 0.8}
            left.plot(stress.rows, means[:, 0, m], marker="o", markersize=3, label=method, **style)
            right.plot(stress.rows, 100 * fails[:, 0, m], marker="o", markersize=3, **style)
        left.set(xlabel=stress.row_label, ylabel="mean error of the arc (cm)", ylim=(0, None))
        right.set(xlabel=stress.row_label, ylabel="failures (%)", ylim=(-2, 102))
        left.legend(fontsize=8)
        for axis in (left, right):
            axis.grid(alpha=0.2)
    else:
        figure = Figure(figsize=(3.1 * len(methods), 6.4), layout="constrained")
        axes = figure.subplots(2, len(methods), squeeze=False)
        for m, method in enumerate(methods):
            for axis, values, top, unit in (
                (axes[0][m], means[:, :, m], 15.0, "mean error (cm)"),
                (axes[1][m], 100 * fails[:, :, m], 100.0, "failures (%)"),
            ):
                image = axis.imshow(
                    values, origin="lower", aspect="auto", vmin=0, vmax=top, cmap="viridis"
                )
                for (r, c), value in np.ndenumerate(values):
                    text = (
                        "-" if np.isnan(value) else f"{value:.1f}" if top < 50 else f"{value:.0f}"
                    )
                    color = "black" if value > 0.6 * top else "white"
                    axis.text(c, r, text, ha="center", va="center", fontsize=6, color=color)
                axis.set_xticks(range(len(stress.columns)), [f"{v:g}" for v in stress.columns])
                axis.set_yticks(range(len(stress.rows)), [f"{v:g}" for v in stress.rows])
                axis.tick_params(labelsize=7)
                axis.set_xlabel(stress.column_label, fontsize=8)
                if m == 0:
                    axis.set_ylabel(stress.row_label, fontsize=8)
                if m == len(methods) - 1:
                    figure.colorbar(image, ax=axis, label=unit)
            axes[0][m].set_title(method, fontsize=9)
    figure.suptitle(
        f"Stability: {stress.name} (failure: no answer, or more than {FAILURE_CM:g} cm off)"
    )
    return figure


def _by_start(stress: Stress, methods: tuple[str, ...], errors: list[np.ndarray]) -> Figure:
    """Mean error and failures over the starting point, all places together.

    Args:
        errors: for each starting point (cases, methods).
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for m, method in enumerate(methods):
        width = 2.4 if method in ("exact", "l1") else 1.0
        scores = [mean_and_failures(some[:, m]) for some in errors]
        left.plot(stress.rows, [s[0] for s in scores], marker="o", label=method, linewidth=width)
        right.plot(stress.rows, [100 * s[1] for s in scores], marker="o", linewidth=width)
    left.set(xlabel=stress.row_label, ylabel="mean error of the arc (cm)", ylim=(0, None))
    right.set(
        xlabel=stress.row_label, ylabel=f"more than {FAILURE_CM:g} cm off (%)", ylim=(-2, 102)
    )
    left.legend(fontsize=8)
    for axis in (left, right):
        axis.grid(alpha=0.2)
    figure.suptitle(
        "The same readings (half of them with a folded base) from each starting point; "
        "exact and l1 take none"
    )
    return figure


def run(context: Context) -> Outcome:
    """The study: all stresses, all mapped methods."""
    cases = context.count(4, 40)
    outcome = Outcome()
    for which, stress in enumerate(STRESSES):
        methods = stress.methods
        tasks, shape = [], []
        for r, row in enumerate(stress.rows):
            for c, column in enumerate(stress.columns):
                key = c if stress.starts else r * len(stress.columns) + c
                # A general optimiser takes up to a second from a bad start.
                here = max(cases // 4, 1) if stress.starts else cases
                tasks.append((which, here, row, column, context.seed, key, methods))
                shape.append((r, c))
        cells = dict(zip(shape, context.map(_cell, tasks, stress.name), strict=True))
        means = np.empty((len(stress.rows), len(stress.columns), len(methods)))
        fails = np.empty_like(means)
        rows: list[tuple[float | str, ...]] = []
        for r, row in enumerate(stress.rows):
            for c, column in enumerate(stress.columns):
                errors = cells[r, c]
                for m, method in enumerate(methods):
                    means[r, c, m], fails[r, c, m] = mean_and_failures(errors[:, m])
                    rows.append((method, row, column, means[r, c, m], fails[r, c, m]))
        names = ("method", stress.row_label, stress.column_label or "-", "mean_cm", "failures")
        outcome.tables.append(Table(stress.name, names, list(rows)))
        context.save(Outcome([outcome.tables[-1]]))
        outcome.figures[stress.name] = _figure(stress, methods, means, fails)
        if stress.starts:
            columns = range(len(stress.columns))
            rows_of_cells = [
                np.concatenate([cells[r, c] for c in columns]) for r in range(len(stress.rows))
            ]
            outcome.figures["by-start"] = _by_start(stress, methods, rows_of_cells)
    return outcome
