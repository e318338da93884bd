"""Where methods fail: mean error and failure rate as one thing after another gets harder.

The maps are over two conditions (force x place, noise x number of sensors, separation x force,
starting point x place) or over one (sensor layout, lost sensors). Every method sees the same
readings. The map over starting points has the same readings in every row, and only the methods that
need a starting point. The thesis's sensitivity study (`experiments/sensitivity.py`) is one more
such map.

One chart shows effects of room and calibration that are not stated to any method: walls, friction,
a wrong map of the muscle, wrong gains, and weak touches at the tip. It compares ours with the
thesis's solver and exact least squares, each given the number of contacts. One map has the mistakes
of the study `mistakes`; ours is asked twice, with nothing stated of the errors and with errors
stated as 0.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from textwrap import fill

import numpy as np
from matplotlib.figure import Figure

from thigmo.localization import METHODS
from thigmo.mechanics import Peg, Rod, Solution, Tube
from thigmo_bench.studies import charts
from thigmo_bench.studies.attempt import (
    FAILURE_CM,
    UNSTATED,
    attempt,
    mean_and_failures,
    mean_over,
)
from thigmo_bench.studies.contact_scenes import one_contact as rubbed
from thigmo_bench.studies.engine import Claim, Context, Outcome, Record
from thigmo_bench.studies.mistakes import TOUCHED_KINDS, draw
from thigmo_bench.studies.rod import Floats
from thigmo_bench.studies.scenes import (
    COLUMN,
    CRITICAL,
    FULL_CURVATURE,
    LENGTH,
    RADIUS,
    SIGMA,
    SPAN,
    Case,
    actuated,
    one_contact,
    read,
    side_of,
)

Draw = Callable[[np.random.Generator, float, float], tuple[Case, float]]
"""Case and the noise that the method is given, for a row and a column condition."""

DEFAULT = METHODS[0]
# Methods quick enough to map; the speed-accuracy chart has the others.
MAPPED = (*METHODS, "l1", "l2", "coordinate", "grid", "slsqp", "pwlf")
# Methods that start somewhere, beside two that do not.
STARTLESS = (DEFAULT, "l1")
STARTED = (*STARTLESS, "alternating", "clamped", "coupled", "slsqp", "nelder-mead")
FOLD_CM = 3.5  # the fold at the base is spread over one body diameter


def _pressed(rng: np.random.Generator, **options: Floats | float) -> Case:
    """One contact anywhere, at 0.7 of the critical moment."""
    arc = float(rng.uniform(20.0, LENGTH))
    return read(rng, (arc,), (side_of(rng) * 0.7 * CRITICAL / arc,), **options)  # type: ignore[arg-type]


def _force_place(rng: np.random.Generator, moment: float, arc: float) -> tuple[Case, float]:
    return read(rng, (arc,), (side_of(rng) * moment * CRITICAL / arc,)), SIGMA


def _noise_sensors(rng: np.random.Generator, sigma: float, sensors: float) -> tuple[Case, float]:
    return _pressed(rng, position=np.linspace(5.0, 45.0, int(sensors)), sigma=sigma), sigma


def _separation_force(rng: np.random.Generator, gap: float, moment: float) -> tuple[Case, float]:
    proximal = LENGTH - gap
    force = side_of(rng) * moment * CRITICAL / LENGTH
    return read(rng, (proximal, LENGTH), (-force * LENGTH / proximal, 1.5 * force)), SIGMA


def _layout(rng: np.random.Generator, first: float, _: float) -> tuple[Case, float]:
    return _pressed(rng, position=np.tile(first + 10.0 * np.arange(5), 2)), SIGMA


def _sensor_loss(rng: np.random.Generator, count: float, _: float) -> tuple[Case, float]:
    case = one_contact(rng)
    remaining = np.where(rng.permutation(case.curvature.size) < count, np.nan, case.curvature)
    return replace(case, curvature=remaining), SIGMA


def _start_place(rng: np.random.Generator, _start: float, arc: float) -> tuple[Case, float]:
    """A case for a starting point; half are folded at the base, for `clamped` and `coupled`."""
    folded = rng.random() < 0.5
    sign = side_of(rng)
    case = read(rng, (arc,), (sign * (1.0 if folded else 0.7) * CRITICAL / arc,))
    if folded:
        near = np.clip(case.position - SPAN / 2, 0.0, FOLD_CM)
        far = np.clip(case.position + SPAN / 2, 0.0, FOLD_CM)
        fold = sign * rng.uniform(0.1, 0.4) / FOLD_CM * (far - near) / SPAN
        case = replace(case, curvature=case.curvature + fold)
    return case, SIGMA


def _against_wall(rng: np.random.Generator, share: float, _: float) -> tuple[Case, float]:
    """A body bent into a smooth wall, by a multiple of the free curvature at which it touched.

    The wall is a row of thin dowels at any angle; its place is that of the strongest contact.
    """
    while True:
        turn, size = rng.uniform(-0.6, 0.6), rng.uniform(10.0, 40.0)
        spacing = np.arange(0.0, size, 0.5)
        x, y = rng.uniform(10.0, 40.0), rng.uniform(4.0, 15.0)
        places = zip(x + spacing * np.cos(turn), y + spacing * np.sin(turn), strict=True)
        pegs = [Peg(px, py, 0.4) for px, py in places if py > RADIUS + 0.5]
        body, end = Rod(Tube(2.0 * RADIUS), pegs), np.inf
        for free in np.arange(0.0, FULL_CURVATURE, 5e-4).tolist():
            body.step(free, LENGTH)
            if not np.isfinite(end) and body.contacts():
                end = share * free
            if free >= end:
                break
        strongest = max(body.contacts(), key=lambda contact: abs(contact.normal), default=None)
        if free < end or strongest is None or abs(body.base_moment) > CRITICAL:
            continue
        clean = Solution(body).averages(COLUMN, SPAN)
        noisy = clean + SIGMA * rng.standard_normal(COLUMN.size)
        return Case(noisy, COLUMN, free, (strongest.arc,)), SIGMA


def _rubbed(rng: np.random.Generator, friction: float, _: float) -> tuple[Case, float]:
    arc, free = rng.uniform(30.0, LENGTH), rng.uniform(0.02, FULL_CURVATURE)
    force, rubs = -rng.uniform(0.3, 1.0) * CRITICAL / arc, friction * side_of(rng)
    scene = rubbed(np.array([arc]), np.array([force]), np.array([free]), COLUMN, rubs)
    noisy = scene.curvature[0] + SIGMA * rng.standard_normal(COLUMN.size)
    return Case(noisy, COLUMN, free, (arc,)), SIGMA


def _wrong_map(rng: np.random.Generator, map_error: float, _: float) -> tuple[Case, float]:
    case = actuated(rng)
    return replace(case, free=(case.free or 0.0) * (1.0 + map_error)), SIGMA


def _wrong_gains(rng: np.random.Generator, size: float, _: float) -> tuple[Case, float]:
    case = actuated(rng)
    gains = 1.0 + size * rng.standard_normal(case.curvature.size)
    return replace(case, curvature=case.curvature * gains), SIGMA


def _weak_at_tip(rng: np.random.Generator, moment: float, _: float) -> tuple[Case, float]:
    return _force_place(rng, moment, LENGTH)


def _mistaken(rng: np.random.Generator, number: float, _: float) -> tuple[Case, float]:
    kind = tuple(TOUCHED_KINDS.values())[int(number)]
    body = kind.bodies[-1]
    frame = draw(rng, kind, body, 1)
    free = None if frame.given.free is None else float(frame.given.free[0])
    arcs = tuple(frame.contacts[0].tolist())
    case = Case(frame.given.curvature[0], body.position, free, arcs, body.span)
    return case, kind.noise * SIGMA


@dataclass(frozen=True)
class Stress:
    """One kind of difficulty: draws cases over one or two conditions, with labels.

    With `starts`, the rows are starting arcs (cm) of the methods, on the same cases. With `names`,
    rows are numbers of these names.
    """

    name: str
    draw: Draw
    row_label: str
    rows: tuple[float, ...]
    column_label: str = "-"
    columns: tuple[float, ...] = (0.0,)
    methods: tuple[str, ...] = MAPPED
    starts: bool = False
    names: tuple[str, ...] = ()

    def row_name(self, row: float) -> float | str:
        """A row as tables and charts show it."""
        return self.names[int(row)] if self.names else row


_ARCS = ("arc of the contact (cm)", (15.0, 20.0, 26.5, 33.0, 39.75, 46.0, 53.0))
_NOISES = (0.0, 1e-4, 3e-4, 6e-4, 1.2e-3, 2.4e-3)
_GAPS = (13.0, 18.5, 23.5, 29.0, 34.0, 39.0)
STRESSES: tuple[Stress, ...] = (
    Stress(
        "force-place", _force_place, "base moment / critical", (0.1, 0.2, 0.4, 0.7, 1.0), *_ARCS
    ),
    Stress(
        "noise-sensors", _noise_sensors, "noise (1/cm)", _NOISES,
        "number of sensors", (2.0, 3.0, 4.0, 5.0, 7.0, 10.0),
    ),
    Stress(
        "separation-force", _separation_force, "separation of two contacts (cm)", _GAPS,
        "distal base moment / critical", (0.3, 0.6, 1.0, 1.5),
    ),
    Stress(
        "starting-point", _start_place, "starting point (cm)", (5.0, 15.0, 26.5, 40.0, 53.0),
        *_ARCS, STARTED, starts=True,
    ),
    Stress("layout", _layout, "centre of the first sensor (cm)", (1.0, 2.75, 5.0, 7.25)),
    Stress("sensor-loss", _sensor_loss, "lost sensors of 10", (0.0, 1.0, 3.0, 5.0, 7.0)),
    Stress(
        "mistakes", _mistaken, "mistake", tuple(map(float, range(len(TOUCHED_KINDS)))),
        methods=(UNSTATED, *MAPPED), names=tuple(TOUCHED_KINDS),
    ),
)  # fmt: skip
# What one chart has together, and the methods in it.
RIVALS = {UNSTATED: "ours", "alternating": "the thesis's solver", "l2": "least squares"}
HARDER: tuple[Stress, ...] = tuple(
    Stress(name, draw, label, rows, methods=tuple(RIVALS))
    for name, draw, label, rows in (
        ("wall", _against_wall, "bend over that at the touch", (1.1, 1.25, 1.5, 2.0, 3.0)),
        ("friction", _rubbed, "coefficient of friction", (0.0, 0.2, 0.4, 0.6, 0.9)),
        ("wrong map", _wrong_map, "free curvature believed, off by",
         (-0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2)),
        ("wrong gains", _wrong_gains, "standard deviation of the gains",
         (0.0, 0.03, 0.05, 0.1, 0.2)),
        ("weak touch at the tip", _weak_at_tip, "base moment / critical",
         (0.05, 0.1, 0.15, 0.2, 0.3, 0.5)),
    )
)  # fmt: skip


def _cell(task: tuple[Stress, int, int, int, int]) -> Floats:
    """Errors of all methods over one cell's cases: (cases, methods)."""
    stress, r, c, cases, seed = task
    # The same cases from every starting point.
    key = [seed, zlib.crc32(stress.name.encode()), c if stress.starts else r * 1000 + c]
    rng = np.random.default_rng(key)
    row, column = stress.rows[r], stress.columns[c]
    start = row if stress.starts else None
    drawn = (stress.draw(rng, row, column) for _ in range(cases))
    return np.array([
        [attempt(case, m, noise=max(noise, 1e-6), start=start)[0] for m in stress.methods]
        for case, noise in drawn
    ])  # fmt: skip


