"""Figures of the calibration steps: data, fit, and what was omitted."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import singledispatch
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thigmo.calibrate.actuator import ActuatorResult, ActuatorResults
from thigmo.calibrate.base import BaseResult
from thigmo.calibrate.bending import BendingResult
from thigmo.calibrate.buckling import BucklingResult
from thigmo.calibrate.columns import Array
from thigmo.calibrate.encoder import EncoderResult
from thigmo.calibrate.flex import FlexResult
from thigmo.calibrate.heading import HeadingResult
from thigmo.calibrate.hysteresis import HysteresisResult
from thigmo.calibrate.noise import NoiseResult
from thigmo.calibrate.stiffness import StiffnessResult
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.display.axes import BLUE, CYCLE, GREEN, ORANGE, RED
from thigmo.errors import DataError
from thigmo.files import whole_file

_MARK = {"straight": ("s", "0.5"), "tip": ("o", BLUE), "bend": ("^", GREEN)}


def _finish(figure: Figure, path: Path, verdict: Verdict) -> None:
    mark, color = ("good", "black") if verdict.good else ("BAD", RED)
    figure.suptitle(f"{mark}: {verdict.reason}", fontsize=10, color=color, wrap=True)
    with (
        DataError.from_os(f"cannot write {path}", "choose another folder"),
        whole_file(path) as file,
    ):
        figure.savefig(file, format="png", dpi=110)


@contextmanager
def _panel(
    path: Path, verdict: Verdict, x: str, y: str, size: tuple[float, float] = (6, 4)
) -> Iterator[Axes]:
    """Axes of a figure that is labelled and written at the end of the block."""
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots()
    yield axes
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    crowded = len(axes.get_legend_handles_labels()[0]) > 6
    axes.legend(fontsize=7 if crowded else None, ncols=2 if crowded else 1)
    _finish(figure, path, verdict)


def _estimates(axes: Axes, estimates: Array, mean: float, se: float) -> None:
    """Draw every estimate, their mean, and its 95 % interval."""
    axes.plot(np.arange(1, len(estimates) + 1), estimates, "o", label="each alone")
    if np.isfinite(mean):
        axes.axhline(mean, color="k", lw=1, label="mean")
        axes.axhspan(mean - 1.96 * se, mean + 1.96 * se, color="k", alpha=0.1)


@singledispatch
def draw(result: StepResult, path: Path) -> None:
    """Draw a step's data and fit; nothing where nothing is fitted. Raises DataError."""


@draw.register
def _flex(result: FlexResult, path: Path) -> None:
    readings, good, sides = result.rows.readings, result.rows.good, result.rows.sides
    counts = [sides.count(side) for side in dict.fromkeys(sides)]
    figure = Figure(figsize=(3.0 * max(counts), 3.2 * len(counts)), layout="constrained")
    grid = figure.subplots(len(counts), max(counts), squeeze=False)
    places = [(row, k) for row, count in enumerate(counts) for k in range(count)]
    for axes in grid.flat:
        axes.set_visible(False)  # where a column has fewer sensors than the other
    kinds, active = np.array(readings.kind), np.array(readings.active)
    for column, (fit, side, place) in enumerate(zip(result.sensors, sides, places, strict=True)):
        axes = grid[place]
        axes.set_visible(True)
        k, ohm = result.rows.model[:, column], readings.ohm[:, column] / 1000
        for kind, (mark, color) in _MARK.items():
            pick = (kinds == kind) & (active != side) & good
            axes.plot(k[pick], ohm[pick], mark, color=color, ms=4, label=kind)
        axes.plot(k[~good], ohm[~good], "x", color=RED, ms=5, label="omitted")
        if fit.healthy:
            line = np.array([np.nanmin(k), np.nanmax(k)])
            if fit.bend_sign:
                line[int(fit.bend_sign < 0)] = 0.0
            axes.plot(line, (fit.zero_ohm + line / fit.scale_per_ohm) / 1000, "k-", lw=1)
        values = ohm[np.isfinite(ohm) & good]
        if len(values):
            low, high = (float(v) for v in np.quantile(values, [0.02, 0.98]))
            margin = max(0.4 * (high - low), 0.2)
            axes.set_ylim(low - margin, high + margin)
        axes.set_title(f"{fit.name}: {fit.reason}", fontsize=7, wrap=True)
        axes.set_xlabel("curvature (1/cm)", fontsize=7)
        axes.tick_params(labelsize=6)
        if place[1] == 0:
            axes.set_ylabel("resistance (kOhm)", fontsize=7)
    next(axes for axes in grid.flat if axes.get_visible()).legend(fontsize=6)
    _finish(figure, path, result.verdict)


