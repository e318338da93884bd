"""No more than a scene needs: time and error of each model of the plant and the localizer.

Plant: random scenes of three kinds (free, gently touched, swept into a peg) are followed step by
step by `arc`, `beam`, `elastica` and the automatic choice at several tolerances. The error is the
largest distance along the final body from an elastica with a four times finer mesh.

Localizer: frames of one to three contacts are answered with each number of contacts, and with the
automatic choice. The error is the mean distance of each true contact from the nearest answered one,
and of each answered one from the nearest true one, 10 cm at most.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter, process_time
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thigmo.display.axes import GREEN
from thigmo.localization import Localizer
from thigmo.mechanics import ModelChoice, Peg, Rod, Tube
from thigmo_bench.studies import charts
from thigmo_bench.studies.attempt import FAILURE_CM
from thigmo_bench.studies.engine import Claim, Context, Outcome, Record
from thigmo_bench.studies.scenes import (
    LENGTH,
    ROBOT,
    SIGMA,
    SPAN,
    Case,
    actuated,
    one_contact,
    three_contacts,
    two_contacts,
)

_STEPS = 200
_KINDS = ("free", "touched gently", "swept into a peg")
_MODELS: dict[str, tuple[ModelChoice, float]] = {
    "arc": ("arc", 0.05),
    "beam": ("beam", 0.05),
    "elastica": ("elastica", 0.05),
    "auto, 1 cm": ("auto", 1.0),
    "auto, 0.2 cm": ("auto", 0.2),
    "auto, 0.05 cm": ("auto", 0.05),
}


# Rungs of the localizer: number of contacts, and method.
_RUNGS: dict[str, dict[str, Any]] = {
    "1 contact": {"contacts": 1},
    "2 contacts": {"contacts": 2},
    "3 contacts": {"contacts": 3},
    "auto": {"contacts": "auto"},
}
_FRAMES: dict[str, Callable[[np.random.Generator], Case]] = {
    "one contact, straight": one_contact,
    "one contact, bent": actuated,
    "two contacts": two_contacts,
    "three contacts": three_contacts,
}
_CALLS = 5  # calls that are timed together: one is too short for the clock
_LEAST_CM = 1e-3  # smaller errors are drawn as this


def scene(kind: str, seed: int) -> tuple[list[Peg], float]:
    """Pegs, and the free curvature (1/cm) at the end of the sweep."""
    rng = np.random.default_rng(seed)
    if kind == "free":
        return [], float(rng.uniform(-0.04, 0.04))
    g = float(rng.uniform(0.001, 0.004) if kind == "touched gently" else rng.uniform(0.015, 0.035))
    x = float(rng.uniform(15.0, 45.0))
    # Where the free body would be at a third to two thirds of the sweep.
    reach = 0.5 * g * float(rng.uniform(0.3, 0.7)) * x**2
    return [Peg(x, 1.75 + 0.6 + max(reach, 0.05), 0.6)], g


def follow(pegs: list[Peg], g: float, model: ModelChoice, tolerance: float, cell: float) -> Rod:
    """Sweep from straight to g in equal steps."""
    body = Rod(Tube(3.5, 0.01108), pegs, model=model, tolerance_cm=tolerance, cell_cm=cell)
    for k in range(_STEPS + 1):
        body.step(g * k / _STEPS, LENGTH)
    return body


def compare_models(seed: int, kind: str) -> list[tuple[float, float, str]]:
    """For every model on one scene: time of a step (us), error (cm), and the models used."""
    pegs, g = scene(kind, seed)
    arcs = np.linspace(0.0, LENGTH, 107)[1:].tolist()
    exact = follow(pegs, g, "elastica", 0.05, 0.25)
    runs = []
    for model, tolerance in _MODELS.values():
        began = perf_counter()
        body = follow(pegs, g, model, tolerance, 1.0)
        step_us = (perf_counter() - began) / _STEPS * 1e6
        off = [np.subtract(body.pose(s)[:2], exact.pose(s)[:2]) for s in arcs]
        error = float(np.hypot(*np.transpose(off)).max())
        runs.append((step_us, error, "+".join(sorted(body.counts))))
    return runs


def time_localizer(seed: int, kind: str) -> list[tuple[float, float, str]]:
    """For every rung on one frame: time of a call (us), error (cm), and the number of contacts."""
    case = _FRAMES[kind](np.random.default_rng(seed))
    runs = []
    for settings in _RUNGS.values():
        localizer = Localizer.of(
            position=case.position, length=LENGTH, span=SPAN, noise=SIGMA, **settings, **ROBOT
        )
        began = process_time()
        for _ in range(_CALLS):
            result = localizer.localize(case.curvature, free_curvature=case.free)
        call_us = (process_time() - began) / _CALLS * 1e6
        arcs = [contact.arc for contact in result.contacts]
        runs.append((call_us, _mean_distance(arcs, case.arcs), str(len(arcs))))
    return runs


def _mean_distance(arcs: Sequence[float], true: Sequence[float]) -> float:
    if not arcs:
        return FAILURE_CM
    distance = np.minimum(np.abs(np.subtract.outer(arcs, true)), FAILURE_CM)
    return float(np.concatenate([distance.min(axis=0), distance.min(axis=1)]).mean())


def ladder(rows: Sequence[Record]) -> Figure:
    """Error against time of each rung, a panel a kind of scene; the automatic choice is green."""
    figure, axes = charts.panels(
        4, 2, size=(3.7, 2.3),
        title="No more than a scene needs: the localizer's rungs (left) and the plant's (right)",
    )  # fmt: skip
    columns = (axes[0::2], list(_FRAMES)), (axes[1::2], list(_KINDS))
    drawn = []
    for panels, scenes in columns:
        for axis, name in zip(panels, scenes, strict=False):
            drawn.append((axis, [row for row in rows if row["scene"] == name]))
            _draw(*drawn[-1])
    axes[-1].set_axis_off()
    axes[-1].text(
        0.0, 0.5, "Dots: mean error. Green: the automatic choice, and what\nit chose most often: "
        "the number of contacts, or the models\nof the plant, which takes the error (cm) that it "
        "may make.\nErrors below 0.001 cm are drawn at 0.001.", fontsize=8, va="center",
    )  # fmt: skip
    figure.draw_without_rendering()
    for axis, panel_rows in drawn:
        names = [_name(row) for row in panel_rows]
        charts.named(axis, [_point(row) for row in panel_rows], names, [])
    return figure


def _auto(row: Record) -> bool:
    return str(row["model"]).startswith("auto")


def _name(row: Record) -> str:
    name = str(row["model"])
    if not _auto(row):
        return name
    # A body is an arc until it is touched.
    return f"{name.removesuffix(' cm').replace(',', '')}: {str(row['used']).removeprefix('arc+')}"


def _point(row: Record) -> tuple[float, float]:
    return float(row["step_us"]), max(float(row["mean_cm"]), _LEAST_CM)


def _draw(axis: Axes, rows: Sequence[Record]) -> None:
    times, errors = np.array([_point(row) for row in rows]).T
    axis.scatter(times, errors, s=16, color=[GREEN if _auto(row) else "0.5" for row in rows])
    axis.set(
        xscale="log", yscale="log", title=rows[0]["scene"], xlabel="time of a call or step (µs)",
        ylabel="error (cm)", xlim=(times.min() / 10, times.max() * 100),
        ylim=(errors.min() / 2, errors.max() * 2),
    )  # fmt: skip
    axis.yaxis.set_major_formatter("{x:g}")
    if errors.max() < 10 * errors.min():
        axis.yaxis.set_minor_formatter("{x:g}")
    axis.tick_params(axis="y", which="both", labelsize=7)


def _rows(
    kind: str, ways: Sequence[str], runs: Sequence[Sequence[tuple[float, float, str]]]
) -> list[Record]:
    rows: list[Record] = []
    for setting, *outcomes in zip(ways, *runs, strict=True):
        times, errors, used = zip(*outcomes, strict=True)
        usual, count = Counter(used).most_common(1)[0]
        share = "" if count == len(outcomes) else f" ({100 * count // len(outcomes)} %)"
        rows.append({
            "scene": kind, "model": setting, "step_us": round(float(np.median(times)), 2),
            "mean_cm": float(np.mean(errors)), "worst_cm": max(errors), "cases": len(outcomes),
            "used": f"{usual}{share}",
        })  # fmt: skip
    return rows


def run(context: Context) -> Outcome:
    """Time against error of the plant's models and of the localizer's numbers of contacts."""
    count = context.count(5, 40)
    rows: list[Record] = []
    touched: list[float] = []
    excess: list[float] = []
    for number, kind in enumerate(_KINDS):
        seeds = [int(s) for s in context.rng(number).integers(0, 2**31, count)]
        runs = context.map(partial(compare_models, kind=kind), seeds, kind)
        rows += _rows(kind, list(_MODELS), runs)
        for (model, tolerance), *outcomes in zip(_MODELS.values(), *runs, strict=True):
            if model == "auto":
                excess += [error - tolerance for _, error, used in outcomes if used != "arc"]
            if model == "elastica" and kind != "free":
                touched += [time for time, *_ in outcomes]
    for number, kind in enumerate(_FRAMES, start=len(_KINDS)):
        seeds = [int(s) for s in context.rng(number).integers(0, 2**31, context.count(10, 400))]
        rows += _rows(
            kind, list(_RUNGS), context.map(partial(time_localizer, kind=kind), seeds, kind)
        )
    return Outcome(
        {"models": rows},
        {"ladder": ladder(rows)},
        claims=[
            Claim("error above the stated tolerance, worst scene", max(excess), 0.0, unit="cm"),
            Claim("a warm elastica step among pegs", float(np.median(touched)), 150.0, unit="us"),
        ],
    )