def errors_of(context: Context, stress: Stress, cases: int) -> Floats:
    """Errors (cm) of every method on every case: (rows, columns, cases, methods)."""
    shape = len(stress.rows), len(stress.columns)
    tasks = [(stress, r, c, cases, context.seed) for r, c in np.ndindex(shape)]
    errors = np.array(context.map(_cell, tasks, stress.name, lambda task: cases))
    return errors.reshape(*shape, cases, len(stress.methods))


def _scores(errors: Floats) -> dict[str, float]:
    mean, failures = mean_and_failures(errors)
    return {"mean_cm": mean, "failures": failures}


def tabulate(stress: Stress, errors: Floats) -> list[Record]:
    """A row for each method and cell."""
    cells = product(enumerate(stress.rows), enumerate(stress.columns))
    return [
        {"method": method, stress.row_label: stress.row_name(row), stress.column_label: column,
         **_scores(errors[r, c, :, m])}
        for (r, row), (c, column) in cells
        for m, method in enumerate(stress.methods)
    ]  # fmt: skip


def pooled(stress: Stress, errors: Floats) -> list[Record]:
    """A row for each method, over all cells."""
    flat = errors.reshape(-1, len(stress.methods))
    return [
        {"stress": stress.name, "method": method, "cases": len(flat), **_scores(method_errors),
         "default_over_it": mean_over(flat[:, 0], method_errors)}
        for method, method_errors in zip(stress.methods, flat.T, strict=True)
    ]  # fmt: skip