@draw.register
def _actuator(result: ActuatorResult, path: Path) -> None:
    r, used = result.readings, result.used
    branch = np.array(r.branch)
    grid = np.linspace(0, max(20.0, float(np.nanmax(r.pressure_psi))), 200)
    labels = "muscle pressure (psi)", "free curvature towards it (1/cm)"
    with _panel(path, result.verdict, *labels, size=(7, 4.5)) as axes:
        for name, mark, color in (("inflate", "^", BLUE), ("deflate", "v", ORANGE)):
            pick, curve = (branch == name) & used, getattr(result.muscle_map, name)
            axes.plot(r.pressure_psi[pick], r.curvature[pick], mark, color=color, ms=4, label=name)
            axes.plot(grid, [curve.curvature(p) for p in grid], "-", color=color, lw=1)
        axes.plot(r.pressure_psi[~used], r.curvature[~used], "x", color=RED, label="omitted")
        axes.set_title(
            f"{r.muscle} muscle at {r.body_pressure_psi:g} psi of body pressure", fontsize=9
        )


@draw.register
def _actuators(results: ActuatorResults, path: Path) -> None:
    for result in results.maps:
        r = result.readings
        muscle = "".join(letter if letter.isalnum() else "_" for letter in r.muscle)
        name = f"{path.stem}-{muscle}-{r.body_pressure_psi:g}psi.png"
        _actuator(result, path.with_name(name))


@draw.register
def _base(result: BaseResult, path: Path) -> None:
    labels = "moment at the base over EI (1/cm)", "turn of the base (rad)"
    with _panel(path, result.verdict, *labels) as axes:
        for pick, mark, color, label in (
            (result.used, "o", BLUE, "push"), (~result.used, "x", RED, "omitted"),
        ):  # fmt: skip
            axes.plot(result.moment[pick], result.turn_rad[pick], mark, color=color, label=label)
        low, high = float(result.moment.min()), float(result.moment.max())
        line = np.array([low, high])
        axes.plot(line, result.compliance_cm * line, "k-", lw=1, label="compliance")


@draw.register
def _buckling(result: BucklingResult, path: Path) -> None:
    with _panel(path, result.verdict, "trial", "critical curvature (1/cm)") as axes:
        _estimates(axes, result.trial_curvature, result.critical_curvature, result.critical_se)
        axes.axhline(0.01108, color=RED, ls=":", label="thesis")


@draw.register
def _heading(result: HeadingResult, path: Path) -> None:
    labels = "turn of the span by camera (rad)", "turn that its IMUs say (rad), without drift"
    with _panel(path, result.verdict, *labels, size=(6, 5)) as axes:
        for number, fit in enumerate(result.sensors):
            color, name = CYCLE[number % len(CYCLE)], fit.name
            axes.plot(*fit.turns, ".", ms=4, color=color, label=name)
            line = np.array([fit.turns[0].min(initial=0.0), fit.turns[0].max(initial=0.0)])
            axes.plot(line, line / fit.scale, "-", lw=0.5, color=color)


@draw.register
def _hysteresis(result: HysteresisResult, path: Path) -> None:
    labels = "time since eversion (s)", "reading less its rest (1/cm)"
    with _panel(path, result.verdict, *labels, size=(8, 4.5)) as axes:
        for number, record in enumerate(result.records):
            color = CYCLE[number % len(CYCLE)]
            resting = float(np.nanmedian(record.curvature[-max(3, len(record.curvature) // 8) :]))
            axes.plot(record.t_s, record.curvature - resting, ".", ms=2, color=color)
        t = np.linspace(0, max(float(r.t_s.max()) for r in result.records), 200)
        for fit in result.sensors:
            axes.plot(t, fit.law.excess(t)[0], "-", lw=1, label=fit.name)


@draw.register
def _stiffness(result: StiffnessResult, path: Path) -> None:
    with _panel(path, result.verdict, "picture", "stiffness under sensors / in gaps") as axes:
        _estimates(axes, result.picture_ratio, result.ratio, result.ratio_se)
        axes.axhline(1.0, color="0.5", ls=":")


@draw.register
def _bending(result: BendingResult, path: Path) -> None:
    if result.pull_stiffness.size:
        with _panel(path, result.verdict, "pull", "bending stiffness EI (N cm²)") as axes:
            _estimates(
                axes, result.pull_stiffness, result.stiffness_n_cm2, result.stiffness_se_n_cm2
            )


@draw.register
def _noise(result: NoiseResult, path: Path) -> None:
    with _panel(path, result.verdict, "", "one sigma (1/cm)", size=(8, 4)) as axes:
        x, sensors = np.arange(len(result.sensors)), result.sensors
        axes.bar(x - 0.2, [s.white for s in sensors], 0.4, label="white")
        swept = np.nan_to_num([s.hysteresis for s in sensors])
        axes.bar(x + 0.2, swept, 0.4, label="within a sweep")
        axes.set_xticks(x, [s.name for s in sensors], rotation=45, fontsize=7)


@draw.register
def _encoder(result: EncoderResult, path: Path) -> None:
    with _panel(path, result.verdict, "length by camera (cm)", "encoder counts") as axes:
        for pick, marker, label in ((result.used, "o", "used"), (~result.used, "x", "omitted")):
            color = BLUE if marker == "o" else RED
            axes.plot(result.length_cm[pick], result.counts[pick], marker, color=color, label=label)