_MEASURES = (("mean error (cm)", 15.0), (f"no answer, or > {FAILURE_CM:g} cm (%)", 100.0))
_ABREAST = 4  # panels in a row, so that the numbers in the cells can be read in print


def _title(stress: Stress, errors: Floats) -> str:
    """The mean error over all cells: of the default method, and of the best and the worst other."""
    means = {
        method: mean_and_failures(errors[..., m].ravel())[0]
        for m, method in enumerate(stress.methods)
    }
    default, *others = means
    named = sorted((m for m in others if np.isfinite(means[m])), key=means.__getitem__)
    words = dict(zip(named[:1] + named[-1:], ("best other", "worst"), strict=False))
    ends = [f"{word} {method} {means[method]:.1f} cm" for method, word in words.items()]
    return ", ".join([f"Mean error over all cells: {default} {means[default]:.1f} cm", *ends])


def _figure(stress: Stress, errors: Floats) -> Figure:
    """A map of the cells for each method: mean error above, failures below."""
    methods = stress.methods
    figure, axes = charts.panels(
        2 * -(-len(methods) // _ABREAST), _ABREAST, size=(1.9, 1.8), share="all",
        title=_title(stress, errors),
    )  # fmt: skip
    rows = np.reshape(np.array(axes), (-1, _ABREAST))
    columns = [f"{v:g}" for v in stress.columns] if len(stress.columns) > 1 else [""]
    labels = stress.names or [f"{v:g}" for v in stress.rows]
    for axis in axes:
        axis.set_axis_off()
    for m, method in enumerate(methods):
        block, column = divmod(m, _ABREAST)
        for measure, (label, top) in enumerate(_MEASURES):
            row = rows[2 * block + measure]
            axis = row[column]
            axis.set_axis_on()
            axis.set_title(f"{method}: {'failures' if measure else 'error'}")
            values = np.array([[mean_and_failures(e)[measure] for e in r] for r in errors[..., m]])
            values *= 100.0 if measure else 1.0
            image = charts.cells(
                axis, values, labels, columns,
                texts=[[_short(v, measure) for v in r] for r in values],
                vmin=0.0, vmax=top, origin="lower",
            )  # fmt: skip
            if column == 0:
                axis.set_ylabel(fill(stress.row_label, 24))
                bar = figure.colorbar(image, ax=row.tolist())
                bar.set_label(label, fontsize=7)
                bar.ax.tick_params(labelsize=6)
            if measure and m + _ABREAST >= len(methods) and len(columns) > 1:
                axis.set_xlabel(stress.column_label)
    return figure


def _unstated_figure(errors: dict[str, Floats]) -> Figure:
    """A column for each stress: mean error above, failures below, a line for each method."""
    figure, axes = charts.panels(
        2, len(HARDER), size=(1.5, 2.3),
        title="Errors that nobody states: mean error (above) and failures (below) as each grows",
    )  # fmt: skip
    tops = [0.0, 100.0]
    for column, stress in enumerate(HARDER):
        for measure, (label, _) in enumerate(_MEASURES):
            axis = axes[measure * len(HARDER) + column]
            values = np.array([
                [mean_and_failures(row[:, m])[measure] for m in range(len(RIVALS))]
                for row in errors[stress.name][:, 0]
            ])  # fmt: skip
            values *= 100.0 if measure else 1.0
            tops[measure] = max(tops[measure], 1.1 * float(np.nanmax(values)))
            lines = {
                name: zip(stress.rows, series, strict=True)
                for name, series in zip(RIVALS.values(), values.T, strict=True)
            }
            charts.curves(axis, lines)
            if measure:
                axis.set_xlabel(fill(stress.row_label, 16), fontsize=7)
            else:
                axis.set_title(fill(stress.name, 12), fontsize=8)
            if column == 0:
                axis.set_ylabel(fill(label, 28), fontsize=7)
            else:
                axis.tick_params(labelleft=False)
    for number, axis in enumerate(axes):
        axis.set_ylim(-0.03 * tops[number >= len(HARDER)], tops[number >= len(HARDER)])
        axis.tick_params(labelsize=6)
    charts.legend_below(figure)
    return figure


def _short(value: float, measure: int) -> str:
    """The number in at most three characters, which fit a cell."""
    if np.isnan(value):
        return "-"
    return f"{value:.0f}" if measure or value >= 9.95 else f"{value:.1f}"


def run(context: Context) -> Outcome:
    """The study: all stresses, all mapped methods."""
    cases = context.count(2, 20)
    outcome = Outcome()
    lines: list[Record] = []
    unstated: dict[str, Floats] = {}
    for stress in (*HARDER, *STRESSES):
        # A general optimiser takes long from a bad start, and three quick methods do not.
        case_count = (
            max(cases // 4, 1) if stress.starts else 5 * cases if stress in HARDER else cases
        )
        errors = errors_of(context, stress, case_count)
        outcome.tables[stress.name] = tabulate(stress, errors)
        _, *other_rows = over_all = pooled(stress, errors)
        lines += over_all
        if stress in HARDER:
            unstated[stress.name] = errors
        else:
            largest, best = max(
                (float(line["default_over_it"]), line["method"]) for line in other_rows
            )
            text = "default method's mean error over that of the best other"
            outcome.claims.append(Claim(f"{stress.name}: {text} ({best})", largest, 1.0))
            outcome.figures[stress.name] = _figure(stress, errors)
        context.save(Outcome({stress.name: outcome.tables[stress.name]}, claims=outcome.claims))
    outcome.tables["rows"] = lines
    outcome.figures["unstated"] = _unstated_figure(unstated)
    return outcome
